"""Compiled where numba is, plain where it is not, and never an error because of a cache."""

from concurrent.futures import ThreadPoolExecutor
import os
import shutil
import subprocess
import sys
import threading

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


@pytest.fixture(autouse=True)
def no_warning_yet(monkeypatch):
    monkeypatch.setattr(jit, '_has_warned', False)


@needs_numba
def test_function_without_a_place_for_its_cache_is_a_warning():
    namespace = {}
    exec('def twice(x):\n    return 2.0 * x', namespace)  # from no file: nowhere to keep it
    with pytest.warns(UserWarning, match='not kept between runs'):
        twice = jit.compiled(namespace['twice'])
    jit.compile_for(twice, '(f8,)')
    assert twice(4.0) == 8.0


@needs_numba
def test_full_disk_is_a_warning(monkeypatch, tmp_path):
    @jit.compiled
    def twice(x):
        return 2.0 * x

    def refuse(*_):
        raise OSError('No space left on device')

    monkeypatch.setattr(twice._cache, 'save_overload', refuse)
    monkeypatch.setattr(twice._cache, 'load_overload', lambda *_: None)
    with pytest.warns(UserWarning, match='No space left'):
        jit.compile_for(twice, '(f8,)')
    assert twice(4.0) == 8.0


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
def test_nothing_compiles_once_prepared():
    @jit.compiled
    def twice(x):
        return 2.0 * x

    jit.compile_for(twice, '(f8,)')
    with pytest.raises(TypeError):
        twice('a text')


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


@needs_numba
def test_threads_may_ask_for_the_same_compilation():
    @jit.compiled
    def twice(x):
        return 2.0 * x

    start = threading.Barrier(4)

    def compile_and_call(_):
        start.wait()
        jit.compile_for(twice, '(f8,)')
        return twice(4.0)

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(compile_and_call, range(4))) == [8.0] * 4
