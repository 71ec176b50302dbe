"""The recorded history of a run."""

from __future__ import annotations

from bisect import bisect_left
import math

import numpy as np
from numpy.typing import ArrayLike

from ...robot.model import Floats


class Series:
    """Rows of equal shape with ascending times [s]."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._rows: list[ArrayLike] = []

    def add(self, time: float, row: ArrayLike) -> None:
        """Append a row, which must not be modified afterwards."""
        self._times.append(time)
        self._rows.append(row)

    def __len__(self) -> int:
        return len(self._times)

    @property
    def times(self) -> Floats:
        """Times of the rows, shape (k,) [s]."""
        return np.array(self._times)

    @property
    def rows(self) -> Floats:
        """All rows, shape (k, ...)."""
        return np.array(self._rows, dtype=float)

    def between(self, begin: float, end: float) -> Floats:
        """Return the rows with begin <= time < end [s], shape (k, ...)."""
        first, last = np.searchsorted(self.times, (begin, end))
        return np.array(self._rows[first:last], dtype=float)


class History:
    """
    The motion of n joints and the commands of the node; times start with the motion [s].

    Attributes
    ----------
    states : Series
        Positions [rad or m], desired positions and measured efforts [N m or N]; rows of shape
        (3, n).
    commands : Series
        Commanded efforts [N m or N]; rows of shape (m,).
    external : Series
        Estimated external efforts [N m or N], NaN for joints without an estimate; rows of shape
        (n,).
    brakes : Series
        1 where the brakes went on, 0 where they opened.
    arrivals : list of float
        Times at which the commands were received, on the steady clock [s].

    """

    def __init__(self) -> None:
        self.states = Series()
        self.commands = Series()
        self.external = Series()
        self.brakes = Series()
        self.arrivals: list[float] = []

    def command_rate(self, begin: float = -math.inf) -> float:
        """
        Return the rate of the commands since a time on the steady clock [Hz].

        This is the slope of a line fitted to the arrivals. Commands that arrive in one burst after
        a pause shift this line but hardly change its slope, whereas the number of commands divided
        by the time would include those that were queued before ``begin``.

        Parameters
        ----------
        begin : float
            Time on the steady clock [s]; by default the start of the motion.

        """
        times = np.array(self.arrivals[bisect_left(self.arrivals, begin) :])
        if len(times) < 2:
            return 0.0
        since = times - times.mean()
        spread = float(since @ since)
        count = np.arange(len(times)) - 0.5 * (len(times) - 1)
        return float(since @ count) / spread if spread > 0.0 else 0.0

    def largest_error(self, begin: float, end: float) -> Floats:
        """Return the largest position error of each joint between two times, shape (n,)."""
        rows = self.states.between(begin, end)
        if not len(rows):
            return np.full(self.states.rows.shape[2:] or (1,), math.nan)
        largest: Floats = np.max(np.abs(rows[:, 1] - rows[:, 0]), axis=0)
        return largest
