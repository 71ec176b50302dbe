"""
Fits joint terms, gains, and the delay of the efforts.

Joint terms model effects in the drive of a joint, such as friction and armature. The friction
width is the speed over which Coulomb friction is smoothed. A block is a contiguous part of the
recordings. An optional term is used only if it improves the prediction of left-out blocks.

The gain of a joint is the effort per unit of current. Currents alone do not determine a common
factor of all gains and masses. A known payload or the robot description determines this factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats, Integers
from ...robot.rigid_body import PARAMETERS
from ..columns import solve_nonnegative
from ..recordings.resampling import pieces
from ..recordings.signals import Motion
from .fit import correlation, RobotFit, weights_of
from .regression import (
    ARMATURE,
    COULOMB,
    DAMPING,
    LOAD,
    Model,
    OFFSET,
    Regression,
    SIGNED,
    SPRING,
    TERMS,
)

FRICTION: tuple[int, ...] = (DAMPING, COULOMB, OFFSET)
LEAST_IMPROVEMENT = {ARMATURE: 0.01, LOAD: 0.02}
"""
An optional term must reduce the squared prediction errors by this fraction, and by one standard
error of the improvement.
"""
LARGEST_LOAD = 0.1
"""Prior standard deviation of the ratio of load friction to load, as in inefficient gears [-]."""
WIDTHS = 10
"""Number of friction widths to try."""
NARROWEST = 0.002
"""Smallest friction width to try [rad/s or m/s]."""
SIGNIFICANT = 5.0
"""A gain is known if its inverse exceeds this many standard errors of the inverse."""
LEAST_CHANGE = 0.15
"""A common factor is reported only if it differs from 1 by at least this much."""
MOST_DISAGREEMENT = 0.5
"""Largest RMS deviation of the factors of the joints from a common factor f, relative to f - 1."""
EXPLAINS = 0.6
"""A common factor must explain this fraction of the error reduction by the identified bodies."""
MOST_DELAY = 0.1
"""Estimated delays are limited to this magnitude [s]."""


class JointFit(NamedTuple):
    """Joint terms that were fitted for given inertial parameters of the bodies."""

    model: Model
    """Model with the chosen terms; all other terms are zero."""
    used: Booleans
    """Whether each term of each joint was chosen, shape (joints, 9)."""


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


def widths_to_try(speeds: Floats) -> Floats:
    """Return friction widths to try for the given joint speeds, shape (WIDTHS, joints)."""
    fast = np.maximum(speeds, 10.0 * NARROWEST)
    return np.geomspace(np.maximum(0.004 * fast, NARROWEST), 0.4 * fast, WIDTHS)


def choose_terms(
    regression: Regression,
    start: JointFit | RobotFit,
    moving: Booleans,
    grid: Floats,
    optional: bool = True,
) -> JointFit:
    """Choose and fit the joint terms; joints that do not move have no term except an offset."""
    found = JointFit(start.model, start.used)
    # The second pass uses the new efforts of coupled drives on preceding joints.
    for _ in range(2 if start.model.couplings.any() else 1):
        found = _choose_terms(regression, found, moving, grid, optional)
    return found


def _choose_terms(
    regression: Regression, start: JointFit, moving: Booleans, grid: Floats, optional: bool
) -> JointFit:
    model = start.model
    target = regression.efforts - regression.rigid(model.bodies)
    for j, owner, columns in regression.actions(model):
        if j != owner:  # a coupled drive acts on the preceding joint
            target[:, j] -= columns @ model.joints[owner]
    grams = _block_grams(regression, model, grid, target)
    joints, used = np.zeros(start.used.shape), np.zeros(start.used.shape, dtype=bool)
    widths = np.zeros(len(used))
    for j in range(len(used)):
        chosen: tuple[int, ...] = (OFFSET,)
        width = 0
        if moving[j]:
            kept = (SPRING,) if start.used[j, SPRING] else ()
            chosen, width = _best(grams[j], (*FRICTION, *kept), optional)
        used[j, list(chosen)] = True
        widths[j] = grid[width, j]
        joints[j, list(chosen)] = _fits(grams[j][width].sum(axis=0)[None], chosen)[0]
    return JointFit(replace(model, joints=joints, widths=widths), used)


def fits_without_blocks(regression: Regression, friction: JointFit) -> list[Model]:
    """Refit the chosen terms, leaving out one block at a time; couplings are not supported."""
    model = friction.model
    target = regression.efforts - regression.rigid(model.bodies)
    grams = _block_grams(regression, model, model.widths[None], target)
    joints = np.zeros((grams[0].shape[1], *model.joints.shape))
    for j, used in enumerate(friction.used):
        others = [np.delete(grams[j][0], k, axis=0).sum(axis=0) for k in range(len(joints))]
        joints[:, j, used] = _fits(np.array(others), np.flatnonzero(used).tolist())
    return [replace(model, joints=each) for each in joints]


def _block_grams(
    regression: Regression, model: Model, grid: Floats, target: Floats
) -> list[Floats]:
    """Return Gram matrices as one array per joint, shape (widths, blocks, 10, 10)."""
    blocks = [regression.block == k for k in range(regression.block.max() + 1)]
    found = np.zeros((target.shape[1], len(grid), len(blocks), TERMS + 1, TERMS + 1))
    for w, widths in enumerate(grid):
        terms = regression.terms(replace(model, widths=widths))
        for j in range(target.shape[1]):
            table = np.column_stack([terms[:, j], target[:, j]])
            for k, rows in enumerate(blocks):
                found[j, w, k] = table[rows].T @ table[rows]
    return list(found)


def _best(grams: Floats, chosen: tuple[int, ...], optional: bool) -> tuple[tuple[int, ...], int]:
    """Add useful terms to `chosen`; return all chosen terms and the index of the best width."""
    candidates = list(LEAST_IMPROVEMENT) if optional else []
    while candidates:
        trials = [(_improvement(grams, chosen, candidate), candidate) for candidate in candidates]
        improvement, best = max(trials)
        if improvement < 1.0:
            break
        chosen = (*chosen, best)
        candidates.remove(best)
    return tuple(sorted(chosen)), _losses(grams, chosen)[1]


def _improvement(grams: Floats, chosen: tuple[int, ...], candidate: int) -> float:
    """Return the improvement by an additional term, relative to the required improvement."""
    losses, new = _losses(grams, chosen)[0], _losses(grams, (*chosen, candidate))[0]
    gains = losses - new
    error = np.sqrt(len(gains)) * gains.std(ddof=1) if len(gains) > 1 else np.inf
    least = max(LEAST_IMPROVEMENT[candidate] * losses.sum(), error)
    return float(gains.sum() / max(least, 1e-300))


def _losses(grams: Floats, chosen: Sequence[int]) -> tuple[Floats, int]:
    """Return each block's squared prediction error for the best width, and the width's index."""
    others = grams.sum(axis=1, keepdims=True) - grams if grams.shape[1] > 1 else grams
    factors = np.zeros((*grams.shape[:2], TERMS + 1))
    factors[..., -1] = 1.0
    factors[..., list(chosen)] = -_fits(others, chosen)
    losses = np.einsum('wbi,wbij,wbj->wb', factors, grams, factors)
    best = int(np.argmin(losses.sum(axis=1)))
    return losses[best], best


def _fits(grams: Floats, chosen: Sequence[int]) -> Floats:
    """Solve many least-squares problems at once; only `SIGNED` terms may become negative."""
    index: Integers = np.array(chosen)
    matrices = grams[..., index[:, None], index].copy()
    # At constant load, load friction looks like Coulomb friction, so a prior limits load friction.
    squares = 0.1 * grams[..., -1, -1] / np.maximum(grams[..., OFFSET, OFFSET], 1.0)
    for k in np.flatnonzero(index == LOAD):
        matrices[..., k, k] += squares / LARGEST_LOAD**2
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(matrices, axis1=-2, axis2=-1), 1e-300))
    matrices *= scale[..., None] * scale[..., None, :]
    matrices += 1e-10 * np.eye(len(index))
    vectors = scale * grams[..., index, -1]
    solutions = np.linalg.solve(matrices, vectors[..., None])[..., 0]
    wrong = (solutions[..., ~SIGNED[index]] < 0.0).any(axis=-1)
    if wrong.any():
        roots = np.linalg.cholesky(matrices[wrong])
        targets = np.linalg.solve(roots, vectors[wrong][..., None])[..., 0]
        solutions[wrong] = [
            solve_nonnegative(root.T, vector, SIGNED[index])[0]
            for root, vector in zip(roots, targets, strict=True)
        ]
    return np.asarray(scale * solutions)


# ---- Gains --------------------------------------------------------------------------------------


def first_gains(
    regression: Regression, bodies: Floats, widths: Floats, moving: Booleans
) -> tuple[Floats, Booleans]:
    """
    Estimate the gain of each joint (effort per current) for the given bodies.

    Returns the gains, and whether the recordings determine each gain, shape (joints,). Gains may
    be negative. An undetermined gain is set to the median magnitude of the determined gains.

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


