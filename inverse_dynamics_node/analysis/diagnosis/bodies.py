"""
Checks whether the inertial parameters of several links are wrong.

All links are fitted to one half of the recording, close to those of the model. If they predict the
other half far better than the explanation that has been found, no simpler cause is credible.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Booleans, Floats, Integers
from .joint_samples import ACCELERATION, DIRECTION, MODEL, ONE, SPEED
from .regression_data import RegressionData, RobotFit

MOST_SAMPLES = 800  # of the recording that are used
BLOCKS = 10  # contiguous parts; fitted to those with an even number, tested with the others
WRONG = 0.3  # standard deviation of masses, relative to those of the model
SIZE = 0.2  # [m], of centres of mass and radii of gyration
LIGHTEST = 0.1  # [kg]; lighter bodies are not more accurate
UNEXPLAINED = 0.01  # fraction of the squares; with less, the links are accurate enough
BETTER = 0.35  # fraction of the unexplained squares that the links leave at most, for one cause


VARIANTS = (
    ('is_scaled', 'has_rotor', 'has_offset'),
    ('is_scaled', 'has_offset'),
    ('is_scaled',),
)
"""Sensor faults that wrong links may replace, the most first; rotors are often real."""


class Bodies(NamedTuple):
    """Residuals before and after fitting all links, in the half that was not used."""

    robot_fit: RobotFit
    """The explanation without the parts that wrong links replace."""
    before: Floats
    """RMS of each joint, shape (n,) [N m or N]."""
    after: Floats
    """RMS of each joint, shape (n,) [N m or N]."""


def wrong_bodies(
    data: RegressionData,
    robot_fit: RobotFit,
    dynamics: InverseDynamics,
    states: tuple[Floats, Floats, Floats],
    rows: list[Booleans],
    index: list[int],
) -> Bodies | None:
    """
    Return the residuals with fitted links, if these explain far more than the explanation.

    Parameters
    ----------
    data, robot_fit
        Samples of n joints, and their explanation.
    dynamics : InverseDynamics
        The model.
    states : tuple of q, qd, qdd
        Of the whole robot at the K times of the samples, each of shape (K, N).
    rows : list of ndarray, each of shape (K,)
        Times that the samples of each joint contain.
    index : list of int
        Index of each joint in the model.

    Returns
    -------
    bodies : Bodies or None

    """
    in_order = robot_fit.source == tuple(range(len(index)))
    plain = data.friction_only()
    if (
        data.is_too_short
        or not in_order
        or robot_fit.unit != 1.0
        or not (data.has_gravity and robot_fit.candidate.has_gravity)
        or data.unexplained(plain) < UNEXPLAINED
        or not any(samples.moves for samples in data.joints)
    ):
        return None
    every = max(1, len(states[0]) // MOST_SAMPLES)
    chosen: Integers = np.arange(0, len(states[0]), every)
    regressor = dynamics.regressor(*(np.ascontiguousarray(x[chosen]) for x in states))
    tried: list[RobotFit] = []
    for replaced in VARIANTS:
        base = robot_fit._replace(candidate=data.nominal)
        for flag in replaced:
            base = data.refit(base, without=flag)
        if tried and [x.sensor_fault for x in base.fits] == [
            x.sensor_fault for x in tried[-1].fits
        ]:
            continue
        tried.append(base)
        after = _unseen(data, base, dynamics, regressor, rows, index, chosen)
        left = tuple(
            fit._replace(remaining=fit.remaining * float(x / max(fit.rms, 1e-12)) ** 2)
            for fit, x in zip(base.fits, after, strict=True)
        )
        unexplained = data.unexplained(base._replace(fits=left))
        limit = 1.0 if _has_several_causes(robot_fit) else BETTER
        if unexplained < limit * data.unexplained(robot_fit):
            return Bodies(base, np.array([fit.rms for fit in base.fits]), after)
    return None


def _has_several_causes(robot_fit: RobotFit) -> bool:
    """Return whether an explanation combines a load or a mounting with faults of joints."""
    flags = [fit.sensor_fault.is_scaled or fit.sensor_fault.has_offset for fit in robot_fit.fits]
    return robot_fit.candidate.kind is not None and any(flags)


def _unseen(
    data: RegressionData,
    robot_fit: RobotFit,
    dynamics: InverseDynamics,
    regressor: Floats,
    rows: list[Booleans],
    index: list[int],
    chosen: Integers,
) -> Floats:
    """Return the RMS residual of each joint in the half that the links were not fitted to."""
    block = chosen * BLOCKS // len(rows[0])
    halves = [
        _rows(data, robot_fit, regressor, rows, index, chosen, block % 2 == half)
        for half in (0, 1)
    ]
    prior = _prior(dynamics, halves[0].matrix.shape[1])
    residuals = []
    for fitted, tested in (halves, halves[::-1]):
        matrix = np.vstack([fitted.matrix, prior])
        target = np.append(fitted.target, np.zeros(len(prior)))
        change = np.linalg.lstsq(matrix, target, rcond=1e-12)[0]
        residuals.append((tested.target - tested.matrix @ change) * tested.scale)
    joints = np.concatenate([half.joint for half in halves[::-1]])
    squares = np.concatenate(residuals) ** 2
    found: Floats = np.array([fit.rms for fit in robot_fit.fits])
    for j in np.unique(joints):
        found[j] = math.sqrt(float(np.mean(squares[joints == j])))
    return found


class _Rows(NamedTuple):
    """Weighted rows of a linear regression."""

    matrix: Floats
    target: Floats
    joint: Integers
    """Joint of each row."""
    scale: Floats
    """Effort by which each row was divided."""


def _rows(
    data: RegressionData,
    robot_fit: RobotFit,
    regressor: Floats,
    rows: list[Booleans],
    index: list[int],
    chosen: Integers,
    half: Booleans,
) -> _Rows:
    matrices, targets, joints, scales = [], [], [], []
    moving = [j for j, samples in enumerate(data.joints) if samples.moves]
    width = regressor.shape[2]
    for position, j in enumerate(moving):
        samples, fit = data.joints[j], robot_fit.fits[j]
        used = rows[j][chosen] & half
        own = np.cumsum(rows[j])[chosen[used]] - 1  # rows of the samples
        columns = samples.columns[own]
        matrix = np.zeros((len(own), width + 4 * len(moving)))
        matrix[:, :width] = regressor[used, index[j]]
        at = width + 4 * position
        matrix[:, at : at + 2] = columns[:, [SPEED, DIRECTION]]
        matrix[:, at + 2] = columns[:, ACCELERATION] * fit.sensor_fault.has_rotor
        matrix[:, at + 3] = columns[:, ONE] * fit.sensor_fault.has_offset
        target = fit.sensor_fault.sign * columns[:, data.first_measured + j] - columns[:, MODEL]
        square = float(samples.squares[data.first_measured + j])
        left = fit.remaining + samples.floor(data.first_measured + j)
        scale = math.sqrt(left * square)
        # Samples within a smoothing window are not independent.
        scale *= math.sqrt(max(len(chosen) / data.sample_count, 1.0))
        matrices.append(matrix / scale)
        targets.append(target / scale)
        joints.append(np.full(len(own), j))
        scales.append(np.full(len(own), scale))
    return _Rows(
        np.vstack(matrices),
        np.concatenate(targets),
        np.concatenate(joints),
        np.concatenate(scales),
    )


def _prior(dynamics: InverseDynamics, width: int) -> Floats:
    """Return rows that keep the links near those of the model."""
    masses = np.maximum(dynamics.inertial_parameters()[::10], LIGHTEST)
    size = np.array([1.0, *3 * [SIZE], *6 * [SIZE**2]])
    deviation = WRONG * (masses[:, None] * size).reshape(-1)
    rows: Floats = np.zeros((len(deviation), width))
    rows[:, : len(deviation)] = np.diag(1.0 / deviation)
    return rows
