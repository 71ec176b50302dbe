"""
Blocks of states, each state in a lane, for functions that compute many states at once.

The functions read and write rows: component j of lane k is ``rows[i, j * LANES + k]``, where i is
a body or a joint.

- Compiled, a block has 64 lanes of one number each.
- Without numba, a block has one lane, which contains arrays of many states. The same functions are
  numpy expressions then.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .equations import Vector
from .jit import IS_COMPILED, simd_inline, simd_step

LANES = 64 if IS_COMPILED else 1
BLOCK = LANES if IS_COMPILED else 2048  # states in a block
FEWEST = 64  # states from which on blocks are faster than one state after the other
CACHE_LINE = 8  # numbers in a line of the processor's cache


@simd_inline
def lane(rows: Any, i: int, j: int, k: int) -> Vector:
    """Return the vector whose first component is component j of a row."""
    return rows[i, j * LANES + k], rows[i, (j + 1) * LANES + k], rows[i, (j + 2) * LANES + k]


@simd_inline
def store_lane(rows: Any, i: int, j: int, k: int, v: Vector) -> None:
    """Store a vector; see `lane`."""
    rows[i, j * LANES + k] = v[0]
    rows[i, (j + 1) * LANES + k] = v[1]
    rows[i, (j + 2) * LANES + k] = v[2]


@simd_step
def transpose(source: Any, target: Any) -> None:
    """Copy rows between arrays, of which one has the lanes and the other has the rows adjacent."""
    for first in range(0, LANES, CACHE_LINE):
        for row in range(len(source)):
            for k in range(first, min(first + CACHE_LINE, LANES)):
                target[row, k] = source[row, k]


@simd_inline
def holds_nan(residue: Any) -> bool:
    """Return whether a lane is NaN; np.any takes no single number before numba 0.64."""
    if IS_COMPILED:
        return bool(residue != 0.0)
    return bool(np.any(residue != 0.0))
