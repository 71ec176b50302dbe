"""Computes what drives need: gravity efforts in all poses, a payload, and trajectories."""

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

_SAMPLES = 4096
_STARTS = 5
"""The search for a worst pose starts from this many of the worst samples."""
_SWEEPS = 4
"""Number of times that the search for a worst pose moves every joint."""
_MOST_JOINTS = 80
"""With more joints, the worst of the samples is the result: a search would take minutes."""
_THIRDS = np.array([0.0, 2.0, 4.0]) * math.pi / 3.0
_TIE = 1e-9
"""Efforts with a smaller relative difference are regarded as equal."""
_ROUNDING = 1e-6
"""Smaller violations of limits are ignored, because files may have only six digits."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Worst gravity efforts of the n joints of a robot."""

    robot: RobotModel
    poses: Floats
    """Pose with the largest gravity effort of each joint, shape (n, n) [rad or m]."""
    worst: Floats
    """Gravity effort of each joint in its worst pose, shape (n,) [N m or N]."""
    samples: Floats
    """Random poses, shape (samples, n) [rad or m]."""

    @property
    def ratios(self) -> Floats:
        """Ratio of each worst effort to its limit, shape (n,); 0 without a limit."""
        return np.asarray(np.abs(self.worst) / self.robot.effort_limits)

    @property
    def hardest(self) -> int:
        """
        Index of the joint nearest to its effort limit.

        Without effort limits, the joint with the largest effort is chosen.

        """
        return int(np.argmax(self.ratios if np.any(self.ratios > 0.0) else np.abs(self.worst)))


class PayloadCapacity(NamedTuple):
    """The largest point mass that all joints can hold at the origin of a link in every pose."""

    link: str
    mass: float
    """Largest mass [kg]; inf if no limit restricts the mass, 0 if the arm cannot hold itself."""
    joint: str | None
    """The joint that reaches its limit first; None if no joint reaches a limit."""
    pose: Floats
    """Pose in which the joint reaches its limit, shape (n,) [rad or m]."""
    loads_joints: bool = True
    """Whether the payload changes the gravity effort of any joint."""


def joint_ranges(robot: RobotModel) -> tuple[Floats, Floats]:
    """Return the lower and upper ends of joint ranges [rad or m], at most one turn per joint."""
    lower, upper = robot.lower.copy(), robot.upper.copy()
    is_wide = ~robot.is_prismatic_joint & ~(upper - lower <= 2.0 * math.pi)
    # Prefer the turn from -180 to 180 degrees.
    start = np.clip(-math.pi, lower[is_wide], upper[is_wide] - 2.0 * math.pi)
    lower[is_wide], upper[is_wide] = start, start + 2.0 * math.pi
    return lower, upper


def explore(dynamics: InverseDynamics) -> Workspace:
    """
    Find the largest gravity effort of each joint over the whole workspace.

    The search starts from the worst of random poses, which are the same in every call. Raises
    ConfigurationError if the robot has no movable joint.

    """
    robot = dynamics.robot
    if not robot.joint_names:
        raise ConfigurationError(f"robot '{robot.name}' has no movable joint")
    lower, upper = joint_ranges(robot)
    n = len(lower)
    samples = np.random.default_rng(1979).uniform(lower, upper, (_SAMPLES, n))
    efforts = np.abs(dynamics.gravity_efforts(samples))
    first = samples[np.argsort(-efforts, axis=0)[:_STARTS]]  # shape (starts, n, n)
    # Set unrelated joints to zero, because the pose is then easier to imagine.
    starts = np.where(_related_joints(robot), first, np.clip(0.0, lower, upper))
    columns = np.tile(np.arange(n), _STARTS)
    noise = _TIE * float(np.max(efforts))
    found = _worst_poses(
        robot, dynamics.gravity_efforts, starts.reshape(-1, n), columns, noise
    ).reshape(starts.shape)
    reached = dynamics.gravity_efforts(found)[:, range(n), range(n)]
    best = np.argmax(np.abs(reached) * (1.0 - _TIE * np.arange(_STARTS)[:, np.newaxis]), axis=0)
    return Workspace(robot, found[best, range(n)], reached[best, range(n)], samples)


