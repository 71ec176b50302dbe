"""
Adds terms that few robots need: springs and coupled drives.

A coupled drive also turns with the preceding joint. Other unknowns may have effects similar
to those of an extra term. Therefore, an extra term must clearly improve the prediction of left-out
blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from ...robot.model import Booleans, Floats, RobotModel
from .fit import Equations, RobotFit
from .regression import ARMATURE, Model, moved_by, RATIO, Regression, SPRING, WIDTH

LEAST_GAIN = 0.1
"""A spring must reduce the squared prediction errors of its joint by this fraction."""
LEAST_GAIN_OF_COUPLING = 0.3
"""A coupling must reduce its joints' squared prediction errors by this fraction on average."""
ERRORS = 3.0
"""Required improvement, averaged over the blocks, in standard errors of the average."""
LEAST_RELATION = 0.1
"""Fraction of a joint's residual that the motion of the coupled joint must explain."""
RATIOS = (-3.0, -1.0, -0.3, -0.1, 0.1, 0.3, 1.0, 3.0)
"""Initial values for the fit of a coupling."""
RATIO_ROUNDS = 3
WRIST = 3
"""Largest number of joints in a wrist."""
INTERSECTION = 2e-3
"""Two joint axes intersect if their distance is smaller than this [m]."""


def with_extra(regression: Regression, moving: Booleans, fit: RobotFit) -> RobotFit | None:
    """Return the fit with the most useful extra term, or None if no extra term is useful."""
    used = fit.used.copy()
    used[:, WIDTH] = moving
    equations = Equations(regression, fit.model)
    base = fit.again(equations, used, fit.model)
    losses, trials = _fitted_losses(base), []
    for joints, least, make in _candidates(regression, moving, fit, equations, used):
        try:
            trial = make()
        except np.linalg.LinAlgError:  # the recordings do not determine the extra term
            continue
        reduction = float(losses.sum() - _fitted_losses(trial).sum())
        relative = reduction / max(float(losses[joints].sum()), 1e-300)
        trials.append((relative / least, joints, least, trial))
    for gain, joints, least, trial in sorted(trials, key=lambda each: -each[0]):
        if gain >= 1.0 and is_needed(base, trial, joints, least):
            return trial._replace(model=trial.model.with_fitted_shapes())
    return None


def _candidates(
    regression: Regression, moving: Booleans, fit: RobotFit, equations: Equations, used: Booleans
) -> Iterator[tuple[list[int], float, Callable[[], RobotFit]]]:
    """Yield the joints, required improvement and fit function of each possible extra term."""
    is_continuous = regression.problem.identified.robot.is_continuous[regression.problem.joints]
    for j in np.flatnonzero(moving).tolist():
        if not used[j, SPRING] and not is_continuous[j]:
            more = used.copy()
            more[j, SPRING] = True
            yield [j], LEAST_GAIN, partial(fit.again, equations, more, fit.model)
        before = int(regression.problem.before[j])
        if (
            may_be_coupled(regression, moving, j)
            and not fit.model.couplings[j]
            and _relation(regression, fit.model, before, j) > LEAST_RELATION
        ):
            more = used.copy()
            more[[before, j], ARMATURE] = True
            make = partial(_coupled, regression, fit, more, j)
            yield [before, j], LEAST_GAIN_OF_COUPLING, make


def without_useless_extras(regression: Regression, fit: RobotFit) -> RobotFit:
    """
    Deselect extra terms that are useless.

    Returns the same object if all terms are useful. Otherwise, the result must be fitted again.

    """
    used, model = fit.used.copy(), fit.model
    for j in range(len(used)):
        if fit.used[j, SPRING]:
            less = fit.used.copy()
            less[j, SPRING] = False
            base = fit.again(fit.equations, less, fit.model)
            used[j, SPRING] = is_needed(base, fit, [j], LEAST_GAIN)
        if fit.model.couplings[j]:
            before = int(regression.problem.before[j])
            base = _uncoupled(regression, fit, j)
            if not is_needed(base, fit, [before, j], LEAST_GAIN_OF_COUPLING):
                model = model.with_coupling(j, 0.0)
    if (used == fit.used).all() and model is fit.model:
        return fit
    return fit._replace(used=used, model=model)


