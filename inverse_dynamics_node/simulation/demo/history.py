"""What happened in a run, over time."""

from __future__ import annotations

from bisect import bisect_left
import math

import numpy as np
from numpy.typing import ArrayLike

from ...robot.model import Floats


class Series:
    """Rows of equal shape, each with a time [s] that never goes back."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._rows: list[ArrayLike] = []

    def add(self, time: float, row: ArrayLike) -> None:
        """Take note of a row, which must not change any more."""
        self._times.append(time)
        self._rows.append(row)

    def __len__(self) -> int:
        return len(self._times)

    @property
    def times(self) -> Floats:
        """Shape (k,) [s]."""
        return np.array(self._times)

    @property
    def rows(self) -> Floats:
        """Shape (k, ...)."""
        return np.array(self._rows, dtype=float)

    def between(self, begin: float, end: float) -> Floats:
        """Return the rows from a time to just before another [s], shape (k, ...)."""
        first, last = np.searchsorted(self.times, (begin, end))
        return np.array(self._rows[first:last], dtype=float)


class History:
    """
    What a commander saw of n joints; times count from the beginning of the motion [s].

    Attributes
    ----------
    states : Series
        Positions [rad or m], desired positions and measured efforts [N m or N]; rows of shape
        (3, n).
    commands : Series
        Efforts that the node sent [N m or N]; rows of shape (m,).
    external : Series
        Efforts that the node lays on contact [N m or N], NaN for joints it does not tell; rows of
        shape (n,).
    brakes : Series
        1 where the brakes went on, 0 where they opened.
    arrivals : list of float
        When the commands were received, on the steady clock [s].

    """

    def __init__(self) -> None:
        self.states = Series()
        self.commands = Series()
        self.external = Series()
        self.brakes = Series()
        self.arrivals: list[float] = []

    def command_rate(self, begin: float = -math.inf) -> float:
        """
        Return the rate at which commands came since a time on the steady clock [Hz].

        This is the slope of a line through the arrivals. A queue that is worked off in one go, or
        a pause that is made up for, moves the line but hardly turns it, whereas a quotient of
        count and time would include the commands of a queue that filled up before ``begin``.

        Parameters
        ----------
        begin : float
            Time on the steady clock [s]; without it, the beginning of the motion.

        """
        times = np.array(self.arrivals[bisect_left(self.arrivals, begin) :])
        if len(times) < 2:
            return 0.0
        since = times - times.mean()
        spread = float(since @ since)
        count = np.arange(len(times)) - 0.5 * (len(times) - 1)
        return float(since @ count) / spread if spread > 0.0 else 0.0

    def largest_error(self, begin: float, end: float) -> Floats:
        """Return how far the joints were off at most from a time to another, shape (n,)."""
        rows = self.states.between(begin, end)
        if not len(rows):
            return np.full(self.states.rows.shape[2:] or (1,), math.nan)
        largest: Floats = np.max(np.abs(rows[:, 1] - rows[:, 0]), axis=0)
        return largest