def common_factor(regression: Regression, fit: RobotFit, friction: JointFit) -> float | None:
    """
    Return the common ratio of measured to modelled link efforts, or None.

    The result is None if the ratio is near one, or if the joints have different ratios. The result
    is also None if the ratio explains too little of the error reduction by the identified bodies.

    """
    left, rigid = regression.residual(friction.model), regression.rigid(friction.model.bodies)
    weights, terms = weights_of(left), regression.terms(friction.model)
    drives = friction.used | (np.arange(TERMS) == ARMATURE)
    for j, used in enumerate(drives):  # remove what drives could also explain
        columns = np.linalg.qr(terms[:, j][:, used])[0]
        for values in (left, rigid):
            values[:, j] -= columns @ (columns.T @ values[:, j])
    squares = np.maximum((rigid**2).sum(axis=0), 1e-300)
    changes, information = (rigid * left).sum(axis=0) / squares, weights * squares
    change = float(information @ changes / information.sum())
    improvement = float(information.sum()) * change**2
    after = regression.residual(fit.model)
    possible = float(weights @ (left**2 - after**2).sum(axis=0))
    disagreement = float(np.sqrt(information @ (changes - change) ** 2 / information.sum()))
    is_common = disagreement < MOST_DISAGREEMENT * abs(change) and len(changes) > 1
    if abs(change) < LEAST_CHANGE or not is_common or improvement < EXPLAINS * possible:
        return None
    return 1.0 + change


