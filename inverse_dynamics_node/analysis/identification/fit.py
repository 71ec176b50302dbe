"""
Fits bodies and joints together by least squares, and keeps all bodies physically possible.

The objective is the sum of squared residuals plus an entropic divergence for each body [1]_. The
divergence of a body is ``tr(P0^-1 P) - log det P``. P is the pseudo-inertia of the body, and P0 is
the pseudo-inertia in the robot description. The divergence is convex, and finite only for physical
bodies. A scalar form of the divergence keeps friction and armature positive. The objective is
self-concordant, so Newton's method converges from any physically possible start.

The divergence is multiplied by a factor, the weight of the robot description. Cross-validation
with blocks of the recordings determines this weight. A block is a contiguous part of a recording.

References
----------
.. [1] T. Lee, P. M. Wensing, F. C. Park, "Geometric robot dynamic identification: a convex
   programming approach", IEEE Transactions on Robotics 36(2), 2020.

"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats, Integers
from ...robot.rigid_body import BASIS, PARAMETERS, pseudo_inertias
from .regression import LOAD, Model, Regression, SIGNED, TERMS

URDF_WEIGHTS = (1e3, 1e2, 1e1, 1e0, 1e-1, 1e-2)
"""
Weights to try for the robot description in the fit, largest first.

