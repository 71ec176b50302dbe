"""The last seconds of measured and modelled efforts."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...robot.model import Floats

DURATION = 10.0  # [s]


class LiveSamples(NamedTuple):
    """Samples of m joints at k times; NaN where a value is unknown."""

    joint_names: tuple[str, ...]
    times: Floats
    """Shape (k,) [s]."""
    q: Floats
    """Shape (k, m) [rad or m], low-pass filtered like all signals below."""
    qd: Floats
    """Shape (k, m) [rad/s or m/s]."""
    measured: Floats
    """Measured efforts, shape (k, m) [N m or N]."""
    modelled: Floats
    """Efforts of the model for the measured motion, shape (k, m) [N m or N]."""

    def of_joints(self, columns: Sequence[int]) -> LiveSamples:
        """Return the samples of some of the joints."""
        some = list(columns)
        names = tuple(self.joint_names[i] for i in some)
        return LiveSamples(names, self.times, *(signal[:, some] for signal in self[2:]))


class LiveWindow:
    """
    Keeps the samples of the last seconds.

    Parameters
    ----------
    joint_names : sequence of str
        The m joints.
    duration : float
        Length of the window [s].

    """

    def __init__(self, joint_names: Sequence[str], duration: float = DURATION) -> None:
        self.joint_names = tuple(joint_names)
        self.duration = duration
        self._times: deque[float] = deque()
        self._rows: deque[Floats] = deque()

    def add(self, time: float, q: Floats, qd: Floats, measured: Floats, modelled: Floats) -> None:
        """
        Add one sample, and drop those that are older than the window.

        Parameters
        ----------
        time : float
            Time of the sample, not before that of the last one [s].
        q, qd, measured, modelled : ndarray, shape (m,)
            See `LiveSamples`.

        """
        self._times.append(time)
        self._rows.append(np.array([q, qd, measured, modelled]))
        while self._times[0] < time - self.duration:
            self._times.popleft()
            self._rows.popleft()

    def clear(self) -> None:
        """Drop all samples: the robot or the node has changed."""
        self._times.clear()
        self._rows.clear()

    def samples(self) -> LiveSamples:
        """Return the samples in the window."""
        rows = np.array(self._rows).reshape(-1, 4, len(self.joint_names))
        return LiveSamples(self.joint_names, np.array(self._times), *rows.transpose(1, 0, 2))
