"""
Blocks of states, each state in a lane, for functions that compute many states at once.

The functions read and write rows: component j of lane k is ``rows[i, j * LANES + k]``, where i is
a body or a joint. The compiler turns loops over the lanes into vector instructions.
"""

from __future__ import annotations

from typing import Any

from .equations import Vector
from .jit import simd_inline, simd_step

LANES = 64  # states in a block, and states from which on blocks are faster than single states
CACHE_LINE = 8  # numbers in a line of the processor's cache
LARGEST_ANGLE = 1e5  # limit of `cosine_and_sine` [rad]
ROUNDER = 1.5 * 2.0**52  # adding and subtracting it rounds to a whole number


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
            for k in range(first, first + CACHE_LINE):
                target[row, k] = source[row, k]


@simd_inline
def cosine_and_sine(x: Any) -> tuple[Any, Any]:
    """
    Compute both to 2 units in the last place, without a branch, so that lanes vectorise.

    The angle minus a whole number of quarter turns is at most pi/4. In that range the polynomials,
    minimax by Remez' algorithm, have an error of 4e-18 before rounding.

    """
    quarters = (x * 0.6366197723675814 + ROUNDER) - ROUNDER
    # pi/2 in three parts of 33, 33 and 53 bits, so that the first two products are exact.
    near = x - quarters * 1.5707963267341256
    second = quarters * 6.077100506303966e-11
    r = near - second
    rounded = (near - r) - second
    r = r + (rounded - quarters * 2.0222662487959506e-21)
    z = r * r
    s = -2.505074748976053e-08 + z * 1.5896213905538575e-10
    s = -0.00019841269829584776 + z * (2.7557313619688146e-06 + z * s)
    s = -0.1666666666666663 + z * (0.008333333333322113 + z * s)
    s = r + r * z * s
    c = 2.0875723479154387e-09 - z * 1.1359658852901971e-11
    c = 2.4801587289487012e-05 + z * (-2.7557314353789556e-07 + z * c)
    c = 0.0416666666666666 + z * (-0.0013888888888874131 + z * c)
    c = 1.0 - (0.5 * z - z * z * c)
    # The quarter is -2 to 2, where -2 and 2 are the same.
    quarter = quarters - 4.0 * ((quarters * 0.25 + ROUNDER) - ROUNDER)
    odd, opposite = abs(quarter) == 1.0, abs(quarter) == 2.0
    cosine, sine = (s, c) if odd else (c, s)
    cosine = -cosine if opposite or quarter == 1.0 else cosine
    return cosine, -sine if opposite or quarter == -1.0 else sine