With a weight of 1, a mass that the recordings do not determine has a standard error of 100 %.
"""
EXPECTED_ERROR = 0.3
"""Least relative error of masses in a robot description, for the errors of the result."""
_MOST_STEPS = 200
_DECREMENT = 1e-8
"""The solver stops when the squared Newton decrement is smaller than this."""
_TO_EDGE = 0.95
"""Largest step, as a fraction of the step at which a value becomes unphysical."""


class RobotFit(NamedTuple):
    """Result of a fit of bodies and joints together."""

    equations: Equations
    weights: Floats
    """Weight of the residuals of each joint, shape (joints,)."""
    urdf_weight: float
    """Weight of the divergence from the robot description."""
    used: Booleans
    """Whether each term of each joint was fitted, shape (joints, 6)."""
    model: Model
    unknowns: Integers
    """Indices of the fitted unknowns; all unknowns are ten per body, followed by six per joint."""
    hessian: Floats
    """Inverse covariance of the unknowns."""
    prior: Prior

    def again(self, model: Model, used: Booleans) -> RobotFit:
        """Repeat the fit with other shapes or terms, starting from a model."""
        equations = self.equations
        if model is not self.model:
            equations = Equations(equations.regression, model)
        return solve(equations, self.weights, self.urdf_weight, used, model)

    def without(self, block: int) -> Model:
        """Repeat the fit without one block of the recordings, and return the model."""
        return solve(
            self.equations, self.weights, self.urdf_weight, self.used, self.model, block
        ).model

    def unseen_losses(self) -> Floats:
        """Return the squared residuals of left-out blocks, shape (blocks, joints)."""
        blocks = range(self.equations.block_count)
        return np.array([self.equations.squares(self.without(k), k) for k in blocks])

    def joint_errors(self) -> Floats:
        """
        Return standard errors of the joint terms, with zero for terms that were not fitted.

        The errors are the larger of those from the residuals and those from the spread between
        fits without one block. The latter include friction that changes with time.

        """
        errors = np.zeros(self.used.shape)
        variances = np.diagonal(np.linalg.inv(self.hessian))
        errors[self.used] = np.sqrt(variances[self.model.bodies.size :])
        count = self.equations.block_count
        values = np.array([self.without(block).joints for block in range(count)])
        return np.asarray(np.maximum(errors, np.sqrt(count - 1) * values.std(axis=0)))


def correlation(residual: Floats) -> float:
    """Return how many correlated rows contain as much information as one independent row."""
    values = residual - residual.mean()
    count = len(values)
    spectrum = np.fft.rfft(values, 2 * count)
    products = np.fft.irfft(np.abs(spectrum) ** 2)[:count]
    if products[0] <= 0.0:
        return 1.0
    products /= products[0]
    below = np.flatnonzero(products < 0.05)
    end = int(below[0]) if len(below) else max(1, count // 10)
    return float(max(1.0, 1.0 + 2.0 * products[1:end].sum()))


def weights_of(residual: Floats) -> Floats:
    """Return inverse variances of residuals, corrected for correlated rows, shape (joints,)."""
    squares = np.mean(residual**2, axis=0)
    dependent = np.array([correlation(column) for column in residual.T])
    return np.asarray(1.0 / (np.maximum(squares, 1e-6 * squares.max() + 1e-12) * dependent))


class Equations:
    """Normal equations of each joint and block, for the columns of a model."""

    def __init__(self, regression: Regression, model: Model) -> None:
        self.regression, self.block_count = regression, regression.block_count
        count = model.bodies.size
        self.size = count + model.joints.size
        actions = regression.actions(model, regression.rigid(model.bodies))
        self.index: list[Integers] = []
        self.blocks: list[Floats] = []
        """For each joint, products of all columns and the target, the last for other rows."""
        for j in range(len(model.joints)):
            moved = regression.moved(j)
            own = [(owner, columns) for row, owner, columns in actions if row == j]
            terms = [count + TERMS * owner + np.arange(TERMS) for owner, _ in own]
            target = regression.efforts[:, j] - regression.known[:, j]
            table = np.column_stack([*(columns for _, columns in own), target])
            bodies = regression.bodies[:, j][:, moved]
            mixed, last = regression.by_block(bodies, table), regression.by_block(table, table)
            self.index.append(np.concatenate([moved, *terms]))
            self.blocks.append(
                np.block([[regression.body_grams[j], mixed], [mixed.transpose(0, 2, 1), last]])
            )

    def normal(self, weights: Floats, without: int | None = None) -> tuple[Floats, Floats]:
        """
        Return matrix and vector of the normal equations.

        Without a block, the rows between blocks are left out too, because they contain parts of
        that block.

        """
        matrix, vector = np.zeros((self.size, self.size)), np.zeros(self.size)
        for weight, index, blocks in zip(weights, self.index, self.blocks, strict=True):
            gram = blocks.sum(axis=0)
            if without is not None:
                gram = gram - blocks[-1] - blocks[without]
            matrix[np.ix_(index, index)] += weight * gram[:-1, :-1]
            vector[index] += weight * gram[:-1, -1]
        return matrix, vector

    def squares(self, model: Model, block: int) -> Floats:
        """Return the sum of squared residuals of every joint in a block, shape (joints,)."""
        x = np.concatenate([model.bodies.ravel(), model.joints.ravel()])
        remaining = []
        for index, blocks in zip(self.index, self.blocks, strict=True):
            factors = np.append(-x[index], 1.0)
            remaining.append(float(factors @ blocks[block] @ factors))
        return np.array(remaining)


def solve(
    equations: Equations,
    weights: Floats,
    urdf_weight: float,
    used: Booleans,
    start: Model,
    without: int | None = None,
) -> RobotFit:
    """
    Minimise the weighted squared residuals plus the divergence from the robot description.

    `weights` is the result of `weights_of`. `urdf_weight` is the weight of the divergence. Terms
    that are not `used` are zero. A scalar divergence keeps friction and armature positive. Its
    reference values depend on `start`. The block `without` is left out.

    """
    identified = equations.regression.problem.identified
    count = PARAMETERS * len(identified.bodies)
    matrix, vector = equations.normal(weights, without)
    terms = np.flatnonzero(used.ravel())
    unknowns = np.concatenate([np.arange(count), count + terms])
    kind = terms % TERMS
    positive = np.flatnonzero(~SIGNED[kind])
    first = start.joints.ravel()[terms]
    size = np.sqrt(np.maximum(np.diagonal(matrix)[count + terms], 1e-12))
    scales = np.maximum(np.abs(first), 0.1 / size)[positive]
    strength = np.where(kind[positive] == LOAD, 1.0, 0.02)
    scales = np.where(kind[positive] == LOAD, 0.05, scales)
    prior = Prior(identified.reference, urdf_weight, positive + count, scales, strength)
    x = np.concatenate([start.bodies.ravel(), first])
    x[count + positive] = np.maximum(x[count + positive], 1e-3 * scales)
    x, hessian = minimise(matrix[np.ix_(unknowns, unknowns)], vector[unknowns], prior, x)
    joints = np.zeros(used.size)
    joints[terms] = x[count:]
    bodies = x[:count].reshape(-1, PARAMETERS)
    model = replace(start, bodies=bodies, joints=joints.reshape(used.shape))
    return RobotFit(equations, weights, urdf_weight, used, model, unknowns, hessian, prior)


def with_best_urdf_weight(fit: RobotFit) -> RobotFit:
    """
    Repeat a fit with the largest weight of the robot description whose loss is small.

    Each block is predicted by a fit to the other blocks. The loss is the sum of weighted squared
    prediction errors. A loss is small if it exceeds the smallest loss by at most 5 %, and by at
    most the standard error of the difference.

    """
    trials = []
    for urdf_weight in URDF_WEIGHTS:
        fit = fit._replace(urdf_weight=urdf_weight)
        trials.append(fit.unseen_losses() @ fit.weights)
    least = min(trials, key=np.sum)

    def is_small(losses: Floats) -> bool:
        excess = losses - least
        error = np.sqrt(len(excess)) * excess.std(ddof=1) if len(excess) > 1 else 0.0
        return bool(excess.sum() <= min(error, 0.05 * least.sum()))

    best = next(k for k, losses in enumerate(trials) if is_small(losses))
    return fit._replace(urdf_weight=URDF_WEIGHTS[best]).again(fit.model, fit.used)


def body_covariance(fit: RobotFit) -> Floats:
    """
    Return the covariance of the parameters of all bodies, shape (10 per body, 10 per body).

    The fit may trust the robot description more than `EXPECTED_ERROR` allows. The covariance does
    not, so that a mass that the recordings do not determine has at least this error.

    """
    count = fit.model.bodies.size
    x = np.concatenate([fit.model.bodies.ravel(), fit.model.joints[fit.used]])
    excess = max(0.0, fit.urdf_weight - EXPECTED_ERROR**-2)
    nothing = np.zeros_like(fit.prior.positive_weights)
    prior = replace(fit.prior, weight=excess, positive_weights=nothing)
    return np.asarray(np.linalg.inv(fit.hessian - prior.derivatives(x)[1])[:count, :count])


# ---- The solver ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Prior:
    """
    Divergence of the unknowns from reference values.

    The unknowns are ten parameters per body, followed by the fitted terms of the joints.

    """

    bodies: Floats
    """Reference parameters of the bodies, shape (bodies, 10)."""
    weight: float
    """Weight of the divergence of the bodies."""
    positive: Integers
    """Indices of the unknowns that must be positive."""
    scales: Floats
    """Reference values of the positive unknowns."""
    positive_weights: Floats
    """Weights of the divergence of the positive unknowns."""

    def value(self, x: Floats) -> float:
        """Return the divergence, or inf for unphysical values."""
        matrices = pseudo_inertias(self._bodies(x))
        numbers = x[self.positive]
        if not (numbers > 0.0).all():
            return np.inf
        try:
            factors = np.linalg.cholesky(matrices)
        except np.linalg.LinAlgError:
            return np.inf
        log_det = 2.0 * np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
        linear = np.einsum('bk,bk->b', self._pull, self._bodies(x))
        scalars = numbers / self.scales - np.log(numbers)
        bodies = self.weight * (linear - log_det).sum()
        return float(bodies + self.positive_weights @ scalars)

    def derivatives(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the gradient and the Hessian of the divergence."""
        gradient, hessian = np.zeros(len(x)), np.zeros((len(x), len(x)))
        count = len(self.bodies)
        inverses = np.linalg.inv(pseudo_inertias(self._bodies(x)))
        products = np.einsum('bij,kjl->bkil', inverses, BASIS)
        traces = np.trace(products, axis1=2, axis2=3)
        blocks = np.einsum('bkij,blji->bkl', products, products) * self.weight
        gradient[: PARAMETERS * count] = self.weight * (self._pull - traces).ravel()
        for b in range(count):
            rows = slice(PARAMETERS * b, PARAMETERS * (b + 1))
            hessian[rows, rows] = blocks[b]
        numbers = x[self.positive]
        gradient[self.positive] = self.positive_weights * (1.0 / self.scales - 1.0 / numbers)
        hessian[self.positive, self.positive] = self.positive_weights / numbers**2
        return gradient, hessian

    def longest_step(self, x: Floats, step: Floats) -> float:
        """Return a step factor, at most 1, that keeps all values physical."""
        numbers, change = x[self.positive], step[self.positive]
        falling = change < 0.0
        edge = float(np.min(numbers[falling] / -change[falling], initial=np.inf))
        longest = min(1.0, _TO_EDGE * edge)
        inverse = np.linalg.inv(np.linalg.cholesky(pseudo_inertias(self._bodies(x))))
        relative = inverse @ pseudo_inertias(self._bodies(step)) @ inverse.transpose(0, 2, 1)
        least = float(np.linalg.eigvalsh(relative).min())
        if least < 0.0:
            longest = min(longest, _TO_EDGE / -least)
        return longest

    def _bodies(self, x: Floats) -> Floats:
        return x[: self.bodies.size].reshape(-1, PARAMETERS)

    @cached_property
    def _pull(self) -> Floats:
        """Return the gradient of ``tr(P0^-1 P)`` in the body parameters, shape (bodies, 10)."""
        inverses = np.linalg.inv(pseudo_inertias(self.bodies))
        return np.asarray(np.einsum('bij,kji->bk', inverses, BASIS))


