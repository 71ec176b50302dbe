"""
Diagnoses the difference between measured and modelled efforts of the last seconds.

`diagnose_recording` needs more motion and explains it more thoroughly. This works on a few
seconds, also of an arm at rest, and compares with the model of the running node: its payloads,
friction and gravity are part of the modelled efforts.
"""

from __future__ import annotations

from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import FRICTION_WIDTH
from ...robot.end_effector import last_link
from ...robot.model import Booleans, Floats, RobotModel
from ..columns import gravity_columns, payload_columns
from ..least_squares import fit_nonnegative
from .agreement import Agreement, Obstacle, Outcome, Size
from .compared_efforts import CONSTANT
from .fault import FaultKind
from .joint_samples import PARAMETER_COST
from .live_samples import LiveSamples
from .loads import MAX_REACH

MIN_SAMPLES = 50  # one second at 50 Hz
MOVING = 0.02  # [rad/s or m/s]; RMS speed above which a joint moves
AGREEMENT = 0.3  # RMS residual as a fraction of the effort, up to which model and robot agree
SUSPICIOUS = 0.15  # the same, from which explanations are searched
FLOOR_OF_LIMIT, FLOOR_OF_LARGEST = 0.02, 0.05
"""
Residuals below these fractions of the joint's limit and of the largest modelled effort are
ignored; the smaller one applies, because limits of URDFs are often placeholders.
"""
LEAST_FLOOR = 0.005  # fraction of the limit; sensors are not better
REST_FACTOR = 2.5  # a joint at rest may be held by dry friction of any size up to breakaway
FRICTION_AT_REST = 0.1  # fraction of the limit that dry friction may be
SAME_SCALE = (0.7, 1.4)
"""
Factors in this range are model errors, not another unit. It is wider than that of a recording,
because friction and gravity of a few seconds may look like a factor.
"""
MUST_REMAIN = 0.25  # fraction of the squares that an accepted explanation may leave
SOFTENING = 0.1  # added to mean squares, which are 1 at the tolerance

MOST_STATES = 60
"""
States used by a fit; states that are closer in time differ little. Kernels for 64 states or more
may have to be compiled first, for which the display would stop.
"""
MIN_MASS = 0.05  # [kg]
MIN_TILT = math.radians(5.0)  # larger than in a recording, which separates it from friction
SAME_MAGNITUDE = (0.8, 1.25)  # gravity of another magnitude has another cause
WHOLE_WEIGHT = (0.75, 1.25)  # fraction of gravity that the driver compensates


class _RobotFit(NamedTuple):
    """An explanation of all joints, and the squares that it leaves."""

    kind: FaultKind | None
    cost: float
    remaining: float
    """Mean square of residual over tolerance."""
    swapped: tuple[int, ...] = ()
    candidate: _Candidate | None = None
    factors: tuple[float, ...] = ()
    joints: tuple[int, ...] = ()


def diagnose(
    samples: LiveSamples, robot: RobotModel, gravity: Floats, limits: Floats | None = None
) -> Agreement:
    """
    Compare measured and modelled efforts.

    Parameters
    ----------
    samples : LiveSamples
        Samples of all n joints of the robot, in its order.
    robot : RobotModel
        The robot.
    gravity : ndarray, shape (3,)
        Free-fall acceleration in the frame of the root link that the model contains [m/s^2].
    limits : ndarray, shape (n,), optional
        Largest efforts [N m or N]; default: those of the robot.

    Returns
    -------
    agreement : Agreement

    """
    limits = robot.effort_limits if limits is None else limits
    is_known = np.isfinite(samples.measured) & np.isfinite(samples.modelled)
    # At first, efforts are unknown until all topics are connected and the filters have settled.
    known_rows = is_known.any(axis=1).sum()
    columns = np.flatnonzero(2 * is_known.sum(axis=0) > known_rows).tolist()
    if len(samples.times) >= MIN_SAMPLES and not np.isfinite(samples.measured).any():
        return Agreement(Outcome.UNDECIDED, Obstacle.NO_EFFORTS)
    rows = is_known[:, columns].all(axis=1) & np.isfinite(samples.q).all(axis=1)
    if not columns or rows.sum() < MIN_SAMPLES:
        return Agreement(Outcome.UNDECIDED, Obstacle.TOO_FEW_SAMPLES)
    whole = LiveSamples(samples.joint_names, *(signal[rows] for signal in samples[1:]))
    return _Comparison(whole, columns, robot, gravity, limits).agreement()


