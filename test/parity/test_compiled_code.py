"""Compiled code gives the efforts of plain Python, whatever the cache on disk contains."""

import json
import os
import subprocess
import sys

from kinematics import assert_close
from loads import samples
import numpy as np
import pytest
from robot_files import ROOT


def run(code, folder=ROOT, **environment):
    result = subprocess.run(
        [sys.executable, '-c', code],
        cwd=folder,
        env={**os.environ, 'PYTHONPATH': str(folder), **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, result.stderr
    return result


def test_plain_python_gives_the_same_with_loads():
    code = 'import json, loads; print(json.dumps(loads.samples()))'
    path = os.pathsep.join([str(ROOT), str(ROOT / 'test')])
    actual = json.loads(run(code, PYTHONPATH=path, NUMBA_DISABLE_JIT='1').stdout)
    for ours, theirs in zip(actual, samples(), strict=True):
        for name, values in theirs.items():
            assert_close(np.array(ours[name]), np.array(values), 1e-12)


# A compiled function that calls another one of the same folder, as the kernels call the equations.
# The kernels themselves take twenty seconds to compile.
STEP = """
from numba.extending import register_jitable

@register_jitable
def step(x):
    return 2.0 * x
"""
KERNEL = """
from inverse_dynamics_node.dynamics.jit import compile_for, compiled
from step import step

@compiled
def kernel(x):
    return 1.0 + step(x)

compile_for(kernel, '(f8,)')
print(kernel(3.0), sum(kernel.stats.cache_hits.values()))
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / 'step.py').write_text(STEP)
    (tmp_path / 'kernel.py').write_text(KERNEL)
    return tmp_path


def call_kernel(folder):
    """Return the result, how often the cache was used, and the warnings."""
    result = run('import kernel', folder, PYTHONPATH=f'{ROOT}:{folder}')
    return *map(float, result.stdout.split()), result.stderr


def test_damaged_cache_is_a_warning(folder):
    assert call_kernel(folder) == (7.0, 0, '')
    files = list(folder.rglob('*.nb?'))
    assert files
    for path in files:
        path.write_bytes(path.read_bytes()[:60])
    result, used, warnings = call_kernel(folder)
    assert (result, used) == (7.0, 0)
    assert warnings.count('not kept between runs') == 1


@pytest.mark.long
def test_cached_code_is_used_until_another_file_of_its_folder_changes(folder):
    assert call_kernel(folder) == (7.0, 0, '')
    assert call_kernel(folder) == (7.0, 1, '')
    (folder / 'step.py').write_text(STEP.replace('2.0', '-2.0'))
    assert call_kernel(folder) == (-5.0, 0, '')
