"""
What drives add to the efforts of the bodies: friction and armature, gains of currents, a delay.

A term of a joint is used if it improves the prediction of blocks of the recording that it was not
fitted to.

A current is the effort divided by a gain. Gains and masses are only known together: if all of them
were multiplied by the same factor, the currents would be the same. The masses of the robot
description, and a known payload, decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats, Integers
from ...robot.rigid_body import PARAMETERS
from ..least_squares import fit_nonnegative
from ..recordings.resampling import pieces
from ..recordings.signals import Motion
from .fit import correlation, RobotFit
from .regression import (
    ARMATURE,
    COULOMB,
    COUPLINGS,
    DAMPING,
    LOAD,
    Model,
    OFFSET,
    Regression,
    SIGNED,
    TERMS,
)

FRICTION: tuple[int, ...] = (DAMPING, COULOMB, OFFSET)
CANDIDATES: tuple[tuple[int, ...], ...] = (
    (ARMATURE,),
    (LOAD,),
    tuple(range(TERMS)[COUPLINGS[0]]),
    tuple(range(TERMS)[COUPLINGS[1]]),
)
LEAST_IMPROVEMENT = np.array([0.01, 0.02, 0.3, 0.3])
"""Fraction of the squares by which each candidate must improve the prediction."""
LARGEST_LOAD = 0.1
"""Load friction of a poor gear [-]: the standard deviation that is expected beforehand."""
WIDTHS = 10
"""Widths to try."""
SIGNIFICANT = 5.0
"""Standard errors by which a current has to depend on the modelled effort."""
MOST_DELAY = 0.1
"""Longest delay in either direction [s]."""


class JointFit(NamedTuple):
    """Terms of the joints, fitted to what given bodies leave."""

    model: Model
    """With the chosen terms; others are zero."""
    used: Booleans
    """Which terms were chosen, shape (m, 13)."""


class Delay(NamedTuple):
    """How late measured efforts are."""

    seconds: float
    error: float
    """Its standard error [s]."""


class EffortCorrection(NamedTuple):
    """What turns recorded efforts of m joints into those of the model."""

    delay: float
    """Time by which recorded efforts are late [s]."""
    gains: Floats
    """Effort per recorded value, shape (m,)."""
    is_gain_known: Booleans
    """Shape (m,)."""

    def apply(self, motions: Sequence[Motion]) -> list[Floats]:
        """Return the efforts of motions without delay, in N m or N, each of shape (K, m)."""
        return [_shifted(motion, self.delay) * self.gains for motion in motions]


def widths_to_try(speeds: Floats, slowest: float = 0.002) -> Floats:
    """Return widths for joints with fast speeds of shape (m,), shape (WIDTHS, m)."""
    fast = np.maximum(speeds, 10.0 * slowest)
    return np.geomspace(np.maximum(0.004 * fast, slowest), 0.4 * fast, WIDTHS)


def choose_terms(
    regression: Regression, bodies: Floats, moving: Booleans, grid: Floats, optional: bool = True
) -> JointFit:
    """
    Fit the terms of all joints to what the bodies leave.

    Parameters
    ----------
    regression : Regression
        Samples with blocks.
    bodies : ndarray, shape (b, 10)
        Parameters of the bodies.
    moving : ndarray, shape (m,)
        Whether friction of the joint can be identified.
    grid : ndarray, shape (w, m)
        Widths to choose from.
    optional : bool
        Whether to try more than friction.

    """
    m = len(regression.problem.joints)
    target = regression.efforts - regression.rigid(bodies)
    grams = _block_grams(regression, bodies, grid, target)
    joints, used = np.zeros((m, TERMS)), np.zeros((m, TERMS), dtype=bool)
    widths = np.zeros(m)
    for j in range(m):
        chosen: tuple[int, ...] = (OFFSET,)
        width = 0
        if moving[j]:
            chosen, width = _best(grams[j], optional)
        used[j, list(chosen)] = True
        widths[j] = grid[width, j]
        joints[j, list(chosen)] = _fit(grams[j][width].sum(axis=0), chosen)
    return JointFit(Model(bodies, joints, widths), used)


def fit_terms(
    regression: Regression, bodies: Floats, used: Booleans, widths: Floats, rows: Booleans
) -> Model:
    """Fit chosen terms to some rows of what the bodies leave."""
    target = regression.efforts - regression.rigid(bodies)
    model = Model(bodies, np.zeros(used.shape), widths)
    terms = regression.terms(model)
    joints = np.zeros(used.shape)
    for j in range(len(joints)):
        table = np.column_stack([terms[rows, j], target[rows, j]])
        chosen = np.flatnonzero(used[j]).tolist()
        joints[j, chosen] = _fit(table.T @ table, chosen)
    return Model(bodies, joints, widths)


def _block_grams(
    regression: Regression, bodies: Floats, grid: Floats, target: Floats
) -> list[Floats]:
    """Return products of columns for each joint, shape (w, blocks, 14, 14)."""
    blocks = [regression.block == k for k in range(regression.block.max() + 1)]
    found = np.zeros((target.shape[1], len(grid), len(blocks), TERMS + 1, TERMS + 1))
    for w, widths in enumerate(grid):
        terms = regression.terms(Model(bodies, np.zeros((target.shape[1], TERMS)), widths))
        for j in range(target.shape[1]):
            table = np.column_stack([terms[:, j], target[:, j]])
            for k, rows in enumerate(blocks):
                found[j, w, k] = table[rows].T @ table[rows]
    return list(found)


def _best(grams: Floats, optional: bool) -> tuple[tuple[int, ...], int]:
    """Return the terms and the number of the width that predict best."""
    chosen = FRICTION
    losses, width = _losses(grams, chosen)
    candidates = list(range(len(CANDIDATES))) if optional else []
    while candidates:
        trials = [(_losses(grams, (*chosen, *CANDIDATES[c])), c) for c in candidates]
        (new, new_width), best = min(trials, key=lambda trial: trial[0][0].sum())
        gains = losses - new
        error = np.sqrt(len(gains)) * gains.std(ddof=1) if len(gains) > 1 else np.inf
        if gains.sum() < max(LEAST_IMPROVEMENT[best] * losses.sum(), error):
            break
        chosen, losses, width = (*chosen, *CANDIDATES[best]), new, new_width
        candidates.remove(best)
    return tuple(sorted(chosen)), width


def _losses(grams: Floats, chosen: Sequence[int]) -> tuple[Floats, int]:
    """Return remaining squares of each block, fitted to the others, for the best width."""
    others = grams.sum(axis=1, keepdims=True) - grams if grams.shape[1] > 1 else grams
    factors = np.zeros((*grams.shape[:2], TERMS + 1))
    factors[..., -1] = 1.0
    factors[..., list(chosen)] = -_fits(others, chosen)
    losses = np.einsum('wbi,wbij,wbj->wb', factors, grams, factors)
    best = int(np.argmin(losses.sum(axis=1)))
    return losses[best], best


def _fits(grams: Floats, chosen: Sequence[int]) -> Floats:
    """Solve many least squares at once; unsigned terms are not negative."""
    index: Integers = np.array(chosen)
    matrices = grams[..., index[:, None], index].copy()
    _expect_little_load(matrices, grams, index)
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(matrices, axis1=-2, axis2=-1), 1e-300))
    matrices *= scale[..., None] * scale[..., None, :]
    matrices += 1e-10 * np.eye(len(index))
    vectors = scale * grams[..., index, -1]
    solutions = np.linalg.solve(matrices, vectors[..., None])[..., 0]
    wrong = (solutions[..., ~SIGNED[index]] < 0.0).any(axis=-1)
    for at in zip(*np.nonzero(wrong), strict=True):
        solutions[at] = _nonnegative(matrices[at], vectors[at], SIGNED[index])
    return np.asarray(scale * solutions)


def _fit(gram: Floats, chosen: Sequence[int]) -> Floats:
    """Solve least squares with products of columns."""
    return np.asarray(_fits(gram[None], chosen)[0])


def _expect_little_load(matrices: Floats, grams: Floats, index: Integers) -> None:
    """Expect a small load friction, or a load that hardly changes stands for Coulomb friction."""
    squares = 0.1 * grams[..., -1, -1] / np.maximum(grams[..., OFFSET, OFFSET], 1.0)
    for k in np.flatnonzero(index == LOAD):
        matrices[..., k, k] += squares / LARGEST_LOAD**2


def _nonnegative(matrix: Floats, vector: Floats, signed: Booleans) -> Floats:
    root = np.linalg.cholesky(matrix).T
    return fit_nonnegative(root, np.linalg.solve(root.T, vector), signed)[0]


# ---- Gains --------------------------------------------------------------------------------------


def first_gains(
    regression: Regression, bodies: Floats, widths: Floats, moving: Booleans
) -> tuple[Floats, Booleans]:
    """
    Estimate gains with the masses of the robot description.

    Parameters
    ----------
    regression : Regression
        With currents as efforts.
    bodies : ndarray, shape (b, 10)
        Bodies of the description.
    widths : ndarray, shape (m,)
        Widths of Coulomb friction.
    moving : ndarray, shape (m,)
        Whether the friction of the joint matters.

    Returns
    -------
    gains : ndarray, shape (m,)
        Effort per current; negative for a current with the opposite sign. If a gain cannot be
        determined, the median of the others.
    determined : ndarray, shape (m,)

    """
    rigid = regression.rigid(bodies)
    direction = regression.direction(widths)
    slopes, errors = np.zeros(len(widths)), np.zeros(len(widths))
    for j in range(len(widths)):
        columns = [rigid[:, j], np.ones(len(rigid))]
        if moving[j]:
            columns += [regression.qdd[:, j], regression.qd[:, j], direction[:, j]]
        table = np.column_stack(columns)
        scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
        solution = np.linalg.lstsq(table / scale, regression.efforts[:, j], rcond=None)[0]
        residual = regression.efforts[:, j] - table / scale @ solution
        covariance = np.linalg.pinv((table / scale).T @ (table / scale))
        variance = np.mean(residual**2) * correlation(residual) * covariance[0, 0]
        slopes[j], errors[j] = solution[0] / scale[0], np.sqrt(variance) / scale[0]
    determined = np.abs(slopes) > SIGNIFICANT * errors
    gains = np.ones(len(widths))
    if determined.any():
        gains[determined] = 1.0 / slopes[determined]
        gains[~determined] = np.median(np.abs(gains[determined]))
    return gains, determined


# ---- Delay --------------------------------------------------------------------------------------


def estimate_delay(regression: Regression, fit: RobotFit) -> Delay:
    """
    Estimate how late the measured efforts are, together with all other unknowns.

    Parameters
    ----------
    regression : Regression
        The samples that were fitted.
    fit : RobotFit
        Fit without a delay.

    Returns
    -------
    delay : Delay
        Of the efforts as they are corrected now, to first order.

    """
    model, weights = fit.model, fit.weights
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
    vector = vector[fit.unknowns]
    total = float((weights * effect**2).sum())
    identified = total - float(vector @ np.linalg.solve(fit.hessian, vector))
    if identified <= 1e-9 * total or total == 0.0:
        return Delay(0.0, np.inf)
    delay = float((weights * effect * residual).sum()) / identified
    delay = float(np.clip(delay, -MOST_DELAY, MOST_DELAY))
    return Delay(delay, float(1.0 / np.sqrt(identified)))


def _shifted(motion: Motion, delay: float) -> Floats:
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
