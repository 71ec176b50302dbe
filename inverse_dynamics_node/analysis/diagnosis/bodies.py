"""
Checks whether wrong inertial parameters of several links explain the measured efforts.

The parameters of all links are fitted near their values in the model, together with friction,
rotor inertias and a delay of the efforts. A payload, a tilted base or an offset is added only if
the fit becomes far more likely. Links that were fitted to one half of the recording predict the
efforts of the other half. A simpler explanation is rejected if its errors are far larger than
those of this prediction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Booleans, Floats, Integers
from .compared_efforts import ComparedEfforts
from .fault import FaultKind
from .intervals import FaultInterval
from .joint_samples import (
    ACCELERATION,
    DIRECTION,
    JointFit,
    LOADS,
    MIN_OFFSET,
    ONE,
    SPEED,
    WEIGHT,
)
from .loads import PARAMETERS
from .regression_data import CandidateModel, LIKE_A_LOAD, RegressionData, RobotFit

MOST_SAMPLES = 800  # approximate number of samples that the fit uses
BLOCKS = 10  # every second block of the recording belongs to the same half
SEGMENTS = 40  # segments of the recording; segments with a bad fit have less weight
ROUNDS = 4  # number of times that links and weights are fitted in turn
SPREADS = (0.1, 0.2, 0.3, 0.5)
"""Possible relative standard deviations of the masses. The most likely value is chosen."""
SIZE = 0.2  # [m], standard deviation of centres of mass and radii of gyration
LIGHTEST = 0.1  # [kg]; lighter bodies have the prior of a body with this mass
FRICTION = 10.0  # standard deviation of friction, relative to the effort of the joint
OFFSET = 0.3  # standard deviation of offsets, relative to the effort of the joint
LOUD = 4.0  # segments with more than this multiple of the median square have little weight
HEAVIEST = 10.0  # [kg], standard deviation of payloads
STRENGTH = 0.02  # relative standard deviation of the magnitude of gravity
UNEXPLAINED = 0.01  # links are accurate if less than this fraction of the squares remains
SMALL = 4e-4  # fitted links are ignored if another explanation leaves less than this fraction
BETTER = 0.35
"""
Fitted links replace another explanation if they leave less than this fraction of its squared
residuals. If fitted links make any cause in that explanation unnecessary, the fraction is 1
instead.
"""
CHANGING = 2.0  # links may leave this multiple of the squares that a tilting base leaves
NEEDED = 10.0  # smallest increase of the log evidence for an additional cause
CERTAIN = 5.0  # values above this number of standard errors are certain
ROTOR = 0.05  # rotors with less than this fraction of the RMS effort are not reported
DELAY = 0.1  # [s], standard deviation of delays


class Bodies(NamedTuple):
    """Fitted links, and their residuals in two-fold cross-validation."""

    robot_fit: RobotFit
    """Friction and other causes that act in addition to wrong links."""
    change: Floats
    """Change of the inertial parameters of b links, shape (10 b,)."""
    before: list[float]
    """RMS residual of each joint without fitted links [N m or N]."""
    after: list[float]
    """RMS residual of each joint with fitted links [N m or N]."""
    delay: float
    """Linear estimate of the delay of the measured efforts [s]."""
    delay_error: float
    """Standard error of the delay [s]."""
    unexplained: float
    """Unexplained fraction of the squared efforts, with less weight for badly fitted segments."""
    unexplained_anywhere: float
    """Unexplained fraction of the squared efforts, with the same weight for all samples."""
    are_wrong: bool
    """Whether the model and friction alone leave a fraction above `UNEXPLAINED` unexplained."""
    has_own_gravity: bool
    """Whether wrong links also cause residuals in the gravity efforts."""

    def explain_more(
        self, data: RegressionData, before: RobotFit, fault: FaultInterval | None
    ) -> bool:
        """Return whether wrong links explain far more than `fault`; None means `before`."""
        if fault is None:
            left = data.unexplained(before)
        elif fault.kind is FaultKind.MOUNTING:
            return self.confirmed(fault) is None
        else:
            left = fault.data.unexplained(fault.outside)
        if left < SMALL:
            return False
        return self.unexplained < (BETTER if self._confirms(before) else 1.0) * left

    def confirmed(self, fault: FaultInterval | None) -> FaultInterval | None:
        """Return `fault`, or None if `fault` is a tilt that wrong links also explain."""
        if fault is None or fault.kind is not FaultKind.MOUNTING:
            return fault
        return None if self.unexplained_anywhere < CHANGING * fault.left else fault

    def _confirms(self, before: RobotFit) -> bool:
        """Return whether every cause in `before` is still needed after the links are fitted."""
        candidate = before.candidate
        if candidate.has_gravity and candidate.kind not in (None, self.robot_fit.candidate.kind):
            return False
        return not any(
            is_found > is_needed
            for fit, beside in zip(before.fits, self.robot_fit.fits, strict=True)
            for is_found, is_needed in zip(fit.sensor_fault, beside.sensor_fault, strict=True)
        )


def fit_bodies(
    compared: ComparedEfforts, data: RegressionData, robot_fit: RobotFit
) -> Bodies | None:
    """
    Fit all links, or return None if the samples are not sufficient.

    `data` contains the samples of `compared`, and `robot_fit` is the explanation so far.
    """
    if data.is_too_short or data.is_at_rest:
        return None
    plain = data.friction_only()
    is_plain = (
        robot_fit.source == plain.source
        and not data.contradicts(robot_fit.candidate)
        and not robot_fit.is_scaled
        and not any(fit.sensor_fault.is_swapped for fit in robot_fit.fits)
    )
    # Also start without wrong signs, units or orders, because wrong links can look similar.
    starts = (robot_fit,) if is_plain else (plain, robot_fit)
    # A driver may compensate gravity for the real links, or for the links of the model.
    found = [
        _Problem(compared, data, start, has_own_gravity).solve()
        for start in starts
        for has_own_gravity in ((True,) if start.candidate.has_gravity else (False, True))
    ]
    return min(found, key=lambda each: each.unexplained_anywhere)


class _Problem:
    """
    A linear regression with weighted rows.

    The unknowns are gravity, payloads, the delay of the efforts, and changes of the link
    parameters. Each joint also has unknown friction, rotor inertia and offset.
    """

    def __init__(
        self,
        compared: ComparedEfforts,
        data: RegressionData,
        robot_fit: RobotFit,
        has_own_gravity: bool,
    ) -> None:
        dynamics, states = compared.dynamics, compared.fit_states
        rates = compared.rates(robot_fit)[compared.fit_samples]
        moving = [j for j, samples in enumerate(data.joints) if samples.moves]
        fits = tuple(_without_doubtful_scale(fit) for fit in robot_fit.fits)
        robot_fit = data.refit(robot_fit._replace(fits=fits))
        self.data, self.robot_fit, self.moving = data, robot_fit, moving
        self.squares = {j: data.square(robot_fit, j) for j in moving}
        every = max(1, len(states[0]) // MOST_SAMPLES)
        chosen: Integers = np.arange(0, len(states[0]), every)
        q, qd, qdd = (np.ascontiguousarray(x[chosen]) for x in states)
        self.has_gravity = robot_fit.candidate.has_gravity
        self.has_own_gravity = has_own_gravity
        regressor = dynamics.regressor(q, qd, qdd)
        if not has_own_gravity:
            regressor = regressor - dynamics.regressor(q, np.zeros_like(q), np.zeros_like(q))
        self.width = regressor.shape[2]
        self.own = self.width + 4 * np.arange(len(moving))  # first column of each joint
        self.gravity = self.width + 4 * len(moving)
        self.payloads = self.gravity + 3
        self.delay = self.payloads + 4 * len(data.links)
        base = data.other_gravity() if data.contradicts(robot_fit.candidate) else data.nominal
        self.base = base
        self.prior = self._prior(dynamics)
        loads = [LOADS + PARAMETERS * k + i for k in range(len(data.links)) for i in range(4)]
        parts, targets, joints, times = [], [], [], []
        for position, j in enumerate(moving):
            samples, fit = data.joints[j], robot_fit.fits[j]
            rows = compared.used(compared.varying[j])[compared.fit_samples]
            used = rows[chosen]
            columns = samples.columns[np.cumsum(rows)[chosen[used]] - 1]
            matrix = np.zeros((len(columns), self.delay + 1))
            matrix[:, : self.width] = regressor[used, compared.index[compared.varying[j]]]
            own = columns[:, [SPEED, DIRECTION, ACCELERATION, ONE]]
            matrix[:, self.own[position] : self.own[position] + 4] = own
            matrix[:, self.gravity : self.payloads] = columns[:, WEIGHT : WEIGHT + 3]
            matrix[:, self.payloads : self.delay] = columns[:, loads]
            matrix[:, self.delay] = -rates[chosen[used], j]
            source = columns[:, data.first_measured + robot_fit.source[j]]
            target = fit.sensor_fault.sign * source / robot_fit.factor(j)
            targets.append(target - columns[:, : data.first_measured] @ base.weights)
            parts.append(matrix)
            joints.append(np.full(len(columns), position))
            times.append(chosen[used] / len(rows))
        self.matrix, self.target = np.vstack(parts), np.concatenate(targets)
        self.joint, time = np.concatenate(joints), np.concatenate(times)
        self.segment = (time * SEGMENTS).astype(int)
        self.half = self.segment // (SEGMENTS // BLOCKS) % 2
        self.products = [self._products(k) for k in range(len(moving))]
        # Samples within a smoothing window are not independent.
        self.dependence = max(len(chosen) / data.sample_count, 1.0)

    def _products(self, position: int) -> tuple[Integers, Integers, Floats]:
        """
        Return the first row of each segment, the nonzero columns, and the Gram matrices.

        Each Gram matrix is computed only once because all samples of a segment have the same
        weight. The last column is the target.
        """
        rows = np.flatnonzero(self.joint == position)
        first = np.unique(self.segment[rows], return_index=True)[1]
        values = np.column_stack([self.matrix[rows], self.target[rows]])
        columns = np.flatnonzero(values.any(axis=0))
        products = [part.T @ part for part in np.split(values[:, columns], first[1:])]
        return rows[first], columns, np.array(products)

    def _prior(self, dynamics: InverseDynamics) -> Floats:
        """Return the inverse prior covariance of all unknowns."""
        masses = np.maximum(dynamics.robot.mass[1:], LIGHTEST)
        size = np.array([1.0, *3 * [SIZE], *6 * [SIZE**2]])
        deviation = np.full(self.delay + 1, DELAY)
        deviation[: self.width] = (masses[:, None] * size).reshape(-1)
        for position, j in enumerate(self.moving):
            columns = self.data.joints[j].squares[[SPEED, DIRECTION, ACCELERATION, ONE]]
            ratio = np.array([FRICTION, FRICTION, 1.0, OFFSET]) * math.sqrt(self.squares[j])
            own = slice(self.own[position], self.own[position] + 4)
            deviation[own] = ratio / np.sqrt(np.maximum(columns, 1e-12))
        for first in range(self.payloads, self.delay, 4):
            deviation[first : first + 4] = HEAVIEST * size[:4]
        g_0 = max(float(np.linalg.norm(self.data.gravity)), 1e-12)
        deviation[self.gravity : self.gravity + 3] = g_0
        prior: Floats = np.diag(deviation**-2.0)
        # The magnitude of gravity is known.
        known = slice(self.gravity, self.gravity + 3)
        prior[known, known] += np.outer(*2 * [self.data.gravity]) / (STRENGTH * g_0**2) ** 2
        return prior

    def solve(self) -> Bodies:
        """Fit the links, and add other causes that are needed."""
        causes = []
        if self.has_gravity:
            loads = range(self.payloads, self.delay, 4)
            causes += [slice(self.gravity, self.payloads), *(slice(k, k + 4) for k in loads)]
        used = np.ones(self.delay + 1, dtype=bool)
        used[self.gravity : self.delay] = used[self.own + 3] = False
        weights = self._weights(_with(used, *causes))
        system = self._system(weights)
        fit, candidate = self._best_fit(used, system), self.base
        least = fit.evidence + NEEDED
        for cause in causes:
            other = self._best_fit(_with(used, cause), system)
            found = self._candidate(other, cause)
            if found is not None and other.evidence > least:
                fit, candidate, least = other, found, other.evidence
        for position, j in enumerate(self.moving):
            own = int(self.own[position]) + 3
            other = self._best_fit(_with(fit.used, slice(own, own + 1)), system)
            is_large = abs(other.solution[own]) > MIN_OFFSET * math.sqrt(self.squares[j])
            if is_large and other.evidence > fit.evidence + NEEDED:
                fit = other
        return self._bodies(fit, weights, candidate)

    def _system(self, weights: Floats) -> tuple[Floats, Floats]:
        """Return the matrix and the right-hand side of the weighted normal equations."""
        size = self.delay + 2
        system = np.zeros((size, size))
        for rows, columns, products in self.products:
            system[np.ix_(columns, columns)] += np.tensordot(weights[rows], products, 1)
        return system[:-1, :-1], system[:-1, -1]

    def _best_fit(self, used: Booleans, system: tuple[Floats, Floats]) -> _Fit:
        """Fit the unknowns in the mask `used`, with the most likely value of `SPREADS`."""
        from scipy.linalg import lu_factor, lu_solve

        products, vector = system[0][np.ix_(used, used)], system[1][used]
        prior = self.prior[np.ix_(used, used)]
        prior_volume = np.linalg.slogdet(prior)[1]
        best, most = (prior, vector), -math.inf
        for spread in SPREADS:
            hessian = products + prior
            hessian[: self.width, : self.width] += prior[: self.width, : self.width] * (
                spread**-2 - 1.0
            )
            factors = lu_factor(hessian)
            values = lu_solve(factors, vector)
            volume = prior_volume - 2.0 * self.width * math.log(spread)
            volume -= np.log(np.abs(np.diagonal(factors[0]))).sum()
            evidence = 0.5 * float(vector @ values + volume)
            if evidence > most:
                best, most = (hessian, values), evidence
        solution, errors = np.zeros((2, len(used)))
        solution[used] = best[1]
        errors[used] = np.sqrt(np.maximum(np.diagonal(np.linalg.inv(best[0])), 0.0))
        return _Fit(used, solution, errors, most)

    def _weights(self, used: Booleans) -> Floats:
        """Return the inverse variances of the rows, estimated from the residuals of a fit."""

        def mean(of: Integers, squares: Floats, weights: Floats, count: int) -> Floats:
            sums = np.bincount(of, weights * squares, count)
            return np.asarray(sums / np.maximum(np.bincount(of, weights, count), 1e-12))

        fits, moving = self.robot_fit.fits, self.moving
        square = np.array([self.squares[j] for j in moving])
        floor = np.array([self.data.floor(self.robot_fit, j) for j in moving]) * square
        variance = np.array([fits[j].remaining for j in moving]) * square + floor
        trust = np.ones(len(self.target))
        for _ in range(ROUNDS):
            weights = trust / variance[self.joint] / self.dependence
            fit = self._best_fit(used, self._system(weights))
            residual = self.target - self.matrix @ fit.solution
            relative = residual**2 / variance[self.joint]
            sizes = mean(self.segment, relative, np.ones_like(relative), SEGMENTS)
            # A push during a few segments must not change the links.
            loudness = sizes / (LOUD * max(float(np.median(sizes)), 1e-12))
            trust = (1.0 / (1.0 + loudness**2))[self.segment]
            variance = mean(self.joint, residual**2, trust, len(moving)) + floor
        return np.asarray(trust / variance[self.joint] / self.dependence)

    def _candidate(self, fit: _Fit, cause: slice) -> CandidateModel | None:
        """Return a model with the fitted cause, or None if the cause is not credible."""
        data, solution, errors = self.data, fit.solution[cause], fit.errors[cause]
        if cause.start == self.gravity:
            gravity = data.gravity + solution
            gravity *= np.linalg.norm(data.gravity) / np.linalg.norm(gravity)
            return data.mounted(gravity) if data.is_tilted(gravity) else None
        k, mass = (cause.start - self.payloads) // 4, float(solution[0])
        if abs(mass) < CERTAIN * errors[0]:
            return None
        com = solution[1:] / mass
        errors = np.append(errors[0], errors[1:] / abs(mass))
        return data.loaded(k, self.base, np.array([mass, *com]), errors)

    def _bodies(self, fit: _Fit, weights: Floats, candidate: CandidateModel) -> Bodies:
        """Return the fitted links, and their residuals in two-fold cross-validation."""
        data, before = self.data, self.robot_fit
        after = [each.rms for each in before.fits]
        residual = np.zeros_like(self.target)
        for half in (False, True):
            system = self._system(np.where(self.half == half, weights, 0.0))
            seen = self._best_fit(fit.used, system)
            tested = self.half != half
            residual[tested] = (self.target - self.matrix @ seen.solution)[tested]
        fits = list(data.refit(before, self.base).fits)
        left, anywhere = fits.copy(), fits.copy()
        for position, j in enumerate(self.moving):
            own, square = self.joint == position, self.squares[j]
            squares = residual[own] ** 2
            weighted = float(np.average(squares, weights=weights[own]))
            after[j] = math.sqrt(weighted) * before.factor(j)
            left[j] = fits[j]._replace(remaining=weighted / square)
            anywhere[j] = fits[j]._replace(remaining=float(np.mean(squares)) / square)
            fault = fits[j].sensor_fault._replace(
                has_rotor=self._has_rotor(fit, position, j),
                has_offset=bool(fit.used[self.own[position] + 3]),
            )
            fits[j] = fits[j]._replace(sensor_fault=fault)
        robot_fit = before._replace(candidate=candidate, fits=tuple(fits))
        return Bodies(
            robot_fit,
            fit.solution[: self.width],
            [each.rms for each in data.refit(robot_fit).fits],
            after,
            float(fit.solution[self.delay]),
            float(fit.errors[self.delay]),
            data.unexplained(robot_fit._replace(fits=tuple(left))),
            data.unexplained(robot_fit._replace(fits=tuple(anywhere))),
            data.unexplained(data.friction_only()) > UNEXPLAINED,
            self.has_own_gravity,
        )

    def _has_rotor(self, fit: _Fit, position: int, j: int) -> bool:
        rotor = int(self.own[position]) + 2
        size = math.sqrt(float(self.data.joints[j].squares[ACCELERATION])) * fit.solution[rotor]
        is_certain = fit.solution[rotor] > CERTAIN * fit.errors[rotor]
        return bool(is_certain and size > ROTOR * math.sqrt(self.squares[j]))


class _Fit(NamedTuple):
    """Solution of the regression."""

    used: Booleans
    """Mask of the unknowns that were fitted."""
    solution: Floats
    """Values of all unknowns, with zero for unknowns that were not fitted."""
    errors: Floats
    """Standard errors of all unknowns, with zero for unknowns that were not fitted."""
    evidence: float
    """Logarithm of the marginal likelihood of the efforts, up to a constant."""


def _with(used: Booleans, *causes: slice) -> Booleans:
    used = used.copy()
    for cause in causes:
        used[cause] = True
    return used


def _without_doubtful_scale(fit: JointFit) -> JointFit:
    """Remove the fitted scale of an effort if wrong links may cause this scale."""
    if not LIKE_A_LOAD[0] < fit.scale < LIKE_A_LOAD[1]:
        return fit
    return fit._replace(sensor_fault=fit.sensor_fault._replace(is_scaled=False))
