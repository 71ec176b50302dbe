"""
Estimates what converts recorded values to efforts: a delay, and gains of currents.

The gain of a joint is the effort per unit of current. Currents alone do not determine a common
factor of all gains and masses. A known payload or the robot description determines this factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats
from ..recordings.resampling import pieces
from ..recordings.signals import Motion
from .fit import correlation, RobotFit
from .regression import Model, Regression, TERMS

SIGNIFICANT = 5.0
"""A gain is known if its inverse exceeds this many standard errors of the inverse."""
MOST_ERROR = 0.1
"""Joints with a larger standard error of their factor are not used for a common factor."""
EXPECTED_SPREAD = 0.03
"""Usual difference between the factors of the joints."""
LEAST_FACTOR, LEAST_CHANGE, CERTAIN = 0.2, 0.05, 3.0
"""
A common factor is reported if it exceeds the first, and if its difference from 1 exceeds the
second and this many standard errors.
"""
MOST_DELAY = 0.1
"""Estimated delays are limited to this magnitude [s]."""


class EffortCorrection(NamedTuple):
    """Delay and gains that convert recorded values to efforts."""

    delay: float
    """Delay of the recorded values [s]."""
    gains: Floats
    """Effort per unit of the recorded value, for each joint, shape (joints,)."""
    is_gain_known: Booleans
    """Whether the gain of each joint is known, shape (joints,)."""

    def apply(self, motions: Sequence[Motion]) -> list[Floats]:
        """Return the corrected efforts of each motion, shape (samples, joints) [N m or N]."""
        return [_shifted(motion, self.delay) * self.gains for motion in motions]


# ---- Gains ---------------------------------------------------------------------------------


def link_factors(regression: Regression, model: Model, used: Booleans) -> tuple[Floats, Floats]:
    """
    Return how many times as large as modelled the measured efforts of the links are.

    The joint terms in the mask `used` are fitted beside the factor of each joint. Returns the
    factors and their standard errors, shape (joints,).

    """
    rigid = regression.rigid(model.bodies)
    terms = regression.terms(model, rigid)
    factors, errors = np.zeros((2, len(used)))
    for j, chosen in enumerate(used):
        table = np.column_stack([rigid[:, j], terms[:, j][:, chosen]])
        scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
        solution = np.linalg.lstsq(table / scale, regression.efforts[:, j], rcond=None)[0]
        residual = regression.efforts[:, j] - table / scale @ solution
        covariance = np.linalg.pinv((table / scale).T @ (table / scale))
        variance = np.mean(residual**2) * correlation(residual) * covariance[0, 0]
        factors[j], errors[j] = solution[0] / scale[0], np.sqrt(variance) / scale[0]
    return factors, errors


def common_factor(factors: Floats, errors: Floats) -> tuple[float, float] | None:
    """
    Return a significant common factor of the efforts of all joints and its error, or None.

    The arguments are the results of `link_factors`. If the joints disagree, the error is larger.
    Factors that are negative or very small have another cause, so they are never returned.

    """
    known = (errors > 0.0) & (errors < MOST_ERROR)
    if known.sum() < 2:
        return None
    values, weights = factors[known], 1.0 / (errors[known] ** 2 + EXPECTED_SPREAD**2)
    weights /= weights.sum()
    mean = float(weights @ values)
    spread = weights @ (values - mean) ** 2 / (len(values) - 1)
    error = float(np.sqrt(weights**2 @ errors[known] ** 2 + spread))
    change = abs(mean - 1.0)
    if mean < LEAST_FACTOR or change < max(LEAST_CHANGE, CERTAIN * error):
        return None
    return mean, error


def first_gains(regression: Regression, model: Model, used: Booleans) -> tuple[Floats, Booleans]:
    """
    Estimate the gain of each joint (effort per current) for the given bodies.

    Returns the gains, and whether the recordings determine each gain, shape (joints,). Gains may
    be negative. An undetermined gain is set to the median magnitude of the determined gains.

    """
    slopes, errors = link_factors(regression, model, used)
    determined = np.abs(slopes) > SIGNIFICANT * errors
    gains = np.ones(len(slopes))
    if determined.any():
        gains[determined] = 1.0 / slopes[determined]
        gains[~determined] = np.median(np.abs(gains[determined]))
    return gains, determined


# ---- Delay ---------------------------------------------------------------------------------


def estimate_delay(fit: RobotFit) -> tuple[float, float]:
    """
    Estimate the remaining delay of the corrected efforts, and its standard error [s].

    The delay is estimated together with all other unknowns, to first order.

    """
    regression, model, weights = fit.equations.regression, fit.model, fit.weights
    predicted = regression.predict(model)
    residual = regression.efforts - predicted
    effect = -np.gradient(predicted, regression.times, axis=0)
    count = model.bodies.size
    vector = np.zeros(count + model.joints.size)
    for j in range(len(model.joints)):
        vector[:count] += weights[j] * effect[:, j] @ regression.bodies[:, j]
    for j, owner, columns in regression.actions(model, regression.rigid(model.bodies)):
        vector[count + TERMS * owner + np.arange(TERMS)] += weights[j] * effect[:, j] @ columns
    vector = vector[fit.unknowns]
    total = float((weights * effect**2).sum())
    identified = total - float(vector @ np.linalg.solve(fit.hessian, vector))
    if identified <= 1e-9 * total or total == 0.0:
        return 0.0, np.inf
    delay = float((weights * effect * residual).sum()) / identified
    return float(np.clip(delay, -MOST_DELAY, MOST_DELAY)), float(1.0 / np.sqrt(identified))


def _shifted(motion: Motion, delay: float) -> Floats:
    """Return the efforts of a motion after removing the delay, shape (samples, joints)."""
    from scipy.interpolate import CubicSpline

    if delay == 0.0:
        return motion.efforts
    efforts = motion.efforts.copy()
    for begin, end in pieces(motion.times):
        times = motion.times[begin:end]
        later = np.clip(times + delay, times[0], times[-1])
        efforts[begin:end] = CubicSpline(times, efforts[begin:end])(later)
    return np.asarray(efforts)
