"""
Finds faults that act only during an interval of a recording: a load, a push or a tilting base.

For a load or a push, the model with fitted friction, rotor inertias and offsets must explain the
efforts outside the interval. Inside the interval, a payload or an external force explains the
residual. To find a tilting base, gravity is fitted at several times, called knots.
"""

from __future__ import annotations

from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Booleans, Floats, Integers
from .fault import FaultKind
from .joint_samples import (
    ACCELERATION,
    DIRECTION,
    GRAVITY,
    LOADS,
    MODEL,
    NO_FAULT,
    ONE,
    SPEED,
    unexplained_fraction,
    WEIGHT,
)
from .regression_data import angle_between, MIN_TILT, RegressionData, RobotFit

SEGMENTS = 40  # number of equal segments; an interval starts and ends at edges of segments
LONGEST = 0.9  # longest interval, as a fraction of the recording; the rest reveals friction
EXPLAINED_OUTSIDE = 0.1  # largest unexplained fraction of the squares outside the interval
REFINEMENTS = 3  # number of refinements of the start and end of a load
LONGEST_FORCE = 0.5  # longest external force, as a fraction of the recording
LOUDER = 9.0  # smallest ratio of the mean squares inside and outside an interval
LOUDER_LOAD = 3.0  # a fitted load may leave this multiple of the squares that remain outside
MUCH_LOUDER = 25.0  # smallest ratio of the mean squares inside and outside for an external force
IMPROVES = 0.3  # a cause leaves at most this fraction of the unexplained squares
NOT_EXPLAINED = 9.0  # an interval is searched for if more than this multiple of the floor remains
NOT_EXPLAINED_BY_CANDIDATE = 1.5  # the same limit after a candidate has changed the model
AS_GOOD = 0.002  # fraction of the squares that an explanation may leave in any case
MIN_DURATION = 6.0  # [s]; no interval is searched for in shorter recordings

KNOT_DISTANCE = 0.75  # [s] between knots
MOST_KNOTS = 40
MOST_ROWS = 800  # approximate number of samples of each joint for the fit of gravity
GRAVITY_RANGE = 5.0  # [m/s^2], standard deviation of the difference from the gravity of the model
GRAVITY_STEP = 2.0  # [m/s^2], standard deviation of the change of gravity between knots
STRENGTH = 0.25  # largest relative change of the magnitude of gravity


class FaultInterval(NamedTuple):
    """A fault that acts only during an interval of a recording."""

    kind: FaultKind
    """Payload, external force or mounting."""
    interval: tuple[float, float]
    """Start and end of the interval [s]."""
    outside: RobotFit
    """Fit to the samples in ``data``."""
    data: RegressionData
    """All samples or, if the kind is an external force, only those outside the interval."""
    joints: tuple[int, ...] = ()
    """Indices of the joints on which an external force acts."""
    knots: Floats = np.zeros(0)
    """Times at which gravity was fitted, shape (k,) [s]."""
    gravity: Floats = np.zeros((0, 3))
    """Gravity in the base frame at the knots, shape (k, 3) [m/s^2]."""
    left: float = math.nan
    """Fraction of the squared efforts that the fitted gravity leaves unexplained."""


def span(data: RegressionData) -> tuple[float, float]:
    """Return the times of the first and last samples [s]."""
    times = [samples.times for samples in data.joints]
    return min(float(t[0]) for t in times), max(float(t[-1]) for t in times) + 1e-9


def find_fault_interval(data: RegressionData, robot_fit: RobotFit) -> FaultInterval | None:
    """
    Find a fault that acts only during an interval of the recording.

    Return None unless the fault explains far more of the efforts than `robot_fit` does.
    """
    # A permanent candidate explains a temporary load or tilt in part.
    is_nominal = robot_fit.candidate.kind is None
    floors = NOT_EXPLAINED if is_nominal else NOT_EXPLAINED_BY_CANDIDATE
    if data.duration < MIN_DURATION or not data.is_open(robot_fit, floors):
        return None
    unexplained = data.unexplained(robot_fit)
    fault = _interval(data, robot_fit)
    if fault is not None and fault.kind is FaultKind.PAYLOAD:
        return fault
    left_by_force = 0.0 if fault is None else fault.data.unexplained(fault.outside)
    tilt = find_tilt(data, min(IMPROVES * unexplained, max(2.0 * left_by_force, AS_GOOD)))
    return tilt or fault


