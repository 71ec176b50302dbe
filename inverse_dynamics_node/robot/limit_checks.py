"""Warnings about missing or implausible limits, and about positions far outside the limits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .model import Floats, ModelWarning, RobotModel

_FAR_BEYOND = 50.0
"""An effort limit above this multiple of the largest gravity effort is probably a placeholder."""
_FEWEST_EQUAL, _FRACTION_EQUAL = 3, 0.8
_ROUND_LIMITS = (100.0, 1000.0, 10000.0, 100000.0)
"""Effort limits [N m] that exporters write if the real limits are unknown."""


def limit_subject(joint: str, quantity: str) -> str:
    """Return the subject of warnings about a limit; ``quantity`` is 'effort' or 'velocity'."""
    return f"joint '{joint}' {quantity} limit"


def effort_limit_warnings(robot: RobotModel) -> tuple[ModelWarning, ...]:
    """Return warnings about effort limits, except those already in ``robot.warnings``."""
    hint = 'write <limit effort="..."/>, or set the parameter effort_limits of the node'
    missing = (
        ModelWarning('missing', hint, limit_subject(name, 'effort'))
        for name, limit in zip(robot.joint_names, robot.effort_limits, strict=True)
        if math.isinf(limit)
    )
    reported = {warning.subject for warning in robot.warnings}
    return (
        *(warning for warning in missing if warning.subject not in reported),
        *_placeholders(robot),
    )


def _placeholders(robot: RobotModel) -> tuple[ModelWarning, ...]:
    """
    Return warnings about effort limits that look like placeholders.

    Each limit is compared with the effort that would hold the whole robot stretched out
    horizontally. Gravity efforts are never larger, and motors are not oversized by orders of
    magnitude. Prismatic joints are ignored, because a gripper presses with many times the
    weight of its fingers.

    """
    hint = 'write the largest effort of the joint, from the data sheet of its drive'
    is_revolute = ~robot.is_prismatic_joint
    limits = robot.effort_limits
    rated = limits[is_revolute & np.isfinite(limits)]
    if not rated.size:
        return ()
    most = _moment_of_weight(robot)
    common, count = Counter(rated.tolist()).most_common(1)[0]
    if common in _ROUND_LIMITS and count >= max(_FEWEST_EQUAL, _FRACTION_EQUAL * rated.size):
        text = f'{count} of {rated.size} effort limits of revolute joints are {common:g} N m'
        return (ModelWarning(f'{text}, which looks like a placeholder', hint),)
    return tuple(
        ModelWarning(
            f'{limit:.7g} N m looks like a placeholder, because holding the whole robot '
            f'stretched out takes at most {most:.3g} N m',
            hint,
            limit_subject(name, 'effort'),
        )
        for name, limit, revolute in zip(robot.joint_names, limits, is_revolute, strict=True)
        if revolute and most > 0.0 and _FAR_BEYOND * most < limit < math.inf
    )


def _moment_of_weight(robot: RobotModel) -> float:
    """Return an upper bound for the gravity efforts on Earth [N m]."""
    reach = np.zeros(len(robot.parent))
    for body in range(1, len(robot.parent)):
        joint = int(robot.joint_index[body])
        ends = np.abs([robot.lower[joint], robot.upper[joint]])
        travel = np.max(ends[np.isfinite(ends)], initial=0.0) if robot.is_prismatic[body] else 0.0
        reach[body] = reach[robot.parent[body]] + np.linalg.norm(robot.p_PL[body]) + travel
    arms = reach + np.linalg.norm(robot.com, axis=1)
    return float(9.81 * np.sum((robot.mass * arms)[1:]))


_MARGIN = 0.1
"""Tolerated distance outside the limits, as a fraction of the range."""
_LEAST_MARGINS = (0.1, 0.01)
"""Minimum of the tolerated distance, for revolute joints [rad] and for prismatic joints [m]."""
_FULL_TURN = 2.0 * math.pi


class ImplausiblePosition(NamedTuple):
    """A joint whose position is implausibly far outside its limits."""

    joint: str
    position: float
    """The position that is furthest outside the limits [rad or m]."""
    lower: float
    """Lower position limit [rad or m]; -inf without a limit."""
    upper: float
    """Upper position limit [rad or m]; inf without a limit."""
    looks_like_degrees: bool
    """Whether the position would be plausible if it were in degrees."""
    is_prismatic: bool = False
    """Whether the unit is m instead of rad."""

    def __str__(self) -> str:
        unit = 'm' if self.is_prismatic else 'rad'
        sentence = (
            f'{self.joint} is at {self.position:.4g} {unit}, '
            f'outside its limits {self.lower:.4g} to {self.upper:.4g}'
        )
        return f'{sentence} (in degrees?)' if self.looks_like_degrees else sentence


def implausible_positions(
    robot: RobotModel, positions: ArrayLike, joint_names: Sequence[str] = ()
) -> list[ImplausiblePosition]:
    """
    Find joints that are implausibly far outside their limits; report each joint once.

    Encoder offsets often put a joint slightly outside its limits. The tolerance is therefore a
    tenth of the range, but at least 0.1 rad or 0.01 m. Equal lower and upper limits are ignored,
    because such limits are usually placeholders.

    ``positions`` have shape (..., n) [rad or m]. NaN and infinite values are ignored.
    ``joint_names`` are the names of the n columns, by default the joints of the robot. Unknown
    names are ignored. A wrong shape raises a ValueError.

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
            and abs(worst) > _FULL_TURN  # a smaller position may be due to an encoder offset
            and lower - margin <= math.radians(worst) <= upper + margin
        )
        found.append(
            ImplausiblePosition(names[k], worst, lower, upper, looks_like_degrees, is_prismatic)
        )
    return found


def position_warnings(
    robot: RobotModel, positions: ArrayLike, joint_names: Sequence[str] = ()
) -> tuple[ModelWarning, ...]:
    """Return warnings about `implausible_positions`; those that look like degrees come first."""
    hints = {
        True: 'convert the positions to radians',
        False: 'check units (rad, m), zero positions, the order of the joints, and whether the '
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
    """
    Return the finite position that is furthest outside the limits.

    If all positions are inside, return the position that is nearest to a limit.

    """
    finite = positions[np.isfinite(positions)]
    if not finite.size:
        return None
    return float(finite[np.argmax(np.maximum(lower - finite, finite - upper))])


def _margin(lower: float, upper: float, is_prismatic: bool) -> float:
    least = _LEAST_MARGINS[is_prismatic]
    return max(least, _MARGIN * (upper - lower)) if math.isfinite(upper - lower) else least
