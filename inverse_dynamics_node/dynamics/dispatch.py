"""Quantities of states in arrays of any shape: computed one by one, or many at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..robot.model import Floats, RobotModel
from .arguments import broadcast, check_out, explain, is_free
from .jit import IS_COMPILED
from .lanes import LANES
from .newton_euler import OK

Computation = Callable[[Sequence[Floats], Floats], int]
"""Takes arguments and an array for the results; returns a status."""


def over_states(
    robot: RobotModel,
    kind: tuple[int, ...],
    few: Computation,
    many: Computation,
    out: Floats | None,
    **arguments: ArrayLike,
) -> Floats:
    """
    Compute a quantity of anything that numpy can read as rows of n numbers.

    Parameters
    ----------
    robot : RobotModel
        Robot of n joints.
    kind : tuple of int
        Shape of the result for one state.
    few, many : callable
        Compute the quantity for arguments of shape (N, n): for any N, and quickly for N of at
        least `lanes.LANES`, for which numba may have to compile first.
    out : ndarray, optional
        Receives the result.
    **arguments : array_like
        Joint positions and so on, by name.

    Returns
    -------
    result : ndarray, shape (..., *kind)
        ``out`` if it was given.

    Raises
    ------
    JointStateError
        If a shape does not fit the robot, or a value is not finite.

    """
    rows, shape = broadcast(len(robot.joint_names), **arguments)
    shape = (*shape[:-1], *kind)
    if out is not None:
        check_out(out, shape)
    result = np.empty(shape) if out is None or not is_free(out, rows) else out
    flat = result.reshape(len(rows[0]), *kind)
    is_large = IS_COMPILED and robot.joint_names and len(flat) >= LANES
    if (many if is_large else few)(rows, flat) != OK:
        raise explain(robot.joint_names, None, None, **arguments)
    if out is None or result is out:
        return result
    out[...] = result
    return out


def one_by_one(one: Computation) -> Computation:
    """Return the computation of several states by the computation of one."""

    def few(rows: Sequence[Floats], results: Floats) -> int:
        states = zip(zip(*rows, strict=True), results, strict=True)
        return max((one(state, result) for state, result in states), default=OK)

    return few
