"""
Collects the limits of a motion, and draws random states within the limits.

Missing position and speed limits are replaced by assumed values. A missing effort limit remains
infinite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from ...errors import ConfigurationError, listed
from ...robot.kinematics import last_link, path_to
from ...robot.model import Booleans, Floats, RobotModel
from ..sizing import joint_ranges

FRACTION = 0.8
"""Fraction of the limits that a motion uses. The controller may need the rest."""
ASSUMED_SPEED = (1.0, 0.25)
"""Assumed speed limits of a revolute joint [rad/s] and of a prismatic joint [m/s]."""
ASSUMED_SLIDE = 1.0
"""Assumed length of the range of a prismatic joint without position limits [m]."""
_LEAST_RANGE = 1e-3
"""A joint is considered immovable if its range is smaller than this value [rad or m]."""
_POSES = 300
"""Number of random poses that show which links are often close to each other."""


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of a motion. Joints that are not in `joint_names` stay at their `rest` positions."""

    joint_names: tuple[str, ...]
    """Names of the moving joints."""
    index: list[int]
    """Indices of the moving joints among all joints of the robot."""
    rest: Floats
    """Positions of all joints before the motion, shape (joints,) [rad or m]."""
    lower: Floats
    """Lower ends of the position ranges, shape (moving joints,) [rad or m]."""
    upper: Floats
    """Upper ends of the position ranges, shape (moving joints,) [rad or m]."""
    speeds: Floats
    """Largest permitted speeds, shape (moving joints,) [rad/s or m/s]."""
    efforts: Floats
    """
    Largest permitted effort of each joint, shape (joints,) [N m or N].

    It is inf without a limit, and for a joint that the motion does not load.
    """
    notes: tuple[str, ...] = ()
    """Notes for the user about assumptions."""

    @property
    def middle(self) -> Floats:
        """Middle of the position ranges, shape (moving joints,) [rad or m]."""
        return np.asarray(0.5 * (self.lower + self.upper))

    @property
    def half(self) -> Floats:
        """Half width of the position ranges, shape (moving joints,) [rad or m]."""
        return np.asarray(0.5 * (self.upper - self.lower))


def motion_limits(
    robot: RobotModel, joints: Sequence[str] = (), link: str | None = None
) -> MotionLimits:
    """
    Collect the limits of a motion.

    `joints` are the joints to move. The default is all joints between the base and `link` that can
    move, except those of a virtual base. The default of `link` is `last_link`. The motion may use
    the `FRACTION` of the position ranges, speeds and efforts. Before the motion, each joint is at
    0, or in the middle of its range if 0 is out of range. Raises ConfigurationError if a joint
    does not exist or cannot move.

    """
    notes: list[str] = []
    lower, upper, speeds, assumed = _ranges(robot)
    low, high = joint_ranges(robot)
    positions = np.where((low <= 0.0) & (high >= 0.0), 0.0, 0.5 * (lower + upper))
    still = {  # joints that cannot move, with the reason
        name: f'its range is only {low:g} to {high:g}'
        for name, low, high in zip(robot.joint_names, lower, upper, strict=True)
        if high - low < _LEAST_RANGE
    }
    names = _chosen(robot, joints, link or last_link(robot), still, notes)
    index = robot.joint_indices(names)
    for words, is_assumed in assumed.items():
        if is_assumed[index].any():
            joints = [robot.joint_names[i] for i in index if is_assumed[i]]
            notes.append(f'{words}: {listed(joints)}')
    return MotionLimits(
        tuple(names),
        index,
        positions,
        lower[index],
        upper[index],
        speeds[index],
        np.where(_loaded(robot, index), FRACTION * robot.effort_limits, np.inf),
        notes=tuple(notes),
    )


def _ranges(robot: RobotModel) -> tuple[Floats, Floats, Floats, dict[str, Booleans]]:
    """Return lower, upper and speed limits, and for which joints something is assumed."""
    slides = robot.is_prismatic_joint
    lower, upper = joint_ranges(robot)
    unbounded = slides & ~(np.isfinite(lower) & np.isfinite(upper))
    start = np.where(np.isfinite(lower), lower, -0.5 * ASSUMED_SLIDE)
    start = np.where(np.isfinite(upper), upper - ASSUMED_SLIDE, start)
    lower = np.where(unbounded, start, lower)
    upper = np.where(unbounded, start + ASSUMED_SLIDE, upper)
    middle, half = 0.5 * (lower + upper), 0.5 * FRACTION * (upper - lower)
    speeds = np.where(slides, ASSUMED_SPEED[1], ASSUMED_SPEED[0])
    speeds = np.where(np.isfinite(robot.velocity_limits), robot.velocity_limits, speeds)
    endless = ~slides & ~(robot.upper - robot.lower <= 2.0 * math.pi)
    turning, sliding = ASSUMED_SPEED
    assumed = {
        'joints with a range of more than one turn move within one turn': endless,
        f'joints without position limits move within {ASSUMED_SLIDE:g} m': unbounded,
        f'joints without a speed limit move with at most {turning:g} rad/s or {sliding:g} m/s': (
            ~np.isfinite(robot.velocity_limits)
        ),
    }
    return middle - half, middle + half, FRACTION * speeds, assumed


