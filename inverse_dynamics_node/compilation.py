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

Function = TypeVar('Function', bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """
    Mark a function to be compiled by `compile_for`, its machine code cached on disk.

    Without numba it stays the Python function that it is.

    """
    if not IS_COMPILED:
        return function
    try:
        return cast(Function, numba.njit(cache=True, error_model='numpy')(function))
    except RuntimeError as error:
        # numba refuses to decorate where no cache directory is writable: a package owned by root,
        # run by a service without a home.
        warnings.warn(f'compiled code is not kept between runs: {error}', stacklevel=2)
        return cast(Function, numba.njit(error_model='numpy')(function))


def inlined(function: Function) -> Function:
    """
    Mark a function to become part of those that call it.

    For the innermost one it saves a tenth of the whole: what it reads was just computed.

    """
    if not IS_COMPILED:
        return function
    return cast(Function, numba.njit(inline='always', error_model='numpy')(function))


def compile_for(function: Any, signature: str) -> None:
    """
    Compile for one signature now, and for no other ever after: nothing compiles in a control loop.

    A call with other types raises a TypeError from then on.

    """
    if not IS_COMPILED or not function._can_compile:
        return
    try:
        function.compile(signature)
    except OSError as error:  # compiled and usable; only saving it failed, on a full disk say
        warnings.warn(f'compiled code is not kept between runs: {error}', stacklevel=2)
    function.disable_compile()
