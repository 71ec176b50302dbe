"""
Measures a payload from recordings with and without the payload.

The robot repeats the same motion in a loaded run and in an empty run. The difference between
their efforts is due to the payload, because friction, offsets and errors in link masses cancel.
The efforts are linear in the ten inertial parameters of the payload, which a least-squares fit
determines.

What does not cancel is unknown too: changes of friction, offsets and gains between the runs, and
the gains of the measured efforts. The gains have usual errors. The efforts of the empty arm,
divided by those of its description, show how wrong the gains may be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import ConfigurationError, RecordingError
from ..robot.model import Booleans, Floats, RobotModel
from ..robot.rigid_body import (
    moved_inside,
    PARAMETERS,
    parameters_of_pseudo_inertias,
    rigid_body,
    RigidBody,
)
from .columns import body_columns, moment_matrices, payload_columns, SECOND_MOMENTS
from .identification.preparation import measured_joints, prepare_all
from .recordings.resampling import pieces, Resampler, resampler
from .recordings.signals import Motion, Recording

STILL = 0.01  # [rad/s or m/s]; the arm rests while all joints are slower
LEAST_REST = 0.5  # [s]; shortest rest in a pose
SETTLING = 0.2  # [s]; removed at both ends of a rest
RESTS = 1.0 / 3.0  # poses are used if the arm rests for a larger fraction of both runs
NEAR = 0.1  # [rad, m, rad/s or m/s]; largest difference between matching states
LEAST_MATCHED = 0.5  # smallest fraction of the loaded run with a match in the empty run
WINDOW = 0.15  # [s]; smoothing window
WIDTH = 0.05  # [rad/s or m/s]; speed over which Coulomb friction is smoothed
DRIFT = 0.01  # relative change of the gain of each measured effort between the runs
GAIN = 0.01  # relative error of these gains, if the empty arm agrees with its description
LINK_ERROR = 0.15  # relative error of the masses and mass distributions of links
RADIUS = 0.05  # [m]; assumed radius of gyration of a payload
REACH = 0.5  # [m]; expected distance of the centre of mass from the origin of the link
LEAST_COM_ERROR = 5e-4  # [m]; joints bend, and the frames of links are not exact
MOST_COM_ERROR = 0.05  # [m]; a coordinate with a larger standard error is unknown
CERTAIN = 3.0  # a payload is certain if its mass exceeds this many standard errors
LIGHTEST = 0.1  # [kg]; lower bound of the mass in the expected second moments
HEAVIEST = 1e3  # [kg]; expected size of the mass
LEAST_NOISE = 0.05  # lower bound of relative squared residuals, as a fraction of the median
_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """A measured payload with its standard errors."""

    link: str
    """Link that carries the payload."""
    body: RigidBody
    """The payload in the link frame; the inertia is always physically consistent."""
    mass_error: float
    """Standard error of the mass [kg]."""
    com_error: Floats
    """Standard error of each coordinate of the centre of mass, shape (3,) [m]."""
    shows_inertia: bool
    """Whether the inertia was measured; otherwise, the inertia of a ball is assumed."""
    ratio: float
    """Efforts of the empty arm divided by those of its description."""
    ratio_error: float
    """Standard error of `ratio`; NaN if the measured efforts do not contain gravity."""
    joint_names: tuple[str, ...]
    """The joints with measured efforts."""
    times: Floats
    """Times of the samples, shape (samples,) [s]."""
    measured: Floats
    """Measured efforts minus those of arm and friction, shape (samples, joints) [N m or N]."""
    fitted: Floats
    """Efforts of the fitted payload, shape (samples, joints) [N m or N]."""
    duration: float
    """Time from the first to the last used sample of the loaded run [s]."""
    poses: int
    """Number of poses that were used; 0 if a motion was used instead."""
    matched: float
    """Fraction of the loaded run that matches the empty run."""

    @property
    def residuals(self) -> Floats:
        """Efforts that the fit does not explain, shape (samples, joints) [N m or N]."""
        return self.measured - self.fitted

    @property
    def unknown(self) -> tuple[str, ...]:
        """Unknown coordinates of the centre of mass, such as x."""
        large = self.com_error > MOST_COM_ERROR
        return tuple(axis for axis, is_large in zip('xyz', large, strict=True) if is_large)

    @property
    def is_certain(self) -> bool:
        """Whether the mass is clearly above zero."""
        return bool(self.body.mass > CERTAIN * self.mass_error)

    @property
    def is_scaled(self) -> bool:
        """Whether the empty arm seems to weigh clearly more or less than its description."""
        return bool(abs(self.ratio - 1.0) > 2.0 * self.ratio_error)


class _Rows(NamedTuple):
    """One run as rows for m joints."""

    times: Floats
    """Times of the rows, shape (rows,) [s]."""
    payload: Floats
    """Efforts per unit of the payload's parameters, shape (rows, m, 10)."""
    terms: Floats
    """Efforts per unit of offset, drift, armature and friction, shape (rows, m, terms)."""
    arm: Floats
    """Modelled efforts of the empty arm, shape (rows, m)."""
    efforts: Floats
    """Measured efforts, shape (rows, m)."""

    def where(self, chosen: Booleans) -> _Rows:
        """Return the chosen rows."""
        return _Rows(*(values[chosen] for values in self))


