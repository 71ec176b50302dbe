"""Positions far outside the limits of the robot description, usually because of wrong units."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .model import Floats, RobotModel
from .model_warning import ModelWarning

_MARGIN = 0.1
"""Tolerated distance outside the limits, as a fraction of their range."""
_LEAST_MARGINS = (0.1, 0.01)
"""Smallest tolerated distance of revolute [rad] and of prismatic joints [m]."""
_FULL_TURN = 2.0 * math.pi


class ImplausiblePosition(NamedTuple):
    """A joint that is further outside its position limits than makes sense."""

    joint: str
    position: float
    """Position furthest outside the limits [rad or m]."""
    lower: float
    """Lower position limit; -inf if there is none [rad or m]."""
    upper: float
    """Upper position limit; inf if there is none [rad or m]."""
    looks_like_degrees: bool
    """Whether the position would be plausible if it were in degrees."""
    is_prismatic: bool = False
    """Whether the unit is m instead of rad."""

    def __str__(self) -> str:
        """Return a sentence such as 'joint2 at 57.3 rad, limits -2.97 to 2.97: degrees?'."""
        unit = 'm' if self.is_prismatic else 'rad'
        sentence = (
            f'{self.joint} at {self.position:.4g} {unit}, '
            f'limits {self.lower:.4g} to {self.upper:.4g}'
        )
        return f'{sentence}: degrees?' if self.looks_like_degrees else sentence


def implausible_positions(
    robot: RobotModel, positions: ArrayLike, joint_names: Sequence[str] = ()
) -> list[ImplausiblePosition]:
    """
    Find joints that are further outside their position limits than makes sense.

    A tenth of the range, but at least 0.1 rad or 0.01 m, is tolerated, because encoder offsets and
    soft limits often put a joint slightly outside. Joints without limits are never reported, nor
    are those whose limits are equal (usually placeholders).

    Parameters
    ----------
    robot : RobotModel
        With n joints.
    positions : array_like, shape (..., n)
        One configuration or many [rad or m]; NaN and infinite values are ignored.
    joint_names : sequence of str, optional
        Names of the columns if they are not the robot's joints in its order; names that the robot
        does not have are ignored.

    Returns
    -------
    found : list of ImplausiblePosition
        At most one for each joint, in the order of the columns.

    """
    names = tuple(joint_names) or robot.joint_names
    table = np.asarray(positions, dtype=np.float64)
    if table.shape[-1:] != (len(names),):
        raise ValueError(f'positions have shape {table.shape}, expected (..., {len(names)})')
    table = table.reshape(-1, len(names))
    known = [k for k, name in enumerate(names) if name in robot.joint_names]
    rows = [robot.joint_names.index(names[k]) for k in known]
    found = []
    for k, i in zip(known, rows, strict=True):
        lower, upper = float(robot.lower[i]), float(robot.upper[i])
        worst = _worst(table[:, k], lower, upper)
        if not lower < upper or worst is None:
            continue
        is_prismatic = bool(robot.is_prismatic_joint[i])
        margin = _margin(lower, upper, is_prismatic)
        if lower - margin <= worst <= upper + margin:
            continue
        looks_like_degrees = (
            not is_prismatic
            and abs(worst) > _FULL_TURN  # below, an offset is at least as likely
            and lower - margin <= math.radians(worst) <= upper + margin
        )
        found.append(
            ImplausiblePosition(names[k], worst, lower, upper, looks_like_degrees, is_prismatic)
        )
    return found


def position_warnings(
    robot: RobotModel, positions: ArrayLike, joint_names: Sequence[str] = ()
) -> tuple[ModelWarning, ...]:
    """
    Return warnings about positions that are further outside the limits than makes sense.

    Parameters
    ----------
    robot, positions, joint_names
        As for `implausible_positions`.

    Returns
    -------
    warnings : tuple of ModelWarning
        First those of positions that seem to be in degrees; empty if all are plausible.

    """
    hints = {
        True: 'convert the positions to radians',
        False: 'check units (rad, m), zero positions and the order of the joints, and that the '
        'limits belong to this robot',
    }
    found = implausible_positions(robot, positions, joint_names)
    return tuple(
        ModelWarning(str(each), hint)
        for in_degrees, hint in hints.items()
        for each in found
        if each.looks_like_degrees is in_degrees
    )


def _worst(positions: Floats, lower: float, upper: float) -> float | None:
    """Return the finite position furthest outside its limits, or the first if all are inside."""
    finite = positions[np.isfinite(positions)]
    if not finite.size:
        return None
    return float(finite[np.argmax(np.maximum(lower - finite, finite - upper))])


def _margin(lower: float, upper: float, is_prismatic: bool) -> float:
    least = _LEAST_MARGINS[is_prismatic]
    return max(least, _MARGIN * (upper - lower)) if math.isfinite(upper - lower) else least
