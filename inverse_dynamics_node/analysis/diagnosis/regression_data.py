"""
Finds an explanation of measured efforts that has few parameters and leaves small residuals.

An *explanation* consists of a candidate model and a fit of each joint. A *candidate model* is the
model of the robot, possibly with a change such as a payload. The fit of a joint contains friction
and sensor faults.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Floats
from .fault import FaultKind, GravityConvention, WITH_GRAVITY
from .joint_samples import (
    ACCELERATION,
    ANOTHER_UNIT,
    CREDIBLE,
    GRAVITY,
    JointFit,
    JointSamples,
    LOADS,
    MODEL,
    NO_FAULT,
    ONE,
    PARAMETER_COST,
    SensorFault,
    unexplained_fraction,
    WEIGHT,
)
from .loads import fit_payload, MAX_REACH, PARAMETERS, point_mass_parameters

UNIT_PARAMETERS = 2  # wrong units are rare, and cost as much as two parameters
COST_TOLERANCE = 0.1  # smaller differences of costs are ignored
MAX_ITERATIONS = 3  # candidate model and sensor faults are fitted in turn
MIN_DURATION = 4.0  # [s]; in shorter recordings, a fit may be good by chance
OWN_CONTRIBUTION = 0.7  # a candidate leaves at most this fraction of the nominal model's residual
NO_GRAVITY = 0.25  # efforts with less than this fraction of gravity lack gravity
CONSIDERABLE = 0.3  # a smaller ratio of gravity to modelled effort may be a model error
LIKE_A_LOAD = (0.3, 3.0)  # a load or wrong links may cause factors in this range
GRAVITY_KINDS = FaultKind.GRAVITY_COMPENSATED, FaultKind.GRAVITY_MEASURED
STRENGTH = 0.02  # largest relative error of the magnitude of gravity in a fitted mounting
MIN_TILT = math.radians(3.0)
SAME_UNIT = 1.25  # largest ratio between the factors of joints with the same unit


def angle_between(vectors: Floats, other: Floats) -> Floats:
    """Return the angle of each vector, shape (..., 3), to another vector [rad]."""
    lengths = np.linalg.norm(vectors, axis=-1) * np.linalg.norm(other)
    return np.asarray(np.arccos(np.clip(vectors @ other / lengths, -1.0, 1.0)))


class CandidateModel(NamedTuple):
    """A weighted sum of sample columns that models the efforts of the whole robot."""

    kind: FaultKind | None
    """Kind of the change, or None for the unchanged model."""
    weights: Floats
    """Factors of the first columns of the samples."""
    parameters: int
    """Number of parameters that change the model."""
    has_gravity: bool = True
    """Whether the modelled efforts contain gravity."""
    link: str = ''
    """Link that carries the payload."""
    solution: tuple[float, ...] = ()
    """Gravity [m/s^2] of a mounting, or mass [kg] and centre of mass [m] of a payload."""
    errors: tuple[float, ...] = ()
    """Standard errors of the solution."""


class RobotFit(NamedTuple):
    """An explanation: a candidate model and the fit of each joint."""

    candidate: CandidateModel
    fits: tuple[JointFit, ...]
    source: tuple[int, ...]
    """Index of the measured effort that belongs to each joint."""
    unit: float = 1.0
    """Common factor of the measured efforts of all joints."""

    @property
    def cost(self) -> float:
        """Sum of the costs of all joints and of the parameters that joints share."""
        moved = sum(i != j for i, j in enumerate(self.source))
        parameters = self.candidate.parameters + moved + UNIT_PARAMETERS * (self.unit != 1.0)
        swapped = [fit.sensor_fault.is_swapped for fit in self.fits if not fit.is_friction_only]
        # An opposite sign convention of all joints is as likely as wrong signs of two joints.
        if all(swapped):
            parameters -= max(len(swapped) - 2, 0)
        return sum(fit.cost for fit in self.fits) + PARAMETER_COST * parameters

    @property
    def is_scaled(self) -> bool:
        """Whether the measured effort of any joint is in a wrong unit."""
        return self.unit != 1.0 or any(fit.sensor_fault.is_scaled for fit in self.fits)

    def factor(self, joint: int) -> float:
        """Return the absolute ratio of measured to actual effort of a joint."""
        return self.unit * self.fits[joint].scale


class RegressionData:
    """
    The samples of n joints, and the search for an explanation of the measured efforts.

    The keys of `links` are the links that may carry a load. The values are the largest masses that
    can be removed from these links [kg]. `heaviest` is an upper limit for the mass of a load [kg].
    `gravity` is the gravity of the model in the frame of the base link [m/s^2]. The samples cover
    `duration` seconds. Only `sample_count` samples of each joint are independent. Sensor faults
    and candidate models are searched for only if the duration is at least `least_duration` [s].
    The `convention` says whether measured and modelled efforts should contain gravity.
    """

    def __init__(
        self,
        joints: Sequence[JointSamples],
        links: Mapping[str, float],
        heaviest: float,
        gravity: Floats,
        sample_count: float,
        duration: float,
        least_duration: float = MIN_DURATION,
        convention: GravityConvention = WITH_GRAVITY,
    ) -> None:
        self.joints = tuple(joints)
        self.links = tuple(links)
        self.link_masses, self.heaviest = tuple(links.values()), heaviest
        self.gravity = gravity
        self.sample_count = sample_count
        self.duration, self.least_duration = duration, least_duration
        self.first_measured = LOADS + PARAMETERS * len(links)
        self.convention, self.has_gravity = convention, convention.in_measured
        self.nominal = CandidateModel(None, self._weights(), 0, has_gravity=self.has_gravity)

    def with_joints(self, joints: Sequence[JointSamples], duration: float) -> RegressionData:
        """Return a copy with other samples, which cover `duration` seconds."""
        other = copy(self)
        other.joints, other.duration = tuple(joints), duration
        other.sample_count = self.sample_count * duration / self.duration
        return other

    def restricted(self, interval: tuple[float, float], is_inside: bool) -> RegressionData:
        """Return the samples inside or outside an interval [s]."""
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

    def loads(self, k: int, start: RobotFit) -> list[RobotFit]:
        """Return successive fits of a payload on link k, with the sensor faults of `start`."""
        found: list[RobotFit] = []
        fits = start.fits
        for _ in range(MAX_ITERATIONS):
            candidate = self._payload(k, self.nominal, list(fits))
            if candidate is None:
                break
            found.append(self.refit(start, candidate))
            fits = found[-1].fits
        return found

    def friction_only(self) -> RobotFit:
        """Fit only friction, and leave the model unchanged."""
        fits = tuple(
            samples.fit(self.nominal.weights, self.first_measured + j, NO_FAULT)
            for j, samples in enumerate(self.joints)
        )
        return RobotFit(self.nominal, fits, tuple(range(len(fits))))

    @property
    def is_too_short(self) -> bool:
        """Whether the samples cover too short a time for an explanation."""
        return self.duration < self.least_duration

    @property
    def is_at_rest(self) -> bool:
        """Whether no joint moves enough to identify its friction."""
        return not any(samples.moves for samples in self.joints)

    def floor(self, robot_fit: RobotFit, j: int) -> float:
        """Return the fraction of a joint's squared effort that needs no explanation."""
        return self.joints[j].floor(self.first_measured + robot_fit.source[j])

    def square(self, robot_fit: RobotFit, j: int) -> float:
        """Return the mean square of the effort of a joint, in the unit of the model."""
        measured = self.first_measured + robot_fit.source[j]
        return float(self.joints[j].squares[measured]) / robot_fit.factor(j) ** 2

    def is_open(self, robot_fit: RobotFit, floors: float, most: float = math.inf) -> bool:
        """
        Return whether the effort of at least one moving joint is unexplained.

        An effort is explained if the remaining fraction of its square does not exceed a limit. The
        limit is `floors` times the floor, or `most` if smaller, but at least the floor.
        """
        return any(
            samples.moves and fit.remaining > max(floor, min(floors * floor, most))
            for j, (samples, fit) in enumerate(zip(self.joints, robot_fit.fits, strict=True))
            for floor in [self.floor(robot_fit, j)]
        )

    def explain(self) -> RobotFit:
        """Return the credible explanation with the lowest cost."""
        if self.is_too_short:
            return self.friction_only()
        nominal = self._fit_joints(self.nominal)
        lowest_cost = sum(
            math.log(samples.floor(self.first_measured + j))
            for j, samples in enumerate(self.joints)
        )
        if nominal.cost - lowest_cost < PARAMETER_COST:
            return nominal  # no further parameter can be worth its cost
        # Prefer missing gravity if an offset explains the efforts equally well.
        found = sorted(
            self._candidates(nominal),
            key=lambda each: each.cost - COST_TOLERANCE * self.contradicts(each.candidate),
        )
        return next(each for each in found if each is nominal or self._is_credible(each))

    def _candidates(self, nominal: RobotFit) -> list[RobotFit]:
        other = self._fit_joints(self.other_gravity())
        found = [nominal, *self._common_unit(nominal)]
        # At rest, efforts in a small unit seem to lack gravity.
        if len(found) == 1 or not (self.has_gravity and self.is_at_rest):
            found.append(other)
        # Start without sensor faults, and again with the sensor faults of the nominal fit.
        starts = [[JointFit(NO_FAULT, 0.0, 1.0)] * len(self.joints), list(nominal.fits)]
        swapped = [fit.sensor_fault.is_swapped for fit in nominal.fits]
        if any(swapped):  # a load may look like other sensor faults
            starts.append([JointFit(SensorFault(is_swapped=each), 0.0, 1.0) for each in swapped])
        for start in starts:
            found += self._iterate(self._mounting, start)
            for k in range(len(self.links)):
                found += self._iterate(partial(self._payload, k, self.nominal), start)
                found += self._iterate(partial(self._payload, k, other.candidate), start)
        return found + self._reordered()

    def _is_credible(self, robot_fit: RobotFit) -> bool:
        """Return whether a candidate is possible and clearly better than the unchanged model."""
        candidate = robot_fit.candidate
        if candidate.kind is None:
            return True
        # At rest, a load cannot be distinguished from the compensation of the load.
        is_load = candidate.kind is FaultKind.PAYLOAD
        if self.is_at_rest and is_load and not candidate.has_gravity:
            return False
        # Loads and gravity cannot be identified in unknown units.
        if robot_fit.is_scaled and candidate.kind not in GRAVITY_KINDS:
            return False
        without = self.refit(robot_fit, candidate=self.nominal)
        if self.unexplained(robot_fit) > OWN_CONTRIBUTION * self.unexplained(without):
            return False
        return not self.contradicts(candidate) or self._explains_gravity(robot_fit)

    def unexplained(self, robot_fit: RobotFit) -> float:
        """Return the unexplained fraction of squared efforts, averaged over both joint types."""
        # The effort of a joint at rest also contains unknown dry friction.
        used = [j for j, samples in enumerate(self.joints) if samples.moves or self.is_at_rest]
        squares = [self.square(robot_fit, j) for j in used]
        remaining = [
            robot_fit.fits[j].remaining * square for j, square in zip(used, squares, strict=True)
        ]
        kinds = [self.joints[j].is_prismatic for j in used]
        return unexplained_fraction(remaining, squares, kinds)

    def _explains_gravity(self, robot_fit: RobotFit) -> bool:
        """Return whether the residual of the fit contains hardly any effort of gravity."""
        numerator = denominator = 0.0
        is_shown = False
        for j, (samples, fit) in enumerate(zip(self.joints, robot_fit.fits, strict=True)):
            floor, modelled = self.floor(robot_fit, j), samples.squares[MODEL]
            if not self.has_gravity:
                modelled = modelled + samples.squares[GRAVITY]
            is_heavy = samples.squares[GRAVITY] > CONSIDERABLE**2 * modelled
            # The unknown dry friction of a joint at rest looks like missing gravity.
            is_heavy = is_heavy and (samples.moves or self.is_at_rest)
            if is_heavy and fit.remaining > max(CREDIBLE, floor):
                return False
            is_shown = is_shown or bool(is_heavy)
            gravity = samples.without_friction(samples.triangle[:, GRAVITY])
            target = samples.without_friction(self._target(j, robot_fit))
            variance = (fit.remaining + floor) * self.square(robot_fit, j)
            numerator += float(gravity @ target) / variance
            denominator += float(np.sum(gravity**2)) / variance
        return is_shown and abs(numerator) < NO_GRAVITY * denominator

    def _target(self, j: int, robot_fit: RobotFit) -> Floats:
        """Return the measured effort of a joint minus all explained efforts except friction."""
        R, fit = self.joints[j].triangle, robot_fit.fits[j]
        measured = R[:, self.first_measured + robot_fit.source[j]]
        target: Floats = fit.sensor_fault.sign / robot_fit.factor(j) * measured
        target = target - R[:, : self.first_measured] @ robot_fit.candidate.weights
        return target - fit.rotor * R[:, ACCELERATION] - fit.offset * R[:, ONE]

    def refit(
        self,
        robot_fit: RobotFit,
        candidate: CandidateModel | None = None,
        without: str = '',
    ) -> RobotFit:
        """Fit again, with another candidate model or without one kind of sensor fault."""
        candidate = candidate or robot_fit.candidate
        fits = []
        for j, (samples, fit) in enumerate(zip(self.joints, robot_fit.fits, strict=True)):
            sensor_fault = fit.sensor_fault
            if without:
                sensor_fault = sensor_fault._replace(**{without: False})
            measured = self.first_measured + robot_fit.source[j]
            fits.append(samples.fit(candidate.weights, measured, sensor_fault, robot_fit.unit))
        return robot_fit._replace(candidate=candidate, fits=tuple(fits))

    def _common_unit(self, nominal: RobotFit) -> list[RobotFit]:
        """Return a fit with one unit for the efforts of all joints, if most scales are similar."""
        factors = [fit.scale for fit in nominal.fits if fit.sensor_fault.is_scaled]
        factors += self._factors_at_rest(nominal)
        middle = float(np.median(factors)) if factors else 1.0
        alike = [x for x in factors if 1.0 / SAME_UNIT < x / middle < SAME_UNIT]
        if len(alike) < 2 or 2 * len(alike) < len(factors):
            return []
        units = float(np.exp(np.mean(np.log(alike)))) * np.linspace(0.9, 1.1, 21)
        found = [self._fit_joints(self.nominal, float(unit)) for unit in units]
        return [min(found, key=lambda each: each.cost)]

    def _factors_at_rest(self, nominal: RobotFit) -> list[float]:
        """Return tentative scales of joints whose own data vary too little to reveal a scale."""
        factors = []
        for j, (samples, fit) in enumerate(zip(self.joints, nominal.fits, strict=True)):
            measured = self.first_measured + j
            if not samples.shows_scale and fit.remaining > samples.floor(measured):
                scaled = samples.fit(self.nominal.weights, measured, ANOTHER_UNIT)
                if (
                    scaled.remaining < CREDIBLE
                    and not LIKE_A_LOAD[0] < scaled.scale < LIKE_A_LOAD[1]
                ):
                    factors.append(scaled.scale)
        return factors

    def _weights(self, gravity: float = 0.0) -> Floats:
        """Return weights of columns: 1 for the model, and `gravity` for the gravity efforts."""
        weights = np.zeros(self.first_measured)
        weights[MODEL], weights[GRAVITY] = 1.0, gravity
        return weights

    def other_gravity(self) -> CandidateModel:
        """Return the model with the opposite convention for gravity."""
        kind = GRAVITY_KINDS[not self.has_gravity]
        weights = self._weights(-1.0 if self.has_gravity else 1.0)
        return CandidateModel(kind, weights, 1, has_gravity=not self.has_gravity)

    def contradicts(self, candidate: CandidateModel) -> bool:
        """Return whether the candidate model has gravity although it should not, or vice versa."""
        return candidate.has_gravity is not self.has_gravity

    def _fit_joints(self, candidate: CandidateModel, unit: float = 1.0) -> RobotFit:
        fits = tuple(
            samples.best_fit(candidate.weights, self.first_measured + j, unit)
            for j, samples in enumerate(self.joints)
        )
        return RobotFit(candidate, fits, tuple(range(len(fits))), unit)

    def _iterate(
        self,
        fit_candidate: Callable[[list[JointFit]], CandidateModel | None],
        fits: list[JointFit],
    ) -> list[RobotFit]:
        """Fit the candidate model and the sensor faults of the joints alternately."""
        found: list[RobotFit] = []
        for _ in range(MAX_ITERATIONS):
            candidate = fit_candidate(fits)
            if candidate is None:
                break
            found.append(self._fit_joints(candidate))
            if len(found) > 1 and found[-1].cost > found[-2].cost - COST_TOLERANCE:
                break
            fits = list(found[-1].fits)
        return found

    def _rows(self, fits: list[JointFit], fixed: Floats) -> tuple[Floats, Floats] | None:
        """
        Return weighted columns and targets of all joints, without friction and sensor faults.

        The targets are the measured efforts minus the columns multiplied by `fixed`. Return None
        if the units of all efforts are unknown.
        """
        stacked, targets = [], []
        candidate = self.nominal._replace(weights=fixed)
        robot_fit = RobotFit(candidate, tuple(fits), tuple(range(len(fits))))
        for j, (samples, fit) in enumerate(zip(self.joints, fits, strict=True)):
            if fit.sensor_fault.is_scaled:
                continue  # the unit of this joint is unknown
            # Joints with a good fit have more weight.
            variance = min(fit.remaining, 1.0) + self.floor(robot_fit, j)
            weight = math.sqrt(self.sample_count / (variance * self.square(robot_fit, j)))
            columns = samples.triangle[:, : self.first_measured]
            stacked.append(weight * samples.without_friction(columns))
            targets.append(weight * samples.without_friction(self._target(j, robot_fit)))
        return (np.vstack(stacked), np.concatenate(targets)) if stacked else None

    def _mounting(self, fits: list[JointFit]) -> CandidateModel | None:
        """Return the model with the fitted gravity, or None if gravity is not tilted."""
        if not self.has_gravity:
            return None
        rows = self._rows(fits, self._weights(-1.0))
        if rows is None:
            return None
        regressors = rows[0][:, WEIGHT : WEIGHT + 3]
        gravity = np.asarray(np.linalg.lstsq(regressors, rows[1], rcond=1e-6)[0], dtype=float)
        return self.mounted(gravity) if self.is_tilted(gravity) else None

    def is_tilted(self, gravity: Floats) -> bool:
        """Return whether gravity differs from that of the model in direction but not magnitude."""
        g, g_0 = np.linalg.norm(gravity), np.linalg.norm(self.gravity)
        # The mounting does not change the magnitude of gravity.
        if g_0 == 0.0 or abs(g / g_0 - 1.0) > STRENGTH:
            return False
        return bool(angle_between(gravity, self.gravity) > MIN_TILT)

    def mounted(self, gravity: Floats) -> CandidateModel:
        """Return the model with the given gravity [m/s^2] in the frame of the base link."""
        weights = self._weights(-1.0)
        weights[WEIGHT : WEIGHT + 3] = gravity
        return CandidateModel(FaultKind.MOUNTING, weights, 3, solution=tuple(gravity.tolist()))

    def _payload(
        self, k: int, base: CandidateModel, fits: list[JointFit]
    ) -> CandidateModel | None:
        """Fit a point mass on link k to the residual efforts of the candidate model `base`."""
        rows = self._rows(fits, base.weights)
        if rows is None:
            return None
        load = slice(LOADS + PARAMETERS * k, LOADS + PARAMETERS * (k + 1))
        sample_count = self.sample_count * len(self.joints)
        solution, errors = fit_payload(rows[0][:, load], rows[1], sample_count)
        return (
            self.loaded(k, base, solution, errors) if abs(solution[0]) > 3.0 * errors[0] else None
        )

    def loaded(
        self, k: int, base: CandidateModel, solution: Floats, errors: Floats
    ) -> CandidateModel | None:
        """Add a point mass on link k to a model, or return None if the load is implausible."""
        # The missing mass of a body cannot exceed the mass of the body.
        least = -self.link_masses[k] - 3.0 * errors[0]
        if not least < solution[0] < self.heaviest or np.linalg.norm(solution[1:]) > MAX_REACH:
            return None
        load = slice(LOADS + PARAMETERS * k, LOADS + PARAMETERS * (k + 1))
        weights = base.weights.copy()
        weights[load] = point_mass_parameters(float(solution[0]), solution[1:])
        return CandidateModel(
            FaultKind.PAYLOAD,
            weights,
            4 + base.parameters,
            base.has_gravity,
            self.links[k],
            tuple(solution.tolist()),
            tuple(errors.tolist()),
        )

    def _reordered(self) -> list[RobotFit]:
        """Return a fit with efforts exchanged between joints, if the exchange explains them."""
        from scipy.optimize import linear_sum_assignment

        n, weights = len(self.joints), self.nominal.weights

        def fit(joint: int, measured: int) -> JointFit:
            return self.joints[joint].fit(weights, self.first_measured + measured, NO_FAULT)

        unexplained = [j for j in range(n) if fit(j, j).remaining > CREDIBLE]
        if len(unexplained) < 2:
            return []
        fits = [[fit(j, i) for i in unexplained] for j in unexplained]
        costs = np.array([[fit.cost for fit in row] for row in fits])
        penalty = PARAMETER_COST * (1.0 - np.eye(len(unexplained)))
        rows, columns = linear_sum_assignment(costs + penalty)
        chosen, source = list(self._fit_joints(self.nominal).fits), list(range(n))
        for row, column in zip(rows, columns, strict=True):
            if row != column:
                if fits[row][column].remaining > CREDIBLE:
                    return []
                chosen[unexplained[row]] = fits[row][column]
                source[unexplained[row]] = unexplained[column]
        return [RobotFit(self.nominal, tuple(chosen), tuple(source))]
