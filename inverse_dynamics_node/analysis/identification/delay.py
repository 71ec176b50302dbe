"""Estimates by how much measured efforts are late."""

from __future__ import annotations

import numpy as np

from ...robot.model import Floats
from ...robot.rigid_body import PARAMETERS
from ..recordings.resampling import pieces
from ..recordings.signals import Motion
from .fit import Solution
from .regression import Regression, TERMS

MOST_DELAY = 0.1
"""Longest delay in either direction [s]."""


def estimate_delay(
    regression: Regression, solution: Solution, weights: Floats
) -> tuple[float, float]:
    """
    Estimate how late the measured efforts are, together with all other unknowns.

    Parameters
    ----------
    regression : Regression
        The samples that were fitted.
    solution : Solution
        Fit without a delay.
    weights : ndarray, shape (m,)
        Weights of the joints.

    Returns
    -------
    delay, error : float
        Correction of the delay and its standard error [s], to first order.

    """
    model = solution.model
    terms = regression.terms(model)
    predicted = regression.rigid(model.bodies) + (terms * model.joints).sum(axis=-1)
    residual = regression.efforts - predicted
    effect = -_rate(regression, predicted)
    count, b = len(regression.problem.joints), len(model.bodies)
    vector = np.zeros(PARAMETERS * b + TERMS * count)
    for j in range(count):
        vector[: PARAMETERS * b] += weights[j] * effect[:, j] @ regression.bodies[:, j]
        own = PARAMETERS * b + TERMS * j + np.arange(TERMS)
        vector[own] += weights[j] * effect[:, j] @ terms[:, j]
    vector = vector[solution.unknowns]
    total = float((weights * effect**2).sum())
    identified = total - float(vector @ np.linalg.solve(solution.hessian, vector))
    if identified <= 1e-9 * total or total == 0.0:
        return 0.0, np.inf
    delay = float((weights * effect * residual).sum()) / identified
    return float(np.clip(delay, -MOST_DELAY, MOST_DELAY)), float(1.0 / np.sqrt(identified))


def shifted(motion: Motion, delay: float) -> Floats:
    """Return the efforts of a motion without a delay, shape (K, m)."""
    from scipy.interpolate import CubicSpline

    efforts = motion.efforts.copy()
    for begin, end in pieces(motion.times):
        times = motion.times[begin:end]
        if len(times) > 3:
            later = np.minimum(np.maximum(times + delay, times[0]), times[-1])
            efforts[begin:end] = CubicSpline(times, efforts[begin:end])(later)
    return np.asarray(efforts)


def _rate(regression: Regression, values: Floats) -> Floats:
    """Differentiate rows with respect to time, run by run."""
    rates, first = np.zeros_like(values), 0
    for smooth in regression.resamplers:
        last = first + len(smooth.times)
        for begin, end in pieces(smooth.times) if last - first > 2 else []:
            part = slice(first + begin, first + end)
            if end - begin > 2:
                rates[part] = np.gradient(values[part], smooth.times[begin:end], axis=0)
        first = last
    return rates
