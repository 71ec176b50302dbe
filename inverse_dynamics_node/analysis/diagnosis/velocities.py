"""
Compares measured velocities with measured positions, per joint.

Over steps of 0.2 s, the change of the position is compared with the integral of the velocity. The
comparison needs a motion, and is insensitive to noise and to irregular sampling times.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats
from ..recordings.signals import lag
from .fault import Fault, FaultKind

STEP = 0.2  # [s]
LONGEST_GAP = 0.1  # [s]; steps with a longer interval without a sample are left out
FEWEST_STEPS = 5
LEAST_TRAVEL = 0.05  # [rad or m]; sum of all changes of the position that a comparison needs
NO_VELOCITY = 0.1  # velocities that explain a smaller fraction of the motion are zero
ALIKE, UNLIKE = 0.9, 0.5  # correlations of a proportional and of an unrelated velocity
SAME_FACTOR = (0.5, 2.0)  # other factors are faults
LEAST_LAG = 0.05  # [s]


class VelocityCheck(NamedTuple):
    """The comparison of velocities with positions."""

    compared: Booleans
    """Whether the motion of each joint was large enough, shape (m,)."""
    faults: tuple[Fault, ...]


def check_velocities(names: Sequence[str], times: Floats, q: Floats, qd: Floats) -> VelocityCheck:
    """
    Compare the velocities of m joints with the positions, both of shape (k, m).

    Velocities that are NaN were not measured. Such a joint is returned as compared, because it has
    no velocities that could be wrong.
    """
    compared = np.zeros(len(names), dtype=bool)
    factors: dict[str, float] = {}
    lags: dict[str, float] = {}
    for j, name in enumerate(names):
        if not np.isfinite(qd[:, j]).all():
            compared[j] = True
            continue
        found = _compare(times, q[:, j], qd[:, j])
        if found is None:
            continue
        compared[j] = True
        factor, late = found
        if late:
            lags[name] = late
        elif not SAME_FACTOR[0] < factor < SAME_FACTOR[1]:
            factors[name] = factor
    faults = []
    if factors:
        faults.append(Fault(FaultKind.VELOCITY, tuple(factors), tuple(factors.values())))
    if lags:
        faults.append(Fault(FaultKind.VELOCITY_LAG, tuple(lags), tuple(lags.values())))
    return VelocityCheck(compared, tuple(faults))


def _compare(times: Floats, q: Floats, qd: Floats) -> tuple[float, float] | None:
    """Return the factor of the velocity, or NaN, and its lag [s]; None without motion."""
    if len(times) < 3:
        return None
    gaps = np.diff(times)
    period = float(np.median(gaps))
    every = max(1, round(STEP / period))
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (qd[1:] + qd[:-1]) * gaps)])
    count = len(gaps) // every
    longest = gaps[: count * every].reshape(count, every).max(axis=1, initial=0.0)
    is_whole = longest < max(LONGEST_GAP, 2.0 * period)
    ends = slice(0, count * every + 1, every)
    moved, claimed = np.diff(q[ends])[is_whole], np.diff(whole[ends])[is_whole]
    if len(moved) < FEWEST_STEPS:
        return None
    if float(np.sum(np.abs(moved))) < LEAST_TRAVEL:
        return None
    squares, claimed_squares = float(moved @ moved), float(claimed @ claimed)
    if claimed_squares < NO_VELOCITY**2 * squares:
        return 0.0, 0.0
    if not is_whole.all():  # a lag is searched for in signals without gaps
        return _factor(moved, claimed)
    even = np.arange(times[0], times[-1], period)
    smooth = np.ones(every) / every
    derived = np.convolve(np.gradient(np.interp(even, times, q), period), smooth, 'valid')
    recorded = np.convolve(np.interp(even, times, qd), smooth, 'valid')
    late = lag(recorded, derived, period)
    if late > LEAST_LAG:
        return 1.0, late
    return _factor(moved, claimed)


def _factor(moved: Floats, claimed: Floats) -> tuple[float, float] | None:
    """Return the factor of the claimed to the real motion, NaN if unrelated, and no lag."""
    product, squares = float(moved @ claimed), float(moved @ moved)
    alike = abs(product) / math.sqrt(squares * float(claimed @ claimed))
    if UNLIKE < alike < ALIKE:
        return None
    return (product / squares if alike > ALIKE else math.nan), 0.0
