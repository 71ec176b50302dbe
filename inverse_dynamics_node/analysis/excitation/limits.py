"""
The limits of a motion, and states of the joints that move within them.

Limits are those of positions, speeds and efforts; assumptions where a URDF has none. What the
robot must keep clear of is in `clearance`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...errors import ConfigurationError, listed
from ...robot.capsules import Capsules
from ...robot.model import Floats, RobotModel
from ..sizing import joint_ranges
from .clearance import Clearance, find_clearance

FRACTION = 0.8
"""Fraction of the limits that a motion uses; the rest is for control and for unknown masses."""
ASSUMED_SPEED = (1.0, 0.25)
"""Speed limits of joints without one [rad/s], [m/s]."""
ASSUMED_SLIDE = 1.0
"""Range of a prismatic joint without position limits [m]."""
_LEAST_RANGE = 1e-3
"""Smallest range that is worth moving in [rad or m]."""
_POSES = 400
"""Number of random poses that show which parts of the robot may come near each other."""
_LIGHT = (0.05, 0.05)
"""A joint that carries less than this mass [kg] and this fraction of the robot is light."""


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of the m joints of a robot that move; the others rest."""

    joint_names: tuple[str, ...]
    """The m joints that move."""
    index: list[int]
    """Their indices among the n joints of the robot."""
    rest: Floats
    """
    Positions of all joints of the robot where they do not move, shape (n,) [rad or m].

    The way to the start of a motion begins there.
    """
    lower: Floats
    """Shape (m,) [rad or m]."""
    upper: Floats
    """Shape (m,) [rad or m]."""
    speeds: Floats
    """Shape (m,) [rad/s or m/s]."""
    efforts: Floats
    """Of all joints of the robot, shape (n,) [N m or N]; inf if there is none."""
    clearance: Clearance | None = None
    """What the robot must keep clear of; None for nothing."""
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
) -> MotionLimits:
    """
    Collect the limits of a motion.

    Parameters
    ----------
    robot : RobotModel
        The robot, with its limits.
    joints : sequence of str
        The joints to move; empty for all that can move and carry more than a few grams.
    fraction : float
        Fraction of ranges, speeds and efforts to use.
    ranges : mapping of str to (float, float), optional
        Position ranges by joint, to be used in full, in place of those of the robot description
        [rad or m].
    rest : mapping of str to float, optional
        Positions of joints that do not move, and positions before the motion of those that do
        [rad or m]; by default 0 or the nearest limit.

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
    names = _chosen(robot, joints, still, _light(robot), notes)
    index = robot.joint_indices(names)
    return MotionLimits(
        tuple(names),
        index,
        positions,
        lower[index],
        upper[index],
        speeds[index],
        fraction * robot.effort_limits,
        notes=tuple(notes),
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


def _light(robot: RobotModel) -> dict[str, str]:
    """Return the joints that carry next to nothing, such as those of fingers, with the mass."""
    carried = robot.mass.copy()
    for body in range(len(carried) - 1, 0, -1):
        carried[robot.parent[body]] += carried[body] if robot.parent[body] > 0 else 0.0
    of_joints = np.bincount(robot.joint_index[1:], carried[1:], len(robot.joint_names))
    least = min(_LIGHT[0], _LIGHT[1] * float(robot.mass[1:].sum()))
    return {
        robot.joint_names[i]: f'it carries {of_joints[i]:.2g} kg; --joints moves it'
        for i in np.flatnonzero(of_joints < least)
    }


def _chosen(
    robot: RobotModel,
    joints: Sequence[str],
    still: dict[str, str],
    light: dict[str, str],
    notes: list[str],
) -> list[str]:
    """Return the joints to move, in the order of the robot."""
    robot.joint_indices(joints)
    for name in joints:
        if name in still:
            raise ConfigurationError(f"joint '{name}' cannot move: {still[name]}")
    if not joints:
        still = light | still
    wanted = joints or robot.joint_names
    names = [name for name in robot.joint_names if name in wanted and name not in still]
    if not names:
        reasons = '; '.join(f"'{name}': {reason}" for name, reason in still.items())
        raise ConfigurationError(
            f"robot '{robot.name}' has no joint that can move{f' ({reasons})' * bool(reasons)}"
        )
    left_out = [f'{name} ({still[name]})' for name in robot.joint_names if name in still]
    if left_out and not joints:
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
    q = whole_positions(limits, states.q)
    whole = States(q, np.zeros_like(q), np.zeros_like(q))
    for part, values in zip(whole[1:], states[1:], strict=True):
        part[:, limits.index] = values
    return whole


def whole_positions(limits: MotionLimits, q: Floats) -> Floats:
    """Return the positions of all joints, shape (k, n), for those of the m that move."""
    whole: Floats = np.tile(limits.rest, (len(q), 1))
    whole[:, limits.index] = q
    return whole


def random_states(limits: MotionLimits, count: int, rng: np.random.Generator) -> States:
    """Draw states within the limits; accelerations are such as to reach the speed in 0.5 s."""
    m = len(limits.speeds)
    q = rng.uniform(limits.lower, limits.upper, (count, m))
    qd = rng.uniform(-limits.speeds, limits.speeds, (count, m))
    qdd = rng.uniform(-2.0 * limits.speeds, 2.0 * limits.speeds, (count, m))
    return States(q, qd, qdd)


def keep_clear(
    robot: RobotModel,
    limits: MotionLimits,
    capsules: Capsules,
    floor: float = -math.inf,
    boxes: Sequence[Floats] = (),
) -> MotionLimits:
    """
    Return limits of motions that hit nothing.

    Parameters
    ----------
    robot : RobotModel
        The robot of n joints.
    limits : MotionLimits
        Other limits of its motion.
    capsules : Capsules
        Around its bodies.
    floor, boxes
        As for `find_clearance`.

    """
    poses = random_states(limits, _POSES, np.random.default_rng(3)).q
    poses = whole_positions(limits, poses)
    clearance = find_clearance(robot, capsules, poses, floor, boxes)
    return replace(limits, clearance=clearance, notes=(*limits.notes, *capsules.notes))


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
        One column for each limit of position, speed and effort; 0 within it.

    """
    parts = [
        np.abs(states.q - limits.middle) / limits.half,
        np.abs(states.qd) / limits.speeds,
    ]
    bounded = np.isfinite(limits.efforts)
    if bounded.any():
        efforts = dynamics.efforts(*whole_states(limits, states))
        parts.append(np.abs(efforts[:, bounded]) / limits.efforts[bounded])
    found: Floats = np.maximum(np.concatenate(parts, axis=1) - aim, 0.0)
    return found
