"""
Finds the explanation of measured efforts that leaves least unexplained with fewest parameters.

A *hypothesis* concerns the efforts of the whole robot, such as a payload. The efforts of every
joint may be distorted in addition.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
import math

import numpy as np

from ...robot.model import Floats
from .explanation import Explanation, Hypothesis
from .joint_samples import (
    ACCELERATION,
    CREDIBLE,
    DIRECTION,
    Fit,
    GRAVITY,
    JointSamples,
    LOADS,
    MODEL,
    ONE,
    PARAMETER_COST,
    SPEED,
    UNDISTORTED,
    WEIGHT,
)
from .loads import fit_payload, MAX_REACH, PARAMETERS, point_mass_parameters

COST_TOLERANCE = 0.1  # smaller differences of costs are ignored
MAX_ITERATIONS = 3  # of fitting the hypothesis and the distortions in turn
MIN_DURATION = 4.0  # [s] of samples; in less, chance explains too much
OWN_CONTRIBUTION = 0.7  # of the squares that are left without a hypothesis, to be left at most
NO_GRAVITY = 0.25  # largest fraction of gravity in efforts that lack gravity
CONSIDERABLE = 0.3  # fraction of a joint's modelled effort; less gravity may be a wrong model
SAME_UNIT = 1.25  # largest ratio between the factors of joints with the same unit


class Evidence:
    """
    The samples of all joints, and the search for their explanation.

    Parameters
    ----------
    joints : sequence of JointSamples
        Samples of n joints.
    links : mapping of str to float
        Links that may carry a load, with the mass of the body of each [kg]. The efforts of loads
        on them are in the samples, from column ``LOADS`` on.
    gravity : ndarray, shape (3,)
        Gravity of the model in the frame of the base link [m/s^2].
    sample_count : float
        Number of independent samples of a joint.
    duration : float
        Time that the samples represent [s].

    """

    def __init__(
        self,
        joints: Sequence[JointSamples],
        links: Mapping[str, float],
        gravity: Floats,
        sample_count: float,
        duration: float,
    ) -> None:
        self.joints = tuple(joints)
        self.links = tuple(links)
        self.link_masses = tuple(links.values())
        self.gravity = gravity
        self.sample_count = sample_count
        self.duration = duration
        self.first_measured = LOADS + PARAMETERS * len(links)
        self.as_is = Hypothesis('as_is', self._weights({MODEL: 1.0}), 0)

    def with_joints(self, joints: Sequence[JointSamples], duration: float) -> Evidence:
        """Return the same evidence with other samples."""
        links = dict(zip(self.links, self.link_masses, strict=True))
        sample_count = self.sample_count * duration / self.duration
        return Evidence(joints, links, self.gravity, sample_count, duration)

    def restricted(self, interval: tuple[float, float], is_inside: bool) -> Evidence:
        """Return the samples inside or outside of an interval [s]."""
        begin, end = interval
        joints = []
        for samples in self.joints:
            used = ((samples.times >= begin) & (samples.times <= end)) == is_inside
            if not used.any():
                used[:1] = True
            joints.append(
                replace(samples, columns=samples.columns[used], times=samples.times[used])
            )
        inside = min(end - begin, self.duration)
        duration = inside if is_inside else self.duration - inside
        return self.with_joints(joints, max(duration, 1e-9))

    def loads(self, k: int, start: Explanation) -> list[Explanation]:
        """Fit payloads on link k without distortions."""
        found: list[Explanation] = []
        fits = start.fits
        for _ in range(MAX_ITERATIONS):
            hypothesis = self._payload(k, self.as_is, list(fits))
            if hypothesis is None:
                break
            found.append(self.refit(start, hypothesis))
            fits = found[-1].fits
        return found

    def friction_only(self) -> Explanation:
        """Return the model as it is, with friction."""
        fits = tuple(
            samples.fit(self.as_is.weights, self.first_measured + j, UNDISTORTED)
            for j, samples in enumerate(self.joints)
        )
        return Explanation(self.as_is, fits, tuple(range(len(fits))))

    def distorted(self) -> Explanation:
        """Return the model as it is, with the best distortion of every joint."""
        return self._fit_joints(self.as_is)

    @property
    def is_too_short(self) -> bool:
        """Whether there are too few samples for an explanation."""
        return self.duration < MIN_DURATION

    def explain(self) -> Explanation:
        """Return the credible explanation with the lowest cost."""
        if self.is_too_short:
            return self.friction_only()
        as_is = self._fit_joints(self.as_is)
        lowest_cost = sum(
            math.log(samples.floor(self.first_measured + j))
            for j, samples in enumerate(self.joints)
        )
        if as_is.cost - lowest_cost < PARAMETER_COST:
            return as_is  # no further parameter can be worth its cost
        # If an offset of a joint explains as much as missing gravity, prefer missing gravity.
        found = sorted(
            self._candidates(as_is),
            key=lambda each: each.cost - COST_TOLERANCE * each.hypothesis.is_weightless,
        )
        return next(each for each in found if each is as_is or self._is_credible(each))

    def _candidates(self, as_is: Explanation) -> list[Explanation]:
        weightless = self._fit_joints(self.weightless())
        found = [as_is, weightless]
        # Start without distortions, and with those that seem best for the model as it is.
        for start in ([Fit(UNDISTORTED, 0.0, 1.0)] * len(self.joints), list(as_is.fits)):
            found += self._iterate(self._mounting, start)
            for k in range(len(self.links)):
                found += self._iterate(partial(self._payload, k, self.as_is), start)
                found += self._iterate(partial(self._payload, k, weightless.hypothesis), start)
        return found + self._reordered() + self._common_unit(as_is)

    def _is_credible(self, explanation: Explanation) -> bool:
        """Return whether a hypothesis is possible, and improves enough by itself."""
        hypothesis = explanation.hypothesis
        if hypothesis.kind == 'as_is':
            return True
        # Loads and gravity cannot be identified in unknown units.
        if explanation.is_scaled and hypothesis.kind != 'weightless':
            return False
        without = self.refit(explanation, hypothesis=self.as_is)
        if self.unexplained(explanation) > OWN_CONTRIBUTION * self.unexplained(without):
            return False
        return not hypothesis.is_weightless or self._lacks_gravity(explanation)

    def unexplained(self, explanation: Explanation) -> float:
        """Return the remaining fraction of the squares: mean of revolute and prismatic joints."""
        remaining = {False: 0.0, True: 0.0}
        squares = {False: 0.0, True: 0.0}
        none_moves = not any(samples.moves for samples in self.joints)
        for j, (samples, fit) in enumerate(zip(self.joints, explanation.fits, strict=True)):
            # The effort of a joint at rest also contains an unknown dry friction.
            if not (samples.moves or none_moves):
                continue
            measured = self.first_measured + explanation.source[j]
            square = float(samples.squares[measured]) / explanation.factor(j) ** 2
            remaining[samples.is_prismatic] += fit.remaining * square
            squares[samples.is_prismatic] += square
        return float(
            np.mean([remaining[kind] / squares[kind] for kind in squares if squares[kind]])
        )

    def _lacks_gravity(self, explanation: Explanation) -> bool:
        """Return whether the efforts contain hardly any gravity, and are explained without it."""
        numerator = denominator = 0.0
        is_shown = False
        for j, (samples, fit) in enumerate(zip(self.joints, explanation.fits, strict=True)):
            gravity, target = samples.triangle[:, GRAVITY], self._target(j, explanation)
            is_heavy = samples.squares[GRAVITY] > CONSIDERABLE**2 * samples.squares[MODEL]
            if is_heavy and samples.moves and fit.remaining > CREDIBLE:
                return False
            # A joint at rest may have any dry friction, which looks like less gravity.
            is_shown = is_shown or bool(is_heavy and samples.moves)
            if samples.moves:
                friction = np.linalg.qr(samples.triangle[:, [SPEED, DIRECTION]])[0]
                gravity, target = (x - friction @ (friction.T @ x) for x in (gravity, target))
            measured = self.first_measured + explanation.source[j]
            variance = fit.remaining + samples.floor(measured)
            variance *= float(samples.squares[measured]) / explanation.factor(j) ** 2
            numerator += float(gravity @ target) / variance
            denominator += float(np.sum(gravity**2)) / variance
        return is_shown and abs(numerator) < NO_GRAVITY * denominator

    def _target(self, j: int, explanation: Explanation) -> Floats:
        """Return the reduced effort of a joint that an explanation leaves to friction."""
        R, fit = self.joints[j].triangle, explanation.fits[j]
        measured = R[:, self.first_measured + explanation.source[j]]
        target: Floats = fit.distortion.sign / explanation.factor(j) * measured
        target = target - R[:, : self.first_measured] @ explanation.hypothesis.weights
        return target - fit.rotor * R[:, ACCELERATION] - fit.offset * R[:, ONE]

    def refit(
        self,
        explanation: Explanation,
        hypothesis: Hypothesis | None = None,
        without: str = '',
    ) -> Explanation:
        """Fit an explanation again, with another hypothesis or without a kind of distortion."""
        hypothesis = hypothesis or explanation.hypothesis
        fits = []
        for j, (samples, fit) in enumerate(zip(self.joints, explanation.fits, strict=True)):
            distortion = fit.distortion
            if without:
                distortion = distortion._replace(**{without: False})
            measured = self.first_measured + explanation.source[j]
            fits.append(samples.fit(hypothesis.weights, measured, distortion, explanation.unit))
        return explanation._replace(hypothesis=hypothesis, fits=tuple(fits))

    def _common_unit(self, as_is: Explanation) -> list[Explanation]:
        """Scale the efforts of all joints alike, including those that hardly moved."""
        factors = [fit.scale for fit in as_is.fits if fit.distortion.is_scaled]
        middle = float(np.median(factors)) if factors else 1.0
        alike = [x for x in factors if 1.0 / SAME_UNIT < x / middle < SAME_UNIT]
        if len(alike) < 2 or 2 * len(alike) < len(factors):
            return []
        units = float(np.exp(np.mean(np.log(alike)))) * np.linspace(0.9, 1.1, 21)
        found = [self._fit_joints(self.as_is, float(unit)) for unit in units]
        return [min(found, key=lambda each: each.cost)]

    def _weights(self, values: dict[int, float]) -> Floats:
        weights = np.zeros(self.first_measured)
        for column, value in values.items():
            weights[column] = value
        return weights

    def weightless(self) -> Hypothesis:
        weights = self._weights({MODEL: 1.0, GRAVITY: -1.0})
        return Hypothesis('weightless', weights, 1, is_weightless=True)

    def _fit_joints(self, hypothesis: Hypothesis, unit: float = 1.0) -> Explanation:
        fits = tuple(
            samples.best_fit(hypothesis.weights, self.first_measured + j, unit)
            for j, samples in enumerate(self.joints)
        )
        return Explanation(hypothesis, fits, tuple(range(len(fits))), unit)

    def _iterate(
        self, fit_hypothesis: Callable[[list[Fit]], Hypothesis | None], fits: list[Fit]
    ) -> list[Explanation]:
        """Fit a hypothesis to the joints, and the joints to the hypothesis, in turn."""
        found: list[Explanation] = []
        for _ in range(MAX_ITERATIONS):
            hypothesis = fit_hypothesis(fits)
            if hypothesis is None:
                break
            found.append(self._fit_joints(hypothesis))
            if len(found) > 1 and found[-1].cost > found[-2].cost - COST_TOLERANCE:
                break
            fits = list(found[-1].fits)
        return found

    def _rows(self, fits: list[Fit], fixed: Floats) -> tuple[Floats, Floats] | None:
        """
        Stack the samples of all joints, weighted, with friction and distortions removed.

        Returns columns and targets; the targets are the efforts that the fixed columns leave. None
        if the units of all efforts are unknown.

        """
        stacked, targets = [], []
        for j, (samples, fit) in enumerate(zip(self.joints, fits, strict=True)):
            if fit.distortion.is_scaled:
                continue  # its unit is unknown
            R = samples.triangle
            columns = R[:, : self.first_measured]
            target = fit.distortion.sign * R[:, self.first_measured + j] - columns @ fixed
            target = target - fit.rotor * R[:, ACCELERATION] - fit.offset * R[:, ONE]
            if samples.moves:
                Q = np.linalg.qr(R[:, [SPEED, DIRECTION]])[0]
                target = target - Q @ (Q.T @ target)
                columns = columns - Q @ (Q.T @ columns)
            # Joints that are explained well have more weight.
            variance = min(fit.remaining, 1.0) + samples.floor(self.first_measured + j)
            variance *= samples.squares[self.first_measured + j]
            weight = math.sqrt(self.sample_count / variance)
            stacked.append(weight * columns)
            targets.append(weight * target)
        return (np.vstack(stacked), np.concatenate(targets)) if stacked else None

    def _mounting(self, fits: list[Fit]) -> Hypothesis | None:
        """Fit the direction of gravity."""
        fixed = self._weights({MODEL: 1.0, GRAVITY: -1.0})
        rows = self._rows(fits, fixed)
        if rows is None:
            return None
        regressors = rows[0][:, WEIGHT : WEIGHT + 3]
        gravity = np.linalg.lstsq(regressors, rows[1], rcond=1e-6)[0]
        g, g_0 = np.linalg.norm(gravity), np.linalg.norm(self.gravity)
        # A different magnitude has another cause than the mounting.
        if g_0 == 0.0 or not 0.8 * g_0 < g < 1.25 * g_0:
            return None
        angle = math.acos(np.clip(gravity @ self.gravity / (g * g_0), -1.0, 1.0))
        if angle < math.radians(3.0):
            return None
        weights = fixed.copy()
        weights[WEIGHT : WEIGHT + 3] = gravity
        return Hypothesis('mounting', weights, 3, solution=tuple(gravity.tolist()))

    def _payload(self, k: int, base: Hypothesis, fits: list[Fit]) -> Hypothesis | None:
        """Fit a point mass on link k to the efforts that a base hypothesis leaves."""
        rows = self._rows(fits, base.weights)
        if rows is None:
            return None
        load = slice(LOADS + PARAMETERS * k, LOADS + PARAMETERS * (k + 1))
        sample_count = self.sample_count * len(self.joints)
        solution, errors = fit_payload(rows[0][:, load], rows[1], sample_count)
        # A body cannot lack more than its mass.
        least = -self.link_masses[k] - 3.0 * errors[0]
        if abs(solution[0]) < 3.0 * errors[0] or solution[0] < least:
            return None
        if np.linalg.norm(solution[1:]) > MAX_REACH:
            return None
        weights = base.weights.copy()
        weights[load] = point_mass_parameters(float(solution[0]), solution[1:])
        return Hypothesis(
            'payload',
            weights,
            4 + base.parameters,
            base.is_weightless,
            self.links[k],
            tuple(solution.tolist()),
            tuple(errors.tolist()),
        )

    def _reordered(self) -> list[Explanation]:
        """Assign the efforts of joints that are not explained to each other's joints."""
        from scipy.optimize import linear_sum_assignment

        n, weights = len(self.joints), self.as_is.weights

        def fit(joint: int, measured: int) -> Fit:
            return self.joints[joint].fit(weights, self.first_measured + measured, UNDISTORTED)

        unexplained = [j for j in range(n) if fit(j, j).remaining > CREDIBLE]
        if len(unexplained) < 2:
            return []
        fits = [[fit(j, i) for i in unexplained] for j in unexplained]
        costs = np.array([[fit.cost for fit in row] for row in fits])
        penalty = PARAMETER_COST * (1.0 - np.eye(len(unexplained)))
        rows, columns = linear_sum_assignment(costs + penalty)
        chosen, source = list(self._fit_joints(self.as_is).fits), list(range(n))
        for row, column in zip(rows, columns, strict=True):
            if row != column:
                if fits[row][column].remaining > CREDIBLE:
                    return []
                chosen[unexplained[row]] = fits[row][column]
                source[unexplained[row]] = unexplained[column]
        return [Explanation(self.as_is, tuple(chosen), tuple(source))]
