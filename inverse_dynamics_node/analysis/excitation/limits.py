"""
The limits of a motion, and states of the joints that move within them.

Limits are those of positions, speeds, efforts and height; assumptions where a URDF has none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...errors import ConfigurationError, listed
from ...robot.kinematics import moving_points
from ...robot.model import Floats, RobotModel
from ..sizing import joint_ranges

FRACTION = 0.8
"""Fraction of the limits that a motion uses; the rest is for control and for unknown masses."""
ASSUMED_SPEED = (1.0, 0.25)
"""Speed limits of joints without one [rad/s], [m/s]."""
ASSUMED_SLIDE = 1.0
"""Range of a prismatic joint without position limits [m]."""
_LEAST_RANGE = 1e-3
"""Smallest range that is worth moving in [rad or m]."""
_HEIGHT = 0.1
"""Height below the floor that is as bad as twice the limit of a speed [m]."""


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of m joints of a robot, which the others join at rest."""

    joint_names: tuple[str, ...]
    """The m joints that move."""
    index: list[int]
    """Their indices among the n joints of the robot."""
    rest: Floats
    """Positions of all joints of the robot where they do not move, shape (n,) [rad or m]."""
    lower: Floats
    """Shape (m,) [rad or m]."""
    upper: Floats
    """Shape (m,) [rad or m]."""
    speeds: Floats
    """Shape (m,) [rad/s or m/s]."""
    efforts: Floats
    """Of all joints of the robot, shape (n,) [N m or N]; inf if there is none."""
    floor: float = -math.inf
    """Least height of all links and centres of mass in the frame of the base [m]."""
    notes: tuple[str, ...] = ()
    """Sentences about assumptions."""

    @property
    def middle(self) -> Floats:
        """Middle of the ranges, shape (m,) [rad or m]."""
        middle: Floats = 0.5 * (self.lower + self.upper)
        return middle

    @property
    def half(self) -> Floats:
        """Half of the ranges, shape (m,) [rad or m]."""
        half: Floats = 0.5 * (self.upper - self.lower)
        return half


def motion_limits(
    robot: RobotModel,
    joints: Sequence[str] = (),
    fraction: float = FRACTION,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    rest: Mapping[str, float] | None = None,
    floor: float = -math.inf,
) -> MotionLimits:
    """
    Collect the limits of a motion.

    Parameters
    ----------
    robot : RobotModel
        The robot, with its limits.
    joints : sequence of str
        The joints to move; empty for all that can move.
    fraction : float
        Fraction of ranges, speeds and efforts to use.
    ranges : mapping of str to (float, float), optional
        Position ranges by joint, to be used in full, in place of those of the robot description
        [rad or m].
    rest : mapping of str to float, optional
        Positions of joints that do not move [rad or m]; by default 0 or the nearest limit.
    floor : float
        Least height of all links and centres of mass in the frame of the base [m].

    Raises
    ------
    ConfigurationError
        If a joint does not exist or cannot move, or a value is invalid.

    """
    if not 0.0 < fraction <= 1.0:
        raise ConfigurationError(f'fraction is {fraction!r}, expected more than 0, up to 1')
    notes: list[str] = []
    lower, upper, speeds = _ranges(robot, fraction, notes)
    for name, (low, high) in (ranges or {}).items():
        (i,) = robot.joint_indices([name])
        _check_range(robot, i, low, high)
        lower[i], upper[i] = low, high
    positions = np.clip(0.0, *joint_ranges(robot))
    for name, position in (rest or {}).items():
        positions[robot.joint_indices([name])[0]] = position
    still = _that_cannot_move(robot, lower, upper)
    names = _chosen(robot, joints, still, notes)
    index = robot.joint_indices(names)
    return MotionLimits(
        tuple(names),
        index,
        positions,
        lower[index],
        upper[index],
        speeds[index],
        fraction * robot.effort_limits,
        floor,
        tuple(notes),
    )


def _ranges(robot: RobotModel, fraction: float, notes: list[str]) -> tuple[Floats, Floats, Floats]:
    """Return the parts of ranges and speeds to use; add the assumptions to the notes."""
    slides = robot.is_prismatic_joint
    lower, upper = joint_ranges(robot)
    unbounded = slides & ~(np.isfinite(lower) & np.isfinite(upper))
    start = np.where(np.isfinite(lower), lower, -0.5 * ASSUMED_SLIDE)
    start = np.where(np.isfinite(upper), upper - ASSUMED_SLIDE, start)
    lower, upper = (
        np.where(unbounded, ends, given)
        for ends, given in ((start, lower), (start + ASSUMED_SLIDE, upper))
    )
    middle, half = 0.5 * (lower + upper), 0.5 * fraction * (upper - lower)
    assumed = np.where(slides, ASSUMED_SPEED[1], ASSUMED_SPEED[0])
    speeds = np.where(np.isfinite(robot.velocity_limits), robot.velocity_limits, assumed)
    endless = ~slides & ~(robot.upper - robot.lower <= 2.0 * math.pi)
    for condition, words in (
        (endless, 'range of more than a turn: moves within one turn'),
        (unbounded, f'no position limits: moves within {ASSUMED_SLIDE:g} m'),
        (
            ~np.isfinite(robot.velocity_limits),
            f'no speed limit: {ASSUMED_SPEED[0]:g} rad/s (sliding: {ASSUMED_SPEED[1]:g} m/s) '
            'assumed',
        ),
    ):
        found = [robot.joint_names[i] for i in np.flatnonzero(condition)]
        if found:
            notes.append(f'{words}: {listed(found)}')
    return middle - half, middle + half, fraction * speeds


