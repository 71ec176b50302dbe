"""Finds a base that tilts: a direction of gravity that changes over time."""

from __future__ import annotations

import math

import numpy as np

from ...robot.model import Booleans, Floats, RobotModel
from ..columns import gravity_columns
from .fault import FaultKind
from .fault_interval import FaultInterval, span
from .joint_samples import ACCELERATION, DIRECTION, GRAVITY, MODEL, NO_FAULT, ONE, SPEED, WEIGHT
from .regression_data import RegressionData

KNOT_DISTANCE = 0.75  # [s] between the times at which a changing gravity is fitted
MOST_KNOTS = 40
MOST_ROWS = 800  # samples of a joint that are used for a changing gravity
GRAVITY_RANGE = 5.0  # [m/s^2], standard deviation of gravity at a knot
GRAVITY_STEP = 2.0  # [m/s^2], standard deviation of its change between knots
STRENGTH = 0.25  # largest relative change of the strength of gravity
MIN_TILT = math.radians(3.0)


def find_tilt(data: RegressionData, most_left: float) -> FaultInterval | None:
    """Fit gravity at several times of the recording, and friction for all of it."""
    strength = float(np.linalg.norm(data.gravity))
    moving = [j for j, samples in enumerate(data.joints) if samples.moves]
    if strength == 0.0 or not moving:
        return None
    begin, end = span(data)
    count = int(min(MOST_KNOTS, max(4, round((end - begin) / KNOT_DISTANCE))))
    knots: Floats = np.linspace(begin, end, count)
    gravity, left = _fit_gravity(data, moving, knots)
    if left > most_left:
        return None
    angles = np.arccos(
        np.clip(gravity @ data.gravity / (np.linalg.norm(gravity, axis=1) * strength), -1, 1)
    )
    lengths = np.linalg.norm(gravity, axis=1)
    mean = gravity.mean(axis=0) / np.linalg.norm(gravity.mean(axis=0))
    turns = np.arccos(np.clip(gravity @ mean / np.linalg.norm(gravity, axis=1), -1, 1))
    if (
        min(angles.max(), 2.0 * turns.max()) < MIN_TILT
        or np.abs(lengths / strength - 1.0).max() > 0.25
    ):
        return None
    tilted: Booleans = angles > max(MIN_TILT, 0.2 * float(angles.max()))
    at = np.flatnonzero(tilted)
    # Between two knots, gravity changes linearly.
    interval = float(knots[max(at[0] - 1, 0)]), float(knots[min(at[-1] + 1, count - 1)])
    if at[0] == 0:
        interval = float(knots[0]), interval[1]
    robot_fit = data.friction_only()
    return FaultInterval(
        FaultKind.MOUNTING, interval, robot_fit, data, knots=knots, gravity=gravity
    )


def _fit_gravity(data: RegressionData, moving: list[int], knots: Floats) -> tuple[Floats, float]:
    """Return gravity at the knots, and the unexplained fraction of the squares."""
    count = len(knots)
    matrices, targets, weights, squares = [], [], [], []
    for position, j in enumerate(moving):
        samples = data.joints[j]
        every = max(1, len(samples.times) // MOST_ROWS)
        columns, times = samples.columns[::every], samples.times[::every]
        hats = np.stack([np.interp(times, knots, row) for row in np.eye(count)], axis=1)
        matrix = np.zeros((len(times), 3 * count + 4 * len(moving)))
        matrix[:, : 3 * count] = np.einsum(
            'tk,tx->tkx', hats, columns[:, WEIGHT : WEIGHT + 3]
        ).reshape(len(times), -1)
        own = 3 * count + 4 * position
        matrix[:, own : own + 4] = columns[:, [SPEED, DIRECTION, ACCELERATION, ONE]]
        measured = columns[:, data.first_measured + j]
        # The model contains its own gravity, which is replaced.
        target = measured - columns[:, MODEL] + columns[:, GRAVITY]
        target = target - columns[:, WEIGHT : WEIGHT + 3] @ data.gravity
        floor = samples.floor(data.first_measured + j) * float(np.mean(measured**2))
        fit = samples.fit(data.nominal.weights, data.first_measured + j, NO_FAULT)
        matrices.append(matrix)
        targets.append(target)
        weights.append(fit.remaining * float(np.mean(measured**2)) + floor)
        squares.append(float(np.mean(measured**2)))
    prior = np.zeros((6 * count - 3, matrices[0].shape[1]))
    prior[: 3 * count, : 3 * count] = np.eye(3 * count) / GRAVITY_RANGE
    steps = np.eye(3 * count)[3:] - np.eye(3 * count)[:-3]
    prior[3 * count :, : 3 * count] = steps / GRAVITY_STEP
    change, remaining = np.zeros(prior.shape[1]), np.array(squares)
    for _ in range(2):
        rows = [matrix / math.sqrt(w) for matrix, w in zip(matrices, weights, strict=True)]
        right = [target / math.sqrt(w) for target, w in zip(targets, weights, strict=True)]
        change = np.linalg.lstsq(
            np.vstack([*rows, prior]), np.concatenate([*right, np.zeros(len(prior))]), rcond=1e-10
        )[0]
        remaining = np.array(
            [np.mean((t - m @ change) ** 2) for t, m in zip(targets, matrices, strict=True)]
        )
        weights = [
            float(left + data.joints[j].floor(data.first_measured + j) * square)
            for left, j, square in zip(remaining, moving, squares, strict=True)
        ]
    gravity: Floats = data.gravity + change[: 3 * count].reshape(count, 3)
    kinds = np.array([data.joints[j].is_prismatic for j in moving])
    fractions = [
        np.sum(remaining[kinds == kind]) / np.sum(np.array(squares)[kinds == kind])
        for kind in np.unique(kinds)
    ]
    return gravity, float(np.mean(fractions))


def changing_gravity_efforts(
    fault: FaultInterval, robot: RobotModel, q: Floats, times: Floats
) -> Floats:
    """
    Return the efforts of a gravity that changes over time.

    Parameters
    ----------
    fault : FaultInterval
        A base that tilts, with gravity at k knots.
    robot : RobotModel
        Robot with n joints.
    q : ndarray, shape (K, n)
        Joint positions [rad or m].
    times : ndarray, shape (K,)
        [s].

    Returns
    -------
    efforts : ndarray, shape (K, n)
        Interpolated linearly between the knots [N m or N].

    """
    if fault.knots is None or fault.gravity is None:
        return np.zeros_like(q)
    knots, gravity = fault.knots, fault.gravity
    at_times = np.stack([np.interp(times, knots, component) for component in gravity.T], axis=-1)
    return np.asarray(np.einsum('knx,kx->kn', gravity_columns(robot, q), at_times))
