"""
Supervision of the control loop: the phases, lost joint states, and dry runs.

No ROS, and no clock: times are arguments.
"""

from __future__ import annotations

import enum
import math

from ..robot.model import Floats
from .command_shaping import StopRamp
from .joint_states import State

_LEAST_RECOVERY = 0.2  # [s]; shortest time without a gap after which lost states are used again
_TOLERATED_DROP = 0.05  # of the gain; a loss that lowered it by less ends with the next state
_ZEROS_TIME = 0.5  # [s]; zeros after the ramp, because best-effort subscribers may lose some


class Phase(enum.Enum):
    """State of the controller."""

    WAITING = 'waiting for the first complete joint state'
    RUNNING = 'following the reference'
    FLOATING = 'floating: no reference'
    TOO_FAR = 'floating: the reference is too far away'
    HOLDING = 'holding position: no reference'
    HOLDING_TOO_FAR = 'holding position: the reference is too far away'
    STATE_LOST = 'joint states lost'
    NO_SOLUTION = 'no finite efforts for this joint state and reference'
    STOPPED = 'stopped'


TOO_FAR_PHASES = (Phase.TOO_FAR, Phase.HOLDING_TOO_FAR)
"""Phases in which the reference is too far away."""
COMPUTING_PHASES = (Phase.RUNNING, Phase.FLOATING, Phase.HOLDING, *TOO_FAR_PHASES)
"""Phases in which efforts are computed from a fresh state."""


class _Sent(enum.Enum):
    COMPUTED = enum.auto()
    FALLING = enum.auto()
    NOTHING = enum.auto()


class DryRun:
    """
    Decides which efforts are sent: the computed ones, or in a dry run none.

    A receiver holds the last command forever. At the start of a dry run, the commands therefore
    fall from the last one to zero over the stop ramp, and zeros follow for half a second. After
    that nothing is sent, so that another node may command the robot. The computed efforts are not
    affected.

    Parameters
    ----------
    is_active : bool
        Whether to begin with a dry run.

    """

    def __init__(self, *, is_active: bool = False) -> None:
        self._sent = _Sent.NOTHING if is_active else _Sent.COMPUTED
        self._last: Floats | None = None
        self._ramp = StopRamp()

    @property
    def is_active(self) -> bool:
        """Whether the computed efforts are not sent."""
        return self._sent is not _Sent.COMPUTED

    @property
    def may_end(self) -> bool:
        """Whether there is a dry run, and the robot holds no effort of an earlier command."""
        return self.is_active and not self.has_effort

    @property
    def has_effort(self) -> bool:
        """Whether an effort of the last command that was sent is not zero."""
        return self._last is not None and bool(self._last.any())

    @property
    def has_sent(self) -> bool:
        """Whether the robot may depend on this node: false once nothing is sent."""
        return self._last is not None

    def end(self) -> None:
        """Send the computed efforts from now on; they must rise from zero."""
        self._sent = _Sent.COMPUTED

    def begin(self, time_to_fall: float) -> None:
        """
        Let the commands fall to zero, and end.

        Parameters
        ----------
        time_to_fall : float
            Time in which they fall; what is left of it if they already do [s].

        """
        if self._last is None:
            self._sent = _Sent.NOTHING
        elif self._sent is _Sent.COMPUTED:
            self._sent = _Sent.FALLING
            self._ramp.begin(self._last, time_to_fall)

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
        if self._sent is _Sent.COMPUTED:
            self._last = efforts
        elif self._sent is _Sent.FALLING:
            self._ramp.advance(elapsed)
            if self._ramp.time_left < -_ZEROS_TIME and not self.has_effort:
                self._sent, self._last = _Sent.NOTHING, None
            else:
                self._last = self._ramp.command()
        return self._last


class StateSupervisor:
    """
    Decides whether efforts may be computed, and whether they are sent.

    They are not computed before the first complete joint state, while joint states are lost (too
    old or inconsistent, now or until recently), and while the controller is stopped. Intermittent
    states would otherwise raise and lower the efforts again and again, which shakes the arm.

    """

    def __init__(self) -> None:
        self.phase = Phase.WAITING
        """What the last command was computed for."""
        self.is_stopping = False
        """Whether the efforts are to be zero; they may still be ramping down."""
        self.dry_run = DryRun()
        self._lost_gain = 0.0  # gain at which the states were lost
        self._tolerated_drop = _TOLERATED_DROP  # of the gain, in losses in quick succession
        self._fresh_since = math.inf  # arrival of the first state after the last gap

    def start(self) -> None:
        """Wait for the first joint state."""
        self.is_stopping, self.phase = False, Phase.WAITING

    def blocking_phase(
        self, now: float, state: State | None, timeout: float, gain: float
    ) -> Phase | None:
        """
        Return the phase in which no efforts may be computed; None if they may.

        Parameters
        ----------
        now : float
            The time [s].
        state : State or None
            The latest joint state; None if there has been no complete one.
        timeout : float
            Age from which on a state is too old [s].
        gain : float
            Factor of the computed efforts, from 0 to 1: falls while the states are lost.

        """
        if self.phase is Phase.WAITING and self._is_lost(now, state, timeout, gain):
            return Phase.WAITING
        if self.is_stopping:
            return Phase.STOPPED
        return Phase.STATE_LOST if self._is_lost(now, state, timeout, gain) else None

    def _is_lost(self, now: float, state: State | None, timeout: float, gain: float) -> bool:
        """Return whether the states are lost; after a reset of the clock, an age is negative."""
        was_lost = self.phase is Phase.STATE_LOST
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
