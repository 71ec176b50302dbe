"""Compilation with numba if it is installed; a cache that fails is a warning, not an error."""

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

# Statuses that the functions of the passes return
OK = 0
WRONG_SIZE = 1
NOT_FINITE = 2

# Allows a fused a * b + c and ignores the sign of zero. A NaN stays a NaN.
FAST_MATH = {'contract', 'nsz', 'arcp'}

Function = TypeVar('Function', bound=Callable[..., Any])

_cached: list[Any] = []
_ready: set[Any] = set()
_compiling = threading.Lock()
_has_warned = False


def compiled(function: Function) -> Function:
    """
    Mark a function for compilation by `compile_for`, with its machine code cached on disk.

    Without numba, return the Python function itself.

    """
    return _kept(function) if IS_COMPILED else function


def simd_kernel(function: Function) -> Function:
    """Mark a function of `batch` for compilation; it releases the interpreter lock."""
    return _kept(function, fastmath=FAST_MATH, nogil=True) if IS_COMPILED else function


def simd_step(function: Function) -> Function:
    """Mark a step of such a function, which contains the loops over lanes."""
    if not IS_COMPILED:
        return function
    return cast(Function, numba.njit(error_model='numpy', fastmath=FAST_MATH)(function))


def simd_inline(function: Function) -> Function:
    """Mark a function to be inlined; loops over lanes are not vectorised across calls."""
    if not IS_COMPILED:
        return function
    options = {'error_model': 'numpy', 'fastmath': FAST_MATH, 'forceinline': True}
    return cast(Function, numba.njit(**options)(function))


def compile_for(function: Any, *signatures: str) -> None:
    """
    Compile for some signatures now, and disable compilation, so that none happens in the loop.

    A call with other types raises a TypeError afterwards.

    """
    if not IS_COMPILED or function in _ready:
        return
    with _compiling:
        if function in _ready:  # another thread has compiled it meanwhile
            return
        for signature in signatures:
            try:
                function.compile(signature)
            except Exception as error:
                # A full disk, or files that a power failure has left incomplete.
                _warn(error)
                # numba has no public way to give up a cache, or to find another stamp below.
                for dispatcher in _cached:
                    dispatcher._cache = numba.core.caching.NullCache()
                function.compile(signature)
        function.disable_compile()
        _ready.add(function)


def prepared(function: Callable[..., int], *dimensions: int) -> Callable[..., int]:
    """
    Prepare a function of the passes for arrays: compile it, or run it on lists of floats.

    Parameters
    ----------
    function : callable
        Takes arrays, of which the last but one receives the results and the last is a table of
        `robot_table`; returns a status.
    *dimensions : int
        Numbers of dimensions of the arguments, which are contiguous arrays of float64.

    Returns
    -------
    prepared : callable
        Takes the same arguments; raises a TypeError for arguments of other types.

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
        except ValueError:  # Python's sine of infinity
            return NOT_FINITE
        if arguments[-2].size:
            arguments[-2][...] = lists[-2]
        return status

    return on_lists


def _kept(function: Function, **options: Any) -> Function:
    try:
        dispatcher = numba.njit(cache=True, error_model='numpy', **options)(function)
    except RuntimeError as error:
        # numba refuses to decorate where no cache directory is writable: a package owned by root,
        # run by a service without a home.
        _warn(error)
        dispatcher = numba.njit(error_model='numpy', **options)(function)
    else:
        # numba discards cached code when the function's own file has changed. The equations that
        # are inlined into it stand in other files of its folder.
        folder = Path(function.__code__.co_filename).parent
        dispatcher._cache._cache_file._source_stamp = _stamp(folder)
        _cached.append(dispatcher)
    return cast(Function, dispatcher)


@cache
def _stamp(folder: Path) -> tuple[tuple[str, float, int], ...]:
    """Return names, times of modification and sizes of the source files in a folder."""
    files = sorted(folder.glob('*.py'))
    return tuple((file.name, file.stat().st_mtime, file.stat().st_size) for file in files)


def _warn(error: Exception) -> None:
    """Warn once; every function has the same problem."""
    global _has_warned
    if not _has_warned:
        _has_warned = True
        warnings.warn(
            f'compiled code is not kept between runs ({type(error).__name__}: {error}); '
            'NUMBA_CACHE_DIR can name a directory for it',
            stacklevel=3,
        )
