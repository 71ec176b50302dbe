"""The position controller of a simulated robot, which holds it until commands arrive."""

from __future__ import annotations

import math

import numpy as np

from .mujoco.hardware import MujocoRobot

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
        """Hold the robot from now on [s], starting where it is."""
        self.is_on = True
        self._start, self._began = self._robot.positions(), now
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
        self._robot.hold(
            self._start + reach * (1.0 - np.cos(phase)),
            reach * self._frequency * np.sin(phase),
            reach * self._frequency**2 * np.cos(phase),
        )