# ---- A load or a push ----------------------------------------------------------------------


def _interval(data: RegressionData, robot_fit: RobotFit) -> FaultInterval | None:
    begin, end = span(data)
    edges = np.linspace(begin, end, SEGMENTS + 1)
    first, last = np.triu_indices(SEGMENTS + 1, 1)
    is_possible = last - first <= LONGEST * SEGMENTS
    first, last = first[is_possible], last[is_possible]
    cost = np.zeros(len(first))
    left, total = np.zeros(len(first)), 0.0
    loudest = np.zeros(len(first))
    for j, samples in enumerate(data.joints):
        if not samples.moves:
            continue
        inside, outside, counts = _mean_squares(data, j, edges, first, last)
        square = float(samples.squares[data.first_measured + j])
        floor = samples.floor(data.first_measured + j) * square
        fraction = counts / len(samples.times)
        cost += fraction * np.log(inside + floor) + (1.0 - fraction) * np.log(outside + floor)
        left += outside
        total += square
        loudest = np.maximum(loudest, inside / (outside + floor))
    possible = (left < EXPLAINED_OUTSIDE * total) & (loudest > LOUDER)
    if not total or not possible.any():
        return None
    loudest_part = np.flatnonzero(possible)[np.argmin(cost[possible])]
    # A cause that acts most of the time does not stand out. Therefore also try the shortest
    # interval with explained samples outside.
    explained = left < 2.0 * float(left.min()) + AS_GOOD * total
    shortest = np.flatnonzero(explained)[np.argmin((last - first)[explained])]
    intervals = [(float(edges[first[k]]), float(edges[last[k]])) for k in (loudest_part, shortest)]
    loads = [_load(data, interval, robot_fit) for interval in intervals]
    found = [fault for fault in loads if fault is not None]
    if found:
        return min(found, key=lambda fault: fault.data.unexplained(fault.outside))
    forces = (_force(data, interval, robot_fit) for interval in intervals)
    return next((fault for fault in forces if fault is not None), None)


def _mean_squares(
    data: RegressionData, j: int, edges: Floats, first: Integers, last: Integers
) -> tuple[Floats, Floats, Floats]:
    """Return mean squared residuals inside and outside each interval, and sample counts inside."""
    columns = data.joints[j].columns
    target = columns[:, data.first_measured + j] - columns[:, MODEL]
    features = np.column_stack([columns[:, [SPEED, DIRECTION, ACCELERATION, ONE]], target])
    scale = np.maximum(np.linalg.norm(features, axis=0), 1e-300)
    features = features / scale
    rows = np.searchsorted(data.joints[j].times, edges)
    products = np.array([features[a:b].T @ features[a:b] for a, b in zip(rows, rows[1:])])  # noqa: B905, RUF007
    sums = np.concatenate([np.zeros((1, *products.shape[1:])), np.cumsum(products, axis=0)])
    within = sums[last] - sums[first]
    rest = sums[-1] - within
    matrix = rest[:, :-1, :-1] + 1e-9 * np.eye(features.shape[1] - 1)
    solution = np.linalg.solve(matrix, rest[:, :-1, -1:])[:, :, 0]
    vectors = np.column_stack([-solution, np.ones(len(solution))])
    counts = (rows[last] - rows[first]).astype(np.float64)
    squares = scale[-1] ** 2

    def mean(products: Floats, count: Floats) -> Floats:
        sums = np.einsum('ki,kij,kj->k', vectors, products, vectors)
        return np.asarray(squares * np.maximum(sums, 0.0) / np.maximum(count, 1.0))

    return mean(within, counts), mean(rest, len(features) - counts), counts


