"""
Least squares over bodies that remain physical, close to those of the robot description.

The sum of squares has the entropic divergence of every body P from its reference P0 added,
``tr(P0^-1 P) - log det P``. It is convex, finite only inside physics, and does not depend on units
or frames. Friction and armature are kept positive by the same divergence of single numbers. The
whole is self-concordant, so that Newton's method converges from anywhere inside.

References
----------
.. [1] T. Lee, P. M. Wensing, F. C. Park, "Geometric robot dynamic identification: a convex
   programming approach", IEEE Transactions on Robotics 36(2), 2020.

"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...robot.model import Floats, Integers
from ...robot.rigid_body import BASIS, PARAMETERS, pseudo_inertias

_MOST_STEPS = 200
_DECREMENT = 1e-8
"""Predicted decrease of the objective below which the minimum has been found."""
_TO_EDGE = 0.95
"""Largest fraction of the way to the edge of physics in one step."""


@dataclass(frozen=True, eq=False)
class Prior:
    """References of the unknowns; bodies come first, ten unknowns each."""

    bodies: Floats
    """Reference parameters of the bodies, shape (b, 10)."""
    weights: Floats
    """Weight of the divergence of each body, shape (b,)."""
    positive: Integers
    """Indices of the unknowns that are positive numbers, shape (s,)."""
    scales: Floats
    """References of these, shape (s,)."""
    positive_weights: Floats
    """Weight of the divergence of each of these, shape (s,)."""

    def value(self, x: Floats) -> float:
        """Return the divergence, infinite outside physics."""
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
        return float(self.weights @ (linear - log_det) + self.positive_weights @ scalars)

    def derivatives(self, x: Floats) -> tuple[Floats, Floats]:
        """Return gradient and Hessian of the divergence, shapes (p,) and (p, p)."""
        gradient, hessian = np.zeros(len(x)), np.zeros((len(x), len(x)))
        count = len(self.bodies)
        inverses = np.linalg.inv(pseudo_inertias(self._bodies(x)))
        products = np.einsum('bij,kjl->bkil', inverses, BASIS)
        traces = np.trace(products, axis1=2, axis2=3)
        blocks = np.einsum('bkij,blji->bkl', products, products) * self.weights[:, None, None]
        gradient[: PARAMETERS * count] = (self.weights[:, None] * (self._pull - traces)).ravel()
        for b in range(count):
            rows = slice(PARAMETERS * b, PARAMETERS * (b + 1))
            hessian[rows, rows] = blocks[b]
        numbers = x[self.positive]
        gradient[self.positive] = self.positive_weights * (1.0 / self.scales - 1.0 / numbers)
        hessian[self.positive, self.positive] = self.positive_weights / numbers**2
        return gradient, hessian

    def longest_step(self, x: Floats, step: Floats) -> float:
        """Return the multiple of a step that reaches the edge of physics; at most 1."""
        longest = 1.0
        numbers, change = x[self.positive], step[self.positive]
        if (change < 0.0).any():
            falling = change < 0.0
            longest = _TO_EDGE * float(np.min(numbers[falling] / -change[falling]))
            longest = min(longest, 1.0)
        if len(self.bodies):
            inverse = np.linalg.inv(np.linalg.cholesky(pseudo_inertias(self._bodies(x))))
            change = inverse @ pseudo_inertias(self._bodies(step)) @ inverse.transpose(0, 2, 1)
            least = float(np.linalg.eigvalsh(change).min())
            if least < 0.0:
                longest = min(longest, _TO_EDGE / -least)
        return longest

    def _bodies(self, x: Floats) -> Floats:
        return x[: self.bodies.size].reshape(-1, PARAMETERS)

    @cached_property
    def _pull(self) -> Floats:
        """Return the derivatives of ``tr(P0^-1 P)``, shape (b, 10)."""
        inverses = np.linalg.inv(pseudo_inertias(self.bodies))
        return np.asarray(np.einsum('bij,kji->bk', inverses, BASIS))


def minimise(matrix: Floats, vector: Floats, prior: Prior, start: Floats) -> tuple[Floats, Floats]:
    """
    Minimise ``x^T A x / 2 - b^T x`` plus the divergence.

    Parameters
    ----------
    matrix, vector : ndarray, shapes (p, p) and (p,)
        A and b of the normal equations.
    prior : Prior
        The divergence.
    start : ndarray, shape (p,)
        Inside physics.

    Returns
    -------
    x : ndarray, shape (p,)
        The minimum.
    hessian : ndarray, shape (p, p)
        Second derivatives there; the inverse of the covariance.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the data determine too little.

    """
    from scipy.linalg import cho_factor, cho_solve

    x = start.copy()
    value = _value(matrix, vector, prior, x)
    hessian = matrix
    for _ in range(_MOST_STEPS):
        gradient, hessian = prior.derivatives(x)
        gradient += matrix @ x - vector
        hessian += matrix
        if not (np.isfinite(hessian).all() and (np.diagonal(hessian) > 0.0).all()):
            raise np.linalg.LinAlgError('a parameter has no influence on the efforts')
        size = 1.0 / np.sqrt(np.diagonal(hessian))
        factor = cho_factor(hessian * np.outer(size, size) + 1e-14 * np.eye(len(x)))
        step = -size * cho_solve(factor, size * gradient)
        decrement = -float(gradient @ step)
        if decrement < _DECREMENT:
            break
        length = prior.longest_step(x, step)
        while length > 1e-6:
            trial = _value(matrix, vector, prior, x + length * step)
            if trial <= value - 1e-4 * length * decrement + 1e-14 * abs(value):
                break
            length *= 0.5
        else:
            break  # rounding errors: there is no better point
        x, value = x + length * step, trial
    return x, hessian


def _value(matrix: Floats, vector: Floats, prior: Prior, x: Floats) -> float:
    return 0.5 * float(x @ matrix @ x) - float(vector @ x) + prior.value(x)
