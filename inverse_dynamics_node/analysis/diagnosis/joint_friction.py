"""The friction of all compared joints."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...robot.model import Booleans, Floats
from ..recordings.resampling import smooth_like_efforts
from .compared_efforts import ComparedEfforts
from .correction import added_efforts
from .friction import fit_friction, fit_shape, FrictionFit, is_moving
from .joint_samples import CREDIBLE
from .regression_data import RobotFit

ALL = slice(None)


def fit_joints(
    compared: ComparedEfforts,
    residual: Floats,
    obscured: dict[int, str],
    used: Booleans | slice = ALL,
) -> list[FrictionFit]:
    """Fit friction to a residual, which consists of the used samples."""
    fits = []
    for c in range(len(compared.names)):
        fit = fit_friction(
            compared.qd[used, c],
            compared.direction[used, c],
            residual[:, c],
            compared.period,
            compared.motion.window,
            compared.width,
        )
        if c in obscured:
            fit = FrictionFit.unknown(obscured[c], fit.offset if fit.unknown_because else 0.0)
        fits.append(fit)
    return fits


def obscured(compared: ComparedEfforts, robot_fit: RobotFit) -> dict[int, str]:
    """Return why the friction of some columns is unknown even if they moved enough."""
    reasons = dict.fromkeys(compared.constant, 'its effort was not measured')
    is_scaled = any(fit.sensor_fault.is_scaled for fit in robot_fit.fits)
    for c, fit in zip(compared.varying, robot_fit.fits, strict=True):
        if fit.moves and fit.remaining > CREDIBLE:
            reasons[c] = 'its effort is not explained'
        elif is_scaled and fit.is_friction_only:
            reasons[c] = 'the unit of its effort is unknown'
    return reasons


def load_on_gears(compared: ComparedEfforts, robot_fit: RobotFit) -> Floats:
    """Return the magnitude of the modelled efforts without friction and rotors, shape (K, c)."""
    return np.abs(compared.rigid + added_efforts(compared, robot_fit))


def with_shapes(
    compared: ComparedEfforts, fits: list[FrictionFit], residual: Floats, load: Floats
) -> list[FrictionFit]:
    """Fit the shape of the friction of joints whose friction is known; see `load_on_gears`."""
    return [
        fit_shape(
            fit,
            compared.qd[:, c],
            residual[:, c],
            load[:, c],
            partial(smooth_like_efforts, compared.motion),
            compared.width,
            compared.motion.window,
        )
        for c, fit in enumerate(fits)
    ]


def friction_efforts(compared: ComparedEfforts, c: int, fit: FrictionFit, load: Floats) -> Floats:
    """Return the efforts of friction and offset of a column, with its load."""
    qd = compared.qd[:, c]
    if not fit.has_shape:
        return fit.efforts(qd, compared.direction[:, c])
    direction = np.tanh(qd / fit.width)
    step = np.column_stack([direction, load * direction])
    step = smooth_like_efforts(compared.motion, step)
    efforts: Floats = fit.efforts(qd, step[:, 0]) + fit.load_friction * step[:, 1]
    return efforts


def with_friction_only(compared: ComparedEfforts) -> Floats:
    """Return the modelled efforts with friction that is fitted without faults."""
    efforts: Floats = compared.rigid.copy()
    for c, fit in enumerate(fit_joints(compared, compared.measured - compared.rigid, {})):
        efforts[:, c] += fit.damping * compared.qd[:, c]
        efforts[:, c] += fit.coulomb * compared.direction[:, c]
    return efforts


def when_comparable(compared: ComparedEfforts, fits: list[FrictionFit]) -> list[Booleans]:
    """Select the samples of every column at which fitted friction is valid."""
    every = np.ones(len(compared.qd), dtype=bool)
    return [
        every if fit.unknown_because else is_moving(compared.qd[:, c], compared.width)
        for c, fit in enumerate(fits)
    ]