class _Comparison:
    """Complete samples of the c compared joints; columns are these joints."""

    def __init__(
        self,
        whole: LiveSamples,
        columns: list[int],
        robot: RobotModel,
        gravity: Floats,
        limits: Floats,
    ) -> None:
        self.whole, self.columns, self.robot, self.gravity = whole, columns, robot, gravity
        compared = whole.of_joints(columns)
        self.names = compared.joint_names
        self.measured, self.modelled = compared.measured, compared.modelled
        self.qd = np.nan_to_num(compared.qd)
        self.is_prismatic = robot.is_prismatic_joint[columns]
        self.limits = limits[columns]
        self.moves: Booleans = _rms(self.qd) > MOVING
        self.effort = np.maximum(_rms(self.measured), _rms(self.modelled))
        self.floor = self._floor()
        self.residual = self._without_friction(self.measured - self.modelled)
        self.tolerance = np.maximum(self.floor, SUSPICIOUS * self.effort)

    def agreement(self) -> Agreement:
        """Return whether model and robot agree."""
        r = _rms(self.residual)
        is_checked = _rms(self.modelled) > self.floor
        common = Agreement(
            Outcome.AGREE,
            sizes=self._sizes(),
            checked=self._names(is_checked),
            unchecked=self._names(~is_checked),
            is_moving=bool(self.moves.any()),
        )
        silent = self._silent(is_checked)
        if silent.any():
            if np.array_equal(silent, is_checked):
                return replace(common, outcome=Outcome.UNDECIDED, cause=Obstacle.ZERO_EFFORTS)
            return replace(
                common,
                outcome=Outcome.DIFFER,
                cause=FaultKind.NOT_MEASURED,
                joints=self._names(silent),
            )
        differs = r > np.maximum(self.floor, AGREEMENT * self.effort)
        if (r > self.tolerance).any():
            fit = self._explain()
            if fit is not None:
                return self._explained(common, fit)
        if differs.any():
            return self._unexplained(common, differs, r)
        if not is_checked.any():
            return replace(common, outcome=Outcome.UNDECIDED, cause=Obstacle.SMALL_EFFORTS)
        return common

    def _floor(self) -> Floats:
        """Return the residuals that are ignored, shape (c,)."""
        largest = np.zeros(len(self.names))
        for kind in (False, True):
            same = self.is_prismatic == kind
            if same.any():
                largest[same] = np.max(_rms(self.modelled)[same])
        floor = np.minimum(FLOOR_OF_LIMIT * self.limits, FLOOR_OF_LARGEST * largest)
        finite = np.where(np.isfinite(self.limits), self.limits, 0.0)
        floor = np.maximum(floor, LEAST_FLOOR * finite)
        return np.asarray(np.where(self.moves, floor, REST_FACTOR * floor))

    def _without_friction(self, residual: Floats) -> Floats:
        """Subtract dry and viscous friction of the joints that moved in both directions."""
        rest: Floats = residual.copy()
        for c in np.flatnonzero(self.moves):
            direction = np.tanh(self.qd[:, c] / FRICTION_WIDTH)
            if min(np.mean(direction > 0.5), np.mean(direction < -0.5)) < 0.1:
                continue
            features = np.column_stack([direction, self.qd[:, c]])
            rest[:, c] -= features @ fit_nonnegative(features, residual[:, c])[0]
        return rest

    def _silent(self, is_checked: Booleans) -> Booleans:
        """Return which joints measure a constant zero where the model has an effort."""
        largest = max(float(np.max(np.abs(self.modelled))), CONSTANT)
        is_zero = np.max(np.abs(self.measured), axis=0) <= CONSTANT * largest
        return np.asarray(is_zero & is_checked)

    def _explain(self) -> _RobotFit | None:
        """Return the explanation with the lowest cost, or None if none is good enough."""
        nominal = self._fit(None, self.measured - self.modelled, 0)
        swapped = self._swapped()
        found = [nominal]
        if len(swapped):
            # One convention for all joints is as likely as an error of two of them.
            parameters = 2 if self._is_all(swapped) else len(swapped)
            found.append(self._fit(FaultKind.SIGN, self._flipped(swapped), parameters, swapped))
        found += self._scaled()
        for flips in {(), swapped}:
            for candidate in self._candidates(flips):
                left = self._flipped(flips) - candidate.efforts[:, self.columns]
                parameters = candidate.parameters + len(flips)
                fit = self._fit(candidate.kind, left, parameters, flips)
                found.append(fit._replace(candidate=candidate))
        best = min(found, key=lambda fit: fit.cost)
        is_good = best is not nominal and best.remaining < MUST_REMAIN * nominal.remaining
        return best if is_good else None

    def _fit(
        self, kind: FaultKind | None, left: Floats, parameters: int, swapped: tuple[int, ...] = ()
    ) -> _RobotFit:
        squares = float(np.mean((_rms(self._without_friction(left)) / self.tolerance) ** 2))
        cost = len(self.names) * math.log(squares + SOFTENING) + PARAMETER_COST * parameters
        return _RobotFit(kind, cost, squares, swapped)

    def _swapped(self) -> tuple[int, ...]:
        """Return the columns that the opposite sign explains far better."""
        nominal, opposite = (
            _rms(self.residual),
            _rms(self._without_friction(-self.measured - self.modelled)),
        )
        is_swapped = (
            (_rms(self.modelled) > 0.5 * self.floor)
            & (nominal > self.tolerance)
            & (opposite < 0.5 * nominal)
        )
        swapped = tuple(np.flatnonzero(is_swapped).tolist())
        # Several, and all whose sign can be seen: the driver has another convention for all.
        return tuple(range(len(self.names))) if self._is_all(swapped) else swapped

    def _is_all(self, swapped: tuple[int, ...]) -> bool:
        visible = np.flatnonzero(_rms(self.modelled) > self.floor)
        return len(swapped) > 1 and set(visible.tolist()) <= set(swapped)

    def _flipped(self, swapped: tuple[int, ...]) -> Floats:
        sign = np.ones(len(self.names))
        sign[list(swapped)] = -1.0
        left: Floats = sign * self.measured - self.modelled
        return left

    def _candidates(self, flips: tuple[int, ...]) -> list[_Candidate]:
        weights = np.zeros(len(self.whole.joint_names))
        weights[self.columns] = 1.0 / self.tolerance
        residual = np.zeros_like(self.whole.measured)
        residual[:, self.columns] = self._flipped(flips)
        return _fit_candidates(self.whole, residual, weights, self.robot, self.gravity)

    def _scaled(self) -> list[_RobotFit]:
        """
        Try another unit of the measured efforts.

        A factor of one joint needs efforts that vary; at rest any factor fits.

        """
        found = []
        slopes, correlations = self._slopes()
        significant = _rms(self.modelled) > self.floor
        varies = np.std(self.modelled, axis=0) > np.maximum(self.floor, 0.1 * self.effort)
        shared = float(
            np.sum(np.sum(self.measured * self.modelled, axis=0) / self.tolerance**2)
            / np.sum(np.sum(self.modelled**2, axis=0) / self.tolerance**2)
        )
        if significant.sum() >= 2 and _is_another_unit(shared):
            left = self.measured / shared - self.modelled
            # Measured efforts in a small unit have a small residual anyway.
            fit = self._fit(FaultKind.SCALE, left, 2)
            joints = tuple(np.flatnonzero(significant).tolist())
            found.append(fit._replace(factors=(shared,) * len(joints), joints=joints))
        wrong = [
            c
            for c in np.flatnonzero(varies & (correlations > 0.97)).tolist()
            if _is_another_unit(slopes[c])
        ]
        if wrong:
            left = self.measured - self.modelled
            left[:, wrong] = self.measured[:, wrong] / slopes[wrong] - self.modelled[:, wrong]
            fit = self._fit(FaultKind.SCALE, left, 2 * len(wrong))
            found.append(
                fit._replace(factors=tuple(float(slopes[c]) for c in wrong), joints=tuple(wrong))
            )
        return found

    def _slopes(self) -> tuple[Floats, Floats]:
        squares = np.maximum(np.sum(self.modelled**2, axis=0), 1e-300)
        slopes: Floats = np.sum(self.measured * self.modelled, axis=0) / squares
        a = self.measured - self.measured.mean(axis=0)
        b = self.modelled - self.modelled.mean(axis=0)
        norm = np.sqrt(np.sum(a**2, axis=0) * np.sum(b**2, axis=0))
        correlations: Floats = np.sum(a * b, axis=0) / np.maximum(norm, 1e-300)
        return slopes, correlations

    def _explained(self, common: Agreement, fit: _RobotFit) -> Agreement:
        found = replace(common, outcome=Outcome.DIFFER, cause=fit.kind)
        swapped = self._names(np.isin(np.arange(len(self.names)), fit.swapped))
        if fit.kind is FaultKind.SIGN:
            return replace(found, joints=swapped)
        found = replace(found, also_swapped=swapped)
        if fit.candidate is not None:
            return replace(found, values=fit.candidate.values, link=fit.candidate.link)
        return replace(found, joints=tuple(self.names[c] for c in fit.joints), values=fit.factors)

    def _unexplained(self, common: Agreement, differs: Booleans, r: Floats) -> Agreement:
        worst = sorted(np.flatnonzero(differs), key=lambda c: -r[c] / self.tolerance[c])
        names = tuple(self.names[c] for c in worst)
        found = replace(common, cause=FaultKind.UNEXPLAINED, joints=names)
        may_be_friction = ~self.moves & (r < FRICTION_AT_REST * self.limits)
        if np.isfinite(self.limits).all() and may_be_friction[differs].all():
            return replace(found, outcome=Outcome.UNDECIDED, cause=Obstacle.AT_REST)
        return replace(found, outcome=Outcome.DIFFER)

    def _sizes(self) -> tuple[Size, ...]:
        residual = self.measured - self.modelled
        return tuple(
            Size(
                float(np.sqrt(np.mean(residual[:, same] ** 2))),
                float(np.sqrt(np.mean(self.measured[:, same] ** 2))),
                kind,
            )
            for kind in (False, True)
            if (same := self.is_prismatic == kind).any()
        )

    def _names(self, selected: Booleans) -> tuple[str, ...]:
        return tuple(self.names[c] for c in np.flatnonzero(selected))


