"""
What gravity asks of the joints wherever the robot can go, and what payload that leaves.

Poses come from a low-discrepancy sequence over the joint ranges; the worst of them are then
searched on, joint by joint, so that an arm stretched out is found and not only come near to.
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
"""Positions tried for one joint at a time: 11 degrees apart in a whole turn."""
_WINDOWS = (1.0, 1.0, 0.1, 0.01)
"""Shares of a joint's range that the sweeps of the search look at."""
_STARTS = 3
"""Samples that the search for a worst pose begins at: the worst ones."""
_TIE = 1e-9
"""Poses that differ by less than this share in what they ask are as bad as each other."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Efforts that hold a robot of n joints in s poses."""

    robot: RobotModel
    poses: Floats
    """Joint positions, shape (s, n) [rad or m]: the worst found for each joint, then samples."""
    efforts: Floats
    """Gravity efforts in those poses, shape (s, n) [N m or N]."""
    limits: Floats
    """Largest efforts, shape (n,) [N m or N]; inf where there is none."""

    @property
    def sampled(self) -> slice:
        """Which of the poses are samples."""
        return slice(len(self.limits), None)

    @property
    def worst(self) -> Integers:
        """In which pose each joint's gravity effort is largest, shape (n,)."""
        # Of poses as bad as each other, the first: it was searched for.
        sizes = np.abs(self.efforts)
        highest = np.max(sizes, axis=0) * (1.0 - _TIE) - _TIE * np.max(sizes)
        poses: Integers = np.argmax(sizes >= highest, axis=0)
        return poses

    @property
    def peaks(self) -> Floats:
        """The largest gravity effort of each joint, shape (n,) [N m or N], without sign."""
        peaks: Floats = np.max(np.abs(self.efforts), axis=0)
        return peaks

    @property
    def hardest(self) -> int:
        """The joint nearest to its limit, or past it; without limits, of the largest effort."""
        shares = self.peaks / self.limits
        return int(np.argmax(shares if np.any(shares > 0.0) else self.peaks))


class Payload(NamedTuple):
    """The largest point mass at a link's origin that every joint holds in every pose."""

    link: str
    mass: float
    """[kg]; inf where no limit stands against it, 0 where gravity alone exceeds a limit."""
    joint: str | None
    """Which joint gives out first; None if none does."""
    pose: Floats
    """Where it does, shape (n,) [rad or m]."""


def joint_ranges(robot: RobotModel) -> tuple[Floats, Floats]:
    """Return the ends of what there is to look at, each of shape (n,): at most one turn."""
    lower, upper = robot.lower.copy(), robot.upper.copy()
    moved = robot.body_names[1:]
    turns = np.array(
        [not robot.is_prismatic[1 + moved.index(name)] for name in robot.joint_names], bool
    )
    is_wide = turns & ~(upper - lower <= 2.0 * math.pi)
    # The turn around zero where it is within the limits.
    start = np.clip(-math.pi, lower[is_wide], upper[is_wide] - 2.0 * math.pi)
    lower[is_wide], upper[is_wide] = start, start + 2.0 * math.pi
    return lower, upper