def measure_payload(
    robot: RobotModel,
    loaded: Recording,
    empty: Recording,
    link: str,
    gravity: Floats | Sequence[float],
    has_gravity: bool = True,
) -> PayloadEstimate:
    """
    Measure the payload on a link from recordings with and without the payload.

    Both recordings must contain the same motion, or the same poses. The robot model must not
    contain the payload. `gravity` is the free-fall acceleration in the base frame [m/s^2].
    `has_gravity` says whether the measured efforts contain the weight of the arm. Raises
    ConfigurationError if the link does not move, and RecordingError if a recording is too short,
    or if the two motions differ.

    """
    if not robot.link_body[robot.link_index(link)]:
        raise ConfigurationError(
            f"link '{link}' does not move, so no effort shows its payload; choose a link that a "
            'joint moves'
        )
    joints = measured_joints(robot, [loaded, empty])
    motions = [run.motion for run in prepare_all(robot, [loaded, empty], joints)]
    dynamics = InverseDynamics(robot, gravity)
    dynamics.set_friction(0.0, 0.0)
    rests = [_rests(motion) for motion in motions]
    is_still = all(
        sum(each.stop - each.start for each in own) > RESTS * len(motion.times)
        for motion, own in zip(motions, rests, strict=True)
    )
    if is_still:
        motions = list(map(_poses, motions, rests))
    smooth = None if is_still else resampler(motions[0], WINDOW)
    partner, is_near = _partner(robot, *motions)
    matched = float(np.mean(is_near))
    if smooth is not None:
        is_near = smooth(is_near.astype(float)) > 1.0 - 1e-6
    with_load, without = (
        _rows(dynamics, link, joints, motion, smooth).where(is_near)
        for motion in (motions[0], partner)
    )
    gains = _Gains(1.0, math.nan, 0.0, 0.0)
    if has_gravity:
        gains = _gains(without, _link_variances(dynamics, joints, partner))
    fit = _fit(with_load, without, gains)
    errors = np.sqrt(_variances(fit) + np.array([0.0, 1.0, 1.0, 1.0]) * LEAST_COM_ERROR**2)
    fitted, moments = with_load.payload @ fit.x, moment_matrices(fit.x)
    return PayloadEstimate(
        link,
        rigid_body(moved_inside(parameters_of_pseudo_inertias(moments))),
        float(errors[0]),
        errors[1:],
        bool(np.sqrt(np.trace(fit.covariance[4:7, 4:7])) < 0.5 * _second_moment(fit.x)),
        gains.ratio,
        gains.error,
        tuple(robot.joint_names[j] for j in joints),
        with_load.times,
        fitted + fit.residual,
        fitted,
        float(np.ptp(with_load.times)),
        len(with_load.times) if is_still else 0,
        matched,
    )


# ---- States --------------------------------------------------------------------------------


def _rests(motion: Motion) -> list[slice]:
    """Return the intervals in which the arm rests."""
    is_still: Booleans = np.asarray((np.abs(motion.qd) < STILL).all(axis=1))
    found = []
    for begin, end in pieces(motion.times):
        steps = np.diff(is_still[begin:end].astype(int), prepend=0, append=0)
        edges = np.flatnonzero(steps) + begin
        trim = round(SETTLING / motion.period)
        least = round(LEAST_REST / motion.period)
        found += [
            slice(int(a) + trim, int(b) - trim)
            for a, b in zip(edges[::2], edges[1::2], strict=True)
            if b - a >= least + 2 * trim
        ]
    return found


def _poses(motion: Motion, rests: Sequence[slice]) -> Motion:
    """Return the mean positions and efforts in each interval at rest."""
    times, q, efforts = (
        np.array([np.mean(signal[each], axis=0) for each in rests])
        for signal in (motion.times, motion.q, motion.efforts)
    )
    zeros = np.zeros_like(q)
    return motion._replace(times=times, q=q, qd=zeros, qdd=zeros, efforts=efforts)


