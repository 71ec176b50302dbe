"""Low-pass filters."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..robot.model import Booleans, Floats


class LowPass:
    """
    First-order low-pass filter for an array that is sampled at irregular times.

    The elements may be sampled at different times. The filter of an element restarts from the
    latest sample after a long gap or a step back in time, or if the filtered value is not finite.

    ``value`` is the initial filtered value. ``cutoff`` is the cutoff frequency [Hz]; 0 disables
    the filter.

    """

    def __init__(self, value: ArrayLike, cutoff: float = 0.0) -> None:
        self.cutoff = cutoff
        """Cutoff frequency [Hz]; 0 disables the filter."""
        self.value: Floats = np.array(value, dtype=np.float64)
        """Filtered value; each update creates a new array."""
        self.reset()

    def reset(self) -> None:
        """Restart the filters of all elements with the next sample."""
        self._time: float | Floats = -math.inf

    def update(
        self,
        time: float | Floats,
        sample: Floats,
        longest_gap: float | Floats = math.inf,
        restarts: bool | Booleans = False,
    ) -> Floats:
        """
        Filter a sample; return the filtered value as a new array of the same shape.

        ``time`` [s], ``longest_gap`` [s] and ``restarts`` have one value for all elements, or one
        value for each element. The filter of an element restarts if its previous sample is older
        than ``longest_gap``, or if ``restarts`` is true for this element.

        """
        elapsed = np.subtract(time, self._time)
        self._time = np.array(time)
        if not self.cutoff:
            self.value = sample.copy()
            return self.value
        rate = -2.0 * math.pi * self.cutoff
        is_continued = (elapsed >= 0.0) & (elapsed <= longest_gap) & np.logical_not(restarts)
        weight = -np.expm1(rate * np.abs(elapsed))
        with np.errstate(all='ignore'):
            value = self.value + weight * (sample - self.value)
        self.value = np.where(is_continued & np.isfinite(value), value, sample)
        return self.value
