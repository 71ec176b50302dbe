"""Optional compilation with numba; a cache that fails causes a warning, but no error."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
import threading
from typing import Any, cast, TypeVar
import warnings

try:
    import numba
except ImportError:
    numba = None

import numpy as np

IS_COMPILED: bool = numba is not None and not numba.config.DISABLE_JIT

# Return values of the compiled functions
OK = 0
WRONG_SIZE = 1
NOT_FINITE = 2

# The compiler may fuse a * b + c, replace divisions by products with reciprocals, and ignore the
# sign of zero. NaN stays NaN.
FAST_MATH = {'contract', 'nsz', 'arcp'}

Function = TypeVar('Function', bound=Callable[..., Any])

_cached: list[Any] = []
_ready: set[Any] = set()
_compiling = threading.Lock()
_has_warned = False


def compiled(function: Function, **options: Any) -> Function:
    """Prepare a function for `compile_for`, which then caches the compiled code on disk."""
    if not IS_COMPILED:
        return function
    try:
        dispatcher = numba.njit(cache=True, error_model='numpy', **options)(function)
    except RuntimeError as error:
        # No cache directory is writable, for example in a service without a home directory.
        _warn(error)
        dispatcher = numba.njit(error_model='numpy', **options)(function)
    else:
        # numba discards cached code only if the file of the function has changed. The stamp of the
        # folder also covers the inlined functions of other files. numba has no public function
        # that replaces a stamp.
        folder = Path(function.__code__.co_filename).parent
        dispatcher._cache._cache_file._source_stamp = _stamp(folder)
        _cached.append(dispatcher)
    return cast(Function, dispatcher)


def simd_kernel(function: Function) -> Function:
    """Prepare a function for `compile_for`; compiled code releases the interpreter lock."""
    return compiled(function, fastmath=FAST_MATH, nogil=True)


def simd_step(function: Function, **options: bool) -> Function:
    """Prepare a function that loops over SIMD lanes and is called from a `simd_kernel`."""
    if not IS_COMPILED:
        return function
    prepare = numba.njit(error_model='numpy', fastmath=FAST_MATH, **options)
    return cast(Function, prepare(function))


def simd_inline(function: Function) -> Function:
    """Prepare a function for inlining, because a loop that calls functions is not vectorised."""
    return simd_step(function, forceinline=True)


def compile_for(function: Any, *signatures: str) -> None:
    """Compile a function for the given signatures; calls with other types raise a TypeError."""
    if not IS_COMPILED or function in _ready:
        return
    with _compiling:
        if function in _ready:  # another thread has compiled the function meanwhile
            return
        for signature in signatures:
            try:
                function.compile(signature)
            except Exception as error:
                # The disk may be full, or a power failure may have left incomplete files.
                _warn(error)
                # numba has no public function that disables a cache.
                for dispatcher in _cached:
                    dispatcher._cache = numba.core.caching.NullCache()
                function.compile(signature)
        function.disable_compile()
        _ready.add(function)


def prepared(function: Callable[..., int], *dimensions: int) -> Callable[..., int]:
    """
    Compile a function for contiguous float64 arrays.

    Without numba, the function runs on lists of floats. The second-to-last argument of the
    function receives the results, and the last argument is a table in the layout of
    `robot_table`. The function returns a status code such as `OK`. ``dimensions`` contains the
    number of dimensions of each argument. Arguments of other types or dimensions raise a
    TypeError.

    """
    if IS_COMPILED:
        kinds = ', '.join(f'f8[{":, " * (count - 1)}::1]' for count in dimensions)
        compile_for(function, f'({kinds})')
        return function

    def on_lists(*arguments: Any) -> int:
        for values, dimension in zip(arguments, dimensions, strict=True):
            if not isinstance(values, np.ndarray) or values.ndim != dimension:
                raise TypeError
            if values.dtype != np.float64:
                raise TypeError
        lists = [values.tolist() for values in arguments]
        try:
            status = function(*lists)
        except ValueError:  # raised by math.sin(inf)
            return NOT_FINITE
        if arguments[-2].size:
            arguments[-2][...] = lists[-2]
        return status

    return on_lists


@cache
def _stamp(folder: Path) -> tuple[tuple[str, float, int], ...]:
    """Return names, modification times and sizes of the source files in a folder."""
    files = sorted(folder.glob('*.py'))
    return tuple((file.name, file.stat().st_mtime, file.stat().st_size) for file in files)


def _warn(error: Exception) -> None:
    """Warn, at most once per process, that compiled code is not cached."""
    global _has_warned
    if not _has_warned:
        _has_warned = True
        warnings.warn(
            f'compiled code is not kept between runs ({type(error).__name__}: {error}); '
            'set NUMBA_CACHE_DIR to a writable directory',
            stacklevel=3,
        )