def _partner(robot: RobotModel, loaded: Motion, empty: Motion) -> tuple[Motion, Booleans]:
    """Return the empty-run state nearest to each loaded state, and whether the two match."""
    from scipy.spatial import cKDTree

    q = empty.q.copy()
    turns = np.round((np.mean(loaded.q, axis=0) - np.mean(q, axis=0)) / (2.0 * np.pi))
    q += np.where(robot.is_continuous, 2.0 * np.pi * turns, 0.0)
    points, others = np.hstack([loaded.q, loaded.qd]), np.hstack([q, empty.qd])
    _, index = cKDTree(others).query(points)
    is_near: Booleans = np.asarray((np.abs(points - others[index]) < NEAR).all(axis=1))
    if np.mean(is_near) < LEAST_MATCHED:
        raise RecordingError(
            f'the two runs are different motions: only {np.mean(is_near):.0%} of the loaded run '
            f'(expected at least {LEAST_MATCHED:.0%}) matches the empty run within {NEAR:g} rad '
            f'or m and {NEAR:g} rad/s or m/s; record the same motion or poses with and without '
            'payload'
        )
    q, qd, qdd, efforts = (x[index] for x in (empty.q, empty.qd, empty.qdd, empty.efforts))
    return empty._replace(times=loaded.times, q=q, qd=qd, qdd=qdd, efforts=efforts), is_near


# ---- Rows ----------------------------------------------------------------------------------


def _rows(
    dynamics: InverseDynamics,
    link: str,
    joints: Sequence[int],
    run: Motion,
    smooth: Resampler | None,
) -> _Rows:
    """Build the rows of a run; states at rest are not smoothed."""
    states = run.q, run.qd, run.qdd
    payload = payload_columns(dynamics.robot, dynamics.gravity, link, states)[:, joints]
    arm, ones = dynamics.efforts(*states)[:, joints], np.ones_like(run.efforts)
    if smooth is None:  # at rest, the offset contains the friction
        return _Rows(run.times, payload, ones[..., None], arm, run.efforts)
    place = (run.times - run.times[0]) / float(np.ptp(run.times))  # 0 to 1
    direction = np.tanh(run.qd[:, joints] / WIDTH)
    continuous = [ones, ones * place[:, None], run.qd[:, joints], run.qdd[:, joints]]
    steps = [direction, np.abs(run.efforts) * direction]
    terms = smooth(np.stack(continuous, -1)), smooth.discontinuous(np.stack(steps, -1))
    return _Rows(
        smooth.times, smooth(payload), np.concatenate(terms, -1), smooth(arm), smooth(run.efforts)
    )


# ---- Gains ---------------------------------------------------------------------------------


class _Gains(NamedTuple):
    """How wrong the gains of the measured efforts may be."""

    ratio: float
    """Measured efforts of the empty arm divided by modelled ones, over all joints."""
    error: float
    """Standard error of the ratio."""
    common: float
    """Relative error of all gains that the errors of the links do not explain."""
    spread: float
    """Standard deviation of the ratios of single joints."""


def _gains(empty: _Rows, link_variances: Floats) -> _Gains:
    """Compare the efforts of the empty arm with the model."""
    ratios, variances = np.ones((2, len(link_variances)))
    for j in range(len(ratios)):
        columns = np.column_stack([empty.arm[:, j], empty.terms[:, j]])
        products = columns.T @ columns
        inverse = np.linalg.inv(products + 1e-9 * np.diag(np.diagonal(products) + 1e-12))
        solution = inverse @ (columns.T @ empty.efforts[:, j])
        residual = empty.efforts[:, j] - columns @ solution
        noise = _variance_of_noise(residual, columns.shape[1])
        ratios[j], variances[j] = solution[0], noise * inverse[0, 0] + link_variances[j]
    weights = 1.0 / variances / np.sum(1.0 / variances)
    ratio, variance = float(weights @ ratios), float(1.0 / np.sum(1.0 / variances))
    common = max((ratio - 1.0) ** 2 - variance, 0.0)
    spread = float(weights @ (ratios - ratio) ** 2)
    return _Gains(ratio, variance**0.5, common**0.5, spread**0.5)


def _link_variances(dynamics: InverseDynamics, joints: Sequence[int], run: Motion) -> Floats:
    """Return the variance of the ratio of each joint due to the usual errors of the links."""
    robot, states = dynamics.robot, (run.q, run.qd, run.qdd)
    mass = np.maximum(robot.mass[1:], 1e-9)
    gyration = np.trace(robot.inertia[1:], axis1=1, axis2=2) / mass
    size = np.sqrt(np.sum(robot.com[1:] ** 2, axis=1) + 0.5 * gyration)
    powers = size[:, None] ** np.repeat([0, 1, 2], [1, 3, 6])
    errors = (LINK_ERROR * mass[:, None] * powers).ravel()
    columns = body_columns(dynamics, states, range(1, len(robot.mass)))[:, joints]
    arm = dynamics.efforts(*states)[:, joints]
    arm = arm - arm.mean(axis=0)  # an offset contains the mean
    shares = np.einsum('kju,kj->ju', columns, arm) / (np.sum(arm**2, axis=0)[:, None] + 1e-12)
    return np.asarray(np.sum((shares * errors) ** 2, axis=1))