def _load(
    data: RegressionData, interval: tuple[float, float], robot_fit: RobotFit
) -> FaultInterval | None:
    """Fit a temporary load and its interval, or return None if no load explains the efforts."""
    best: FaultInterval | None = None
    for _ in range(REFINEMENTS):
        loaded = with_loads_inside(data, interval)
        plain = loaded.friction_only()
        loads = [load for k in range(len(loaded.links)) for load in loaded.loads(k, plain)]
        if not loads:
            return None
        load = min(loads, key=loaded.unexplained)
        best = FaultInterval(FaultKind.PAYLOAD, interval, load, loaded)
        interval = _refined(data, best)
    assert best is not None
    left = best.data.unexplained(best.outside)
    rest = data.restricted(best.interval, is_inside=False)
    # If the cause is a push, a fitted load leaves more inside the interval than outside.
    if left > LOUDER_LOAD * rest.unexplained(rest.friction_only()) + AS_GOOD:
        return None
    return best if left < IMPROVES * data.unexplained(robot_fit) else None


def _refined(data: RegressionData, fault: FaultInterval) -> tuple[float, float]:
    """Return the interval in which the load reduces the residuals."""
    times = np.unique(np.concatenate([samples.times for samples in data.joints]))
    gain = np.zeros(len(times))
    weights = fault.outside.candidate.weights
    for j, (samples, fit) in enumerate(zip(data.joints, fault.outside.fits, strict=True)):
        if not samples.moves:
            continue
        columns = samples.columns
        left = columns[:, data.first_measured + j] - columns[:, MODEL]
        left = left - fit.friction(columns[:, SPEED], columns[:, DIRECTION])
        load = columns[:, LOADS : data.first_measured] @ weights[LOADS:]
        change = (left**2 - (left - load) ** 2) / max(fit.rms**2, 1e-12)
        gain[np.searchsorted(times, samples.times)] += change
    return best_interval(times, gain, fault.interval)


def _force(
    data: RegressionData, interval: tuple[float, float], robot_fit: RobotFit
) -> FaultInterval | None:
    """Find the joints on which an external force acts, or return None if none is evident."""
    unexplained = data.unexplained(robot_fit)
    outside = data.restricted(interval, is_inside=False)
    if outside.is_too_short or interval[1] - interval[0] > LONGEST_FORCE * data.duration:
        return None
    # Try friction alone, and then also the rotors and offsets of the whole recording.
    found = outside.friction_only()
    is_unit = robot_fit.is_scaled or any(fit.sensor_fault.is_swapped for fit in robot_fit.fits)
    if robot_fit.candidate.kind is None and not is_unit:
        others = outside.refit(robot_fit)
        if outside.unexplained(others) < IMPROVES * outside.unexplained(found):
            found = others
    if outside.unexplained(found) > IMPROVES * unexplained:
        return None
    inside = without_friction(data, found).restricted(interval, is_inside=True)
    joints = tuple(
        j
        for j, fit in enumerate(inside.friction_only().fits)
        if fit.rms > math.sqrt(MUCH_LOUDER) * max(found.fits[j].rms, 1e-12)
        and data.joints[j].moves
    )
    return (
        FaultInterval(FaultKind.EXTERNAL_FORCE, interval, found, outside, joints)
        if joints
        else None
    )


def with_loads_inside(data: RegressionData, interval: tuple[float, float]) -> RegressionData:
    """Return a copy in which the columns for loads are zero outside an interval."""
    joints = []
    for samples in data.joints:
        columns = samples.columns.copy()
        is_outside = (samples.times < interval[0]) | (samples.times > interval[1])
        columns[is_outside, LOADS : data.first_measured] = 0.0
        joints.append(replace(samples, columns=columns))
    return data.with_joints(joints, data.duration)


def without_friction(data: RegressionData, robot_fit: RobotFit) -> RegressionData:
    """Subtract the fitted friction, rotor efforts and offsets from the measured efforts."""
    joints = []
    for j, (samples, fit) in enumerate(zip(data.joints, robot_fit.fits, strict=True)):
        columns = samples.columns.copy()
        source = data.first_measured + robot_fit.source[j]
        effort = fit.sensor_fault.sign / robot_fit.factor(j) * samples.columns[:, source]
        effort -= fit.friction(columns[:, SPEED], columns[:, DIRECTION])
        effort -= fit.rotor * columns[:, ACCELERATION] + fit.offset
        columns[:, data.first_measured + j] = effort
        joints.append(replace(samples, columns=columns, moves=False))
    return data.with_joints(joints, data.duration)


