"""
Computes gravity efforts over the workspace, and the payload that the effort limits allow.

Poses are samples of a low-discrepancy sequence over the joint ranges. A local search, joint by
joint, starts from the worst samples and finds the worst poses, such as a fully extended arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import ConfigurationError
from ..robot.model import (
    Booleans,
    Floats,
    Integers,
    RobotModel,
)

SAMPLES = 4096
_CANDIDATES = 33
"""Positions of one joint that the search tries: 11 degrees apart for a full turn."""
_WINDOWS = (1.0, 1.0, 0.1, 0.01)
"""Fractions of the range of a joint that the passes of the search cover."""
_STARTS = 3
"""Number of the worst samples from which the search for a worst pose starts."""
_MOST_BODIES = 2e8
"""Bodies whose gravity the search computes at most, which takes about ten seconds."""
_TIE = 1e-9
"""Efforts whose relative difference is smaller are regarded as equal."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Efforts that hold a robot with n joints in s poses."""

    robot: RobotModel
    poses: Floats
    """Joint positions, shape (s, n) [rad or m]: the worst pose of each joint, then samples."""
    efforts: Floats
    """Gravity efforts in those poses, shape (s, n) [N m or N]."""
    limits: Floats
    """Effort limits, shape (n,) [N m or N]; inf if there is none."""
    is_search_shortened: bool = False
    """Whether there were too many joints to search for the worst poses thoroughly."""

    @property
    def sampled(self) -> slice:
        """Slice of the poses that are samples."""
        return slice(len(self.limits), None)

    @property
    def worst(self) -> Integers:
        """Index of the pose with the largest gravity effort of each joint, shape (n,)."""
        # If several poses are equally bad, the first one is the result of the search.
        sizes = np.abs(self.efforts)
        highest = np.max(sizes, axis=0) * (1.0 - _TIE) - _TIE * np.max(sizes)
        poses: Integers = np.argmax(sizes >= highest, axis=0)
        return poses

    @property
    def peaks(self) -> Floats:
        """Largest absolute gravity effort of each joint, shape (n,) [N m or N]."""
        peaks: Floats = np.max(np.abs(self.efforts), axis=0)
        return peaks

    @property
    def hardest(self) -> int:
        """The joint closest to its limit; without limits, the one with the largest effort."""
        ratios = self.peaks / self.limits
        return int(np.argmax(ratios if np.any(ratios > 0.0) else self.peaks))


class PayloadCapacity(NamedTuple):
    """The largest point mass at the origin of a link that every joint can hold in every pose."""

    link: str
    mass: float
    """[kg]; inf if no effort limit restricts it, 0 if gravity alone exceeds a limit."""
    joint: str | None
    """The joint that reaches its limit first; None if no joint does."""
    pose: Floats
    """The pose in which it does, shape (n,) [rad or m]."""


def joint_ranges(robot: RobotModel) -> tuple[Floats, Floats]:
    """Return the ends of the joint ranges, of at most one turn, each of shape (n,) [rad or m]."""
    lower, upper = robot.lower.copy(), robot.upper.copy()
    is_wide = ~robot.is_prismatic_joint & ~(upper - lower <= 2.0 * math.pi)
    # The turn around zero, if it is within the limits.
    start = np.clip(-math.pi, lower[is_wide], upper[is_wide] - 2.0 * math.pi)
    lower[is_wide], upper[is_wide] = start, start + 2.0 * math.pi
    return lower, upper