def _check_range(robot: RobotModel, i: int, low: float, high: float) -> None:
    name, unit = robot.joint_names[i], 'm' if robot.is_prismatic_joint[i] else 'rad'
    if not (math.isfinite(low) and math.isfinite(high) and high - low >= _LEAST_RANGE):
        raise ConfigurationError(
            f"range of joint '{name}' is {low:g} to {high:g} {unit}, expected a lower and an "
            'upper end'
        )
    if low < robot.lower[i] or high > robot.upper[i]:
        raise ConfigurationError(
            f"range of joint '{name}' is {low:g} to {high:g} {unit}, expected at most the limits "
            f'{robot.lower[i]:g} to {robot.upper[i]:g} {unit}'
        )


def _that_cannot_move(robot: RobotModel, lower: Floats, upper: Floats) -> dict[str, str]:
    """Return the joints that cannot move, with the reason."""
    still = {}
    for i, name in enumerate(robot.joint_names):
        if upper[i] - lower[i] < _LEAST_RANGE:
            still[name] = f'its range is {lower[i]:g} to {upper[i]:g}'
    return still


def _chosen(
    robot: RobotModel, joints: Sequence[str], still: dict[str, str], notes: list[str]
) -> list[str]:
    """Return the joints to move, in the order of the robot."""
    robot.joint_indices(joints)
    for name in joints:
        if name in still:
            raise ConfigurationError(f"joint '{name}' cannot move: {still[name]}")
    wanted = [name for name in robot.joint_names if name in joints or not joints]
    names = [name for name in wanted if name not in still]
    if not names:
        reasons = '; '.join(f"'{name}': {reason}" for name, reason in still.items())
        raise ConfigurationError(
            f"robot '{robot.name}' has no joint that can move{f' ({reasons})' * bool(reasons)}"
        )
    left_out = [f'{name} ({still[name]})' for name in wanted if name in still]
    if left_out:
        notes.append(f'not moved: {listed(left_out)}')
    return names


# ---- States --------------------------------------------------------------------------------


class States(NamedTuple):
    """States of the m joints that move, each of shape (k, m)."""

    q: Floats
    """[rad or m]."""
    qd: Floats
    """[rad/s or m/s]."""
    qdd: Floats
    """[rad/s^2 or m/s^2]."""


def whole_states(limits: MotionLimits, states: States) -> States:
    """Return the states of all joints of the robot, each of shape (k, n)."""
    k, n = len(states.q), len(limits.rest)
    whole = States(np.tile(limits.rest, (k, 1)), np.zeros((k, n)), np.zeros((k, n)))
    for part, values in zip(whole, states, strict=True):
        part[:, limits.index] = values
    return whole


def random_states(limits: MotionLimits, count: int, rng: np.random.Generator) -> States:
    """Draw states within the limits; accelerations are such as to reach the speed in 0.5 s."""
    m = len(limits.speeds)
    q = rng.uniform(limits.lower, limits.upper, (count, m))
    qd = rng.uniform(-limits.speeds, limits.speeds, (count, m))
    qdd = rng.uniform(-2.0 * limits.speeds, 2.0 * limits.speeds, (count, m))
    return States(q, qd, qdd)


def excess(
    dynamics: InverseDynamics, limits: MotionLimits, states: States, aim: float = 1.0
) -> Floats:
    """
    Return by how much states exceed each limit, relative to the limit.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with its loads.
    limits : MotionLimits
        The limits of its m joints that move.
    states : States
        States of these joints, each of shape (k, m).
    aim : float
        Fraction of the limits that is regarded as the limit.

    Returns
    -------
    excess : ndarray, shape (k, c)
        One column for each limit of position, speed, effort and height; 0 within it.

    """
    parts = [
        np.abs(states.q - limits.middle) / limits.half,
        np.abs(states.qd) / limits.speeds,
    ]
    whole = whole_states(limits, states)
    bounded = np.isfinite(limits.efforts)
    if bounded.any():
        efforts = dynamics.efforts(*whole)
        parts.append(np.abs(efforts[:, bounded]) / limits.efforts[bounded])
    if math.isfinite(limits.floor):
        heights = moving_points(dynamics.robot, whole.q, np.array([0.0, 0.0, 1.0]))
        parts.append(aim + (limits.floor - heights) / _HEIGHT)
    found: Floats = np.maximum(np.concatenate(parts, axis=1) - aim, 0.0)
    return found


class Extent(NamedTuple):
    """A box in the frame of the base, each end of shape (3,) [m]."""

    lowest: Floats
    highest: Floats


def swept_box(robot: RobotModel, q: Floats) -> Extent:
    """
    Return the box that contains the links that move, and their centres of mass, in all poses.

    The thickness of the links is unknown.

    Parameters
    ----------
    robot : RobotModel
        With n joints.
    q : ndarray, shape (k, n)
        Joint positions [rad or m].

    """
    sides = [moving_points(robot, q, axis) for axis in np.eye(3)]
    lowest, highest = ([float(f(side)) for side in sides] for f in (np.min, np.max))
    return Extent(np.array(lowest), np.array(highest))
