"""
Measures the quality of recorded signals: noise, lag of velocities, and filters before recording.

All signals are sampled at uniform times.
"""

from __future__ import annotations

import math

import numpy as np

from ...robot.model import Floats

MAX_LAG = 0.5  # [s]; larger lags are not searched for
MIN_LAG = 0.01  # [s]; at 1 Hz, this lag is an error of 6 % of the accelerations
LAG_EXPLAINS = 0.25  # a lag leaves at most this fraction of the squared difference
FINEST = 0.005  # [s] between compared lags; the best lag is interpolated
MAX_SHAPE = 0.2  # largest relative difference between a shifted velocity and the derived one

CUTOFFS = (1.0, 8.0)  # [Hz]; filters with a higher cut-off hardly affect smoothed efforts
STEEP = 35.0  # [dB] over two octaves; steeper than Coulomb friction (12) and noise (0)
PASSED = 1e-4  # of the largest power; a signal with less power was removed
STILL_FALLING = 20.0  # [dB] from above the cut-off to the highest octave; noise is flat
OUTLIERS = 1.4826  # standard deviation of a normal distribution over its median deviation


def white_noise(values: Floats, smoothed: Floats, centre_weight: float) -> float:
    """
    Estimate the standard deviation of white noise that remains after smoothing with polynomials.

    `centre_weight` is the filter's weight of the middle sample. This weight is also the sum of all
    squared weights, because the filter is a projection. The resolution of the signal is a lower
    limit of the noise.
    """
    removed = values - smoothed
    deviation = OUTLIERS * float(np.median(np.abs(removed - np.median(removed))))
    filtered = deviation * math.sqrt(centre_weight / max(1.0 - centre_weight, 1e-9))
    return math.hypot(filtered, resolution(values) / math.sqrt(12.0))


def resolution(values: Floats) -> float:
    """Return the step between quantised values; 0 if nearly all values differ."""
    levels = np.unique(values)
    # A quantised signal repeats its values, and each step is a multiple of the smallest one.
    if len(levels) < 3 or len(levels) > 0.2 * len(values):
        return 0.0
    steps = np.diff(levels)
    step = float(np.median(steps))
    multiples = steps / float(np.min(steps))
    is_grid = np.abs(multiples - np.round(multiples)) < 0.05
    return step if float(np.mean(is_grid)) > 0.9 else 0.0


def lag(recorded: Floats, derived: Floats, period: float) -> float:
    """
    Return the lag of a smoothed recorded velocity behind the derivative of the position [s].

    The lag is zero if no lag explains the difference. The period is the time between samples [s].
    """
    # The signals are smooth: fewer samples contain the same information.
    every = max(1, round(FINEST / period))
    recorded, derived, period = recorded[::every], derived[::every], every * period
    most = min(round(MAX_LAG / period), len(recorded) // 4)
    if most < 1:
        return 0.0
    middle = derived[most : len(derived) - most]
    shifts = np.arange(-most, most + 1)
    windows = np.lib.stride_tricks.sliding_window_view(recorded, len(middle))
    squares = np.array([np.mean((windows[most + k] - middle) ** 2) for k in shifts])
    best = int(np.argmin(squares))
    size = float(np.mean(middle**2))
    if squares[best] > LAG_EXPLAINS * squares[most] or squares[best] > MAX_SHAPE**2 * size:
        return 0.0
    found = float(shifts[best])
    if 0 < best < len(shifts) - 1:
        before, at, after = squares[best - 1 : best + 2]
        curvature = before - 2.0 * at + after
        found += 0.5 * float(before - after) / float(curvature) if curvature > 0.0 else 0.0
    return found * period if found * period >= MIN_LAG else 0.0


def cut_off(efforts: Floats, period: float) -> float:
    """
    Return the frequency above which the spectrum of an unsmoothed effort is empty [Hz].

    The noise of a sensor reaches up to half the sampling rate. If the spectrum falls steeply at a
    few hertz and continues to fall, the signal was filtered before it was recorded. The period is
    the time between samples [s]. The frequency is infinite if the spectrum is not empty anywhere.
    """
    count = len(efforts)
    line = np.linspace(efforts[0], efforts[-1], count)
    power = np.abs(np.fft.rfft((efforts - line) * np.hanning(count))) ** 2
    frequencies: Floats = np.fft.rfftfreq(count, period).astype(np.float64)
    nyquist = 0.5 / period

    def level(low: float, high: float) -> float:
        chosen = (frequencies >= low) & (frequencies < high)
        return 10.0 * math.log10(float(np.mean(power[chosen])) + 1e-300) if chosen.any() else 0.0

    if not power.any():
        return math.inf
    highest = level(0.5 * nyquist, nyquist)
    frequencies_tried = np.geomspace(*CUTOFFS, 13)
    for frequency in frequencies_tried[frequencies_tried <= nyquist / 8.0]:
        above = level(2.0 * frequency, 4.0 * frequency)
        falls = level(0.5 * frequency, frequency) - above
        if falls > STEEP and above - highest > STILL_FALLING:
            return _passed(frequencies, power)
    return math.inf


def _passed(frequencies: Floats, power: Floats) -> float:
    """Return the highest frequency [Hz] that a spectrum contains."""
    octaves = [
        (f, float(np.mean(power[(frequencies >= f) & (frequencies < 2.0 * f)])))
        for f in np.geomspace(0.25, 0.25 * frequencies[-1], 40)
        if ((frequencies >= f) & (frequencies < 2.0 * f)).any()
    ]
    largest = max(value for _, value in octaves)
    # The middle of the octave.
    return float(max(f for f, value in octaves if value > PASSED * largest) * math.sqrt(2.0))