def payload_capacity(
    dynamics: InverseDynamics, workspace: Workspace, link: str
) -> PayloadCapacity:
    """
    Compute the largest payload that the robot can hold at rest within its effort limits.

    The payload is a point mass at the origin of a link. If the robot already carries a payload,
    `workspace` must include this payload, and the capacity is the additional mass. Raises
    ConfigurationError if the link does not exist.

    Gravity efforts are linear in the mass, so the effort per kilogram determines the largest mass
    in each pose. The pose that permits the least mass is made worse until the mass settles.

    """
    robot = workspace.robot
    bare = InverseDynamics(robot, dynamics.gravity)
    laden = InverseDynamics(robot, dynamics.gravity)
    laden.set_payload(link, 1.0)
    if workspace.ratios.max() > 1.0:
        hardest = workspace.hardest
        return PayloadCapacity(link, 0.0, robot.joint_names[hardest], workspace.poses[hardest])

    def per_kilogram(poses: Floats) -> Floats:
        return laden.gravity_efforts(poses) - bare.gravity_efforts(poses)

    def masses(poses: Floats) -> Floats:
        """Return the mass that each joint can hold in each pose, shape (poses, n) [kg]."""
        slope = per_kilogram(poses)
        # Existing effort in the direction of the added effort.
        used = dynamics.gravity_efforts(poses) * np.sign(slope)
        slope = np.where(np.abs(slope) > 1e-12, np.abs(slope), 1e-300)
        return np.asarray(np.maximum(robot.effort_limits - used, 0.0) / slope)

    poses = np.concatenate([workspace.poses, workspace.samples])
    loads_joints = bool(np.any(np.abs(per_kilogram(poses)) > 1e-12))
    best = PayloadCapacity(link, math.inf, None, poses[0], loads_joints)
    for _ in range(_SWEEPS):
        allowed = masses(poses)
        row, joint = np.unravel_index(np.argmin(allowed), allowed.shape)
        mass, pose = float(allowed[row, joint]), poses[row]
        if mass >= min(best.mass, 1e100):
            break
        best = PayloadCapacity(link, mass, robot.joint_names[joint], pose)

        def efforts(poses: Floats, mass: float = mass) -> Floats:
            return dynamics.gravity_efforts(poses) + mass * per_kilogram(poses)

        starts = poses[np.argsort(allowed[:, joint])[:_STARTS]]
        poses = _worst_poses(robot, efforts, starts, np.full(len(starts), joint), _TIE)
    return best


def _worst_poses(
    robot: RobotModel,
    efforts: Callable[[Floats], Floats],
    starts: Floats,
    columns: Integers,
    noise: float,
) -> Floats:
    """
    Increase the size of one effort in each of k poses, one joint at a time.

    `starts` has the shape (k, n) [rad or m], and `columns` are the k joints with these efforts.
    Gravity efforts are sinusoidal in the position of a revolute joint, so three values give the
    positions of its extrema. They are linear in the position of a prismatic joint. For joints that
    others mimic, both are approximations, so the best of several positions is chosen. If several
    are equally good, the position nearest to zero is chosen.

    """
    lower, upper = joint_ranges(robot)
    poses: Floats = starts.copy()
    rows = np.arange(len(starts))

    def efforts_at(joint: int, places: Floats) -> Floats:
        tried = np.repeat(poses[:, np.newaxis], places.shape[1], axis=1)
        tried[:, :, joint] = places
        return np.asarray(efforts(tried)[rows, :, columns])

    for joint in list(range(len(lower))) * (_SWEEPS if len(lower) <= _MOST_JOINTS else 0):
        low, high = lower[joint], upper[joint]
        values = efforts_at(joint, np.tile(_THIRDS, (len(rows), 1)))
        phase = np.arctan2(values @ np.sin(_THIRDS), values @ np.cos(_THIRDS))
        first = phase + math.pi * np.ceil((low - phase) / math.pi)
        extrema = [first, first + math.pi, first + 2.0 * math.pi]
        fixed = [np.full(len(rows), place) for place in (low, high, 0.0)]
        places = np.clip(np.stack([poses[:, joint], *fixed, *extrema], axis=1), low, high)
        sizes = np.abs(efforts_at(joint, places))
        is_best = sizes >= np.max(sizes, axis=1, keepdims=True) * (1.0 - _TIE) - noise
        choice = np.argmin(np.where(is_best, np.abs(places), math.inf), axis=1)
        poses[:, joint] = places[rows, choice]
    return poses


