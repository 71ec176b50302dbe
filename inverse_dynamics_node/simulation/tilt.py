"""A base that tilts smoothly from one attitude to the next."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.inverse_dynamics import STANDARD_GRAVITY
from ..robot.kinematics import rotation_about
from ..robot.model import Floats
from .trajectory import ease

DURATION = 3.0  # [s] of a change of attitude


def rotation(vector: ArrayLike) -> Floats:
    """Return the matrix of a rotation vector [rad], shape (3, 3)."""
    vector = np.asarray(vector, float)
    angle = float(np.linalg.norm(vector))
    return rotation_about(vector / angle, angle) if angle else np.eye(3)


@dataclass(eq=False)
class Tilt:
    """
    The attitude of a base over time, initially level.

    Attributes
    ----------
    began : float
        Start time of the latest turn [s].
    level : ndarray, shape (3, 3)
        Rotation from the base frame at that time to the level frame.
    turn : ndarray, shape (3,)
        Rotation vector of the whole turn, in the base frame [rad].

    """

    began: float = -np.inf
    level: Floats = field(default_factory=lambda: np.eye(3))
    turn: Floats = field(default_factory=lambda: np.zeros(3))

    def turn_to(self, attitude: ArrayLike, time: float) -> None:
        """Turn from the attitude at a time [s] to a rotation vector from level [rad]."""
        self.level = self.attitude(time)
        self.began = time
        quaternion, turn = np.zeros(4), np.zeros(3)
        mujoco.mju_mat2Quat(quaternion, (self.level.T @ rotation(attitude)).ravel())
        mujoco.mju_quat2Vel(turn, quaternion, 1.0)
        self.turn = turn

    def attitude(self, time: float) -> Floats:
        """Return the rotation from the base frame at a time [s] to the level one, shape (3, 3)."""
        progress = ease(np.array((time - self.began) / DURATION))[0]
        matrix: Floats = self.level @ rotation(progress * self.turn)
        return matrix

    def motion(self, time: float) -> tuple[Floats, Floats, Floats]:
        """
        Return gravity and the motion of the base at a time [s].

        Returns
        -------
        gravity, angular_velocity, angular_acceleration : ndarray, shape (3,)
            In the base frame [m/s^2], [rad/s], [rad/s^2].

        """
        _, speed, acceleration = ease(np.array((time - self.began) / DURATION))
        gravity = self.attitude(time).T @ STANDARD_GRAVITY
        return gravity, speed / DURATION * self.turn, acceleration / DURATION**2 * self.turn
