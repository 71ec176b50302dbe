"""
Decides how far ramps advance from one command to the next. No ROS: time is an argument.

A pause may end with old messages, a late timer or a jump of the clock. The robot has moved in the
meantime, but the commands have not: nothing may catch up.
"""

from __future__ import annotations

import math

NOMINAL_STEP = 0.01
"""Ramps advance by at most this long in one command, unless commands are usually rarer [s]."""
_LONGEST_STEP = 0.5  # [s]; at most this long even then
_MEMORY = 8.0  # usual steps in which the usual step follows a change; it grows by at most 1/4
_LEAST_PAUSE = 0.1  # [s]; shorter times between steps are no interruption
_PAUSE = 4.0  # usual steps; neither are these
_SETTLING = 0.2  # [s]; after an interruption, for messages that were sent before its end


class RampClock:
    """
    Measures the time by which ramps, blends and fades advance with the next command.

    This is the time since the last command, but at most one nominal step: 10 ms, or the period of
    the loop if it is longer. On a machine or with a driver that is always slower, it is the usual
    time between commands, which is a mean with the lengths as weights: several messages in a row
    thus do not hide the pauses between them. A single pause makes it at most 25 % longer.

    Parameters
    ----------
    period : float
        Time between commands [s]; 0 if there is one for every joint state.

    """

    def __init__(self, period: float = 0.0) -> None:
        self._shortest = self._usual = max(NOMINAL_STEP, period)
        self._longest = max(_LONGEST_STEP, period)
        self._now = math.inf
        self._settling = 0.0  # [s]
        self.since = 0.0
        """Time since the last command [s]; 0 after the clock was set back."""
        self.step = 0.0
        """Time by which ramps advance [s]."""

    def start(self) -> None:
        """Let no time pass until the next command."""
        self._now, self._settling = math.inf, 0.0

    def advance(self, now: float) -> bool:
        """
        Advance to the time of the next command.

        Parameters
        ----------
        now : float
            The time [s].

        Returns
        -------
        is_interrupted : bool
            Whether the command must be blended: at a start, and when and shortly after the process
            was suspended, the machine stalled, or the clock jumped.

        """
        since, self._now = now - self._now, now
        usual = self._usual
        self.since = since if since > 0.0 else 0.0  # faster than max()
        self.step = since if 0.0 < since < usual else min(self.since, usual)
        if 0.0 <= since <= max(_LEAST_PAUSE, _PAUSE * usual):
            is_interrupted = self._settling > 0.0
            self._settling = max(0.0, self._settling - since)
        else:
            is_interrupted = True
            self._settling = _SETTLING if since > -math.inf else 0.0
        if since > self._shortest or usual > self._shortest:
            counted = min(self.since, 2.0 * usual)
            usual += (counted - usual) * counted / (_MEMORY * usual)
            self._usual = min(max(usual, self._shortest), self._longest)
        return is_interrupted


def ramp_fraction(elapsed: float, ramp: float) -> float:
    """Return how much of a ramp has passed, 0 to 1; times in [s]."""
    return min(1.0, elapsed / ramp) if ramp > 0.0 else 1.0
