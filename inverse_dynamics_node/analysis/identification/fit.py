"""
Fits bodies and joints together.

Blocked cross-validation chooses how closely the bodies follow the robot description.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats, Integers
from ...robot.rigid_body import PARAMETERS
from .drive_terms import SIGNED
from .regression import LOAD, Model, moved_by, Regression, TERMS
from .solver import minimise, Prior

URDF_WEIGHTS = tuple(10.0 ** np.arange(4.0, -0.1, -0.5))
"""
Weights of the robot description, strongest first.

With a weight of 1, the standard error of a mass that the recordings do not determine is the mass.
"""
EXPECTED_ERROR = 0.3
"""Expected relative error of the masses of a robot description, as a standard deviation."""
ENOUGH = 0.9
"""A mass may be more than twice that of the description if the recording determines it so well."""
MOST_GROWTH = 2.0


class Solution(NamedTuple):
    """Minimum of the regularised least squares."""

    model: Model
    unknowns: Integers
    """Indices of the unknowns: ten for each body, then thirteen for each joint."""
    hessian: Floats
    """Inverse of the covariance of the unknowns."""
    prior: Prior


def correlation(residual: Floats) -> float:
    """Return how many successive rows carry as much information as an independent one."""
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


class Equations:
    """Normal equations of every joint and block, for given widths and loads."""

    def __init__(self, regression: Regression, model: Model) -> None:
        self.regression = regression
        robot, identified = regression.problem.identified.robot, regression.problem.identified
        b, m = len(identified.bodies), len(regression.problem.joints)
        self.size, self.block_count = PARAMETERS * b + TERMS * m, int(regression.block.max()) + 1
        terms = regression.terms(model)
        self.index: list[Integers] = []
        self.all: list[Floats] = []
        self.blocks: list[list[Floats]] = []
        for j, joint in enumerate(regression.problem.joints):
            moved = np.array(moved_by(robot, joint, identified.bodies), dtype=int)
            body = (PARAMETERS * moved[:, None] + np.arange(PARAMETERS)).ravel()
            self.index.append(np.append(body, PARAMETERS * b + TERMS * j + np.arange(TERMS)))
            table = np.column_stack(
                [
                    regression.bodies[:, j][:, body],
                    terms[:, j],
                    regression.efforts[:, j] - regression.known[:, j],
                ]
            )
            self.all.append(table.T @ table)
            parts = [table[regression.block == k] for k in range(self.block_count)]
            self.blocks.append([part.T @ part for part in parts])

    def normal(self, weights: Floats, without: int | None = None) -> tuple[Floats, Floats]:
        """Return matrix and vector of the normal equations, without one of the blocks."""
        matrix, vector = np.zeros((self.size, self.size)), np.zeros(self.size)
        for j, index in enumerate(self.index):
            gram = self.all[j]
            if without is not None:
                gram = np.sum(
                    [part for k, part in enumerate(self.blocks[j]) if k != without], axis=0
                )
            matrix[np.ix_(index, index)] += weights[j] * gram[:-1, :-1]
            vector[index] += weights[j] * gram[:-1, -1]
        return matrix, vector

    def squares(self, model: Model, block: int) -> Floats:
        """Return the remaining squares of every joint in a block, shape (m,)."""
        x = np.concatenate([model.bodies.ravel(), model.joints.ravel()])
        remaining = []
        for j, index in enumerate(self.index):
            factors = np.append(-x[index], 1.0)
            remaining.append(float(factors @ self.blocks[j][block] @ factors))
        return np.array(remaining)


def solve(
    equations: Equations,
    weights: Floats,
    urdf_weight: Floats,
    used: Booleans,
    start: Model,
    without: int | None = None,
) -> Solution:
    """
    Minimise the weighted squares plus the divergence from the robot description.

    Parameters
    ----------
    equations : Equations
        Of b identified bodies and m joints.
    weights : ndarray, shape (m,)
        Inverse variances of the joints, for dependent samples.
    urdf_weight : ndarray, shape (b,)
        Weight of the divergence of every body.
    used : ndarray, shape (m, 13)
        Terms that are fitted; the others are zero.
    start : Model
        First guess; its terms set the scales of those that are positive.
    without : int, optional
        Block to leave out.

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
    model = Model(x[:count].reshape(-1, PARAMETERS), joints.reshape(used.shape), start.widths)
    return Solution(model, unknowns, hessian, prior)


class Trial(NamedTuple):
    """One weight of the robot description."""

    urdf_weight: float
    losses: Floats
    """Weighted squares of blocks that the fit has not seen, shape (blocks,)."""


def choose_urdf_weight(
    equations: Equations, weights: Floats, used: Booleans, start: Model
) -> tuple[float, list[Trial]]:
    """
    Return the strongest weight whose prediction is not clearly worse than the best one.

    Blocks of the recording are predicted by fits to the other blocks. Clearly is one standard
    error of the differences between the blocks.

    """
    trials = []
    models = [start] * equations.block_count
    bodies = len(start.bodies)
    for urdf_weight in URDF_WEIGHTS:
        losses = []
        for k in range(equations.block_count):
            solution = solve(equations, weights, np.full(bodies, urdf_weight), used, models[k], k)
            models[k] = solution.model
            losses.append(float(weights @ equations.squares(solution.model, k)))
        trials.append(Trial(float(urdf_weight), np.array(losses)))
    best = min(trials, key=lambda trial: trial.losses.sum())
    for trial in trials:
        excess = trial.losses - best.losses
        error = np.sqrt(len(excess)) * excess.std(ddof=1) if len(excess) > 1 else 0.0
        if excess.sum() <= min(error, 0.05 * best.losses.sum()):
            return trial.urdf_weight, trials
    return best.urdf_weight, trials


def solve_within_reason(
    equations: Equations, weights: Floats, urdf_weight: float, used: Booleans, start: Model
) -> tuple[Solution, Floats]:
    """
    Solve, and hold masses that grow although the recording does not determine them.

    Returns
    -------
    solution : Solution
        Without such masses.
    data_fraction : ndarray, shape (b,)
        Fraction of the information about the mass of each body that comes from the recording.

    """
    before = equations.regression.problem.identified.before[:, 0]
    urdf_weights = np.full(len(before), urdf_weight)
    for _ in range(40):
        solution = solve(equations, weights, urdf_weights, used, start)
        data_fraction = mass_information(solution)
        growing = solution.model.bodies[:, 0] > 0.99 * MOST_GROWTH * before
        held = growing & (data_fraction <= ENOUGH)
        if not held.any():
            break
        urdf_weights = np.where(held, 2.0 * urdf_weights, urdf_weights)
        start = solution.model
    return solution, data_fraction


def mass_information(solution: Solution) -> Floats:
    """
    Return the fraction of information about each mass that comes from the data.

    The rest is a mass of the robot description with its expected error. So the fraction does not
    depend on the weight of the description in the fit.

    """
    count = len(solution.model.bodies)
    variances = np.diagonal(np.linalg.inv(solution.hessian))[: 10 * count : 10]
    # The divergence alone determines a mass with the relative standard error 1 / sqrt(gamma).
    total = 1.0 / np.maximum(variances, 1e-300)
    own = solution.prior.weights / solution.model.bodies[:, 0] ** 2
    measured = np.maximum(total - own, 0.0)
    expected = 1.0 / (EXPECTED_ERROR * solution.prior.bodies[:, 0]) ** 2
    return np.asarray(measured / (measured + expected))
