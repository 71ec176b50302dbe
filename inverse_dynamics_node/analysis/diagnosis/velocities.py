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

STEP, LONGEST_STEP = 0.2, 0.4  # [s]; longer steps contain a gap
LEAST_TRAVEL = 0.05  # [rad or m]; sum of all changes of the position that a comparison needs
NO_VELOCITY = 0.1  # velocities that explain a smaller fraction of the motion are zero
ALIKE = 0.9  # least correlation of a velocity with another factor
SAME_FACTOR = (0.7, 1.4)
LEAST_LAG = 0.05  # [s]


class VelocityCheck(NamedTuple):
    """The comparison of velocities with positions."""

    compared: Booleans
    """Whether the motion of each joint was large enough, shape (m,)."""
    faults: tuple[Fault, ...]


def check_velocities(names: Sequence[str], times: Floats, q: Floats, qd: Floats) -> VelocityCheck:
    """
    Compare the velocities of m joints with the positions, both of shape (k, m).

    Joints with velocities that are NaN have no measured velocity. They count as compared, because
    the node derives their velocities from the positions.
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
    period = float(np.median(np.diff(times)))
    every = max(1, round(STEP / period))
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (qd[1:] + qd[:-1]) * np.diff(times))])
    is_whole = np.diff(times[::every]) < LONGEST_STEP
    moved, claimed = np.diff(q[::every])[is_whole], np.diff(whole[::every])[is_whole]
    if float(np.sum(np.abs(moved))) < LEAST_TRAVEL:
        return None
    squares, claimed_squares = float(moved @ moved), float(claimed @ claimed)
    if claimed_squares < NO_VELOCITY**2 * squares:
        return 0.0, 0.0
    if not is_whole.all():  # a lag is searched for in signals without gaps
        return _factor(moved, claimed), 0.0
    even = np.arange(times[0], times[-1], period)
    smooth = np.ones(every) / every
    derived = np.convolve(np.gradient(np.interp(even, times, q), period), smooth, 'valid')
    recorded = np.convolve(np.interp(even, times, qd), smooth, 'valid')
    late = lag(recorded, derived, period)
    if late > LEAST_LAG:
        return 1.0, late
    return _factor(moved, claimed), 0.0


def _factor(moved: Floats, claimed: Floats) -> float:
    """Return the factor of the claimed to the real motion, or NaN if they are not alike."""
    product, squares = float(moved @ claimed), float(moved @ moved)
    is_alike = abs(product) > ALIKE * math.sqrt(squares * float(claimed @ claimed))
    return product / squares if is_alike else math.nan
