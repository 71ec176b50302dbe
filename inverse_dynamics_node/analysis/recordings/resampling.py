"""
Smooths the signals of a motion and reduces their sampling rate.

Regressor columns must be smoothed in the same way as the measured efforts, because the fit would
otherwise be biased. The smoothing has no delay and does not reach across gaps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats, Integers
from .signals import Motion

DEGREE = 3
"""Degree of the smoothing polynomials."""
ROWS_PER_WINDOW = 8
"""Number of rows per smoothing window. More rows would add no information."""


class Resampler(NamedTuple):
    """Smooths the K samples of one motion, and reduces them to R rows."""

    of_smooth: Any
    """Sparse matrix for signals that are already smooth, shape (R, K)."""
    of_discontinuous: Any
    """Sparse matrix for all other signals, such as Coulomb friction, shape (R, K)."""
    times: Floats
    """Times of the rows, shape (R,) [s]."""
    seconds: float
    """Length of the smoothing window [s]."""

    def where(self, chosen: Booleans) -> Resampler:
        """Return a resampler with only the chosen rows."""
        return Resampler(
            self.of_smooth[chosen], self.of_discontinuous[chosen], self.times[chosen], self.seconds
        )

    def __call__(self, values: Floats) -> Floats:
        """Convert smooth signals of shape (K, ...) to rows of shape (R, ...)."""
        return _apply(self.of_smooth, values)

    def in_parts(self, function: Callable[[slice], Floats], count: int) -> Floats:
        """
        Convert smooth signals to rows, at most `count` rows at a time.

        The function returns the signals of a slice of samples, shape (samples, ...).

        """
        found = []
        for first in range(0, len(self.times), count):
            matrix = self.of_smooth[first : first + count]
            begin, end = int(matrix.indices.min()), int(matrix.indices.max()) + 1
            found.append(_apply(matrix[:, begin:end], function(slice(begin, end))))
        return np.concatenate(found)

    def discontinuous(self, values: Floats) -> Floats:
        """Convert discontinuous signals of shape (K, ...) to rows of shape (R, ...)."""
        return _apply(self.of_discontinuous, values)


def resampler(motion: Motion, seconds: float) -> Resampler:
    """Return the resampler of a motion; a window of 0 s leaves smooth signals unchanged."""
    from scipy.signal import savgol_coeffs

    half = max(round(0.5 * seconds / motion.period), 0)
    kernel = np.ones(1)
    if half > 0:
        half = max(half, (DEGREE + 2) // 2)
        kernel = savgol_coeffs(2 * half + 1, DEGREE)
    own = np.ones(1)
    if motion.window > motion.degree + 1:
        own = savgol_coeffs(motion.window, motion.degree)
    discontinuous = np.convolve(kernel, own)
    margin = len(discontinuous) // 2
    step = max(1, len(kernel) // ROWS_PER_WINDOW)
    centre: Integers = np.concatenate(
        [np.arange(begin + margin, end - margin, step) for begin, end in pieces(motion.times)]
    )
    return Resampler(
        _matrix(kernel, centre, len(motion.q)),
        _matrix(discontinuous, centre, len(motion.q)),
        motion.times[centre],
        len(kernel) * motion.period,
    )


def smooth_like_efforts(motion: Motion, values: Floats) -> Floats:
    """Smooth signals of shape (K, c) in the same way as the measured efforts."""
    from scipy.signal import savgol_filter

    parts = [
        savgol_filter(values[begin:end], motion.window, motion.degree, axis=0)
        if end - begin >= motion.window
        else values[begin:end]
        for begin, end in pieces(motion.times)
    ]
    return np.concatenate(parts)


def pieces(times: Floats) -> list[tuple[int, int]]:
    """Return the start and end indices of the pieces between gaps."""
    steps = np.diff(times)
    breaks = np.flatnonzero(steps > 1.5 * np.median(steps)) + 1
    return list(zip([0, *breaks], [*breaks, len(times)], strict=True))


def _matrix(kernel: Floats, centre: Integers, count: int) -> Any:
    from scipy.sparse import csr_matrix

    half = len(kernel) // 2
    columns = centre[:, None] + np.arange(-half, half + 1)
    data = np.broadcast_to(kernel[::-1], columns.shape)
    starts = np.arange(len(centre) + 1) * len(kernel)
    return csr_matrix((data.ravel(), columns.ravel(), starts), (len(centre), count))


def _apply(matrix: Any, values: Floats) -> Floats:
    flat = values.reshape(len(values), -1)
    rows = np.asarray(matrix @ flat)
    return rows.reshape(len(rows), *values.shape[1:])
