"""Fits bodies and joints together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats, Integers
from ...robot.pseudo_inertia import PARAMETERS
from .drive_terms import SIGNED
from .regression import LOAD, Model, moved_by, Regression, TERMS
from .solver import minimise, Prior


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
