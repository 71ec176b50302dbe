"""
Supervision of the control loop: the phases, lost joint states, and dry runs.

No ROS, and no clock: times are arguments.
"""

from __future__ import annotations

import enum
import math

import numpy as np

from ..robot.model import Floats
from .command_shaping import ramp_fraction
from .joint_states import State

_LEAST_RECOVERY = 0.2  # [s]; shortest time without a gap after which lost states are used again
_TOLERATED_DROP = 0.05  # of the gain; a loss that lowered it by less ends with the next state
_ZEROS_TIME = 0.5  # [s]; zeros after the ramp, because best-effort subscribers may lose some


class Phase(enum.Enum):
    """State of the controller."""

    WAITING = 'waiting for the first complete joint state'
    RUNNING = 'following the reference'
    HOLDING = 'holding position'
    TOO_FAR = 'holding position: the reference is too far away'
    STATE_LOST = 'joint states lost'
    NO_SOLUTION = 'no finite efforts for this joint state and reference'
    STOPPED = 'stopped'


COMPUTING_PHASES = (Phase.RUNNING, Phase.HOLDING, Phase.TOO_FAR)
"""Phases in which efforts are computed from a fresh state."""


class StateSupervisor:
    """
    Decides whether the joint states are lost: too old or inconsistent, or that until recently.

    Intermittent states would otherwise raise and lower the efforts again and again, which shakes
    the arm.

    """

    def __init__(self) -> None:
        self._lost_gain = 0.0  # gain at which the states were lost
        self._tolerated_drop = _TOLERATED_DROP  # of the gain, in losses in quick succession
        self._fresh_since = math.inf  # arrival of the first state after the last gap

    def is_lost(
        self, now: float, state: State | None, timeout: float, was_lost: bool, gain: float
    ) -> bool:
        """
        Return whether the states are lost.

        Parameters
        ----------
        now : float
            The time [s].
        state : State or None
            The latest joint state; None if there has been no complete one.
        timeout : float
            Age from which on a state is too old [s].
        was_lost : bool
            Whether the last command was computed without a state because they were lost.
        gain : float
            Factor of the computed efforts, from 0 to 1: falls while the states are lost.

        """
        if state is None:
            # A joint of a new robot description was never reported. Its first state ends the loss.
            self._lost_gain = 0.0
            return True
        is_fresh = 0.0 <= now - state.time <= timeout
        if not (is_fresh and state.is_consistent):
            if not was_lost:
                self._lost_gain = gain
                if state.time - self._fresh_since >= recovery_time(timeout):
                    self._tolerated_drop = _TOLERATED_DROP
            self._fresh_since = math.inf
            return True
        self._fresh_since = min(self._fresh_since, state.time)
        if not was_lost:
            return False
        drop = max(0.0, self._lost_gain - gain)
        if drop <= self._tolerated_drop:
            # Losses in quick succession add up, although each may be too short to matter.
            self._tolerated_drop -= drop
            return False
        return state.time - self._fresh_since < recovery_time(timeout)


def recovery_time(timeout: float) -> float:
    """Return the time without a gap after which states that were lost are used again [s]."""
    return max(2.0 * timeout, _LEAST_RECOVERY)


class _Gate(enum.Enum):
    OPEN = enum.auto()
    CLOSING = enum.auto()
    CLOSED = enum.auto()


class DryRun:
    """
    Decides which efforts are sent: the computed ones, or in a dry run none.

    A receiver holds the last command forever. When the gate closes, the commands therefore fall
    from the last one to zero along the stop ramp, and zeros follow for half a second. After that
    nothing is sent, so that another node may command the robot. The computed efforts are not
    affected.

    """

    def __init__(self) -> None:
        self._gate = _Gate.OPEN
        self._last: Floats | None = None
        self._top = np.zeros(0)
        self._ramp = self._fallen = 0.0  # [s]

    def reset(self, *, is_dry_run: bool) -> None:
        """Begin with an open gate, or with a closed one in a dry run; nothing has been sent."""
        self._gate = _Gate.CLOSED if is_dry_run else _Gate.OPEN
        self._last = None

    @property
    def is_open(self) -> bool:
        """Whether the computed efforts are sent."""
        return self._gate is _Gate.OPEN

    @property
    def may_open(self) -> bool:
        """Whether the gate is not open, and the robot holds no effort of an earlier command."""
        return self._gate is not _Gate.OPEN and not self.has_effort

    @property
    def has_effort(self) -> bool:
        """Whether an effort of the last command that was sent is not zero."""
        return self._last is not None and bool(self._last.any())

    @property
    def has_sent(self) -> bool:
        """Whether the robot may depend on this node: false once the gate is closed."""
        return self._last is not None

    def open(self) -> None:
        """Send the computed efforts from now on; they must rise from zero."""
        self._gate = _Gate.OPEN

    def close(self, time_to_fall: float) -> None:
        """
        Let the commands fall to zero, and end.

        Parameters
        ----------
        time_to_fall : float
            Time in which they fall; what is left of it if they already do [s].

        """
        if self._last is None:
            self._gate = _Gate.CLOSED
        elif self._gate is _Gate.OPEN:
            self._gate = _Gate.CLOSING
            self._top = self._last.copy()
            self._ramp, self._fallen = time_to_fall, 0.0

    def select(self, efforts: Floats, elapsed: float) -> Floats | None:
        """
        Select the efforts to send.

        Parameters
        ----------
        efforts : ndarray, shape (m,)
            The computed efforts [N m or N].
        elapsed : float
            Time by which ramps advance [s]; see `RampClock`.

        Returns
        -------
        efforts : ndarray or None
            None if nothing is to be sent.

        """
        if self._gate is _Gate.OPEN:
            self._last = efforts
        elif self._gate is _Gate.CLOSING:
            self._fallen += elapsed
            if self._fallen > self._ramp + _ZEROS_TIME and not self.has_effort:
                self._gate, self._last = _Gate.CLOSED, None
            else:
                self._last = self._top * (1.0 - ramp_fraction(self._fallen, self._ramp))
        return self._last
