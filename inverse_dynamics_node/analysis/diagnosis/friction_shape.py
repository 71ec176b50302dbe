"""
Fits the shape of the friction of one joint: how wide its step is, and how it grows with the load.

Both are accepted only if they explain far more than friction with a narrow step and without load.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...robot.model import Floats
from .friction import FrictionFit, standard_errors

WIDTHS = (0.02, 0.03, 0.05, 0.08, 0.12)  # [rad/s or m/s]
BETTER = 0.85  # fraction of the squares that a width or the load must leave at most
MOST_LOAD = 0.5  # larger ratios of friction to load are another cause


def fit_shape(
    fit: FrictionFit,
    qd: Floats,
    residual: Floats,
    load: Floats,
    smooth: Callable[[Floats], Floats],
    width: float,
    window: int,
) -> FrictionFit:
    """
    Fit the width of the step and the friction per load to all samples of a joint.

    Parameters
    ----------
    fit : FrictionFit
        Friction with the common width.
    qd : ndarray, shape (K,)
        Velocities of the joint [rad/s or m/s].
    residual : ndarray, shape (K,)
        Measured minus modelled effort without friction [N m or N].
    load : ndarray, shape (K,)
        Magnitude of the modelled effort without friction and rotor [N m or N].
    smooth : callable
        Smooths columns of shape (K, c) in the same way as the measured efforts.
    width : float
        Common width [rad/s or m/s].
    window : int
        Number of samples of the smoothing window.

    Returns
    -------
    fit : FrictionFit
        The given one if another shape does not explain far more.

    """
    if fit.unknown_because:
        return fit
    squares, best = _with_width(qd, residual, load, smooth, width, False)
    chosen = width
    for has_load in (False, True):
        for other in (width, *WIDTHS):
            left, solution = _with_width(qd, residual, load, smooth, other, has_load)
            if left < BETTER * squares and solution[2] < MOST_LOAD:
                squares, best, chosen = left, solution, other
    if chosen == width and best[2] == 0.0:
        return fit
    direction = smooth(np.tanh(qd / chosen)[:, None])[:, 0]
    grown = smooth((load * np.tanh(qd / chosen))[:, None])[:, 0]
    features = np.column_stack([qd, direction, np.ones_like(qd)])
    left = residual - features @ np.array([best[0], best[1], best[3]]) - best[2] * grown
    errors = standard_errors(features, left, np.ones(len(qd), dtype=bool), window)
    return FrictionFit(best[0], best[1], best[3], *errors, '', chosen, best[2])


def _with_width(
    qd: Floats,
    residual: Floats,
    load: Floats,
    smooth: Callable[[Floats], Floats],
    width: float,
    has_load: bool,
) -> tuple[float, tuple[float, float, float, float]]:
    """Return the mean square that is left, and damping, Coulomb, load friction and offset."""
    from scipy.optimize import nnls

    direction = np.tanh(qd / width)
    step = smooth(np.column_stack([direction, load * direction * has_load]))
    one = np.ones_like(qd)
    features = np.column_stack([qd, step, one, -one])
    lengths = np.linalg.norm(features, axis=0)
    lengths[lengths == 0.0] = 1.0
    samples = np.column_stack([features / lengths, residual])
    triangle = np.asarray(np.linalg.qr(samples, mode='r'))
    solution, norm = nnls(triangle[:, :-1], triangle[:, -1])
    damping, coulomb, per_load, plus, minus = (solution / lengths).tolist()
    mean_square = float(norm) ** 2 / len(qd)
    return mean_square, (damping, coulomb, per_load, plus - minus)