# ---- Delay --------------------------------------------------------------------------------------


def estimate_delay(regression: Regression, fit: RobotFit) -> tuple[float, float]:
    """
    Estimate the remaining delay of the corrected efforts, and its standard error [s].

    The delay is estimated together with all other unknowns, to first order.

    """
    model, weights = fit.model, fit.weights
    predicted = regression.predict(model)
    residual = regression.efforts - predicted
    effect = -_rate(regression, predicted)
    count, b = len(regression.problem.joints), len(model.bodies)
    vector = np.zeros(PARAMETERS * b + TERMS * count)
    for j in range(count):
        vector[: PARAMETERS * b] += weights[j] * effect[:, j] @ regression.bodies[:, j]
    for j, owner, columns in regression.actions(model):
        own = PARAMETERS * b + TERMS * owner + np.arange(TERMS)
        vector[own] += weights[j] * effect[:, j] @ columns
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

    efforts = motion.efforts.copy()
    for begin, end in pieces(motion.times):
        times = motion.times[begin:end]
        if len(times) > 3:
            later = np.minimum(np.maximum(times + delay, times[0]), times[-1])
            efforts[begin:end] = CubicSpline(times, efforts[begin:end])(later)
    return np.asarray(efforts)


def _rate(regression: Regression, values: Floats) -> Floats:
    """Differentiate samples, one per row, with respect to time, motion by motion."""
    rates, first = np.zeros_like(values), 0
    for smooth in regression.resamplers:
        last = first + len(smooth.times)
        for begin, end in pieces(smooth.times) if last - first > 2 else []:
            part = slice(first + begin, first + end)
            if end - begin > 2:
                rates[part] = np.gradient(values[part], smooth.times[begin:end], axis=0)
        first = last
    return rates
