"""
Finds faults by the evidence of regressions.

The search adds the fault that raises the evidence most, until no fault raises it enough.
"""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np

from ...robot.model import Floats, Integers
from .fault import is_usual
from .regression import (
    CERTAIN,
    CLIP,
    Fit,
    FLOOR,
    Hypothesis,
    LOAD_SPREAD,
    NEEDED,
    Regression,
    SEGMENTS,
)
from .rows import NEGLIGIBLE, OF_MODEL, OWN, POINT_MASS, Rows, SPREAD, Window

FIRST = 0.5  # missing gravity comes first if it adds this fraction of the evidence
MOST_FAULTS = 8
COMMON = 0.08  # smallest deviation of a common factor from 1
MOST_PUSHED = 0.5  # largest fraction of a recording in which an external force acts
MOST_OF_ALL = 0.9  # largest fraction of a recording in which a temporary fault acts
EDGE = 0.02  # windows within this fraction of an end of the recording reach this end
MOST_PAIRS = 10  # joints; in longer chains, only neighbours are exchanged


class Search(Regression):
    """
    The search for faults in rows.

    A *brief* search is for a few seconds of filtered samples, in which a delay, wrong bodies and
    temporary faults look like friction.
    """

    def __init__(self, rows: Rows, can_be_late: bool = True, is_brief: bool = False) -> None:
        super().__init__(rows, is_brief)
        self.can_be_late = can_be_late

    def best(self, start: Fit) -> Fit:
        """Return the best hypothesis that the search finds, beginning with `without_faults`."""
        best = start
        for _ in range(MOST_FAULTS):
            trials = []
            for h, cost in self._candidates(best):
                fit = self.fit(h)
                trials.append((fit.evidence - cost if fit.is_credible else -math.inf, fit))
            gain, found = max(trials, key=lambda trial: trial[0])
            # Without gravity, many other faults seem to explain a part.
            first = [trial for trial in trials if trial[1].hypothesis.other_gravity]
            other, without = max(first, key=lambda trial: trial[0], default=(gain, found))
            is_sensor = found.hypothesis.sensors != best.hypothesis.sensors
            if not is_sensor and other - best.evidence > FIRST * (gain - best.evidence):
                gain, found = other, without
            if gain < best.evidence + NEEDED:
                break
            best = self._pruned(self.trusting(found))
        return best

    def without_faults(self) -> Fit:
        """Return the fit of bodies, friction, rotors and offsets alone."""
        return self.trusting(self.fit(Hypothesis()))

    def shows_sign(self, fit: Fit, j: int) -> bool:
        """Return whether another sign of the effort of a joint would be noticed."""
        factors = (*fit.hypothesis.factors, (j, -1.0))
        other = self.fit(fit.hypothesis._replace(factors=factors))
        return other.evidence < fit.evidence - NEEDED

    def _pruned(self, best: Fit) -> Fit:
        """Remove faults that others have made needless."""
        while True:
            trials = [self.fit(h) for h in best.hypothesis.without_one()]
            found = max(trials, key=lambda fit: fit.evidence)
            if len(trials) < 2 or found.evidence < best.evidence - NEEDED:
                return best
            best = self.trusting(found)

    def _candidates(self, best: Fit) -> Iterator[tuple[Hypothesis, float]]:
        """Yield the hypotheses with one more fault, each with its cost in log evidence."""
        h, n = best.hypothesis, self.rows.count
        factors = dict(h.factors)
        has_gravity = self._has_gravity(h)
        if not h.other_gravity and self.rows.dynamics.gravity.any():
            yield h._replace(other_gravity=OWN), 2.0
            yield h._replace(other_gravity=OF_MODEL), 2.0
        if not h.load and h.window is None:
            for link in self.rows.links:
                yield h._replace(load=link), 8.0 if self.is_brief else 12.0
        if not h.is_tilted and h.window is None and has_gravity:
            yield h._replace(is_tilted=True), 4.0
        if not h.is_late and self.can_be_late and not self.is_brief:
            yield h._replace(is_late=True), 4.0
        if not h.has_wrong_bodies and not self.is_brief:
            yield h._replace(has_wrong_bodies=True), 0.0
        if not h.has_offsets and self.rows.signals.moves.any():
            yield h._replace(has_offsets=True), 4.0
        slopes, precision = self._slopes(best)
        ratios = slopes / h.unit
        free = [j for j in range(n) if j not in factors and j not in h.axes]
        for j in free:
            yield h._replace(factors=(*h.factors, (j, -1.0))), 8.0
            if not self.rows.signals.moves[j]:
                continue
            yield h._replace(axes=(*h.axes, j)), 16.0
            if precision[j] > CERTAIN**2 and not is_usual(abs(ratios[j])):
                yield h._replace(factors=(*h.factors, (j, float(ratios[j])))), 12.0
        yield from self._of_all(h, slopes, free)
        if not h.source and n > 1:
            moves = self.rows.signals.moves
            yield from self._orders(best, [j for j in free if moves[j] or self.is_brief])
        if h.window is None and not self.is_brief:
            yield from ((h._replace(window=window), 12.0) for window in self._windows(best))

    def _has_gravity(self, h: Hypothesis) -> bool:
        """Return whether the measured efforts contain gravity."""
        is_measured = self.rows.convention.in_measured != bool(h.other_gravity)
        return is_measured and bool(self.rows.dynamics.gravity.any())

    def _of_all(
        self, h: Hypothesis, slopes: Floats, free: list[int]
    ) -> Iterator[tuple[Hypothesis, float]]:
        """Yield the hypotheses with other units of all joints."""
        if h.unit > 0.0:
            yield h._replace(unit=-h.unit), 8.0
        known = [j for j in free if slopes[j] != 0.0]
        if not known or abs(h.unit) != 1.0:
            return
        sizes = np.log(np.abs(slopes[known]))
        middle = float(np.exp(np.median(sizes)))
        if abs(middle - 1.0) > COMMON and not (self.is_brief and is_usual(middle)):
            yield h._replace(unit=h.unit * middle), 12.0 if is_usual(middle) else 8.0
        odd = [j for j in known if not is_usual(abs(slopes[j]) / middle)]
        if len(odd) > 1:
            moving = [j for j in known if self.rows.signals.moves[j]]
            others = tuple((j, float(slopes[j] / h.unit)) for j in moving)
            yield h._replace(factors=(*h.factors, *others)), 6.0 * len(others)

    def _orders(self, best: Fit, free: list[int]) -> Iterator[tuple[Hypothesis, float]]:
        """Yield the hypotheses with efforts under the names of other joints."""
        from scipy.optimize import linear_sum_assignment

        h, n = best.hypothesis, self.rows.count
        for a in free:
            for b in free:
                if a < b and (b == a + 1 or n <= MOST_PAIRS):
                    source = list(range(n))
                    source[a], source[b] = b, a
                    yield h._replace(source=tuple(source)), 12.0
        costs = np.array([[self._misfit(best, j, i) for i in range(n)] for j in range(n)])
        source = linear_sum_assignment(costs)[1]
        moved = int(np.count_nonzero(source != np.arange(n)))
        if moved > 2:
            yield h._replace(source=tuple(source.tolist())), 6.0 * moved

    def _own(self, best: Fit) -> tuple[Floats, Floats]:
        """Return the products of the columns of each joint, and the places of model and drive."""
        at = best.columns.at
        places = np.append(at.model, at.drive)
        return best.columns.product(self.weights(best.hypothesis.window)[0]), places

    def _slopes(self, best: Fit) -> tuple[Floats, Floats]:
        """
        Return the ratio of measured to modelled effort of each joint, and its precision.

        Both have the shape (c,). They are zero for joints without modelled effort.
        """
        G, places = self._own(best)
        h, n = best.hypothesis, self.rows.count
        source, factor = h.order(n), h.factor(n) / h.unit
        largest = float(np.max(G[:, places[0], places[0]]))
        slopes, precision = np.zeros((2, n))
        for j in range(n):
            # At rest, the offset is dry friction, which looks like the model.
            own = places if self.rows.signals.moves[j] else places[:1]
            A, b = G[j][np.ix_(own, own)], G[j][own, source[j]]
            if A[0, 0] < NEGLIGIBLE**2 * largest:
                continue
            size = np.sqrt(np.diagonal(A)) + 1e-12
            inverse = np.linalg.inv(A / size / size[:, None] + np.eye(len(own)) * 1e-6)
            x = inverse @ (b / size) / size
            left = G[j][source[j], source[j]] - b @ x
            counts = max(float(self.per_row[:, j].sum()), 1.0)
            slopes[j] = x[0] / factor[j] * (-1.0 if j in h.axes else 1.0)
            error = inverse[0, 0] / size[0] ** 2 * max(left, 0.0) / counts / factor[j] ** 2
            precision[j] = slopes[j] ** 2 / (error + (SPREAD * slopes[j]) ** 2 + 1e-300)
        return slopes, precision

    def shows_scale(self, fit: Fit) -> list[bool]:
        """Return for each joint whether the model, and not only friction, shows in its effort."""
        return [float(each) > CERTAIN**2 for each in self._slopes(fit)[1]]

    def _misfit(self, best: Fit, j: int, i: int) -> float:
        """Return the log residual of the model of joint j for the effort recorded for i."""
        G, places = self._own(best)
        drive = places[1:]
        target = np.zeros(G.shape[1])
        target[i] = 1.0 / best.hypothesis.unit
        target[places[0]] = -1.0
        A, b = G[j][np.ix_(drive, drive)], G[j][drive] @ target
        x = np.linalg.solve(A + 1e-6 * np.trace(A) * np.eye(len(drive)), b)
        target[drive] -= x
        squares = float(target @ G[j] @ target)
        return math.log(max(squares, 0.0) + FLOOR**2 * float(G[j][i, i]) + 1e-12)

    # ---- Windows -------------------------------------------------------------------------

    def _windows(self, best: Fit) -> Iterator[Window]:
        """Yield windows in which a load, a tilt or a push explains more than the best fit."""
        s = self.rows.signals
        # At rest, a push looks like a load, and is more likely.
        for link in self.rows.links if s.moves.any() else ():
            if not best.hypothesis.load:
                places = best.columns.at.loads[link][:POINT_MASS]
                yield from self._refined(best, 'load', link, places, LOAD_SPREAD)
        can_tilt = self._has_gravity(best.hypothesis) and s.moves.any()
        if not best.hypothesis.is_tilted and can_tilt:
            size = float(np.linalg.norm(self.rows.dynamics.gravity))
            yield from self._refined(best, 'tilt', '', best.columns.at.tilt, np.full(3, size))
        ratio = best.residual**2 / best.variance
        gain = 0.5 * self.per_row * (np.minimum(ratio, CLIP) * (1.0 - 1.0 / CLIP) - math.log(CLIP))
        duration = s.times[-1] - s.times[0]
        span = best_span(gain.sum(axis=1))
        joints = [] if span is None else np.flatnonzero(gain[span].sum(axis=0) > 0.0).tolist()
        span = best_span(gain[:, joints].sum(axis=1)) if joints else None
        if span is not None and np.ptp(s.times[span]) < MOST_PUSHED * duration:
            yield Window('push', *_ends(s.times, span), '', tuple(joints))

    def _refined(
        self, best: Fit, kind: str, link: str, places: Integers, spread: Floats
    ) -> Iterator[Window]:
        """Yield the window in which columns explain the residuals, accurate to one sample."""
        times = self.rows.signals.times
        L = best.columns.matrix[:, :, places] * spread
        weights = self.per_row / best.variance
        gains = np.zeros(len(times))
        for k in range(SEGMENTS):
            inside = self.segment == k
            A, r = L[:, inside], best.residual[inside].T
            w = weights[inside].T
            M = np.einsum('csi,cs,csj->ij', A, w, A) + np.eye(len(spread))
            b = np.einsum('csi,cs,cs->i', A, w, r)
            gain = 0.5 * float(b @ np.linalg.solve(M, b)) - 0.5 * float(np.linalg.slogdet(M)[1])
            gains[inside] = gain / max(int(inside.sum()), 1)
        span = best_span(gains)
        for _ in range(3):
            if span is None or np.ptp(times[span]) > MOST_OF_ALL * np.ptp(times):
                return
            window = Window(kind, *_ends(times, span), link)
            A, w, r = L[:, span], weights[span].T, best.residual[span].T
            M = np.einsum('csi,cs,csj->ij', A, w, A) + np.eye(len(spread))
            x = np.linalg.solve(M, np.einsum('csi,cs,cs->i', A, w, r))
            left = best.residual - (L @ x).T
            gains = 0.5 * np.sum(weights * (best.residual**2 - left**2), axis=1)
            span = best_span(gains)
        if span is None:
            return
        yield window
        # A load that acts most of the time looks like wrong bodies that are right for a while.
        if span.start < EDGE * len(times):
            yield window._replace(begin=float(times[span.stop - 1]), end=float(times[-1]))
        elif span.stop > (1.0 - EDGE) * len(times):
            yield window._replace(begin=float(times[0]), end=float(times[span.start]))


def _ends(times: Floats, span: slice) -> tuple[float, float]:
    return float(times[span][0]), float(times[span][-1])


def best_span(gain: Floats) -> slice | None:
    """Return the interval with the largest sum, or None if no sum is positive."""
    total = np.concatenate([[0.0], np.cumsum(gain)])
    lowest = np.minimum.accumulate(total)
    end = int(np.argmax(total - lowest))
    if total[end] <= lowest[end]:
        return None
    begin = int(np.argmin(total[: end + 1]))
    return slice(begin, end) if end - begin > 1 else None
