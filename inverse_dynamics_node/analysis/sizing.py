"""
Computes the efforts that a trajectory requires, and the payload that the effort limits allow.

Gravity efforts are computed in poses that are sampled from the whole workspace. A local search
starts from the samples with the largest efforts and moves one joint at a time. The search finds
the worst poses, such as a fully extended arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from ..dynamics.effort_terms import EffortTerms
from ..dynamics.inverse_dynamics import InverseDynamics
from ..dynamics.trajectory import Trajectory, whole_states
from ..errors import ConfigurationError
from ..robot.kinematics import path_to
from ..robot.model import Booleans, Floats, Integers, RobotModel

SAMPLES = 4096
_CANDIDATES = 33
"""Number of positions that the search tries for each joint, 11 degrees apart over a full turn."""
_WINDOWS = (1.0, 1.0, 0.1, 0.01)
"""Fraction of the joint range that each pass of the search covers."""
_STARTS = 3
"""The search starts from this many samples, which have the largest efforts."""
_MOST_BODIES = 2e8
"""Largest product of poses and bodies in a search, which then takes about ten seconds."""
_TIE = 1e-9
"""Efforts with a smaller relative difference are regarded as equal."""
_ROUNDING = 1e-6
"""Smaller violations of limits are ignored, because files may have only six digits."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Gravity efforts of a robot in many poses."""

    robot: RobotModel
    poses: Floats
    """
    Joint positions, shape (poses, joints) [rad or m].

    The first rows are the worst pose of each joint. The sampled poses follow.
    """
    efforts: Floats
    """Gravity efforts in the `poses`, shape (poses, joints) [N m or N]."""
    limits: Floats
    """Effort limits, shape (joints,) [N m or N]; inf for a joint without a limit."""
    is_search_shortened: bool = False
    """Whether the search for the worst poses was shortened because of many joints."""

    @property
    def sampled(self) -> slice:
        """Slice of the sampled poses."""
        return slice(len(self.limits), None)

    @property
    def worst(self) -> Integers:
        """Indices of the poses with the largest gravity effort of each joint, shape (joints,)."""
        # If several poses are equally bad, choose the first pose, which the search found.
        sizes = np.abs(self.efforts)
        highest = np.max(sizes, axis=0) * (1.0 - _TIE) - _TIE * np.max(sizes)
        return np.asarray(np.argmax(sizes >= highest, axis=0))

    @property
    def peaks(self) -> Floats:
        """Largest absolute gravity effort of each joint, shape (joints,) [N m or N]."""
        return np.asarray(np.max(np.abs(self.efforts), axis=0))

    @property
    def hardest(self) -> int:
        """
        Index of the joint nearest to its effort limit.

        Without effort limits, the joint with the largest effort is chosen.

        """
        ratios = self.peaks / self.limits
        return int(np.argmax(ratios if np.any(ratios > 0.0) else self.peaks))


class PayloadCapacity(NamedTuple):
    """The largest point mass that all joints can hold at the origin of a link in every pose."""

    link: str
    mass: float
    """Largest mass [kg]; inf if no limit restricts the mass, 0 if the arm cannot hold itself."""
    joint: str | None
    """The joint that reaches its limit first; None if no joint reaches a limit."""
    pose: Floats
    """Pose in which the joint reaches its limit, shape (joints,) [rad or m]."""


def joint_ranges(robot: RobotModel) -> tuple[Floats, Floats]:
    """Return the lower and upper ends of joint ranges [rad or m], at most one turn per joint."""
    lower, upper = robot.lower.copy(), robot.upper.copy()
    is_wide = ~robot.is_prismatic_joint & ~(upper - lower <= 2.0 * math.pi)
    # Prefer the turn from -180 to 180 degrees.
    start = np.clip(-math.pi, lower[is_wide], upper[is_wide] - 2.0 * math.pi)
    lower[is_wide], upper[is_wide] = start, start + 2.0 * math.pi
    return lower, upper


