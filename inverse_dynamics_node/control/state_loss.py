"""Loss of the joint states, and when they are used again. No ROS, and no clock."""

from __future__ import annotations

import math

from .joint_states import State

_LEAST_RECOVERY = 0.2  # [s]; shortest time without a gap after which lost states are used again
_TOLERATED_DROP = 0.05  # of the gain; a loss that lowered it by less ends with the next state


class StateLoss:
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
