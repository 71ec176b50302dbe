"""Least squares in which friction, inertia and units are not negative."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..robot.model import Booleans, Floats


def fit_nonnegative(
    features: Floats, target: Floats, signed: Sequence[int] | Booleans = ()
) -> tuple[Floats, float]:
    """
    Fit factors of columns that are not negative, such as those of friction.

    Parameters
    ----------
    features : ndarray, shape (K, p)
        Columns.
    target : ndarray, shape (K,)
        What their sum explains.
    signed : sequence of int, or ndarray of bool
        The columns whose factors may be negative, such as that of an offset.

    Returns
    -------
    factors : ndarray, shape (p,)
    left : float
        Sum of squares that is not explained.

    """
    from scipy.optimize import nnls

    if not features.shape[1]:
        return np.zeros(0), float(target @ target)
    chosen = list(signed) if not isinstance(signed, np.ndarray) else signed
    both = np.column_stack([features, -features[:, chosen]])
    lengths = np.linalg.norm(both, axis=0)
    lengths[lengths == 0.0] = 1.0
    triangle = np.asarray(np.linalg.qr(np.column_stack([both / lengths, target]), mode='r'))
    solution, norm = nnls(triangle[:, :-1], triangle[:, -1])
    solution /= lengths
    factors: Floats = solution[: features.shape[1]].copy()
    factors[chosen] -= solution[features.shape[1] :]
    return factors, float(norm) ** 2