def best_interval(times: Floats, gain: Floats, start: tuple[float, float]) -> tuple[float, float]:
    """
    Return the interval with the largest sum of gains, or `start` if no gain is positive.

    `times` and `gain` have the shape (K,).
    """
    sums = np.concatenate([[0.0], np.cumsum(gain)])
    lowest = np.minimum.accumulate(sums[:-1])
    end = int(np.argmax(sums[1:] - lowest))
    begin = int(np.argmin(sums[: end + 1]))
    if sums[end + 1] <= sums[begin]:
        return start
    return float(times[begin]), float(times[end])


# ---- A base that tilts ---------------------------------------------------------------------


def find_tilt(data: RegressionData, most_left: float) -> FaultInterval | None:
    """Find the interval in which the base is tilted, or return None if no tilt is evident."""
    strength = float(np.linalg.norm(data.gravity))
    moving = [j for j, samples in enumerate(data.joints) if samples.moves]
    if strength == 0.0 or not (data.has_gravity and moving):
        return None
    begin, end = span(data)
    count = int(min(MOST_KNOTS, max(4, round((end - begin) / KNOT_DISTANCE))))
    knots: Floats = np.linspace(begin, end, count)
    gravity, left = _fit_gravity(data, moving, knots)
    if left > most_left:
        return None
    angles = angle_between(gravity, data.gravity)
    turns = angle_between(gravity, gravity.mean(axis=0))
    lengths = np.linalg.norm(gravity, axis=1)
    is_small = min(angles.max(), 2.0 * turns.max()) < MIN_TILT
    if is_small or np.abs(lengths / strength - 1.0).max() > STRENGTH:
        return None
    tilted: Booleans = angles > max(MIN_TILT, 0.2 * float(angles.max()))
    at = np.flatnonzero(tilted)
    # Gravity changes linearly between knots, so the tilt extends to the neighbouring knots.
    interval = float(knots[max(at[0] - 1, 0)]), float(knots[min(at[-1] + 1, count - 1)])
    robot_fit = data.friction_only()
    return FaultInterval(
        FaultKind.MOUNTING, interval, robot_fit, data, knots=knots, gravity=gravity, left=left
    )


def _fit_gravity(data: RegressionData, moving: list[int], knots: Floats) -> tuple[Floats, float]:
    """Return gravity at the knots, and the unexplained fraction of the squared efforts."""
    count = len(knots)
    matrices, targets, remaining, floors, squares = [], [], [], [], []
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
        # Replace the gravity of the model by the columns for gravity.
        target = measured - columns[:, MODEL] + columns[:, GRAVITY]
        target = target - columns[:, WEIGHT : WEIGHT + 3] @ data.gravity
        square = float(np.mean(measured**2))
        fit = samples.fit(data.nominal.weights, data.first_measured + j, NO_FAULT)
        matrices.append(matrix)
        targets.append(target)
        remaining.append(fit.remaining * square)
        floors.append(samples.floor(data.first_measured + j) * square)
        squares.append(square)
    prior = np.zeros((6 * count - 3, matrices[0].shape[1]))
    prior[: 3 * count, : 3 * count] = np.eye(3 * count) / GRAVITY_RANGE
    steps = np.eye(3 * count)[3:] - np.eye(3 * count)[:-3]
    prior[3 * count :, : 3 * count] = steps / GRAVITY_STEP
    change = np.zeros(prior.shape[1])
    for _ in range(2):
        sizes = np.sqrt(np.add(remaining, floors))
        rows = [matrix / size for matrix, size in zip(matrices, sizes, strict=True)]
        right = [target / size for target, size in zip(targets, sizes, strict=True)]
        change = np.linalg.lstsq(
            np.vstack([*rows, prior]), np.concatenate([*right, np.zeros(len(prior))]), rcond=1e-10
        )[0]
        remaining = [
            float(np.mean((t - m @ change) ** 2)) for t, m in zip(targets, matrices, strict=True)
        ]
    gravity: Floats = data.gravity + change[: 3 * count].reshape(count, 3)
    kinds = [data.joints[j].is_prismatic for j in moving]
    return gravity, unexplained_fraction(remaining, squares, kinds)