def explore(
    dynamics: InverseDynamics,
    samples: int = SAMPLES,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Workspace:
    """
    Compute the gravity efforts over the whole workspace.

    The poses are an unscrambled Sobol sequence, so equal arguments give equal results. The number
    of samples is rounded up to a power of two. `progress` is called repeatedly with the completed
    fraction, 0 to 1. Raises ConfigurationError if the robot has no movable joint, or if fewer than
    two samples are requested.

    """
    from scipy.stats import qmc  # the import takes a second

    robot = dynamics.robot
    n = len(robot.joint_names)
    if n == 0:
        raise ConfigurationError(f"robot '{robot.name}' has no movable joint")
    if samples < 2:
        raise ConfigurationError(f'samples is {samples}, expected at least 2')
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
        # If there are too many joints to move, move the nearest joints, which matter most.
        nearest = np.sort(moved[np.argsort(np.abs(moved - joint), kind='stable')[:most_joints]])

        def size(poses: Floats, joint: int = joint) -> Floats:
            return np.asarray(np.abs(dynamics.gravity_efforts(poses)[:, joint]))

        tops = []
        for k in np.argsort(-np.abs(efforts[:, joint]))[:starts]:
            # Set unrelated joints to zero, because the pose is then easier to imagine.
            start = np.where(related, poses[k], np.clip(0.0, lower, upper))
            tops.append(_climb(size, start, nearest, lower, upper, noise, windows))
        # Choose the first pose, unless the effort in another pose is clearly larger.
        heights = size(np.array(tops))
        found.append(tops[int(np.argmax(heights >= np.max(heights) * (1.0 - _TIE) - noise))])
        progress((joint + 1) / n)
    worst = np.array(found)
    return Workspace(
        robot,
        np.concatenate([worst, poses]),
        np.concatenate([dynamics.gravity_efforts(worst), efforts]),
        robot.effort_limits,
        starts < _STARTS,
    )


def _extent_of_search(joints: int) -> tuple[int, tuple[float, ...], int]:
    """Return the number of starts, the windows, and the largest number of joints to move."""
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

    The payload is a point mass at the origin of a link. If the robot already carries a payload,
    `workspace` must include this payload, and the capacity is the additional mass. The capacity is
    valid for all poses in `workspace`, and for the worst pose that a local search finds. Raises
    ConfigurationError if the link does not exist.

    Gravity efforts are linear in the mass, so the effort per kilogram determines the largest mass.

    """
    robot, limits = workspace.robot, workspace.limits
    if np.any(workspace.peaks > limits):
        worst = workspace.poses[workspace.worst[workspace.hardest]]
        return PayloadCapacity(link, 0.0, robot.joint_names[workspace.hardest], worst)
    bare = InverseDynamics(robot, dynamics.gravity)
    laden = InverseDynamics(robot, dynamics.gravity)
    laden.set_payload(link, 1.0)

    def masses(poses: Floats) -> Floats:
        """Return the mass that each joint can hold in each pose, shape (poses, joints) [kg]."""
        per_kilogram = laden.gravity_efforts(poses) - bare.gravity_efforts(poses)
        efforts, slope = dynamics.gravity_efforts(poses), np.abs(per_kilogram)
        # Existing effort in the direction of the added effort.
        used = efforts * np.sign(per_kilogram)
        with np.errstate(divide='ignore', invalid='ignore'):
            found = np.where(slope > 1e-12, (limits - used) / slope, math.inf)
        found = np.where(np.isfinite(limits), np.maximum(found, 0.0), math.inf)
        return np.where(np.abs(efforts) > limits, 0.0, found)

    def shortage(poses: Floats) -> Floats:
        least: Floats = np.min(masses(poses), axis=1)
        # The shortage is finite, and increases when the mass decreases.
        return 1.0 / (np.minimum(least, 1e9) + 1e-6)

    everywhere = np.min(masses(workspace.poses), axis=1)
    start: Floats = workspace.poses[np.argmin(everywhere)]
    if math.isfinite(np.min(everywhere)):
        lower, upper = joint_ranges(robot)
        path = path_to(robot, int(robot.link_body[robot.link_index(link)]))
        start = _climb(shortage, start, np.unique(robot.joint_index[path]), lower, upper)
    allowed = masses(start[np.newaxis])[0]
    joint = int(np.argmin(allowed))
    mass = min(float(allowed[joint]), float(np.min(everywhere)))
    return PayloadCapacity(
        link, mass, robot.joint_names[joint] if mass < math.inf else None, start
    )


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
    Maximise a function of the pose, one joint at a time, in smaller and smaller windows.

    There are few local maxima, because gravity efforts are sinusoidal in the position of a
    revolute joint and linear in the position of a prismatic joint. If several positions of a joint
    are equally good, the position nearest to zero is chosen.

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
    """Return which joints affect the gravity effort of each joint, shape (joints, joints)."""
    related = np.zeros((len(robot.joint_names), len(robot.joint_names)), dtype=bool)
    for body in range(1, len(robot.parent)):
        path = robot.joint_index[path_to(robot, body)]
        related[np.ix_(path, path)] = True
    return related


# ---- Trajectories --------------------------------------------------------------------------


class EffortRequirements(NamedTuple):
    """Efforts, speeds and powers that a trajectory requires."""

    efforts: Floats
    """Joint efforts, shape (times, joints) [N m or N]."""
    terms: EffortTerms
    """Terms of the efforts, such as gravity, each of shape (times, joints) [N m or N]."""
    peak: Floats
    """Signed effort with the largest absolute value, shape (joints,) [N m or N]."""
    peak_time: Floats
    """Time of the peak effort, shape (joints,) [s]."""
    rms: Floats
    """Root mean square of the effort over time, shape (joints,) [N m or N]."""
    rms_terms: Floats
    """Root mean square of each term over time, shape (5, joints) [N m or N]."""
    speed: Floats
    """Largest speed, shape (joints,) [rad/s or m/s]."""
    power: Floats
    """Largest product of effort and velocity, shape (joints,) [W]; 0 if the joint only brakes."""
    braking: Floats
    """Largest power that the joint absorbs, shape (joints,) [W]; 0 if the joint never brakes."""
    effort_limits: Floats
    """Effort limits, shape (joints,) [N m or N]; inf for a joint without a limit."""
    velocity_limits: Floats
    """Velocity limits, shape (joints,) [rad/s or m/s]; inf for a joint without a limit."""
    is_too_strong: Booleans
    """Whether the peak effort exceeds the effort limit, shape (joints,)."""
    is_too_fast: Booleans
    """Whether the largest speed exceeds the velocity limit, shape (joints,)."""
    is_too_far: Booleans
    """Whether a position is outside the position limits, shape (joints,)."""


def effort_requirements(
    dynamics: InverseDynamics, trajectory: Trajectory, others: Floats | None = None
) -> EffortRequirements:
    """
    Compute the efforts, speeds and powers that a trajectory requires.

    The trajectory must have velocities and accelerations. It may contain any joints of the robot,
    in any order. The joints of the result have the same order. `others` contains the positions of
    all joints of the robot [rad or m], by default zero. For joints of the trajectory, these
    positions are ignored. Raises TrajectoryError if a joint is unknown or named twice. Raises
    JointStateError if a value is not finite.

    """
    robot = dynamics.robot
    (q, qd, qdd), index = whole_states(dynamics, trajectory, others)
    efforts = dynamics.efforts(q, qd, qdd)[:, index]
    terms = EffortTerms(*(term[:, index] for term in dynamics.effort_terms(q, qd, qdd)))
    velocities, positions = qd[:, index], q[:, index]
    largest = np.argmax(np.abs(efforts), axis=0)
    power = efforts * velocities
    speed = np.max(np.abs(velocities), axis=0)
    peak = efforts[largest, range(len(index))]
    return EffortRequirements(
        efforts=efforts,
        terms=terms,
        peak=peak,
        peak_time=trajectory.times[largest],
        rms=_rms(trajectory.times, efforts),
        rms_terms=np.array([_rms(trajectory.times, term) for term in terms]),
        speed=speed,
        power=np.max(power, axis=0, initial=0.0),
        braking=np.max(-power, axis=0, initial=0.0),
        effort_limits=robot.effort_limits[index],
        velocity_limits=robot.velocity_limits[index],
        is_too_strong=np.abs(peak) > robot.effort_limits[index] * (1.0 + _ROUNDING),
        is_too_fast=speed > robot.velocity_limits[index] * (1.0 + _ROUNDING),
        is_too_far=np.any(
            (positions < robot.lower[index] - _ROUNDING)
            | (positions > robot.upper[index] + _ROUNDING),
            axis=0,
        ),
    )


def _rms(times: Floats, values: Floats) -> Floats:
    """Compute the root mean square over time by the trapezoidal rule."""
    if len(times) == 1:
        return np.asarray(np.abs(values[0]))
    steps = np.diff(times)[:, np.newaxis]
    squares = np.sum(0.5 * steps * (values[1:] ** 2 + values[:-1] ** 2), axis=0)
    return np.asarray(np.sqrt(squares / (times[-1] - times[0])))
