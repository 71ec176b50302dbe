"""Compilation with numba; a cache that fails causes a warning, but no error."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
import threading
from typing import Any, cast, TypeVar
import warnings

import numba

IS_COMPILED: bool = not numba.config.DISABLE_JIT
"""False for debugging with ``NUMBA_DISABLE_JIT=1``; all functions are then plain Python."""

# Return values of the compiled functions
OK = 0
WRONG_SIZE = 1
NOT_FINITE = 2

# The compiler may fuse a * b + c, replace divisions by products with reciprocals, and ignore the
# sign of zero. NaN stays NaN.
FAST_MATH = {'contract', 'nsz', 'arcp'}

Function = TypeVar('Function', bound=Callable[..., Any])

_ready: set[Any] = set()
_compiling = threading.Lock()
_has_warned = False


def compiled(function: Function, **options: Any) -> Function:
    """Prepare a function for `compile_for`, or for calls from another compiled function."""
    return cast(Function, numba.njit(error_model='numpy', **options)(function))


def simd_step(function: Function) -> Function:
    """Prepare a function that loops over SIMD lanes."""
    return compiled(function, fastmath=FAST_MATH)


def simd_inline(function: Function) -> Function:
    """Prepare a function for inlining, because a loop that calls functions is not vectorised."""
    return compiled(function, fastmath=FAST_MATH, forceinline=True)


def arrays(*dimensions: int) -> str:
    """Return the signature of contiguous float64 arrays with these numbers of dimensions."""
    return '(' + ', '.join(f'f8[{":, " * (count - 1)}::1]' for count in dimensions) + ')'


def compile_for(function: Any, *signatures: str) -> Callable[..., int]:
    """
    Compile a function for the given signatures, and cache the compiled code on disk.

    Calls with other types then raise a TypeError. The result is the function.

    """
    run: Callable[..., int] = function
    if not IS_COMPILED or function in _ready:
        return run
    with _compiling:
        if function in _ready:  # another thread has compiled the function meanwhile
            return run
        try:
            function.enable_caching()
            # numba discards cached code only if the file of the function has changed. The stamp of
            # the folder also covers the inlined functions of other files. numba has no public
            # function that replaces a stamp.
            folder = Path(function.py_func.__code__.co_filename).parent
            function._cache._cache_file._source_stamp = _stamp(folder)
            for signature in signatures:
                function.compile(signature)
        except Exception as error:
            # No cache directory is writable, for example in a service without a home directory.
            # Or the disk is full, or a power failure has left incomplete files.
            _warn(error)
            function._cache = numba.core.caching.NullCache()
            for signature in signatures:
                function.compile(signature)
        function.disable_compile()
        _ready.add(function)
    return run


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