def explore(
    dynamics: InverseDynamics,
    samples: int = SAMPLES,
    effort_limits: ArrayLike | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Workspace:
    """
    Compute the gravity efforts all over the workspace.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with n joints, and what acts on it.
    samples : int
        How many poses to take from a Sobol sequence: rounded up to a power of two.
    effort_limits : array_like, shape (n,), optional
        Largest efforts [N m or N]; without them, those of the robot description.
    progress : callable
        Is told the share that is done, 0 to 1.

    Returns
    -------
    workspace : Workspace
        The same for the same arguments.

    Raises
    ------
    ConfigurationError
        If there are no joints, or fewer than two samples.

    """
    from scipy.stats import qmc  # a second, for who needs it only

    robot = dynamics.robot
    n = len(robot.joint_names)
    if n == 0:
        raise ConfigurationError(f"robot '{robot.name}' has no joint that moves")
    if samples < 2:
        raise ConfigurationError(f'samples is {samples}, expected at least 2')
    limits = robot.effort_limits if effort_limits is None else np.asarray(effort_limits, float)
    lower, upper = joint_ranges(robot)
    sequence = qmc.Sobol(n, scramble=False).random_base2(math.ceil(math.log2(samples)))
    poses = lower + (upper - lower) * sequence
    efforts = dynamics.gravity_efforts(poses)
    noise = _TIE * float(np.max(np.abs(efforts)))
    found = []
    for joint in range(n):
        near = _relatives(robot, joint)
        size = _size_of(dynamics, joint)
        tops = [
            # What no joint on the way moves counts nothing: at zero it is easier to look at.
            _climb(
                size,
                np.where(near, poses[k], np.clip(0.0, lower, upper)),
                np.flatnonzero(near),
                lower,
                upper,
                noise,
            )
            for k in np.argsort(-np.abs(efforts[:, joint]))[:_STARTS]
        ]
        # The first, but for one that is higher by more than rounding.
        heights = size(np.array(tops))
        found.append(tops[int(np.argmax(heights >= np.max(heights) * (1.0 - _TIE) - noise))])
        progress((joint + 1) / n)
    worst = np.array(found)
    return Workspace(
        robot,
        np.concatenate([worst, poses]),
        np.concatenate([dynamics.gravity_efforts(worst), efforts]),
        limits,
    )


def payload_left(dynamics: InverseDynamics, workspace: Workspace, link: str) -> Payload:
    """
    Find the payload that the effort limits leave, at rest.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot that the workspace was explored with; a payload it has is part of the robot.
    workspace : Workspace
        From `explore`.
    link : str
        Where the mass is: at the origin of any link of the robot description.

    Returns
    -------
    payload : Payload
        What every joint holds in every pose of the workspace, and in a worse one if there is.

    Raises
    ------
    ConfigurationError
        If there is no such link.

    Notes
    -----
    Gravity efforts are linear in the mass, so that it follows from two of them in each pose.

    """
    robot, limits = workspace.robot, workspace.limits
    if np.any(workspace.peaks > limits):
        worst = workspace.poses[workspace.worst[workspace.hardest]]
        return Payload(link, 0.0, robot.joint_names[workspace.hardest], worst)
    bare = InverseDynamics(robot, dynamics.gravity)
    laden = InverseDynamics(robot, dynamics.gravity)
    laden.set_payload(link, 1.0)

    def masses(poses: Floats) -> Floats:
        """Return how much each joint can hold in each pose, shape (s, n) [kg]."""
        per_kilogram = laden.gravity_efforts(poses) - bare.gravity_efforts(poses)
        efforts = dynamics.gravity_efforts(poses)
        return _largest_masses(efforts, per_kilogram, limits)

    def shortage(poses: Floats) -> Floats:
        least: Floats = np.min(masses(poses), axis=1)
        # Finite, and rising as less can be held.
        return 1.0 / (np.minimum(least, 1e9) + 1e-6)

    everywhere = np.min(masses(workspace.poses), axis=1)
    start: Floats = workspace.poses[np.argmin(everywhere)]
    if math.isfinite(np.min(everywhere)):
        lower, upper = joint_ranges(robot)
        body = int(robot.link_body[robot.link_names.index(link)])
        near = np.zeros(len(start), dtype=bool)
        near[[j for j in _path(robot, body) if j >= 0]] = True
        start = _climb(shortage, start, np.flatnonzero(near), lower, upper)
    allowed = masses(start[np.newaxis])[0]
    joint = int(np.argmin(allowed))
    mass = min(float(allowed[joint]), float(np.min(everywhere)))
    return Payload(link, mass, robot.joint_names[joint] if mass < math.inf else None, start)


def _largest_masses(efforts: Floats, per_kilogram: Floats, limits: Floats) -> Floats:
    """Solve |efforts + mass * per_kilogram| = limits for the mass, where it is above 0."""
    slope = np.abs(per_kilogram)
    # In the direction in which the payload pulls, so much is used.
    used = efforts * np.sign(per_kilogram)
    with np.errstate(divide='ignore', invalid='ignore'):
        masses = np.where(slope > 1e-12, (limits - used) / slope, math.inf)
    masses = np.where(np.isfinite(limits), masses, math.inf)
    result: Floats = np.where(np.abs(efforts) > limits, 0.0, np.maximum(masses, 0.0))
    return result


def _size_of(dynamics: InverseDynamics, joint: int) -> Callable[[Floats], Floats]:
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
) -> Floats:
    """
    Search for a higher pose along one joint at a time, in ever smaller windows.

    Gravity efforts are sinusoids of every joint that turns and straight lines of every joint that
    slides, so that this does not get stuck easily. Of poses as high as each other it takes that
    nearest to zero.

    """
    pose: Floats = start.copy()
    for share in _WINDOWS:
        half = 0.5 * share * (upper - lower)
        for joint in joints:
            low = max(lower[joint], pose[joint] - half[joint]) if share < 1.0 else lower[joint]
            high = min(upper[joint], pose[joint] + half[joint]) if share < 1.0 else upper[joint]
            places = np.linspace(low, high, _CANDIDATES)
            places = np.append(places, [pose[joint], np.clip(0.0, lower[joint], upper[joint])])
            poses = np.tile(pose, (len(places), 1))
            poses[:, joint] = places
            heights = height(poses)
            best = float(np.max(heights))
            ties = np.flatnonzero(heights >= best * (1.0 - _TIE) - noise)
            pose = poses[ties[np.argmin(np.abs(places[ties]))]]
    return pose


def _relatives(robot: RobotModel, joint: int) -> Booleans:
    """Tell which joints are before or after one in the tree, or it: others do not touch it."""
    related = np.zeros(len(robot.joint_names), dtype=bool)
    for body in range(1, len(robot.parent)):
        path = _path(robot, body)
        if joint in path:
            related[path] = True
    return related


def _path(robot: RobotModel, body: int) -> list[int]:
    """List the joints between the base and a body."""
    path = []
    while body > 0:
        path.append(int(robot.joint_index[body]))
        body = int(robot.parent[body])
    return path
