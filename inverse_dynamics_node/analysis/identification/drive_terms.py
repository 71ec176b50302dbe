"""
Chooses the terms of every joint besides its bodies, and the width of its Coulomb friction.

A term is used if it improves the prediction of blocks of the recording that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...robot.model import Booleans, Floats, Integers
from ..least_squares import fit_nonnegative
from .regression import (
    ARMATURE,
    COULOMB,
    COUPLINGS,
    DAMPING,
    GAIN,
    LOAD,
    Model,
    OFFSET,
    Regression,
    TERMS,
    WIDTH,
)

FRICTION: tuple[int, ...] = (DAMPING, COULOMB, OFFSET)
CANDIDATES: tuple[tuple[int, ...], ...] = (
    (ARMATURE,),
    (LOAD,),
    tuple(range(TERMS)[COUPLINGS[0]]),
    tuple(range(TERMS)[COUPLINGS[1]]),
)
SIGNED = np.isin(np.arange(TERMS), [OFFSET, *CANDIDATES[2], *CANDIDATES[3], WIDTH, GAIN])
LEAST_GAIN = np.array([0.01, 0.02, 0.3, 0.3])
"""Fraction of the squares by which each candidate must improve the prediction."""
LARGEST_LOAD = 0.1
"""Load friction of a poor gear [-]: the standard deviation that is expected beforehand."""
WIDTHS = 10
"""Widths to try."""


def widths_to_try(speeds: Floats, slowest: float = 0.002) -> Floats:
    """Return widths for joints with fast speeds of shape (m,), shape (WIDTHS, m)."""
    fast = np.maximum(speeds, 10.0 * slowest)
    return np.geomspace(np.maximum(0.004 * fast, slowest), 0.4 * fast, WIDTHS)


def choose_terms(
    regression: Regression, bodies: Floats, moving: Booleans, grid: Floats, optional: bool = True
) -> tuple[Model, Booleans]:
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

    Returns
    -------
    model : Model
        With the chosen terms; others are zero.
    used : ndarray, shape (m, 13)
        Which terms were chosen.

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
    return Model(bodies, joints, widths), used


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
        if gains.sum() < max(LEAST_GAIN[best] * losses.sum(), error):
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
