"""
Measures a payload from recordings with and without the payload.

The robot repeats the same motion in a loaded run and in an empty run. The difference between
their efforts is due to the payload, because friction, offsets and errors in link masses cancel.
The efforts are linear in the ten inertial parameters of the payload.

Without an empty run, the inertial parameters of the links are estimated as well. A prior allows
for the usual errors in robot descriptions. These errors increase the standard errors of the
payload.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import RecordingError
from ..robot.model import Booleans, Floats, Integers, RobotModel
from ..robot.rigid_body import (
    moved_inside,
    PARAMETERS,
    parameters_of_pseudo_inertias,
    rigid_body,
    RigidBody,
)
from .columns import body_columns, moment_matrices, payload_columns, SECOND_MOMENTS
from .identification.fit import Prior, weights_of
from .identification.preparation import measured_joints, prepare_all
from .recordings.resampling import pieces, Resampler, resampler
from .recordings.signals import Motion, Recording

STILL = 0.01  # [rad/s or m/s]; the arm rests while all joints are slower
LEAST_REST = 0.5  # [s]; shortest rest in a pose
SETTLING = 0.2  # [s]; removed at both ends of a rest
NEAR = 0.1  # [rad, m, rad/s or m/s]; largest difference between matching states
LEAST_MATCHED = 0.5  # smallest fraction of the loaded run with a match in the empty run
WINDOW = 0.15  # [s]; smoothing window
BLOCKS = 10  # number of contiguous blocks for jackknife estimates
WIDTH = 0.05  # [rad/s or m/s]; speed over which Coulomb friction is smoothed
GAIN = 0.01  # relative error of the gain of each measured effort
GAIN_ALONE = 0.05  # the same without an empty run, when the gain also scales the arm's weight
LINK_ERROR = 0.15  # relative error of link masses and mass distributions
APPARENT = 0.25  # [kg]; apparent payload of an empty arm, 0.02 to 1.5 on real arms
REACH_OF_LINKS = 0.1  # [m]; distance of the apparent payload from the link
RADIUS = 0.05  # [m]; assumed radius of gyration of a payload
REACH = 0.5  # [m]; expected distance of the centre of mass from the origin of the link
MOST_COM_ERROR = 0.05  # [m]; a coordinate with a larger standard error is unknown
CERTAIN = 3.0  # a payload is certain if its mass exceeds this many standard errors
LIGHTEST = 0.1  # [kg]; lower bound of the mass in priors and second moments
LEAST_NOISE = 0.05  # lower bound of relative squared residuals, as a fraction of the median
_SMALLEST = 1e-6  # [kg]
_ROUNDS, _STEPS = 6, 2


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
    """Fraction of the loaded run that matches the empty run; NaN without an empty run."""

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


class _Rows(NamedTuple):
    """Rows of the payload regression."""

    times: Floats
    """Times of the rows, shape (rows,) [s]."""
    payload: Floats
    """Columns of the payload, shape (rows, joints, 10)."""
    links: Floats
    """Columns of the links, shape (rows, joints, 10 per link); none if there is an empty run."""
    terms: Floats
    """Columns of friction and other joint terms, shape (rows, joints, terms)."""
    arm: Floats
    """Modelled efforts of the arm, shape (rows, joints); zero if there is an empty run."""
    target: Floats
    """Efforts to explain, shape (rows, joints)."""
    block: Integers
    """Block index of each row, shape (rows,)."""

    def where(self, chosen: Booleans) -> _Rows:
        """Return the chosen rows."""
        return self._replace(**{name: values[chosen] for name, values in self._asdict().items()})


def measure_payload(
    robot: RobotModel,
    loaded: Recording,
    empty: Recording | None,
    link: str,
    gravity: Floats | Sequence[float],
) -> PayloadEstimate:
    """
    Measure the payload on a link from recordings with and without the payload.

    Both recordings must contain the same motion, or the same poses. Without the `empty` recording,
    a prior allows for the usual errors in link masses, so the standard errors are larger. The
    robot model must not contain the payload. `gravity` is the free-fall acceleration in the base
    frame [m/s^2]. Raises RecordingError if a recording is too short, or if the two motions differ.

    """
    runs = [loaded] if empty is None else [loaded, empty]
    joints = measured_joints(robot, runs)
    motions = [run.motion for run in prepare_all(robot, runs, joints)[0]]
    dynamics = InverseDynamics(robot, gravity)
    dynamics.set_friction(0.0, 0.0)
    rests = [_rests(motion) for motion in motions]
    is_still = all(
        sum(each.stop - each.start for each in own) > 0.5 * len(motion.times)
        for motion, own in zip(motions, rests, strict=True)
    )
    smooth = None if is_still else resampler(motions[0], WINDOW)
    if is_still:
        motions = list(map(_poses, motions, rests))
    partner, is_near, matched = None, np.ones(len(motions[0].times), dtype=bool), math.nan
    if empty is not None:
        partner, is_near = _partner(robot, *motions)
        matched = float(np.mean(is_near))
    rows = _rows(dynamics, link, joints, motions[0], partner, smooth)
    if smooth is not None:
        is_near = smooth(is_near.astype(float)) > 1.0 - 1e-6
    rows = rows.where(is_near)
    prior = _prior_of_links(robot) if empty is None else np.zeros((0, 0))
    fit = _Fit(rows, prior, GAIN_ALONE if empty is None else GAIN)
    covariance, _ = fit.covariances()
    variances = _variance(covariance, fit.x)
    if empty is None:
        offset = REACH_OF_LINKS / max(fit.x[0], LIGHTEST)
        variances += (APPARENT * np.array([1.0, offset, offset, offset])) ** 2
    errors = np.sqrt(variances)
    fitted, moments = rows.payload @ _parameters(fit.x), moment_matrices(_parameters(fit.x))
    return PayloadEstimate(
        link,
        rigid_body(moved_inside(parameters_of_pseudo_inertias(moments))),
        float(errors[0]),
        errors[1:],
        _shows_inertia(covariance, fit.x),
        tuple(robot.joint_names[j] for j in joints),
        rows.times,
        fitted + fit.residual(),
        fitted,
        float(np.ptp(rows.times)),
        len(rows.times) if is_still else 0,
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
    loaded: Motion,
    empty: Motion | None,
    smooth: Resampler | None,
) -> _Rows:
    """Build the rows of the regression; states at rest are not smoothed."""
    robot, states = dynamics.robot, (loaded.q, loaded.qd, loaded.qdd)
    payload = payload_columns(robot, dynamics.gravity, link, states)[:, joints]
    modelled, load = dynamics.efforts(*states)[:, joints], np.abs(loaded.efforts)
    target, arm = loaded.efforts - modelled, modelled
    links = np.zeros((*target.shape, 0))
    if empty is None:
        links = body_columns(dynamics, states, _with_mass(robot))[:, joints]
    else:
        of_empty = dynamics.efforts(empty.q, empty.qd, empty.qdd)[:, joints]
        target, arm = target - (empty.efforts - of_empty), np.zeros_like(target)
        load = load - np.abs(empty.efforts)
    ones = np.ones_like(target)
    if smooth is None:  # at rest, the offset contains the friction
        block = np.arange(len(target))
        return _Rows(loaded.times, payload, links, ones[..., None], arm, target, block)
    place = (loaded.times - loaded.times[0]) / float(np.ptp(loaded.times))  # 0 to 1
    speed = loaded.qd[:, joints]
    direction = np.tanh(speed / WIDTH)
    continuous = [ones, ones * place[:, None], speed]
    if empty is None:
        continuous.append(loaded.qdd[:, joints])
    terms = [
        smooth(np.stack(continuous, -1)),
        smooth.discontinuous(np.stack([direction, load * direction], -1)),
    ]
    return _Rows(
        smooth.times,
        smooth(payload),
        smooth(links),
        np.concatenate(terms, -1),
        smooth(arm),
        smooth(target),
        np.minimum(smooth(place) * BLOCKS, BLOCKS - 1).astype(int),
    )


def _with_mass(robot: RobotModel) -> list[int]:
    return [body for body in range(1, len(robot.mass)) if robot.mass[body] > 0.0]


def _prior_of_links(robot: RobotModel) -> Floats:
    """Return the prior precision matrix for the inertial parameters of the links."""
    links = [
        moved_inside(RigidBody(robot.mass[k], robot.com[k], robot.inertia[k]).parameters())
        for k in _with_mass(robot)
    ]
    nominal = np.reshape(links, (-1, PARAMETERS))
    weights, none = np.full(len(links), LINK_ERROR**-2), np.zeros(0)
    divergence = Prior(nominal, weights, none.astype(int), none, none)
    return divergence.derivatives(nominal.ravel())[1]


# ---- The fit -------------------------------------------------------------------------------


class _Fit:
    """
    Least-squares fit of payload, links and joints, with a prior for all unknowns.

    The unknowns of the payload are the mass m, the first moment h, and the second moment S about
    the centre of mass. The efforts are linear in m, h and S + h h^T / m.

    """

    def __init__(self, rows: _Rows, prior_of_links: Floats, gain_error: float) -> None:
        self.rows, self.prior_of_links, self.gain_error = rows, prior_of_links, gain_error
        count, m, t = rows.terms.shape
        self.first = PARAMETERS + rows.links.shape[2]
        self.size = self.first + m * (1 + t)
        self.joint = np.arange(m)
        self.gains = self.first + self.joint * (1 + t)
        own = np.zeros((count, m, m, 1 + t))
        own[:, self.joint, self.joint, 1:] = rows.terms
        parts = rows.payload, rows.links, own.reshape(count, m, -1), rows.target[..., None]
        self.table = np.concatenate(parts, -1)
        self.x = np.zeros(self.size)
        self.x[0], self.x[4:7] = 1.0, RADIUS**2
        residual = rows.target
        for _ in range(_ROUNDS):
            self._assemble()
            self.weights = self._weights(residual)
            self.x = self._solution()
            residual = self.residual()
        self.weights = self._weights(residual)
        # The spread between blocks reveals slow changes that residuals hide. Each fit without a
        # block estimates the gains again, so the spread is compared with the variance for unknown
        # gains. The smaller variance for known gains would make the standard errors too large.
        ratio = self._between() / _variance(self.covariances()[1], self.x)
        self.weights = self.weights / max(1.0, float(np.mean(ratio)))
        self.x = self._solution()

    def _assemble(self) -> None:
        """Linearise the model in the gains, and build normal equations per block and joint."""
        rows = self.rows
        gain = rows.arm + rows.payload @ _parameters(self.x)
        self.table[:, self.joint, self.gains] = gain
        parts = (self.table[rows.block == k].swapaxes(0, 1) for k in np.unique(rows.block))
        self.products = np.array([part.swapaxes(1, 2) @ part for part in parts])

    def _weights(self, residual: Floats) -> Floats:
        """Return the inverse residual variance of each joint."""
        if len(self.products) < len(self.rows.times):
            return weights_of(residual)
        # With few poses, a joint may fit well by chance, so the variance needs a lower bound. The
        # bound is relative to the effort, because a common bound exceeded the noise of the wrist.
        squares = np.sum(residual**2, axis=0) / max(len(residual) - 2.0, 1.0)
        size = np.mean(self.rows.target**2, axis=0) + 1e-12
        least = LEAST_NOISE * np.median(squares / size) * size
        return np.asarray(1.0 / (squares + least + 1e-12))

    def residual(self) -> Floats:
        """Return the efforts that the fit does not explain, shape (rows, joints)."""
        factors = np.r_[-_parameters(self.x), -self.x[PARAMETERS:], 1.0]
        return np.asarray(self.table @ factors)

    def _normal(self, without: int | None = None) -> tuple[Floats, Floats]:
        """Return matrix and vector of the normal equations, for all blocks except `without`."""
        chosen = np.arange(len(self.products)) != without
        sums = np.tensordot(self.weights, np.sum(self.products[chosen], axis=0), 1)
        return sums[:-1, :-1], sums[:-1, -1]

    def _near(self, x: Floats, matrix: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the parameter derivatives at x, and the precision and mean of the prior."""
        slope = np.eye(self.size)
        slope[:PARAMETERS, :PARAMETERS] = _slope(x)
        mass = max(x[0], LIGHTEST)
        moment = mass * RADIUS**2
        mean = np.zeros(self.size)
        mean[4:7] = moment
        precision = 1e-9 * (np.diagonal(matrix) + 1e-9)
        precision[0] = 1e-6
        precision[1:4] = 1.0 / (REACH * mass) ** 2
        precision[4:10] = 1.0 / moment**2
        precision[self.gains] = 1.0 / self.gain_error**2
        known = np.diag(precision)
        links = slice(PARAMETERS, self.first)
        known[links, links] += self.prior_of_links
        return slope, known, mean

    def _solution(self, without: int | None = None) -> Floats:
        """Solve the linearised normal equations, for all blocks except `without`."""
        (matrix, vector), x = self._normal(without), self.x
        for _ in range(_STEPS):
            slope, known, mean = self._near(x, matrix)
            shift = np.zeros(self.size)
            shift[:PARAMETERS] = _parameters(x) - slope[:PARAMETERS, :PARAMETERS] @ x[:PARAMETERS]
            right = slope.T @ (vector - matrix @ shift) + known @ mean
            x = np.linalg.solve(slope.T @ matrix @ slope + known, right)
        return np.asarray(x)

    def covariances(self) -> tuple[Floats, Floats]:
        """Return the covariance of the unknowns, and its part due to noise."""
        matrix, _ = self._normal()
        slope, known, _ = self._near(self.x, matrix)
        data = slope.T @ matrix @ slope
        whole: Floats = np.asarray(np.linalg.inv(data + known))
        return whole, whole @ data @ whole

    def _between(self) -> Floats:
        """Return jackknife variances of mass and centre of mass, shape (4,)."""
        count = len(self.products)
        if count < 2:
            return np.zeros(4)
        others = [self._solution(k) for k in range(count)]
        mass_and_com = [np.r_[x[0], x[1:4] / _divisor(x)] for x in others]
        return np.asarray((count - 1) * np.var(mass_and_com, axis=0))


