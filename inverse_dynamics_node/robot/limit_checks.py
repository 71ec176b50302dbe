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
_LIGHTEST = 0.2
"""A robot with less moving mass per cube of its reach [kg/m^3] does not exist."""
_ROUND_LIMITS = (100.0, 1000.0, 10000.0, 100000.0)
"""Effort limits [N m] that exporters write if the real limits are unknown."""
_FEWEST_EQUAL = 3
_SHORTEST_ARM = 5
"""Chains with fewer revolute joints may be legs or fingers, which often have equal drives."""
_LIMIT_HINT = 'write the largest effort of the joint, from the data sheet of its drive'


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
        # If all masses are far too small, the limits are not to blame.
        *(_tiny_masses(robot) or _equal_limits(robot) or _excessive_limits(robot)),
    )


def _tiny_masses(robot: RobotModel) -> tuple[ModelWarning, ...]:
    """Return a warning if the robot is far too light for its size."""
    mass = float(np.sum(robot.mass[1:]))
    reach = float(np.max(_distances(robot, 0.0)[1:], initial=0.0))
    if not 0.0 < mass < _LIGHTEST * reach**3:
        return ()
    text = (
        f'the moving links weigh only {mass:.3g} kg together, but reach {reach:.3g} m; real '
        'robots of this size are many times heavier'
    )
    hint = 'write masses in kg; CAD programs also export tonnes, or parts without a density'
    return (ModelWarning(text, hint),)


def _equal_limits(robot: RobotModel) -> tuple[ModelWarning, ...]:
    """
    Return a warning if most joints have one round limit, or all have one limit.

    The drives of an arm become smaller towards the wrist. Equal modules have equal drives, and so
    do many legs and fingers, which are shorter.

    """
    rated = robot.effort_limits[~robot.is_prismatic_joint & np.isfinite(robot.effort_limits)]
    if not rated.size:
        return ()
    depth = np.zeros(len(robot.parent), int)
    for body in range(1, len(robot.parent)):
        is_counted = robot.body_names[body] in robot.joint_names and not robot.is_prismatic[body]
        depth[body] = depth[robot.parent[body]] + is_counted
    common, count = Counter(rated.tolist()).most_common(1)[0]
    is_round = common in _ROUND_LIMITS and count >= max(_FEWEST_EQUAL, 0.8 * rated.size)
    is_modular = np.min(robot.mass[1:]) == np.max(robot.mass[1:]) > 0.0
    is_arm = np.max(depth) >= _SHORTEST_ARM and not is_modular
    if not is_round and not (is_arm and count == rated.size):
        return ()
    text = f'{count} of {rated.size} effort limits of revolute joints are {common:g} N m'
    return (ModelWarning(f'{text}, which looks like a placeholder', _LIMIT_HINT),)


def _excessive_limits(robot: RobotModel) -> tuple[ModelWarning, ...]:
    """
    Return warnings about effort limits far above what gravity takes.

    Each limit is compared with the effort that would hold the whole robot stretched out
    horizontally. Gravity efforts are never larger, and motors are not oversized by orders of
    magnitude. Prismatic joints are ignored, because a gripper presses with many times the
    weight of its fingers.

    """
    most = 9.81 * float(np.sum((robot.mass * _distances(robot, 1.0))[1:]))
    rows = zip(robot.joint_names, robot.effort_limits, robot.is_prismatic_joint, strict=True)
    return tuple(
        ModelWarning(
            f'{limit:.7g} N m looks like a placeholder, because holding the whole robot '
            f'stretched out takes at most {most:.3g} N m',
            _LIMIT_HINT,
            limit_subject(name, 'effort'),
        )
        for name, limit, is_prismatic in rows
        if not is_prismatic and most > 0.0 and _FAR_BEYOND * most < limit < math.inf
    )


def _distances(robot: RobotModel, travel: float) -> Floats:
    """
    Return upper bounds of the distances from the base to the centres of mass [m], shape (b,).

    ``travel`` is the fraction of the travel of prismatic joints that counts, 0 or 1.

    """
    reach = np.zeros(len(robot.parent))
    for body in range(1, len(robot.parent)):
        joint = int(robot.joint_index[body])
        ends = np.abs([robot.lower[joint], robot.upper[joint]])
        slide = np.max(ends[np.isfinite(ends)], initial=0.0) if robot.is_prismatic[body] else 0.0
        step = np.linalg.norm(robot.p_PL[body]) + travel * slide
        reach[body] = reach[robot.parent[body]] + step
    return np.asarray(reach + np.linalg.norm(robot.com, axis=1))


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
