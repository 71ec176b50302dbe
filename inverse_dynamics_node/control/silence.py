"""Silence of publishers that are connected. No ROS, and no clock: time is an argument."""

from __future__ import annotations

_LONGEST_PAUSE = 2.0  # [s]; updates further apart mean that this process did not run


class Silence:
    """
    Measures for how long no message has arrived although there could have been one.

    Parameters
    ----------
    now : float
        The time [s].

    """

    def __init__(self, now: float) -> None:
        self._since = self._last_update = now

    def update(self, now: float, last_message: float, is_expected: bool) -> float:
        """
        Return the length of the silence.

        Parameters
        ----------
        now : float
            The time [s].
        last_message : float
            Time of the last message [s].
        is_expected : bool
            Whether a publisher is connected that could send.

        Returns
        -------
        silence : float
            Without the time in which nothing was expected, or this process did not run [s].

        """
        pause = now - self._last_update
        self._last_update = now
        self._since = max(self._since, last_message)
        if not is_expected:
            self._since = now
        elif pause > _LONGEST_PAUSE:
            self._since = min(now, self._since + pause)
        return now - self._since
