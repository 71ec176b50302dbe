"""The time from the start of a process to the first effort."""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from time import perf_counter

import numpy as np
from robot_files import STANFORD

# The time of a step includes the imports that no earlier step needed.
STEPS = (
    ('import numpy', 'import numpy'),
    ('import numba', 'import numba'),
    ('import inverse_dynamics_node', 'import inverse_dynamics_node as ours'),
    ('import yourdfpy, at the first URDF', 'import yourdfpy'),
    ('read the URDF', f'robot = ours.load_urdf({str(STANFORD)!r})'),
    ('compiled code: load or compile', 'dynamics = ours.InverseDynamics(robot)'),
    ('first effort', 'dynamics.efforts(*numpy.zeros((3, len(robot.joint_names))))'),
)
START = 'Python itself, start and end'
TOTAL = 'total'


def run(cache: str) -> dict[str, float]:
    """Run the steps once; return the time of each step [s]."""
    lines = ['import json', 'from time import perf_counter', 'times = [perf_counter()]']
    for _, code in STEPS:
        lines += [code, 'times.append(perf_counter())']
    lines.append('print(json.dumps(times))')
    start = perf_counter()
    answer = subprocess.run(
        [sys.executable, '-c', '\n'.join(lines)],
        env={**os.environ, 'NUMBA_CACHE_DIR': cache},
        check=True,
        capture_output=True,
        text=True,
    )
    total = perf_counter() - start
    times = json.loads(answer.stdout)
    steps = dict(zip([name for name, _ in STEPS], np.diff(times).tolist(), strict=True))
    return {START: total - (times[-1] - times[0]), **steps, TOTAL: total}


def best(warm: int, cold: int) -> dict[str, dict[str, float]]:
    """Time starts with a warm cache and with a cold cache; take the best."""
    with tempfile.TemporaryDirectory() as folder:
        caches = [str(Path(folder) / f'{k}') for k in range(cold)]
        kinds = {'first start ever': [run(cache) for cache in caches]}
        kinds['later starts'] = [run(caches[0]) for _ in range(warm)]
    return {
        kind: {step: min(run[step] for run in runs) for step in runs[0]}
        for kind, runs in kinds.items()
    }
