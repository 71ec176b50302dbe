"""
Contenders in separate interpreters, timed in the same rounds as the others.

A worker reads a task as one line of JSON, and answers with its results. Then it reads numbers of
sweeps. For each number, it runs these sweeps and answers with the seconds per call. Between
requests, a worker takes no CPU time.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

from inverse_dynamics_node.dynamics.inverse_dynamics import STANDARD_GRAVITY
from inverse_dynamics_node.robot.model import Floats
import numpy as np

from .robots import Robot, STATES
from .timing import Contender

HERE = Path(__file__).resolve().parent


class OtherRobotsError(Exception):
    """A library does not support this kind of robot."""


def kdl(robot: Robot, states: Floats) -> Contender:
    """Run KDL in the first Python interpreter with PyKDL, usually Debian's Python."""
    model = robot.model
    if any(model.parent[1:] != np.arange(len(model.parent) - 1)):
        raise OtherRobotsError('chains only')
    for python in (sys.executable, '/usr/bin/python3'):
        found = subprocess.run([python, '-c', 'import PyKDL'], capture_output=True, check=False)
        if found.returncode == 0:
            break
    else:
        raise ImportError('PyKDL')
    bodies = [
        {
            'rotation': model.R_PL[i].ravel().tolist(),
            'position': model.p_PL[i].tolist(),
            'axis': (model.R_PL[i] @ model.axis[i]).tolist(),
            'slides': bool(model.is_prismatic[i]),
            'mass': float(model.mass[i]),
            'com': model.com[i].tolist(),
            'inertia': model.inertia[i][np.triu_indices(3)].tolist(),
        }
        for i in range(1, len(model.parent))
    ]
    task = {'bodies': bodies, 'gravity': STANDARD_GRAVITY, 'states': states.tolist()}
    return start('KDL', [python, str(HERE / 'kdl.py')], task, STATES)


def start(
    name: str, command: list[str], task: dict[str, Any], calls: int, **environment: str
) -> Contender:
    """Start a worker for a task; ``calls`` is the number of calls per sweep."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )

    def ask(question: Any) -> Any:
        process.stdin.write(json.dumps(question) + '\n')
        process.stdin.flush()
        answer = process.stdout.readline()
        if not answer:
            raise RuntimeError(f'{name}: {process.stderr.read().strip().splitlines()[-1:]}')
        return json.loads(answer)

    def close() -> None:
        process.stdin.close()
        process.wait()

    results = np.array(ask(task))
    return Contender(name, lambda: results, ask, calls, close)