def explore(
    dynamics: InverseDynamics,
    samples: int = SAMPLES,
    effort_limits: ArrayLike | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Workspace:
    """
    Compute the gravity efforts over the whole workspace.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot with n joints, and the loads on it.
    samples : int
        Number of poses from a Sobol sequence; rounded up to a power of two.
    effort_limits : array_like, shape (n,), optional
        Effort limits [N m or N]; default: those of the robot description.
    progress : callable
        Called now and then with the fraction done, 0 to 1.

    Returns
    -------
    workspace : Workspace
        Always the same for the same arguments.

    Raises
    ------
    ConfigurationError
        If there are no joints, or fewer than two samples.

    """
    from scipy.stats import qmc  # the import takes a second

    robot = dynamics.robot
    n = len(robot.joint_names)
    if n == 0:
        raise ConfigurationError(f"robot '{robot.name}' has no movable joint")
    if samples < 2:
        raise ConfigurationError(f'samples is {samples}, expected at least 2')
    limits = robot.effort_limits if effort_limits is None else np.asarray(effort_limits, float)
    lower, upper = joint_ranges(robot)
    sequence = qmc.Sobol(n, scramble=False).random_base2(math.ceil(math.log2(samples)))
    poses = lower + (upper - lower) * sequence
    efforts = dynamics.gravity_efforts(poses)
    noise = _TIE * float(np.max(np.abs(efforts)))
    starts, windows, most_joints = _extent_of_search(n)
    related_joints = _related_joints(robot)
    found = []
    for joint in range(n):
        related = related_joints[joint]
        moved = np.flatnonzero(related)
        # The nearest joints matter most, if there are too many to move them all.
        nearest = np.sort(moved[np.argsort(np.abs(moved - joint), kind='stable')[:most_joints]])
        size = _absolute_effort(dynamics, joint)
        tops = [
            # Joints without influence on this one are set to zero, which is easier to picture.
            _climb(
                size,
                np.where(related, poses[k], np.clip(0.0, lower, upper)),
                nearest,
                lower,
                upper,
                noise,
                windows,
            )
            for k in np.argsort(-np.abs(efforts[:, joint]))[:starts]
        ]
        # The first one, except if another one is higher by more than rounding errors.
        heights = size(np.array(tops))
        found.append(tops[int(np.argmax(heights >= np.max(heights) * (1.0 - _TIE) - noise))])
        progress((joint + 1) / n)
    worst = np.array(found)
    return Workspace(
        robot,
        np.concatenate([worst, poses]),
        np.concatenate([dynamics.gravity_efforts(worst), efforts]),
        limits,
        most_joints < n or (starts, windows) != (_STARTS, _WINDOWS),
    )


def _extent_of_search(joints: int) -> tuple[int, tuple[float, ...], int]:
    """Return how many starts, which windows and how many joints to search in bounded time."""
    for starts, windows in ((_STARTS, _WINDOWS), (1, _WINDOWS), (1, _WINDOWS[:1])):
        bodies = joints**2 * (_CANDIDATES + 2) * starts * len(windows)
        most_joints = max(1, int(_MOST_BODIES / bodies))
        if most_joints >= joints:
            break
    return starts, windows, most_joints


def payload_capacity(
    dynamics: InverseDynamics, workspace: Workspace, link: str
) -> PayloadCapacity:
    """
    Compute the largest payload that the robot can hold at rest within its effort limits.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot for which the workspace was explored, with its present payload if it has one.
    workspace : Workspace
        Result of `explore`.
    link : str
        Any link of the robot description; the point mass is at its origin.

    Returns
    -------
    capacity : PayloadCapacity
        Valid for all poses of the workspace, and for the worst one that a search finds.

    Raises
    ------
    ConfigurationError
        If the link does not exist.

    Notes
    -----
    Gravity efforts are linear in the mass, so that two of them per pose determine it.

    """
    robot, limits = workspace.robot, workspace.limits
    if np.any(workspace.peaks > limits):
        worst = workspace.poses[workspace.worst[workspace.hardest]]
        return PayloadCapacity(link, 0.0, robot.joint_names[workspace.hardest], worst)
    bare = InverseDynamics(robot, dynamics.gravity)
    laden = InverseDynamics(robot, dynamics.gravity)
    laden.set_payload(link, 1.0)

    def masses(poses: Floats) -> Floats:
        """Return the mass that each joint can hold in each pose, shape (s, n) [kg]."""
        per_kilogram = laden.gravity_efforts(poses) - bare.gravity_efforts(poses)
        efforts = dynamics.gravity_efforts(poses)
        return _largest_masses(efforts, per_kilogram, limits)

    def shortage(poses: Floats) -> Floats:
        least: Floats = np.min(masses(poses), axis=1)
        # Finite, and larger for smaller masses.
        return 1.0 / (np.minimum(least, 1e9) + 1e-6)

    everywhere = np.min(masses(workspace.poses), axis=1)
    start: Floats = workspace.poses[np.argmin(everywhere)]
    if math.isfinite(np.min(everywhere)):
        lower, upper = joint_ranges(robot)
        body = int(robot.link_body[robot.link_index(link)])
        on_path = np.zeros(len(start), dtype=bool)
        on_path[[j for j in _path(robot, body) if j >= 0]] = True
        start = _climb(shortage, start, np.flatnonzero(on_path), lower, upper)
    allowed = masses(start[np.newaxis])[0]
    joint = int(np.argmin(allowed))
    mass = min(float(allowed[joint]), float(np.min(everywhere)))
    return PayloadCapacity(
        link, mass, robot.joint_names[joint] if mass < math.inf else None, start
    )


def _largest_masses(efforts: Floats, per_kilogram: Floats, limits: Floats) -> Floats:
    """Solve |efforts + mass * per_kilogram| = limits for the mass; 0 if there is no solution."""
    slope = np.abs(per_kilogram)
    # Effort in the direction in which the payload acts.
    used = efforts * np.sign(per_kilogram)
    with np.errstate(divide='ignore', invalid='ignore'):
        masses = np.where(slope > 1e-12, (limits - used) / slope, math.inf)
    masses = np.where(np.isfinite(limits), masses, math.inf)
    result: Floats = np.where(np.abs(efforts) > limits, 0.0, np.maximum(masses, 0.0))
    return result


def _absolute_effort(dynamics: InverseDynamics, joint: int) -> Callable[[Floats], Floats]:
    def size(poses: Floats) -> Floats:
        efforts: Floats = np.abs(dynamics.gravity_efforts(poses)[:, joint])
        return efforts

    return size


def _climb(
    height: Callable[[Floats], Floats],
    start: Floats,
    joints: Integers,
    lower: Floats,
    upper: Floats,
    noise: float = 0.0,
    windows: tuple[float, ...] = _WINDOWS,
) -> Floats:
    """
    Maximize a function of the pose, one joint at a time, in smaller and smaller windows.

    Gravity efforts are sinusoids of revolute and linear functions of prismatic joint positions, so
    that there are few local maxima. Of equally high poses, the one nearest to zero is chosen.

    """
    pose: Floats = start.copy()
    for fraction in windows:
        half = 0.5 * fraction * (upper - lower)
        for joint in joints:
            low = max(lower[joint], pose[joint] - half[joint]) if fraction < 1.0 else lower[joint]
            high = min(upper[joint], pose[joint] + half[joint]) if fraction < 1.0 else upper[joint]
            places = np.linspace(low, high, _CANDIDATES)
            places = np.append(places, [pose[joint], np.clip(0.0, lower[joint], upper[joint])])
            poses = np.tile(pose, (len(places), 1))
            poses[:, joint] = places
            heights = height(poses)
            best = float(np.max(heights))
            ties = np.flatnonzero(heights >= best * (1.0 - _TIE) - noise)
            pose = poses[ties[np.argmin(np.abs(places[ties]))]]
    return pose


def _related_joints(robot: RobotModel) -> Booleans:
    """
    Return which joints are on a path with each joint, shape (n, n).

    Others have no influence on its effort.

    """
    related = np.zeros((len(robot.joint_names), len(robot.joint_names)), dtype=bool)
    for body in range(1, len(robot.parent)):
        path = _path(robot, body)
        related[np.ix_(path, path)] = True
    return related


def _path(robot: RobotModel, body: int) -> list[int]:
    """List the joints between the base and a body."""
    path = []
    while body > 0:
        path.append(int(robot.joint_index[body]))
        body = int(robot.parent[body])
    return path