def _related_joints(robot: RobotModel) -> Booleans:
    """Return which joints affect the gravity effort of each joint, shape (n, n)."""
    related = np.zeros((len(robot.joint_names), len(robot.joint_names)), dtype=bool)
    for body in range(1, len(robot.parent)):
        path = robot.joint_index[path_to(robot, body)]
        related[np.ix_(path, path)] = True
    return related


# ---- Trajectories --------------------------------------------------------------------------


class EffortRequirements(NamedTuple):
    """Efforts, speeds and powers that a trajectory of m joints requires at k times."""

    trajectory: Trajectory
    efforts: Floats
    """Joint efforts, shape (k, m) [N m or N]."""
    terms: EffortTerms
    """Terms of the efforts, such as gravity, each of shape (k, m) [N m or N]."""
    peak: Floats
    """Signed effort with the largest absolute value, shape (m,) [N m or N]."""
    peak_time: Floats
    """Time of the peak effort, shape (m,) [s]."""
    rms: Floats
    """Root mean square of the effort over time, shape (m,) [N m or N]."""
    rms_terms: Floats
    """Root mean square of each term over time, shape (5, m) [N m or N]."""
    speed: Floats
    """Largest speed, shape (m,) [rad/s or m/s]."""
    power: Floats
    """Largest product of effort and velocity, shape (m,) [W]; 0 if the joint only brakes."""
    braking: Floats
    """Largest power that the joint absorbs, shape (m,) [W]; 0 if the joint never brakes."""
    effort_limits: Floats
    """Effort limits, shape (m,) [N m or N]; inf for a joint without a limit."""
    velocity_limits: Floats
    """Velocity limits, shape (m,) [rad/s or m/s]; inf for a joint without a limit."""
    is_beyond: dict[str, Booleans]
    """Whether the largest effort, speed or position is beyond its limit, each of shape (m,)."""


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
    positions, velocities = q[:, index], qd[:, index]
    largest = np.argmax(np.abs(efforts), axis=0)
    peak, speed = efforts[largest, range(len(index))], np.max(np.abs(velocities), axis=0)
    power = efforts * velocities
    too_low = np.any(positions + _ROUNDING < robot.lower[index], axis=0)
    too_high = np.any(positions - _ROUNDING > robot.upper[index], axis=0)
    return EffortRequirements(
        trajectory=trajectory,
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
        is_beyond={
            'effort': np.abs(peak) > robot.effort_limits[index] * (1.0 + _ROUNDING),
            'speed': speed > robot.velocity_limits[index] * (1.0 + _ROUNDING),
            'position': too_low | too_high,
        },
    )


def _rms(times: Floats, values: Floats) -> Floats:
    """Compute the root mean square over time by the trapezoidal rule."""
    if len(times) == 1:
        return np.asarray(np.abs(values[0]))
    steps = np.diff(times)[:, np.newaxis]
    squares = np.sum(0.5 * steps * (values[1:] ** 2 + values[:-1] ** 2), axis=0)
    return np.asarray(np.sqrt(squares / (times[-1] - times[0])))