def _variance_of_noise(residual: Floats, unknowns: int) -> float:
    """Return the variance of correlated residuals, per independent row."""
    lags = np.correlate(residual, residual, 'full')[len(residual) - 1 :]
    positive = np.cumprod(lags > 0.0) * lags
    return float(2.0 * positive.sum() - lags[0]) / max(len(residual) - unknowns, 1)


# ---- The fit -------------------------------------------------------------------------------


class _Fit(NamedTuple):
    """The fitted payload."""

    x: Floats
    """Mass, first moments and second moments as in `payload_columns`, shape (10,)."""
    covariance: Floats
    """Covariance of x, shape (10, 10)."""
    residual: Floats
    """Efforts that the fit does not explain, shape (rows, joints)."""


def _fit(loaded: _Rows, empty: _Rows, gains: _Gains) -> _Fit:
    """
    Fit the payload to the difference of the runs.

    The unknowns are ten parameters of the payload, and for each joint: the change of the gain
    between the runs, the gain of the payload's efforts, and the terms. The columns of the gains
    contain the fitted efforts of the round before. The fit assumes good gains. Its covariance
    includes what the wrong gains that the empty run shows would change.
    """
    target = loaded.efforts - loaded.arm - (empty.efforts - empty.arm)
    terms = loaded.terms.copy()
    terms[..., -1] -= empty.terms[..., -1]  # friction that grows with the load
    count, m, t = terms.shape
    joint = np.arange(m)
    own = np.zeros((count, m, m, 2 + t))
    own[:, joint, joint, 2:] = terms
    usual = np.array([HEAVIEST] * PARAMETERS + [DRIFT, GAIN, *[math.inf] * t] * m)
    x, residual = np.zeros(len(usual)), target
    for _ in range(_ROUNDS):
        of_payload = loaded.payload @ x[:PARAMETERS]
        own[:, joint, joint, 0] = loaded.arm + of_payload
        own[:, joint, joint, 1] = of_payload
        table = np.concatenate([loaded.payload, own.reshape(count, m, -1)], -1)
        weights = 1.0 / _noise(residual, target, t)
        matrix = sum(w * table[:, j].T @ table[:, j] for j, w in enumerate(weights))
        vector = sum(w * table[:, j].T @ target[:, j] for j, w in enumerate(weights))
        mass, moment = max(x[0], LIGHTEST), _second_moment(x)
        mean = np.zeros(len(x))
        mean[4:PARAMETERS] = [
            moment * (i == k) + x[1 + i] * x[1 + k] / mass for i, k in SECOND_MOMENTS
        ]
        usual[1:4], usual[4:PARAMETERS] = REACH * mass, moment
        is_free = np.isinf(usual)
        precision = usual**-2 + is_free * 1e-9 * (np.diagonal(matrix) + 1e-9)
        covariance = np.linalg.inv(matrix + np.diag(precision))
        x = covariance @ (vector + usual**-2 * mean)
        residual = target - table @ x
    own_share = np.einsum('kju,kj,j->uj', table, of_payload, weights)
    changes = np.column_stack([(gains.ratio - 1.0) * x, gains.spread * covariance @ own_share])[
        :PARAMETERS
    ]
    covariance = covariance[:PARAMETERS, :PARAMETERS] + changes @ changes.T
    return _Fit(x[:PARAMETERS], covariance, residual)


def _noise(residual: Floats, target: Floats, terms: int) -> Floats:
    """Return the variance of the noise of each joint, shape (joints,)."""
    if terms > 1:
        return np.array([_variance_of_noise(each, terms) for each in residual.T]) + 1e-12
    # With few poses, a joint may fit well by chance, so the variance needs a lower bound. The
    # bound is relative to the effort, because a common bound exceeded the noise of the wrist.
    squares = np.sum(residual**2, axis=0) / max(len(residual) - 2.0, 1.0)
    size = np.mean(target**2, axis=0) + 1e-12
    return np.asarray(squares + LEAST_NOISE * np.median(squares / size) * size + 1e-12)


def _second_moment(x: Floats) -> float:
    """Return the expected second moment about an axis [kg m^2]."""
    return float(max(x[0], LIGHTEST) * RADIUS**2)


def _variances(fit: _Fit) -> Floats:
    """Return the variances of mass and centre of mass, shape (4,)."""
    mass = fit.x[0] if abs(fit.x[0]) > 1e-6 else 1e-6
    slope = np.eye(4) / mass
    slope[0, 0] = 1.0
    slope[1:, 0] = -fit.x[1:4] / mass**2
    return np.asarray(np.diagonal(slope @ fit.covariance[:4, :4] @ slope.T).copy())
