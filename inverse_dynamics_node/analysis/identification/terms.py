"""
Chooses friction widths, springs, couplings, and all other terms of the joints.

The friction width is the speed over which Coulomb friction is smoothed. A coupled drive also turns
with the preceding joint. Other unknowns may have effects similar to those of a spring or of a
coupling. Therefore, these two must clearly improve the prediction of left-out blocks, which are
contiguous parts of the recordings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ...robot.model import Booleans, Floats
from ..columns import fit_nonnegative
from .fit import RobotFit
from .regression import ARMATURE, LOAD, Model, moved_by, Regression, SIGNED, SPRING, TERMS

WIDTHS = 16
"""Number of friction widths to try."""
NARROWEST = 0.002
"""Smallest friction width to try [rad/s or m/s]."""
LEAST_GAIN = {SPRING: 0.1, TERMS: 0.3}
"""
Fraction by which a spring, and a coupling (`TERMS`), must reduce squared prediction errors.

The errors are those of the affected joints, on average.
"""
ERRORS_TO_ADD, ERRORS_TO_KEEP = 2.0, 1.0
"""
Required improvement by a spring or coupling, averaged over blocks, in errors of the average.

The limit to keep a term is lower, so that a term is not dropped by the noise of its own test.
"""
SIGNIFICANT = 2.0
"""Armature and load friction below this many standard errors are dropped."""
RATIOS = (-3.0, -1.0, -0.3, -0.1, 0.1, 0.3, 1.0, 3.0)
"""Couplings to try."""
RATIO_STEPS = (1.3, 1.1, 1.03, 1.01)
"""Factors by which a coupling is refined."""
WRIST = 3
"""Largest number of joints in a wrist."""
FIXED_RATIO = 0.995
"""Two joints moved in a fixed ratio if their velocities have at least this correlation."""


# ---- Friction widths -----------------------------------------------------------------------


def with_best_widths(regression: Regression, model: Model, used: Booleans) -> Model:
    """Return the model with the friction widths that fit each joint best, for given bodies."""
    fast = np.maximum(np.quantile(np.abs(regression.qd), 0.95, axis=0), 10.0 * NARROWEST)
    grid = np.geomspace(np.maximum(0.004 * fast, NARROWEST), 0.4 * fast, WIDTHS)
    rigid = regression.rigid(model.bodies)
    target = regression.efforts - rigid
    for j, owner, columns in regression.actions(model, rigid):
        if j != owner:  # a coupled drive acts on the preceding joint
            target[:, j] -= columns @ model.joints[owner]
    squares = np.zeros(grid.shape)
    for k, widths in enumerate(grid):
        terms = regression.terms(replace(model, widths=widths), rigid)
        for j, chosen in enumerate(used):
            columns = terms[:, j][:, chosen]
            squares[k, j] = fit_nonnegative(columns, target[:, j], SIGNED[chosen])[1]
    best = np.argmin(squares, axis=0)
    return replace(model, widths=grid[best, np.arange(len(best))])


# ---- Springs and couplings -----------------------------------------------------------------


def with_extra(fit: RobotFit, moving: Booleans) -> RobotFit | None:
    """Return the fit with the most useful spring or coupling, or None if none is useful."""
    trials = []
    for trial, joints, least in _candidates(fit, moving):
        reduction = (_fitted_losses(fit) - _fitted_losses(trial)).sum()
        relative = reduction / max(float(_fitted_losses(fit)[joints].sum()), 1e-300)
        trials.append((relative / least, joints, least, trial))
    for gain, joints, least, trial in sorted(trials, key=lambda each: -each[0]):
        if gain >= 1.0 and is_needed(fit, trial, joints, least, ERRORS_TO_ADD):
            return trial
    return None


def _candidates(fit: RobotFit, moving: Booleans) -> Iterator[tuple[RobotFit, list[int], float]]:
    """Yield fits with one more spring or coupling, the affected joints, and the least gain."""
    regression = fit.equations.regression
    is_continuous = regression.problem.identified.robot.is_continuous[regression.problem.joints]
    for j in np.flatnonzero(moving).tolist():
        if not fit.used[j, SPRING] and not is_continuous[j]:
            more = fit.used.copy()
            more[j, SPRING] = True
            yield fit.again(fit.model, more), [j], LEAST_GAIN[SPRING]
        before = int(regression.problem.before[j])
        if not fit.model.couplings[j] and may_be_coupled(regression, moving, j):
            yield _coupled(fit, j), [before, j], LEAST_GAIN[TERMS]


def _coupled(fit: RobotFit, j: int) -> RobotFit:
    """Fit the coupling of joint j."""

    def best(ratios: Sequence[float]) -> RobotFit:
        trials = [fit.again(fit.model.with_coupling(j, ratio), fit.used) for ratio in ratios]
        return min(trials, key=lambda trial: float(_fitted_losses(trial).sum()))

    found = best(RATIOS)
    for step in RATIO_STEPS:
        ratio = float(found.model.couplings[j])
        found = best([ratio * step**k for k in (-2, -1, 0, 1, 2)])
    return found


def without_useless_terms(fit: RobotFit) -> RobotFit:
    """Return the fit without terms that are useless; the same object if all are useful."""
    used, model, errors = fit.used.copy(), fit.model, fit.joint_errors()
    optional = [ARMATURE, LOAD]
    used[:, optional] &= model.joints[:, optional] > SIGNIFICANT * errors[:, optional]
    for j in range(len(used)):
        if fit.used[j, SPRING]:
            less = fit.used.copy()
            less[j, SPRING] = False
            base = fit.again(fit.model, less)
            used[j, SPRING] = is_needed(base, fit, [j], LEAST_GAIN[SPRING], ERRORS_TO_KEEP)
        if fit.model.couplings[j]:
            before = int(fit.equations.regression.problem.before[j])
            base = fit.again(fit.model.with_coupling(j, 0.0), fit.used)
            if not is_needed(base, fit, [before, j], LEAST_GAIN[TERMS], ERRORS_TO_KEEP):
                model = model.with_coupling(j, 0.0)
    if (used == fit.used).all() and model is fit.model:
        return fit
    return fit.again(model, used)


def is_needed(
    base: RobotFit, fit: RobotFit, joints: Sequence[int], least: float, errors: float
) -> bool:
    """
    Return whether `fit` predicts left-out blocks clearly better than the smaller model `base`.

    `fit` must reduce the squared residuals of `joints` by the fraction `least` on average. The
    improvement, averaged over the blocks, must exceed `errors` times its standard error, because
    one block may contain most of the squared residuals.

    """
    losses, new = base.unseen_losses(), fit.unseen_losses()
    scale = np.maximum(losses.sum(axis=0), 1e-300)
    if ((losses - new) / scale).sum() < least * len(joints):
        return False
    before, after = ((each[:, joints] / scale[joints]).sum(axis=1) for each in (losses, new))
    gains = np.log(np.maximum(before, 1e-9) / np.maximum(after, 1e-9))
    return len(gains) > 1 and bool(gains.mean() > errors * gains.std(ddof=1) / len(gains) ** 0.5)


def may_be_coupled(regression: Regression, moving: Booleans, j: int) -> bool:
    """
    Return whether the drive of a joint could also turn with the preceding joint.

    Couplings occur in wrists, where gears run through the preceding joint. Both joints must be
    revolute and near the end of the chain. Joints that moved in a fixed ratio are excluded,
    because their columns are collinear.

    """
    problem = regression.problem
    robot, before = problem.identified.robot, int(problem.before[j])
    if before < 0 or not (moving[j] and moving[before]):
        return False
    if abs(np.corrcoef(regression.qd[:, [before, j]].T)[0, 1]) > FIXED_RATIO:
        return False
    joints = problem.joints[before], problem.joints[j]
    if robot.is_prismatic_joint[list(joints)].any():
        return False
    turning = np.flatnonzero(np.isin(robot.joint_index, problem.joints) & ~robot.is_prismatic)
    return len(moved_by(robot, joints[1], turning.tolist())) < WRIST


def _fitted_losses(fit: RobotFit) -> Floats:
    """Return the weighted sum of squared residuals in all blocks, shape (joints,)."""
    equations = fit.equations
    squares = [equations.squares(fit.model, k) for k in range(equations.block_count)]
    return np.asarray(fit.weights * np.sum(squares, axis=0))
