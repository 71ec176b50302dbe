"""Low-pass filters."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..robot.model import Booleans, Floats


class LowPass:
    """
    First-order low-pass filter of a vector that is sampled at irregular times.

    The elements may be sampled at different times. An element restarts, that is, its filtered
    value becomes its latest sample, after a long gap, after a step back in time, and where the
    filtered value would not be finite.

    Parameters
    ----------
    value : array_like, shape (k,)
        Initial filtered value.
    cutoff : float
        Cutoff frequency [Hz]; 0: no filter.

    """

    def __init__(self, value: ArrayLike, cutoff: float = 0.0) -> None:
        self.cutoff = cutoff
        """Cutoff frequency [Hz]; 0: no filter."""
        self.value: Floats = np.array(value, dtype=np.float64)
        """Filtered value, shape (k,); never written in place."""
        self.reset()

    def reset(self) -> None:
        """Restart all elements at the next sample."""
        self._time: float | Floats = -math.inf

    def update(
        self,
        time: float | Floats,
        sample: Floats,
        longest_gap: float | Floats = math.inf,
        restarts: bool | Booleans = False,
    ) -> Floats:
        """
        Filter one sample.

        Parameters
        ----------
        time : float or ndarray, shape (k,)
            When the elements were sampled [s]. If it is one number, so are `longest_gap` and
            `restarts`.
        sample : ndarray, shape (k,)
            The sample; not kept.
        longest_gap : float or ndarray, shape (k,), optional
            Elements whose last sample is older than this restart [s].
        restarts : bool or ndarray of bool, shape (k,), optional
            Further elements that restart.

        Returns
        -------
        value : ndarray, shape (k,)
            The filtered value.

        """
        elapsed = time - self._time
        self._time = time if isinstance(time, float) else np.array(time)
        if not self.cutoff:
            self.value = sample.copy()
            return self.value
        rate = -2.0 * math.pi * self.cutoff
        weight: float | Floats
        if isinstance(elapsed, float):  # takes half the time of the general case
            is_continued = 0.0 <= elapsed <= longest_gap and not restarts
            weight = -math.expm1(rate * elapsed) if is_continued else 1.0
        else:
            is_continued = (elapsed >= 0.0) & (elapsed <= longest_gap) & np.logical_not(restarts)
            weight = -np.expm1(rate * np.abs(elapsed))
        with np.errstate(all='ignore'):
            value = self.value + weight * (sample - self.value)
        self.value = np.where(is_continued & np.isfinite(value), value, sample)
        return self.value
