"""Functions of the passes, prepared to be called with arrays, and their robot tables."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .jit import compile_for, IS_COMPILED
from .newton_euler import NOT_FINITE

VECTOR, MATRIX, MATRICES = 'f8[::1]', 'f8[:,::1]', 'f8[:,:,::1]'
"""Types of contiguous arrays of float64, as numba writes them."""


def prepared(function: Callable[..., int], *kinds: str) -> Callable[..., int]:
    """
    Prepare a function of the passes for arrays: compile it, or run it on lists of floats.

    Parameters
    ----------
    function : callable
        Takes arrays, of which the last but one receives the results and the last is a table of
        `robot_table`; returns a status.
    *kinds : str
        Types of the arguments: `VECTOR`, `MATRIX` or `MATRICES`.

    Returns
    -------
    prepared : callable
        Takes the same arguments; raises a TypeError for arguments of other types.

    """
    if IS_COMPILED:
        compile_for(function, f'({", ".join(kinds)})')
        return function
    dimensions = [kind.count(',') + 1 for kind in kinds]

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