def _is_another_unit(factor: float) -> bool:
    return factor > 1e-6 and not SAME_SCALE[0] < factor < SAME_SCALE[1]


def _rms(signals: Floats) -> Floats:
    """Return the root mean square of each column."""
    result: Floats = np.sqrt(np.mean(signals**2, axis=0))
    return result


class _Candidate(NamedTuple):
    """A cause, and the efforts by which the measured ones exceed the model."""

    kind: FaultKind
    efforts: Floats
    """Shape (k, n) [N m or N]."""
    parameters: int
    values: tuple[float, ...] = ()
    link: str = ''


def _fit_candidates(
    samples: LiveSamples, residual: Floats, weights: Floats, robot: RobotModel, gravity: Floats
) -> list[_Candidate]:
    """
    Fit a missing payload, a wrong direction of gravity, and gravity that the driver compensates.

    Parameters
    ----------
    samples : LiveSamples
        Samples of all n joints at k times.
    residual : ndarray, shape (k, n)
        Measured minus modelled efforts [N m or N].
    weights : ndarray, shape (n,)
        Inverse tolerances of the residual of the joints; 0 for joints that are not compared.
    robot : RobotModel
        The robot.
    gravity : ndarray, shape (3,)
        Gravity of the model in the frame of the root link [m/s^2].

    Returns
    -------
    candidates : list of _Candidate
        Those whose parameters are plausible.

    """
    step = max(1, -(-len(samples.times) // MOST_STATES))
    some = slice(None, None, step)
    q: Floats = np.nan_to_num(samples.q)
    qd: Floats = np.nan_to_num(samples.qd)
    qdd: Floats = np.zeros_like(qd)
    if len(qd) > 1:
        qdd[:] = np.gradient(qd, samples.times, axis=0)
    states = q[some], qd[some], qdd[some]
    target, times, all_times = residual[some], samples.times[some], samples.times
    g = float(np.linalg.norm(gravity))
    if g == 0.0:  # the driver compensates gravity, and possibly that of payloads too
        return []

    def at_all_times(efforts: Floats) -> Floats:
        columns = [np.interp(all_times, times, column) for column in efforts.T]
        result: Floats = np.column_stack(columns)
        return result

    def fit(regressors: Floats) -> Floats:
        rows = (regressors * weights[:, None]).reshape(-1, regressors.shape[-1])
        return np.asarray(
            np.linalg.lstsq(rows, (target * weights).ravel(), rcond=1e-6)[0], dtype=np.float64
        )

    found = []
    weight = gravity_columns(robot, states[0])
    lacking = -(weight @ gravity)[..., None]
    (fraction,) = fit(lacking)
    if WHOLE_WEIGHT[0] < fraction < WHOLE_WEIGHT[1]:
        efforts = at_all_times(lacking[..., 0])
        found.append(_Candidate(FaultKind.GRAVITY_COMPENSATED, efforts, 1))
    change = fit(weight)
    actual = gravity + change
    ratio = float(np.linalg.norm(actual)) / g
    cosine = float(actual @ gravity) / (ratio * g * g) if ratio else 1.0
    is_tilted = math.acos(min(1.0, max(-1.0, cosine))) > MIN_TILT
    if is_tilted and SAME_MAGNITUDE[0] < ratio < SAME_MAGNITUDE[1]:
        efforts = at_all_times(weight @ change)
        found.append(_Candidate(FaultKind.MOUNTING, efforts, 3, tuple(actual.tolist())))
    link = last_link(robot)
    load = payload_columns(robot, gravity, link, states)
    for parameters in (1, 4):
        solution = fit(load[..., :parameters])
        mass = float(solution[0])
        distance = float(np.linalg.norm(solution[1:])) / max(abs(mass), 1e-9)
        if abs(mass) < MIN_MASS or distance > MAX_REACH or mass < -float(np.sum(robot.mass)):
            continue
        efforts = at_all_times(load[..., :parameters] @ solution)
        found.append(_Candidate(FaultKind.PAYLOAD, efforts, 1 + parameters, (mass,), link))
    return found
