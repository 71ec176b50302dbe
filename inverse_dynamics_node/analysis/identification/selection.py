"""Chooses how closely the bodies follow the robot description, by blocked cross-validation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats
from .fit import Equations, Solution, solve
from .regression import Model

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
