"""Compiled code gives the efforts of plain Python, whatever the cache on disk contains."""

import os
import shutil
import subprocess
import sys

from inverse_dynamics_node.dynamics import jit
import pytest
from robot_files import ROOT, STANFORD

needs_numba = pytest.mark.skipif(not jit.IS_COMPILED, reason='numba is not in use')

# Efforts of the Stanford arm, to be printed by another interpreter to the last bit.
PRINT_EFFORTS = f"""
import numpy as np
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.dynamics import jit
robot = load_urdf({str(STANFORD)!r})
dynamics = InverseDynamics(robot)
q, qd, qdd = np.random.default_rng(7).normal(size=(3, 6))
efforts = [*dynamics.efforts(q, qd, qdd), *dynamics.mass_matrix(q).ravel()]
efforts += [*dynamics.efforts(np.tile(q, (3, 1)), qd, qdd).ravel()]
print(jit.IS_COMPILED, *efforts)
"""


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


@needs_numba
def test_plain_python_gives_the_same_efforts():
    compiled, *expected = run(PRINT_EFFORTS).stdout.split()
    plain, *efforts = run(PRINT_EFFORTS, NUMBA_DISABLE_JIT='1').stdout.split()
    assert (compiled, plain) == ('True', 'False')
    assert [float(x) for x in efforts] == pytest.approx([float(x) for x in expected], rel=1e-12)


@needs_numba
def test_damaged_cache_is_a_warning(tmp_path):
    _, *expected = run(PRINT_EFFORTS, NUMBA_CACHE_DIR=str(tmp_path)).stdout.split()
    files = [path for path in tmp_path.rglob('*.nb?') if path.is_file()]
    assert files
    for path in files:
        path.write_bytes(path.read_bytes()[:60])
    result = run(PRINT_EFFORTS, NUMBA_CACHE_DIR=str(tmp_path))
    assert result.stdout.split()[1:] == expected
    assert result.stderr.count('not kept between runs') == 1


@needs_numba
def test_cached_code_is_not_used_after_a_change_of_the_equations(tmp_path):
    package = tmp_path / 'inverse_dynamics_node'
    shutil.copytree(ROOT / 'inverse_dynamics_node', package)
    cache = str(tmp_path / 'cache')
    _, *before = run(PRINT_EFFORTS, tmp_path, NUMBA_CACHE_DIR=cache).stdout.split()
    (equations,) = package.rglob('equations.py')
    text = equations.read_text()
    doubled = text.replace('mass * accel_com[2]', '2.0 * mass * accel_com[2]')
    assert doubled != text
    equations.write_text(doubled)
    _, *after = run(PRINT_EFFORTS, tmp_path, NUMBA_CACHE_DIR=cache).stdout.split()
    assert after != before
