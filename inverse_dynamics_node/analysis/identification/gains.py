"""
Gains of joints whose efforts were recorded as motor currents.

A current is the effort divided by a gain. Gains and masses are only known together: if all of them
were multiplied by the same factor, the currents would be the same. The masses of the robot
description, and a known payload, decide.
"""

from __future__ import annotations

import numpy as np

from ...robot.model import Booleans, Floats
from .regression import Regression

SIGNIFICANT = 5.0
"""Standard errors by which a current has to depend on the modelled effort."""


def first_gains(
    regression: Regression, bodies: Floats, widths: Floats, moving: Booleans
) -> tuple[Floats, Booleans]:
    """
    Estimate gains with the masses of the robot description.

    Parameters
    ----------
    regression : Regression
        With currents as efforts.
    bodies : ndarray, shape (b, 10)
        Bodies of the description.
    widths : ndarray, shape (m,)
        Widths of Coulomb friction.
    moving : ndarray, shape (m,)
        Whether the friction of the joint matters.

    Returns
    -------
    gains : ndarray, shape (m,)
        Effort per current; negative for a current with the opposite sign. If a gain cannot be
        determined, the median of the others.
    determined : ndarray, shape (m,)

    """
    from .fit import correlation

    rigid = regression.rigid(bodies)
    direction = regression.direction(widths)
    slopes, errors = np.zeros(len(widths)), np.zeros(len(widths))
    for j in range(len(widths)):
        columns = [rigid[:, j], np.ones(len(rigid))]
        if moving[j]:
            columns += [regression.qdd[:, j], regression.qd[:, j], direction[:, j]]
        table = np.column_stack(columns)
        scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
        solution = np.linalg.lstsq(table / scale, regression.efforts[:, j], rcond=None)[0]
        residual = regression.efforts[:, j] - table / scale @ solution
        covariance = np.linalg.pinv((table / scale).T @ (table / scale))
        variance = np.mean(residual**2) * correlation(residual) * covariance[0, 0]
        slopes[j], errors[j] = solution[0] / scale[0], np.sqrt(variance) / scale[0]
    determined = np.abs(slopes) > SIGNIFICANT * errors
    gains = np.ones(len(widths))
    if determined.any():
        gains[determined] = 1.0 / slopes[determined]
        gains[~determined] = np.median(np.abs(gains[determined]))
    return gains, determined
