"""Decides what the control loop does with each command."""

from __future__ import annotations

from collections.abc import Sequence
import enum
import math

import numpy as np

from .joint_states import State
from .laws import Law, Reference
from .settings import Settings

_LEAST_RECOVERY = 0.2  # [s]; shortest recovery time after a loss of states
_TOLERATED_DROP = 0.05  # a loss with a smaller drop of the gain ends with the next state


class Phase(enum.Enum):
    """What the control loop does."""

    WAITING = 'waiting for the first complete joint state'
    RUNNING = 'following the reference'
    FLOATING = 'floating: no reference'
    TOO_FAR = 'floating: the reference is too far away'
    HOLDING = 'holding position: no reference'
    HOLDING_TOO_FAR = 'holding position: the reference is too far away'
    CONTACT = 'floating after a contact'
    STATE_LOST = 'joint states lost'
    NO_SOLUTION = 'no finite efforts for this joint state and reference'
    STOPPED = 'stopped'
    LIMIT_STOP = 'stopped by a motion limit'


TOO_FAR_PHASES = (Phase.TOO_FAR, Phase.HOLDING_TOO_FAR)
"""Phases in which the reference is too far away from the joint positions."""
COMPUTING_PHASES = (
    Phase.RUNNING,
    Phase.FLOATING,
    Phase.HOLDING,
    *TOO_FAR_PHASES,
    Phase.CONTACT,
)
"""Phases in which efforts are computed from a fresh state."""


class Supervisor:
    """
    Decides the phase of each command, and stops an arm that falls behind its reference.

    No efforts are computed before the first complete joint state, while joint states are lost,
    during a stop, and after a limit stop. Joint states are considered lost while the latest state
    is too old, and for a recovery time afterwards. Without the recovery time, intermittent states
    would shake the arm. A loss that ends before the efforts have fallen noticeably needs no
    recovery time.

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
        self.contact = ''
        """Which contact has ended the motion of the arm; '' if none has."""
        self.is_behind = ''
        """How far the arm is behind the reference that it was near; '' if it is not."""
        self._is_near = False  # whether the arm has been near the reference that it follows
        self._lost_gain = 0.0  # gain at which the states were lost
        self._tolerated_drop = _TOLERATED_DROP  # remaining drop, for losses in quick succession
        self._fresh_since = math.inf  # arrival time of the first state after the last gap

    def apply(self, settings: Settings, law: Law) -> None:
        """Change the settings and the law."""
        self._settings, self._law = settings, law

    def stop(self) -> None:
        """Stop until `resume`."""
        self.is_stopping = True

    def stop_at_limit(self, reason: str) -> None:
        """Begin a limit stop, which lasts until `resume`; ``reason`` is a sentence."""
        self.limit_stop = reason

    def resume(self) -> bool:
        """End a stop, a limit stop and what follows a contact; return whether there was one."""
        was_stopped = self.is_stopping or bool(self.limit_stop) or bool(self.contact)
        self.is_stopping, self.limit_stop, self.contact = False, '', ''
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
        was_near, self._is_near, self.is_behind = self._is_near, False, ''
        timeout = self._settings.state_timeout
        if self.phase is Phase.WAITING and self._is_lost(now, state, timeout, gain):
            self.phase = Phase.WAITING
        elif self.limit_stop:
            self.phase = Phase.LIMIT_STOP
        elif self.is_stopping:
            self.phase = Phase.STOPPED
        elif self._is_lost(now, state, timeout, gain):
            self.phase = Phase.STATE_LOST
        elif self.contact:
            self.phase = Phase.CONTACT
        else:
            assert state is not None
            self.phase = self._judge(now, state, reference, was_near)
            if self.is_behind and is_live:
                self.stop_at_limit(self.is_behind)
                self.phase = Phase.LIMIT_STOP
        return self.phase

    def _judge(
        self, now: float, state: State, reference: Reference | None, was_near: bool
    ) -> Phase:
        """Decide whether the reference is followed, and whether the arm has fallen behind it."""
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
        k = int(np.argmax(behind))
        is_near = bool(behind[k] <= limit)
        if ahead.max() > limit or not (is_near or was_near):
            return Phase.HOLDING_TOO_FAR if law.holds else Phase.TOO_FAR
        self._is_near = True
        if not is_near:
            unit = self._units[k]
            self.is_behind = (
                f'{self._joints[k]} is {behind[k]:.3g} {unit} from its reference, limit '
                f'{limit:g} {unit}'
            )
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
