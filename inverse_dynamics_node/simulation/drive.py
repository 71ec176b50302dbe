"""The position controller of a simulated robot, which holds it until commands arrive."""

from __future__ import annotations

import math

import numpy as np

from ..robot.model import Floats
from .mujoco.hardware import MujocoRobot

BRAKING = 0.2  # [s] from any speed to rest
_SWAY = (0.3, 0.1)  # [rad], [m]: largest sway of joints that turn and that slide
_RANGE_FRACTION = 0.3  # of the range of a joint
_SLOWEST, _STEP = 0.08, 0.013  # [Hz]: different for each joint, so that their motions differ


class PositionDrive:
    """
    Holds the joints like the controller of the manufacturer, or lets them sway slowly.

    Parameters
    ----------
    robot : MujocoRobot
        The robot, without brakes.
    sways : bool
        Whether every joint moves slowly back and forth, as if jogged by hand.

    """

    def __init__(self, robot: MujocoRobot, sways: bool) -> None:
        self._robot = robot
        model = robot.robot
        ranges = np.where(model.is_continuous, math.inf, model.upper - model.lower)
        largest = np.where(model.is_prismatic_joint, _SWAY[1], _SWAY[0])
        self._amplitude = np.minimum(largest, _RANGE_FRACTION * ranges) if sways else 0.0 * largest
        self._frequency = 2.0 * math.pi * (_SLOWEST + _STEP * np.arange(len(largest)))
        self.is_on = False
        self.take_over(0.0)

    def take_over(self, now: float) -> None:
        """Brake from now on [s], and hold the robot where it comes to rest."""
        self.is_on = True
        self._start, self._began = self._robot.positions(), now
        self._speed = self._robot.velocities()
        model = self._robot.robot
        with np.errstate(invalid='ignore'):  # infinite limits
            middle = 0.5 * (model.lower + model.upper)
        self._side = np.where(self._start > middle, -1.0, 1.0)

    def stand_still(self, now: float) -> None:
        """Stop swaying from now on [s], so that the robot is at rest when it is released."""
        self._amplitude = np.zeros_like(self._amplitude)
        self.take_over(now)

    def act(self, now: float) -> None:
        """Apply the efforts for one time [s]."""
        phase = self._frequency * (now - self._began)
        reach = 0.5 * self._side * self._amplitude
        position, velocity, acceleration = self._braking(now - self._began)
        self._robot.hold(
            position + reach * (1.0 - np.cos(phase)),
            velocity + reach * self._frequency * np.sin(phase),
            acceleration + reach * self._frequency**2 * np.cos(phase),
        )

    def _braking(self, elapsed: float) -> tuple[Floats, Floats, Floats]:
        """Return the smooth motion from the speed at the start to rest, within the limits."""
        time, rate = min(elapsed, BRAKING), math.pi / BRAKING
        model = self._robot.robot
        free = self._start + 0.5 * self._speed * (time + math.sin(rate * time) / rate)
        # A robot that was pushed beyond a limit is held there.
        lowest = np.minimum(model.lower, self._start)
        position = np.clip(free, lowest, np.maximum(model.upper, self._start))
        moves = position == free
        velocity = 0.5 * self._speed * (1.0 + math.cos(rate * time)) * moves
        acceleration = -0.5 * self._speed * rate * math.sin(rate * time) * moves
        return position, velocity, acceleration