def is_needed(base: RobotFit, fit: RobotFit, joints: Sequence[int], least: float) -> bool:
    """
    Return whether `fit` predicts left-out blocks clearly better than the smaller model `base`.

    `fit` must reduce the squared residuals of `joints` by the fraction `least` on average. The
    blocks must improve consistently, because one block may contain most of the squared residuals.

    """
    try:
        losses, new = _unseen_losses(base), _unseen_losses(fit)
    except np.linalg.LinAlgError:  # without a block, the fit has no solution
        return False
    scale = np.maximum(losses.sum(axis=0), 1e-300)
    if ((losses - new) / scale).sum() < least * len(joints):
        return False
    before, after = ((each[:, joints] / scale[joints]).sum(axis=1) for each in (losses, new))
    gains = np.log(np.maximum(before, 1e-9) / np.maximum(after, 1e-9))
    return len(gains) > 1 and bool(gains.mean() > ERRORS * gains.std(ddof=1) / len(gains) ** 0.5)


def may_be_coupled(regression: Regression, moving: Booleans, j: int) -> bool:
    """
    Return whether the drive of a joint could also turn with the preceding joint.

    Couplings occur in wrists, where gears run through the preceding joint. Both joints must be
    revolute and near the end of the chain, and their axes must intersect. Joints that moved in a
    fixed ratio are excluded, because their columns are collinear.

    """
    problem = regression.problem
    robot, before = problem.identified.robot, int(problem.before[j])
    if before < 0 or not (moving[j] and moving[before]):
        return False
    if any(j in group and before in group for group in regression.together):
        return False
    joints = problem.joints[before], problem.joints[j]
    if robot.is_prismatic_joint[list(joints)].any():
        return False
    turning = np.flatnonzero(np.isin(robot.joint_index, problem.joints) & ~robot.is_prismatic)
    is_last = len(moved_by(robot, joints[1], turning.tolist())) < WRIST
    return is_last and _axes_intersect(robot, *joints)


def _relation(regression: Regression, model: Model, first: int, second: int) -> float:
    """
    Return the fraction of a joint's residual that the motion of the other joint explains.

    The fraction is computed for both joints, and the larger one is returned.

    """
    residual = regression.residual(model)
    direction = regression.direction(model.widths)
    signals = np.stack([regression.qdd, regression.qd, direction, np.ones_like(direction)], -1)
    explained = []
    for j, other in ((first, second), (second, first)):
        own, both = signals[:, j], np.hstack([signals[:, j], signals[:, other, :3]])
        left = [
            float(np.sum((residual[:, j] - columns @ solution) ** 2))
            for columns in (own, both)
            for solution in [np.linalg.lstsq(columns, residual[:, j], rcond=None)[0]]
        ]
        explained.append(1.0 - left[1] / max(left[0], 1e-300))
    return max(explained)


def _axes_intersect(robot: RobotModel, before: int, joint: int) -> bool:
    """Return whether the axes of two successive joints intersect and are not parallel."""
    bodies = robot.joint_index.tolist()
    first, second = (bodies.index(k, 1) for k in (before, joint))
    axis = robot.R_PL[second] @ robot.axis[second]
    normal = np.cross(robot.axis[first], axis)
    length = float(np.linalg.norm(normal))
    return length > 0.1 and abs(float(normal @ robot.p_PL[second])) < INTERSECTION * length


def _coupled(regression: Regression, fit: RobotFit, used: Booleans, j: int) -> RobotFit:
    """Fit the coupling of joint j, starting from the best of several values."""

    def fitted(model: Model) -> RobotFit:
        return fit.again(Equations(regression, model), used, model)

    trials = (fitted(fit.model.with_coupling(j, ratio)) for ratio in RATIOS)
    best = min(trials, key=lambda trial: float(_fitted_losses(trial).sum()))
    used = used.copy()
    used[j, RATIO] = True
    for _ in range(RATIO_ROUNDS):
        best = fitted(best.model.with_fitted_shapes())
    return best


def _uncoupled(regression: Regression, fit: RobotFit, j: int) -> RobotFit:
    """Repeat the fit without the coupling of joint j."""
    used, model = fit.used.copy(), fit.model.with_coupling(j, 0.0)
    used[j, RATIO] = False
    used[[regression.problem.before[j], j], ARMATURE] = True
    return fit.again(Equations(regression, model), used, model)


def _fitted_losses(fit: RobotFit) -> Floats:
    """Return the weighted sum of squared residuals in all blocks, shape (joints,)."""
    equations = fit.equations
    squares = [equations.squares(fit.model, k) for k in range(equations.block_count)]
    return np.asarray(fit.weights * np.sum(squares, axis=0))


def _unseen_losses(fit: RobotFit) -> Floats:
    """Return the squared residuals of left-out blocks, shape (blocks, joints)."""
    blocks = range(fit.equations.block_count)
    return np.array([fit.equations.squares(fit.without(k), k) for k in blocks])
