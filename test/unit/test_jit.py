"""A cache that cannot be used is a warning, not an error."""

from concurrent.futures import ThreadPoolExecutor
import threading

from inverse_dynamics_node.dynamics import jit
from numba.core.caching import FunctionCache
import pytest


@pytest.fixture(autouse=True)
def no_warning_yet(monkeypatch):
    monkeypatch.setattr(jit, '_has_warned', False)


def test_function_that_cannot_be_cached_is_a_warning():
    namespace = {}
    exec('def twice(x):\n    return 2.0 * x', namespace)  # without a source file
    twice = jit.compiled(namespace['twice'])
    with pytest.warns(UserWarning, match='not kept between runs'):
        jit.compile_for(twice, '(f8,)')
    assert twice(4.0) == 8.0


def test_full_disk_is_a_warning(monkeypatch, tmp_path):
    @jit.compiled
    def twice(x):
        return 2.0 * x

    def refuse(*_):
        raise OSError('No space left on device')

    monkeypatch.setattr(FunctionCache, 'save_overload', refuse)
    monkeypatch.setattr(FunctionCache, 'load_overload', lambda *_: None)
    with pytest.warns(UserWarning, match='No space left'):
        jit.compile_for(twice, '(f8,)')
    assert twice(4.0) == 8.0


def test_nothing_compiles_once_prepared():
    @jit.compiled
    def twice(x):
        return 2.0 * x

    jit.compile_for(twice, '(f8,)')
    with pytest.raises(TypeError):
        twice('a text')


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