def _parameters(x: Floats) -> Floats:
    """Convert the unknowns x to the parameters of `payload_columns`, shape (10,)."""
    outer = np.outer(x[1:4], x[1:4]) / max(x[0], LIGHTEST)
    return np.asarray(np.r_[x[:4], x[4:10] + [outer[i, j] for i, j in SECOND_MOMENTS]])


def _slope(x: Floats) -> Floats:
    """Return the derivatives of `_parameters` with respect to the unknowns, shape (10, 10)."""
    slope = np.eye(PARAMETERS)
    m, h = max(x[0], LIGHTEST), x[1:4]
    for row, (i, j) in enumerate(SECOND_MOMENTS, start=4):
        slope[row, 0] = -h[i] * h[j] / m**2 * (x[0] > LIGHTEST)
        slope[row, 1 + i] += h[j] / m
        slope[row, 1 + j] += h[i] / m
    return slope


def _divisor(x: Floats) -> float:
    """Return the mass, or a small positive mass if the mass is near zero."""
    return float(x[0]) if abs(x[0]) > _SMALLEST else _SMALLEST


def _variance(covariance: Floats, x: Floats) -> Floats:
    """Return the variances of mass and centre of mass, shape (4,)."""
    slope = np.zeros((4, 4))
    slope[0, 0] = 1.0
    slope[1:, 0] = -x[1:4] / _divisor(x) ** 2
    slope[1:, 1:] = np.eye(3) / _divisor(x)
    return np.asarray(np.diagonal(slope @ covariance[:4, :4] @ slope.T).copy())


def _shows_inertia(covariance: Floats, x: Floats) -> bool:
    """Return whether the measurement clearly improves on the prior of the second moments."""
    moment = max(x[0], LIGHTEST) * RADIUS**2
    return bool(np.sqrt(np.trace(covariance[4:7, 4:7])) < 0.5 * moment)
