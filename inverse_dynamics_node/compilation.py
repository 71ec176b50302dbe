"""numba where it is installed, plain Python where it is not; never an error because of a cache."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast, TypeVar
import warnings

try:
    import numba
except ImportError:
    numba = None

IS_COMPILED: bool = numba is not None and not numba.config.DISABLE_JIT

# a * b + c may round once, and the sign of zero does not matter. A NaN stays a NaN.
LANE_MATH = {'contract', 'nsz', 'arcp'}

Function = TypeVar('Function', bound=Callable[..., Any])

_cached: list[Any] = []
_has_warned = False


def compiled(function: Function) -> Function:
    """
    Mark a function to be compiled by `compile_for`, its machine code cached on disk.

    Without numba it stays the Python function that it is.

    """
    return _kept(function) if IS_COMPILED else function


def compiled_for_lanes(function: Function) -> Function:
    """Mark the same of a function on lanes; threads may run it side by side."""
    return _kept(function, fastmath=LANE_MATH, nogil=True) if IS_COMPILED else function


def inlined(function: Function) -> Function:
    """
    Mark a function to become part of those that call it.

    For the innermost one it saves a tenth of the whole: what it reads was just computed.

    """
    if not IS_COMPILED:
        return function
    return cast(Function, numba.njit(inline='always', error_model='numpy')(function))


def lanewise(function: Function) -> Function:
    """Mark a function to be a step of those on lanes: with loops over lanes of its own."""
    if not IS_COMPILED:
        return function
    return cast(Function, numba.njit(error_model='numpy', fastmath=LANE_MATH)(function))


def in_lane(function: Function) -> Function:
    """Mark a function to become part of such loops, which otherwise would not be vectorised."""
    if not IS_COMPILED:
        return function
    options = {'error_model': 'numpy', 'fastmath': LANE_MATH, 'forceinline': True}
    return cast(Function, numba.njit(**options)(function))


def compile_for(function: Any, *signatures: str) -> None:
    """
    Compile for some signatures now, and for no other ever after: none compiles in a control loop.

    A call with other types raises a TypeError from then on.

    """
    if not IS_COMPILED or not function._can_compile:
        return
    for signature in signatures:
        try:
            function.compile(signature)
        except Exception as error:
            # A full disk, or files that a power cut has left half written.
            _warn(error)
            for dispatcher in _cached:
                dispatcher._cache = numba.core.caching.NullCache()
            function.compile(signature)
    function.disable_compile()


def _kept(function: Function, **options: Any) -> Function:
    try:
        dispatcher = numba.njit(cache=True, error_model='numpy', **options)(function)
    except RuntimeError as error:
        # numba refuses to decorate where no cache directory is writable: a package owned by root,
        # run by a service without a home.
        _warn(error)
        dispatcher = numba.njit(error_model='numpy', **options)(function)
    else:
        _cached.append(dispatcher)
    return cast(Function, dispatcher)


def _warn(error: Exception) -> None:
    """Say it once: what is true of one function is true of all."""
    global _has_warned
    if not _has_warned:
        _has_warned = True
        warnings.warn(
            f'compiled code is not kept between runs ({type(error).__name__}: {error}); '
            'NUMBA_CACHE_DIR can name a directory for it',
            stacklevel=3,
        )
