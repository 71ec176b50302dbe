"""Functions of the passes, prepared to be called with arrays, and their robot tables."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..robot.model import Floats
from .jit import compile_for, IS_COMPILED
from .newton_euler import NOT_FINITE

VECTOR, MATRIX = 'f8[::1]', 'f8[:,::1]'
"""Types of contiguous arrays of float64, as numba writes them."""


def prepared(function: Callable[..., int], *kinds: str) -> Callable[..., int]:
    """
    Prepare a function of the passes for arrays: compile it, or run it on lists of floats.

    Parameters
    ----------
    function : callable
        Takes arrays and, as its last argument, a table; returns a status.
    *kinds : str
        Types of the arguments: `VECTOR` or `MATRIX`.

    Returns
    -------
    prepared : callable
        Takes the same arguments; raises a TypeError for arguments of other types. Without numba
        it copies the results of the last array only.

    """
    if IS_COMPILED:
        compile_for(function, f'({", ".join(kinds)})')
        return function
    dimensions = [kind.count(',') + 1 for kind in kinds[:-1]]

    def on_lists(*arguments: Any) -> int:
        # Python reads a list several times faster than an array.
        *arrays, robot = arguments
        for values, dimension in zip(arrays, dimensions, strict=True):
            if not isinstance(values, np.ndarray) or values.ndim != dimension:
                raise TypeError
            if values.dtype != np.float64:
                raise TypeError
        lists = [values.tolist() for values in arrays]
        try:
            status = function(*lists, robot)
        except ValueError:  # Python's sine of infinity
            return NOT_FINITE
        if arrays[-1].size:
            arrays[-1][...] = lists[-1]
        return status

    return on_lists


def for_kernels(table: Floats) -> Any:
    """Return a table as the passes expect it: an array for numba, lists of floats for Python."""
    return table if IS_COMPILED else table.tolist()
