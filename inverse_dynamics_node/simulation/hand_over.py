"""
Who moves a simulated robot: its position controller, or the commands.

The position controller holds the robot before commands arrive, and after the commands stop.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..robot.model import Floats
from .drivers import Actuation, Command

_SWAY = (0.3, 0.1)  # [rad], [m]: largest sway of revolute and prismatic joints
_RANGE_FRACTION = 0.2  # largest sway as a fraction of the joint's range
_SLOWEST, _STEP = 0.08, 0.013  # [Hz]: sway frequency of the first joint; increase per joint
RELEASE = 1.5  # [s]: time for which commands must arrive before the hand-over
GAP = 0.1  # [s]: a longer gap between commands restarts the wait for the hand-over
SILENCE = 0.5  # [s]: after this time without commands, the position controller takes over
STEADY = 0.5  # [s]: commands are steady if they change by less than 1 % in this time
LONGEST = 10.0  # [s]: after this time, unsteady commands take over too
LONGEST_STEP = 0.002  # [s]: with longer steps, the position controller is unstable


class HandOver:
    """
    Decides whether the position controller or the commands move a simulated robot.

    The commands take over after they have arrived for ``release`` seconds and their efforts have
    become steady. An earlier hand-over would drop the robot. Commands whose efforts do not become
    steady take over after `LONGEST` seconds. When the commands stop, the position controller stops
    the robot where it is, as brakes do, and holds it.

    With ``sways``, the position controller moves every joint slowly back and forth until the first
    command arrives. ``log`` is a logger of rclpy or of Python.
    """

    def __init__(
        self, actuation: Actuation, log: Any, sways: bool = False, release: float = RELEASE
    ) -> None:
        self._actuation, self._release, self._log = actuation, release, log
        self._robot = actuation.robot
        model = self._robot.robot
        self._last_command = self._flow_began = self._steady_since = -math.inf
        self._steady_efforts = np.zeros(len(self._robot.command_names))
        self._start = self._robot.positions()
        ranges = np.where(model.is_continuous, math.inf, model.upper - model.lower)
        largest = np.where(model.is_prismatic_joint, _SWAY[1], _SWAY[0])
        self._reach = 0.5 * np.minimum(largest, _RANGE_FRACTION * ranges) * sways
        self._frequency = 2.0 * math.pi * (_SLOWEST + _STEP * np.arange(len(self._reach)))
        self.is_held = True
        """Whether the position controller holds the robot."""

    def command(self, command: Command, now: float) -> None:
        """Handle a complete and finite command that arrives at the time ``now`` [s]."""
        if now - self._last_command > GAP:
            self._flow_began = self._steady_since = now
            if self.is_held:
                self._take_over()
        self._last_command = now
        if self.is_held:
            self._compare(self._actuation.with_gravity(command.efforts), now)
            if not self._is_due(now):
                return
            self.is_held = False
            self._log.info('the robot follows the commands')
        self._actuation.command = command

    def _compare(self, efforts: Floats, now: float) -> None:
        """If the efforts have changed, restart the timer for steady efforts."""
        size = np.abs(efforts)
        tolerance = 0.01 * size + 0.002 * size.max(initial=0.0)
        if (np.abs(efforts - self._steady_efforts) > tolerance).any():
            self._steady_efforts, self._steady_since = efforts, now

    def _is_due(self, now: float) -> bool:
        flow = now - self._flow_began
        steady = now - self._steady_since >= min(STEADY, self._release)
        return flow >= self._release and (steady or flow >= LONGEST)

    def advance(self, now: float, duration: float) -> None:
        """Advance the simulation from the time ``now`` by a duration [s]."""
        if now - self._last_command > SILENCE and not self.is_held:
            self._take_over()
            self._log.info('no commands arrive, so the position controller holds the robot')
        steps = _steps_in(duration)
        for i in range(steps):
            if self.is_held:
                phase = self._frequency * (now + i * duration / steps)
                self._robot.track(
                    self._start + self._reach * (1.0 - np.cos(phase)),
                    self._reach * self._frequency * np.sin(phase),
                    self._reach * self._frequency**2 * np.cos(phase),
                )
            else:
                self._actuation.act()
            self._robot.advance(duration / steps)

    def _take_over(self) -> None:
        """Stop the robot, and hold it where it is."""
        self.is_held = True
        self._robot.stop()
        self._start = self._robot.positions()
        self._reach = np.zeros_like(self._start)


def _steps_in(duration: float) -> int:
    """Return the number of simulation steps in a duration [s]."""
    return max(1, math.ceil(duration / LONGEST_STEP - 1e-6))


class PositionLoop:
    """
    Moves a simulated robot whose drives follow positions, and add the commanded efforts.

    The arm sags under its weight, as far as the gains of the drives permit, until efforts arrive.
    Efforts act until others arrive, because a forward_command_controller holds them.
    """

    is_held = False
    """Whether something rigid holds the robot."""

    def __init__(self, actuation: Actuation) -> None:
        self._actuation = actuation
        start = actuation.robot.positions()[actuation.robot.command_index]
        actuation.command = Command(np.zeros(len(start)), start, np.zeros(len(start)))

    def command(self, command: Command, now: float) -> None:
        """Handle efforts that arrive at the time ``now`` [s]."""
        self._actuation.command = self._actuation.command._replace(efforts=command.efforts)

    def follow(self, positions: Floats, velocities: Floats) -> None:
        """Follow positions [rad or m] and velocities [rad/s or m/s], each of shape (m,)."""
        motion = {'positions': positions, 'velocities': velocities}
        self._actuation.command = self._actuation.command._replace(**motion)

    def advance(self, now: float, duration: float) -> None:
        """Advance the simulation from the time ``now`` by a duration [s]."""
        steps = _steps_in(duration)
        for _ in range(steps):
            self._actuation.act()
            self._actuation.robot.advance(duration / steps)