def minimise(matrix: Floats, vector: Floats, prior: Prior, start: Floats) -> tuple[Floats, Floats]:
    """
    Minimise ``x^T A x / 2 - b^T x`` plus the divergence, starting from physical values.

    Returns x and the Hessian at x. The inverse of the Hessian is the covariance of x. Raises
    numpy.linalg.LinAlgError if the data do not determine all unknowns.

    """
    from scipy.linalg import cho_factor, cho_solve

    def objective(x: Floats) -> float:
        return 0.5 * float(x @ matrix @ x) - float(vector @ x) + prior.value(x)

    x = start.copy()
    value = objective(x)
    hessian = matrix
    for _ in range(_MOST_STEPS):
        try:
            gradient, curvature = prior.derivatives(x)
            gradient += matrix @ x - vector
            hessian = curvature + matrix
            if not (np.isfinite(hessian).all() and (np.diagonal(hessian) > 0.0).all()):
                raise np.linalg.LinAlgError('a parameter does not affect the efforts')
            size = 1.0 / np.sqrt(np.diagonal(hessian))
            factor = cho_factor(hessian * np.outer(size, size) + 1e-12 * np.eye(len(x)))
            step = -size * cho_solve(factor, size * gradient)
            length = prior.longest_step(x, step)
        except np.linalg.LinAlgError:
            if (x == start).all():
                raise
            break  # an unsuitable model drives a body to the edge of what is possible
        decrement = -float(gradient @ step)
        if decrement < _DECREMENT:
            break
        while length > 1e-6:
            trial = objective(x + length * step)
            if trial <= value - 1e-4 * length * decrement + 1e-14 * abs(value):
                break
            length *= 0.5
        else:
            break  # rounding errors prevent further progress
        x, value = x + length * step, trial
    return x, hessian
