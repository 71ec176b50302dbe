"""Decides whether efforts may be computed and sent, and whether a reference is followed."""

from __future__ import annotations

from collections.abc import Sequence
import enum
import math

import numpy as np

from ..robot.model import Floats
from .joint_states import State
from .laws import Law, Reference
from .settings import Settings
from .shaping import StopRamp

_LEAST_RECOVERY = 0.2  # [s]; shortest recovery time after a loss of states
_TOLERATED_DROP = 0.05  # a loss with a smaller drop of the gain ends with the next state
_ZEROS_TIME = 0.5  # [s]; zeros are sent for this long after the ramp, because messages may be lost


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
    LIMIT_STOP = 'stopped by a motion limit'


TOO_FAR_PHASES = (Phase.TOO_FAR, Phase.HOLDING_TOO_FAR)
"""Phases in which the reference is too far away from the joint positions."""
COMPUTING_PHASES = (Phase.RUNNING, Phase.FLOATING, Phase.HOLDING, *TOO_FAR_PHASES)
"""Phases in which efforts are computed from a fresh state."""


class _Sent(enum.Enum):
    COMPUTED = enum.auto()
    FALLING = enum.auto()
    NOTHING = enum.auto()


class DryRun:
    """
    Selects the efforts to send, during normal operation and during dry runs.

    At the start of a dry run, the commands fall to zero over the stop ramp, because a receiver
    holds the last command forever. Zeros follow for half a second. Then nothing is sent, so that
    another node may command the robot. The computed efforts are not affected.

    """

    def __init__(self, *, is_active: bool = False) -> None:
        self._sent = _Sent.NOTHING if is_active else _Sent.COMPUTED
        self._last: Floats | None = None
        self._ramp = StopRamp()

    @property
    def is_active(self) -> bool:
        """Whether a dry run is active, in which the computed efforts are not sent."""
        return self._sent is not _Sent.COMPUTED

    @property
    def has_effort(self) -> bool:
        """Whether the last command that was sent contains a nonzero effort."""
        return self._last is not None and bool(self._last.any())

    @property
    def has_sent(self) -> bool:
        """Whether this node sends commands, on which the robot may depend."""
        return self._last is not None

    def end(self) -> None:
        """End the dry run; the caller must let the computed efforts rise from zero."""
        self._sent = _Sent.COMPUTED

    def begin(self, time_to_fall: float) -> None:
        """
        Start a dry run, in which the commands first fall to zero.

        ``time_to_fall`` is the time until the commands are zero [s].

        """
        if self._last is None:
            self._sent = _Sent.NOTHING
        elif self._sent is _Sent.COMPUTED:
            self._sent = _Sent.FALLING
            self._ramp.begin(self._last, time_to_fall)

    def select(self, efforts: Floats, elapsed: float) -> Floats | None:
        """
        Return the efforts to send, shape (m,) [N m or N]; None if nothing is sent.

        ``elapsed`` is the time by which ramps advance [s]; see `RampClock`.

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


class Supervisor:
    """
    Decides what each command does: the phase of the controller.

    No efforts are computed before the first complete joint state, while joint states are lost,
    while the controller is stopped, and after a limit stop. Joint states are considered lost while
    the latest state is too old or inconsistent, and for a recovery time afterwards. Without the
    recovery time, intermittent states would shake the arm. A loss that ends before the efforts
    have fallen noticeably needs no recovery time.

    ``joints`` and ``units`` are the names of the m commanded joints and the units of their
    positions.

    """

    def __init__(self, joints: Sequence[str], units: Sequence[str]) -> None:
        self._joints, self._units = joints, units
        self.phase = Phase.WAITING
        """Phase of the last command."""
        self.is_stopping = False
        """Whether a stop has been requested; the efforts may still be ramping down."""
        self.limit_stop = ''
        """Why the motion limits have stopped the arm; '' if they have not."""
        self._is_near = False  # whether the arm has been near the reference that it follows
        self._lost_gain = 0.0  # gain at which the states were lost
        self._tolerated_drop = _TOLERATED_DROP  # remaining drop, for losses in quick succession
        self._fresh_since = math.inf  # arrival time of the first state after the last gap

    def apply(self, settings: Settings, law: Law) -> None:
        """Change the settings and the law."""
        self._settings, self._law = settings, law

    def start(self) -> None:
        """Return to the phase `WAITING`, and end a stop and a limit stop."""
        self.resume()
        self.phase = Phase.WAITING

    def stop(self) -> None:
        """Stop until `resume`."""
        self.is_stopping = True

    def stop_at_limit(self, reason: str) -> None:
        """Begin a limit stop, which lasts until `resume`; ``reason`` is a sentence."""
        self.limit_stop = reason

    def resume(self) -> bool:
        """End a stop and a limit stop; return whether there was one."""
        was_stopped = self.is_stopping or bool(self.limit_stop)
        self.is_stopping, self.limit_stop = False, ''
        return was_stopped

    def decide(
        self,
        now: float,
        state: State | None,
        reference: Reference | None,
        gain: float,
        *,
        is_live: bool = True,
    ) -> Phase:
        """
        Decide the phase of the next command.

        ``now`` is the time [s], and ``gain`` the factor for the computed efforts, from 0 to 1.
        Unless ``is_live``, an arm that falls behind its reference is not stopped.

        """
        was_near, self._is_near = self._is_near, False
        timeout = self._settings.state_timeout
        if self.phase is Phase.WAITING and self._is_lost(now, state, timeout, gain):
            self.phase = Phase.WAITING
        elif self.limit_stop:
            self.phase = Phase.LIMIT_STOP
        elif self.is_stopping:
            self.phase = Phase.STOPPED
        elif self._is_lost(now, state, timeout, gain):
            self.phase = Phase.STATE_LOST
        else:
            assert state is not None
            self.phase = self._follow(now, state, reference, stops=was_near and is_live)
        return self.phase

    def fail(self) -> None:
        """Record that the law has found no finite efforts."""
        self.phase = Phase.NO_SOLUTION

    def _follow(
        self, now: float, state: State, reference: Reference | None, *, stops: bool
    ) -> Phase:
        """
        Decide whether the reference is followed.

        If ``stops`` is true, an arm that has fallen too far behind is stopped.

        """
        settings, law = self._settings, self._law
        without_reference = Phase.HOLDING if law.holds else Phase.FLOATING
        if reference is None or not law.uses_reference:
            return without_reference
        # The age may be negative after the clock was set back.
        if not 0.0 <= now - reference.time <= (settings.reference_timeout or math.inf):
            return without_reference
        limit, positions = settings.max_tracking_error, reference.positions
        if not limit or not law.is_closed or positions is None:
            return Phase.RUNNING
        behind = np.abs(law.distance(law.measured(state), positions))
        ahead = behind
        if law.equilibrium is not None:
            ahead = np.abs(law.distance(law.equilibrium, positions))
        if ahead.max() > limit:
            return Phase.HOLDING_TOO_FAR if law.holds else Phase.TOO_FAR
        k = int(np.argmax(behind))
        self._is_near = behind[k] <= limit
        if not self._is_near and stops:
            unit = self._units[k]
            self.stop_at_limit(
                f'{self._joints[k]} is {behind[k]:.3g} {unit} from its reference, limit '
                f'{limit:g} {unit}'
            )
            return Phase.LIMIT_STOP
        return Phase.RUNNING

    def _is_lost(self, now: float, state: State | None, timeout: float, gain: float) -> bool:
        """Return whether joint states are lost, or newer than ``now`` after a clock jump."""
        was_lost = self.phase is Phase.STATE_LOST
        if state is None:
            # No joint state has ever arrived. The first one ends the loss.
            self._lost_gain = 0.0
            return True
        is_fresh = 0.0 <= now - state.time <= timeout
        if not is_fresh:
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
            # Drops add up, so that many short losses also need a recovery time.
            self._tolerated_drop -= drop
            return False
        return state.time - self._fresh_since < recovery_time(timeout)


def recovery_time(timeout: float) -> float:
    """Return how long joint states must arrive without a gap before a loss ends [s]."""
    return max(2.0 * timeout, _LEAST_RECOVERY)
