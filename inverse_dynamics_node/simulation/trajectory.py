"""
A smooth reference motion that starts and ends at rest and stays within all limits.

Each joint oscillates about its start position, and adjacent joints have different frequencies. A
quintic polynomial fades the sine in and out, so that position, velocity and acceleration are
continuous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.model import Floats, RobotModel
from .mujoco import SimulationError, with_unit_diagonal

LARGEST_SWING = (0.5, 0.1)  # [rad], [m]: of revolute and prismatic joints
FREQUENCIES = (0.20, 0.31, 0.24, 0.38, 0.28, 0.43, 0.34)  # [Hz]: adjacent joints differ
ROOM_USED = 0.8  # fraction of the distance to the nearest position limit
SPEED_USED = 0.5  # fraction of the velocity limit
NEGLIGIBLE = 1e-6  # [N m or N], in place of an effort limit of 0
EFFORT_USED = 0.9  # fraction of the effort limit; feedback needs the remainder
STEEPEST_FADE = 1.875  # largest slope of the quintic


@dataclass(frozen=True, eq=False)
class Oscillation:
    """A motion of n joints that starts and ends at rest in the same pose."""

    start: Floats
    """Start positions of the joints, shape (n,) [rad or m]."""
    swing: Floats
    """Largest distance of each joint from its start position, shape (n,) [rad or m]."""
    frequency: Floats
    """Frequency of each joint's sine, shape (n,) [Hz]."""
    moving: float
    """Duration of the motion [s]."""

    @property
    def fade(self) -> float:
        """Time from rest to the full swing [s]."""
        return min(2.0, self.moving / 3.0)

    def sample(self, time: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """
        Return positions, velocities and accelerations ``time`` seconds after the start.

        The results have the shape (..., n) if ``time`` has the shape (...). The joints rest before
        and after the motion.
        """
        t = np.asarray(time, dtype=float)[..., np.newaxis]
        fade = self.fade
        w_in, w_out = ease(t / fade), ease((t - self.moving) / fade + 1.0)
        w = w_in[0] - w_out[0]
        wd = (w_in[1] - w_out[1]) / fade
        wdd = (w_in[2] - w_out[2]) / fade**2
        rate = 2.0 * np.pi * self.frequency
        s, c = np.sin(rate * t), np.cos(rate * t)
        q = self.start + self.swing * w * s
        qd = self.swing * (wd * s + w * rate * c)
        qdd = self.swing * (wdd * s + 2.0 * wd * rate * c - w * rate**2 * s)
        return q, qd, qdd


def ease(x: Floats) -> tuple[Floats, Floats, Floats]:
    """Return a quintic that rises from 0 at x = 0 to 1 at x = 1, and its first two derivatives."""
    x = np.minimum(np.maximum(x, 0.0), 1.0)
    return (
        x**3 * (10.0 + x * (6.0 * x - 15.0)),
        30.0 * x**2 * (1.0 - x) ** 2,
        60.0 * x * (1.0 - x) * (1.0 - 2.0 * x),
    )


def start_pose(robot: RobotModel, dynamics: InverseDynamics) -> Floats:
    """
    Choose a pose, shape (n,), that the drives can hold and in which the joints are weakly coupled.

    Two joints are strongly coupled if they move nearly the same mass in the same way, like two
    wrist joints of a straight arm. If such joints turn in opposite directions, they move hardly
    any mass, and any control delay causes large errors. Raise a `SimulationError` if no joint
    can move, or if the drives are too weak for all sampled poses.
    """
    if not robot.joint_names:
        raise SimulationError(f'robot {robot.name!r} has no joint that can move')
    bounded = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    lower = np.where(bounded, robot.lower, -np.pi)
    upper = np.where(bounded, robot.upper, np.pi)
    middle, reach = 0.5 * (lower + upper), np.minimum(0.25 * (upper - lower), 1.0)
    random = np.random.default_rng(0)
    poses = middle + reach * random.uniform(-1.0, 1.0, (200, len(middle)))
    loads = [effort_used(robot, dynamics.gravity_efforts(q)) for q in poses]
    if min(loads) > EFFORT_USED:
        efforts = np.abs(dynamics.gravity_efforts(poses[np.argmin(loads)]))
        weakest = int(np.argmax(efforts / np.maximum(robot.effort_limits, NEGLIGIBLE)))
        raise SimulationError(
            'the effort limits of the URDF are too small to hold and move the robot: joint '
            f'{robot.joint_names[weakest]!r} needs {efforts[weakest]:.3g} against gravity, its '
            f'limit is {robot.effort_limits[weakest]:g}. Write the limits from the data sheet '
            'into <limit effort>, and check the masses'
        )
    easy = poses[np.array(loads) <= max(0.5, min(loads))]

    def independence(q: Floats) -> float:
        return float(np.linalg.eigvalsh(with_unit_diagonal(dynamics.mass_matrix(q)))[0])

    return max(easy, key=independence)


def plan(
    robot: RobotModel, dynamics: InverseDynamics, start: Floats, moving: float
) -> Oscillation:
    """
    Plan a motion about ``start`` within the limits of position, velocity and effort.

    The motion lasts ``moving`` seconds. Raise a `SimulationError` if no joint can move.
    """
    count = len(robot.joint_names)
    frequency = np.resize(FREQUENCIES, count)
    trajectory = Oscillation(start, np.zeros(count), frequency, moving)
    room = np.minimum(start - robot.lower, robot.upper - start)
    speed = STEEPEST_FADE / trajectory.fade + 2.0 * np.pi * frequency  # per unit of swing
    swing = np.min(
        [
            np.where(robot.is_prismatic_joint, LARGEST_SWING[1], LARGEST_SWING[0]),
            ROOM_USED * np.maximum(room, 0.0),
            SPEED_USED * robot.velocity_limits / speed,
        ],
        axis=0,
    )
    if not swing.any():
        raise SimulationError('no joint can move within its limits of position and velocity')
    times = np.linspace(0.0, moving, 200)
    for _ in range(6):
        trajectory = Oscillation(start, swing, frequency, moving)
        if effort_used(robot, dynamics.efforts(*trajectory.sample(times))) <= EFFORT_USED:
            break
        swing = 0.7 * swing
    return trajectory


def effort_used(robot: RobotModel, efforts: Floats) -> float:
    """Return the largest ratio of effort to limit, for efforts of shape (..., n)."""
    ratios = abs(efforts) / np.maximum(robot.effort_limits, NEGLIGIBLE)
    return float(np.max(ratios, initial=0.0))
