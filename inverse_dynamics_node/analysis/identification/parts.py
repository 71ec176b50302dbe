"""
Finds causes that act during a part of a recording only: a load, a push, a base that tilts.

Friction, rotors and offsets are fitted to the rest of the recording, in which the model is right.
Whatever is left inside the part is explained by a payload, or else by an external force. A base
that tilts is found by a direction of gravity that changes over time.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np

from ...robot.model import Floats, Integers
from .evidence import Evidence
from .explanation import Explanation
from .joint_samples import (
    ACCELERATION,
    DIRECTION,
    LOADS,
    MODEL,
    ONE,
    SPEED,
)
from .part import Cause, Part, span
from .tilt import find_tilt

SEGMENTS = 40  # of a recording, whose edges are possible limits of a part
LONGEST = 0.9  # fraction of the recording; the rest shows the friction
EXPLAINED_OUTSIDE = 0.1  # largest unexplained fraction of the squares outside of the part
REFINEMENTS = 3  # of the begin and end of a load
LONGEST_FORCE = 0.5  # fraction of the recording
LOUDER = 9.0  # ratio of the mean squares inside and outside, from which on there is a part
MUCH_LOUDER = 25.0  # the same for an external force, which may have any course over time
IMPROVES = 0.3  # fraction of the unexplained squares that a cause must leave at most
NOT_EXPLAINED = 9.0  # times the floor; a joint with less is explained, and no part is searched
NOT_EXPLAINED_BY_HYPOTHESIS = 1.5  # the same if the model has been changed already
AS_GOOD = 0.002  # unexplained fraction of the squares that a tilt may leave in any case
MIN_DURATION = 6.0  # [s] of a recording whose parts are considered


def find_part(evidence: Evidence, explanation: Explanation) -> Part | None:
    """
    Return the part of a recording to which a cause is limited, if there is one.

    Parameters
    ----------
    evidence : Evidence
        Samples of the whole recording.
    explanation : Explanation
        The best explanation of the whole recording.

    Returns
    -------
    part : Part or None
        None if a part does not explain far more than the explanation of all samples.

    """
    if evidence.duration < MIN_DURATION or not _is_open(evidence, explanation):
        return None
    unexplained = evidence.unexplained(explanation)
    part = _interval(evidence, explanation)
    if part is not None and part.cause is Cause.LOAD:
        return part
    left_by_force = 0.0 if part is None else part.evidence.unexplained(part.outside)
    tilt = find_tilt(evidence, min(IMPROVES * unexplained, max(2.0 * left_by_force, AS_GOOD)))
    return tilt or part


def _is_open(evidence: Evidence, explanation: Explanation) -> bool:
    """Return whether a joint that moves is not explained."""
    # A load or a mounting that holds for a part only leaves less than nothing does.
    is_as_is = explanation.hypothesis.kind == 'as_is'
    floors = NOT_EXPLAINED if is_as_is else NOT_EXPLAINED_BY_HYPOTHESIS
    return any(
        samples.moves and fit.remaining > floors * samples.floor(evidence.first_measured + source)
        for samples, fit, source in zip(
            evidence.joints, explanation.fits, explanation.source, strict=True
        )
    )


# ---- A load or a push ----------------------------------------------------------------------


def _interval(evidence: Evidence, explanation: Explanation) -> Part | None:
    begin, end = span(evidence)
    edges = np.linspace(begin, end, SEGMENTS + 1)
    first, last = _pairs()
    cost = np.zeros(len(first))
    left, total = np.zeros(len(first)), 0.0
    loudest = np.zeros(len(first))
    for j, samples in enumerate(evidence.joints):
        if not samples.moves:
            continue
        inside, outside, counts = _mean_squares(evidence, j, edges, first, last)
        square = float(samples.squares[evidence.first_measured + j])
        floor = samples.floor(evidence.first_measured + j) * square
        fraction = counts / len(samples.times)
        cost += fraction * np.log(inside + floor) + (1.0 - fraction) * np.log(outside + floor)
        left += outside
        total += square
        loudest = np.maximum(loudest, inside / (outside + floor))
    possible = (left < EXPLAINED_OUTSIDE * total) & (loudest > LOUDER)
    if not total or not possible.any():
        return None
    loudest_part = np.flatnonzero(possible)[np.argmin(cost[possible])]
    # A part that lasts longer than the rest is not the louder one, but the rest is explained.
    explained = left < 2.0 * float(left.min()) + AS_GOOD * total
    shortest = np.flatnonzero(explained)[np.argmin((last - first)[explained])]
    intervals = [(float(edges[first[k]]), float(edges[last[k]])) for k in (loudest_part, shortest)]
    loads = [_load(evidence, interval, explanation) for interval in intervals]
    found = [part for part in loads if part is not None]
    if found:
        return min(found, key=lambda part: part.evidence.unexplained(part.outside))
    forces = (_force(evidence, interval, explanation) for interval in intervals)
    return next((part for part in forces if part is not None), None)


def _pairs() -> tuple[Integers, Integers]:
    """Return the first and last edges of all possible parts."""
    first, last = np.triu_indices(SEGMENTS + 1, 1)
    chosen = last - first <= LONGEST * SEGMENTS
    return first[chosen], last[chosen]


def _features(evidence: Evidence, j: int) -> Floats:
    """Return the columns of friction, rotor and offset, and the effort that the model leaves."""
    columns = evidence.joints[j].columns
    target = columns[:, evidence.first_measured + j] - columns[:, MODEL]
    return np.column_stack([columns[:, [SPEED, DIRECTION, ACCELERATION, ONE]], target])


def _mean_squares(
    evidence: Evidence, j: int, edges: Floats, first: Integers, last: Integers
) -> tuple[Floats, Floats, Floats]:
    """Return mean squares inside and outside of all parts, and the number of samples inside."""
    features = _features(evidence, j)
    scale = np.maximum(np.linalg.norm(features, axis=0), 1e-300)
    features = features / scale
    rows = np.searchsorted(evidence.joints[j].times, edges)
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
    evidence: Evidence, interval: tuple[float, float], explanation: Explanation
) -> Part | None:
    """Return a part during which a load is carried; None if none explains it."""
    best: Part | None = None
    for _ in range(REFINEMENTS):
        loaded = with_loads_inside(evidence, interval)
        plain = loaded.friction_only()
        loads = [load for k in range(len(loaded.links)) for load in loaded.loads(k, plain)]
        if not loads:
            return None
        load = min(loads, key=loaded.unexplained)
        best = Part(Cause.LOAD, interval, load, loaded)
        interval = _refined(evidence, best)
    assert best is not None
    left = best.evidence.unexplained(best.outside)
    return best if left < IMPROVES * evidence.unexplained(explanation) else None


def _refined(evidence: Evidence, part: Part) -> tuple[float, float]:
    """Return the interval in which a load explains more than no load."""
    times = np.unique(np.concatenate([samples.times for samples in evidence.joints]))
    gain = np.zeros(len(times))
    weights = part.outside.hypothesis.weights
    for j, (samples, fit) in enumerate(zip(evidence.joints, part.outside.fits, strict=True)):
        if not samples.moves:
            continue
        columns = samples.columns
        left = columns[:, evidence.first_measured + j] - columns[:, MODEL]
        left = left - fit.damping * columns[:, SPEED] - fit.coulomb * columns[:, DIRECTION]
        load = columns[:, LOADS : evidence.first_measured] @ weights[LOADS:]
        change = (left**2 - (left - load) ** 2) / max(fit.rms**2, 1e-12)
        gain[np.searchsorted(times, samples.times)] += change
    return best_interval(times, gain, part.interval)


def _force(
    evidence: Evidence, interval: tuple[float, float], explanation: Explanation
) -> Part | None:
    """Return a part during which an external force acts; None if there is no clear push."""
    unexplained = evidence.unexplained(explanation)
    outside = evidence.restricted(interval, is_inside=False)
    if outside.is_too_short or interval[1] - interval[0] > LONGEST_FORCE * evidence.duration:
        return None
    # The model with friction, or else with the rotors and offsets of the whole recording.
    found = outside.friction_only()
    if outside.unexplained(found) > IMPROVES * unexplained:
        is_unit = explanation.is_scaled or any(
            fit.distortion.is_swapped for fit in explanation.fits
        )
        if explanation.hypothesis.kind != 'as_is' or is_unit:
            return None
        found = outside.refit(explanation)
        if outside.unexplained(found) > IMPROVES * unexplained:
            return None
    inside = without_friction(evidence, found).restricted(interval, is_inside=True)
    joints = tuple(
        j
        for j, fit in enumerate(inside.friction_only().fits)
        if fit.rms > math.sqrt(MUCH_LOUDER) * max(found.fits[j].rms, 1e-12)
        and evidence.joints[j].moves
    )
    return Part(Cause.FORCE, interval, found, outside, joints) if joints else None


def with_loads_inside(evidence: Evidence, interval: tuple[float, float]) -> Evidence:
    """Return samples in which loads act inside of an interval only."""
    joints = []
    for samples in evidence.joints:
        columns = samples.columns.copy()
        is_outside = (samples.times < interval[0]) | (samples.times > interval[1])
        columns[is_outside, LOADS : evidence.first_measured] = 0.0
        joints.append(replace(samples, columns=columns))
    return evidence.with_joints(joints, evidence.duration)


def without_friction(evidence: Evidence, explanation: Explanation) -> Evidence:
    """Return samples whose efforts do not contain the friction of an explanation."""
    joints = []
    for j, (samples, fit) in enumerate(zip(evidence.joints, explanation.fits, strict=True)):
        columns = samples.columns.copy()
        source = evidence.first_measured + explanation.source[j]
        effort = fit.distortion.sign / explanation.factor(j) * samples.columns[:, source]
        effort -= fit.damping * columns[:, SPEED] + fit.coulomb * columns[:, DIRECTION]
        effort -= fit.rotor * columns[:, ACCELERATION] + fit.offset
        columns[:, evidence.first_measured + j] = effort
        joints.append(replace(samples, columns=columns, moves=False))
    return evidence.with_joints(joints, evidence.duration)


def best_interval(times: Floats, gain: Floats, start: tuple[float, float]) -> tuple[float, float]:
    """
    Return the interval with the largest sum.

    Parameters
    ----------
    times : ndarray, shape (K,)
        [s].
    gain : ndarray, shape (K,)
        How much better each sample is explained inside of the interval than outside.
    start : tuple of float
        Result if no sample has a gain.

    Returns
    -------
    begin, end : float
        [s].

    """
    sums = np.concatenate([[0.0], np.cumsum(gain)])
    lowest = np.minimum.accumulate(sums[:-1])
    end = int(np.argmax(sums[1:] - lowest))
    begin = int(np.argmin(sums[: end + 1]))
    if sums[end + 1] <= sums[begin]:
        return start
    return float(times[begin]), float(times[end])