def _chosen(
    robot: RobotModel, joints: Sequence[str], link: str, still: dict[str, str], notes: list[str]
) -> list[str]:
    """Return the joints to move, in the order of the robot."""
    robot.joint_indices(joints)
    for name in joints:
        if name in still:
            raise ConfigurationError(f"joint '{name}' cannot move: {still[name]}")
    path = path_to(robot, int(robot.link_body[robot.link_index(link)]))
    arm = [robot.joint_names[robot.joint_index[body]] for body in path[_virtual(robot, path) :]]
    wanted = [name for name in joints or arm if name not in still]
    names = [name for name in robot.joint_names if name in wanted]
    others = [
        f'{name} ({still[name]})' if name in still else name
        for name in robot.joint_names
        if name not in wanted
    ]
    hint = f'joints that do not move: {listed(others)}; --joints names all joints to move'
    if not names:
        raise ConfigurationError(
            f"robot '{robot.name}' has no joint to move between the base and link '{link}'"
            + (f'; {hint}' if others else '')
        )
    if others and not joints:
        notes.append(hint)
    return names


def _loaded(robot: RobotModel, index: Sequence[int]) -> Booleans:
    """Return whether the motion of some joints loads each joint, shape (joints,)."""
    loaded = np.zeros(len(robot.joint_names), bool)
    for body in range(1, len(robot.parent)):
        joints = robot.joint_index[path_to(robot, body)]
        loaded[joints] |= bool(np.isin(joints, index).any())
    return loaded


def _virtual(robot: RobotModel, path: Sequence[int]) -> int:
    """
    Return the number of joints with which a description lets the whole robot drive or fly.

    These joints are between a base without mass and the first body with mass on the path. There
    are at least two of them, and at least one of them is prismatic.
    """
    count = 1 + int(np.argmax(robot.mass[path] > 0.0)) if path else 0
    is_virtual = robot.mass[0] == 0.0 and count > 1 and robot.is_prismatic[path[:count]].any()
    return count if is_virtual else 0


# ---- States --------------------------------------------------------------------------------


class States(NamedTuple):
    """States of the moving joints; each array has the shape (states, moving joints)."""

    q: Floats
    """Positions [rad or m]."""
    qd: Floats
    """Velocities [rad/s or m/s]."""
    qdd: Floats
    """Accelerations [rad/s^2 or m/s^2]."""


def whole_states(limits: MotionLimits, states: States) -> States:
    """Extend states of the moving joints to all joints of the robot, shape (states, joints)."""
    q = whole_positions(limits, states.q)
    whole = States(q, np.zeros_like(q), np.zeros_like(q))
    whole.qd[:, limits.index], whole.qdd[:, limits.index] = states.qd, states.qdd
    return whole


def whole_positions(limits: MotionLimits, q: Floats) -> Floats:
    """Extend positions of the moving joints to all joints of the robot, shape (poses, joints)."""
    whole: Floats = np.tile(limits.rest, (len(q), 1))
    whole[:, limits.index] = q
    return whole


def random_states(limits: MotionLimits, count: int, rng: np.random.Generator) -> States:
    """
    Draw random states within the position and speed limits.

    The largest acceleration takes a joint from rest to its largest speed in 0.5 s.

    """
    m = len(limits.speeds)
    q = rng.uniform(limits.lower, limits.upper, (count, m))
    qd = rng.uniform(-limits.speeds, limits.speeds, (count, m))
    qdd = rng.uniform(-2.0 * limits.speeds, 2.0 * limits.speeds, (count, m))
    return States(q, qd, qdd)


def default_and_random_poses(limits: MotionLimits) -> Floats:
    """Return the default pose, and random poses within the limits, shape (poses, joints)."""
    states = random_states(limits, _POSES, np.random.default_rng(3))
    return np.vstack([limits.rest, whole_positions(limits, states.q)])
