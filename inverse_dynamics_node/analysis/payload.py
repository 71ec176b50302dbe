"""
Measures a payload from recordings with and without the payload.

The robot repeats the same motion in a loaded run and in an empty run. The difference between
their efforts is due to the payload, because friction, offsets and errors in link masses cancel.
The efforts are linear in the ten inertial parameters of the payload, which a least-squares fit
determines.

What does not cancel is unknown too: changes of friction, offsets and gains between the runs, and
the gains of the measured efforts. Joints that disagree about the payload show how wrong the gains
are. If all gains are wrong by the same factor, the efforts of the empty arm differ from those of
its description by this factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import ConfigurationError, RecordingError
from ..robot.kinematics import whole_turns
from ..robot.model import Booleans, Floats, RobotModel
from ..robot.rigid_body import (
    moved_inside,
    PARAMETERS,
    parameters_of_pseudo_inertias,
    rigid_body,
    RigidBody,
)
from .columns import (
    body_columns,
    moment_matrices,
    payload_columns,
    SECOND_MOMENTS,
    usual_errors,
)
from .identification.preparation import measured_joints, prepare_all
from .recordings.resampling import Resampler, resampler
from .recordings.signals import Motion, Recording

NEAR = 0.1  # [rad, m, rad/s or m/s]; largest difference between matching states
LEAST_MATCHED = 0.5  # smallest fraction of the loaded run with a match in the empty run
WINDOW = 0.15  # [s]; smoothing window
WIDTH = 0.05  # [rad/s or m/s]; speed over which Coulomb friction is smoothed
DRIFT = 0.01  # relative change of the gain of each measured effort between the runs
GAIN = 0.01  # relative error of these gains, unless the joints disagree
LINK_ERROR = 0.15  # relative error of the masses and mass distributions of links
RADIUS = 0.05  # [m]; assumed radius of gyration of a payload
REACH = 0.5  # [m]; expected distance of the centre of mass from the origin of the link
LEAST_COM_ERROR = 5e-4  # [m]; joints bend, and the frames of links are not exact
MOST_COM_ERROR = 0.05  # [m]; a coordinate with a larger standard error is unknown
CERTAIN = 3.0  # a payload is certain if its mass exceeds this many standard errors
LIGHTEST = 0.1  # [kg]; lower bound of the mass in the expected second moments
HEAVIEST = 1e3  # [kg]; expected size of the mass
_FIRST_GAIN = 0.1  # assumed error of the gains in the first round
_ROUNDS = 10


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
    is_scaled: bool
    """Whether the errors contain a part of ``ratio - 1`` that its error does not explain."""
    joint_names: tuple[str, ...]
    """The joints with measured efforts."""
    times: Floats
    """Times of the samples, shape (samples,) [s]."""
    measured: Floats
    """Measured efforts minus those of arm and friction, shape (samples, joints) [N m or N]."""
    fitted: Floats
    """Efforts of the fitted payload, shape (samples, joints) [N m or N]."""
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
    motion, other = prepare_all(robot, [loaded, empty], joints)
    dynamics = InverseDynamics(robot, gravity)
    dynamics.set_friction(0.0, 0.0)
    smooth = resampler(motion, WINDOW)
    partner, is_near = _partner(robot, motion, other)
    is_matched = smooth(is_near.astype(float)) > 1.0 - 1e-6
    with_load, without = (
        _rows(dynamics, link, joints, run, smooth).where(is_matched) for run in (motion, partner)
    )
    fit = _fit(with_load, without)
    ratio, ratio_error, common = 1.0, math.nan, 0.0
    if has_gravity:
        ratio, ratio_error, weights = _ratio(without, _link_errors(dynamics, joints, partner))
        expected = ratio_error**2 + fit.gain_error**2 * float(weights @ weights)
        common = max((ratio - 1.0) ** 2 - expected, 0.0)  # squared error of all gains
    errors = _errors(fit.x, fit.covariance + common * np.outer(fit.x, fit.x))
    fitted, moments = with_load.payload @ fit.x, moment_matrices(fit.x)
    return PayloadEstimate(
        link,
        rigid_body(moved_inside(parameters_of_pseudo_inertias(moments))),
        float(errors[0]),
        errors[1:],
        bool(np.sqrt(np.trace(fit.covariance[4:7, 4:7])) < 0.5 * _second_moment(fit.x)),
        ratio,
        ratio_error,
        common > 0.0,
        tuple(robot.joint_names[j] for j in joints),
        with_load.times,
        fitted + fit.residual,
        fitted,
        float(np.mean(is_near)),
    )


def _partner(robot: RobotModel, loaded: Motion, empty: Motion) -> tuple[Motion, Booleans]:
    """Return the empty-run state nearest to each loaded state, and whether the two match."""
    from scipy.spatial import cKDTree

    q = empty.q.copy()
    q += whole_turns(np.mean(loaded.q, axis=0) - np.mean(q, axis=0), robot.is_continuous)
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


def _rows(
    dynamics: InverseDynamics,
    link: str,
    joints: Sequence[int],
    run: Motion,
    smooth: Resampler,
) -> _Rows:
    """Build the rows of a run."""
    states = run.q, run.qd, run.qdd
    payload = payload_columns(dynamics.robot, dynamics.gravity, link, states)[:, joints]
    arm, ones = dynamics.efforts(*states)[:, joints], np.ones_like(run.efforts)
    place = (run.times - run.times[0]) / float(np.ptp(run.times))  # 0 to 1
    direction = np.tanh(run.qd[:, joints] / WIDTH)
    continuous = [ones, ones * place[:, None], run.qd[:, joints], run.qdd[:, joints]]
    steps = [direction, np.abs(run.efforts) * direction]
    terms = smooth(np.stack(continuous, -1)), smooth.discontinuous(np.stack(steps, -1))
    return _Rows(
        smooth.times, smooth(payload), np.concatenate(terms, -1), smooth(arm), smooth(run.efforts)
    )


# ---- The empty arm -------------------------------------------------------------------------


def _ratio(empty: _Rows, link_errors: Floats) -> tuple[float, float, Floats]:
    """
    Compare the efforts of the empty arm with the model.

    Returns the ratio of measured to modelled efforts, its standard error, and the weight of each
    joint in the ratio, shape (m,).
    """
    ratios, noises = np.ones((2, len(link_errors)))
    for j in range(len(ratios)):
        columns = np.column_stack([empty.arm[:, j], empty.terms[:, j]])
        products = columns.T @ columns
        inverse = np.linalg.inv(products + 1e-9 * np.diag(np.diagonal(products) + 1e-12))
        solution = inverse @ (columns.T @ empty.efforts[:, j])
        noise = _variance_of_noise(empty.efforts[:, j] - columns @ solution, columns.shape[1])
        ratios[j], noises[j] = solution[0], noise * inverse[0, 0]
    covariance = link_errors @ link_errors.T + np.diag(noises)
    weights = np.linalg.solve(covariance, np.ones(len(ratios)))
    variance = 1.0 / float(np.sum(weights))
    weights = variance * weights
    return float(weights @ ratios), variance**0.5, weights


def _link_errors(dynamics: InverseDynamics, joints: Sequence[int], run: Motion) -> Floats:
    """Return how much the usual error of each parameter of a link changes the ratio of a joint."""
    robot, states = dynamics.robot, (run.q, run.qd, run.qdd)
    columns = body_columns(dynamics, states, range(1, len(robot.mass)))[:, joints]
    arm = dynamics.efforts(*states)[:, joints]
    arm = arm - arm.mean(axis=0)  # an offset contains the mean
    shares = np.einsum('kju,kj->ju', columns, arm) / (np.sum(arm**2, axis=0)[:, None] + 1e-12)
    return np.asarray(shares * usual_errors(robot, LINK_ERROR).ravel())


def _variance_of_noise(residual: Floats, unknowns: int) -> float:
    """Return the variance of correlated residuals, per independent row."""
    count = len(residual)
    lags = np.correlate(residual, residual, 'full')[count - 1 :]
    total = float(2.0 * np.sum(np.cumprod(lags > 0.0) * lags) - lags[0])
    correlated = total / (lags[0] + 1e-12)  # rows per independent row
    return float(total / max(count - unknowns * correlated, 0.1 * count)) + 1e-12


# ---- The fit -------------------------------------------------------------------------------


class _Fit(NamedTuple):
    """The fitted payload."""

    x: Floats
    """Mass, first moments and second moments as in `payload_columns`, shape (10,)."""
    covariance: Floats
    """Covariance of x, shape (10, 10)."""
    gain_error: float
    """Relative error of the gain of each joint."""
    residual: Floats
    """Efforts that the fit does not explain, shape (rows, joints)."""


def _fit(loaded: _Rows, empty: _Rows) -> _Fit:
    """
    Fit the payload to the difference of the runs.

    The unknowns are ten parameters of the payload, and for each joint: the change of the gain
    between the runs, the gain of the payload's efforts, and the terms. The columns of the gains
    contain the fitted efforts of the round before. The usual error of the gains follows from the
    fitted gains of the round before, as in the evidence approximation [1]_.

    References
    ----------
    .. [1] D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4(3), 1992.

    """
    target = loaded.efforts - loaded.arm - (empty.efforts - empty.arm)
    terms = loaded.terms.copy()
    terms[..., -1] -= empty.terms[..., -1]  # friction that grows with the load
    count, m, t = terms.shape
    joint = np.arange(m)
    own = np.zeros((count, m, m, 2 + t))
    own[:, joint, joint, 2:] = terms
    usual = np.array([HEAVIEST] * PARAMETERS + [DRIFT, GAIN, *[math.inf] * t] * m)
    gains = PARAMETERS + 1 + (2 + t) * joint
    usual[gains] = _FIRST_GAIN
    x, residual = np.zeros(len(usual)), target
    for _ in range(_ROUNDS):
        of_payload = loaded.payload @ x[:PARAMETERS]
        own[:, joint, joint, 0] = loaded.arm + of_payload
        own[:, joint, joint, 1] = of_payload
        table = np.concatenate([loaded.payload, own.reshape(count, m, -1)], -1)
        weights = [1.0 / _variance_of_noise(each, t) for each in residual.T]
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
        known = m - np.sum(np.diagonal(covariance)[gains] / usual[gains] ** 2)
        usual[gains] = np.sqrt((GAIN**2 + np.sum(x[gains] ** 2)) / max(known - 1.0, 1.0))
    inner = slice(PARAMETERS)
    return _Fit(x[inner], covariance[inner, inner], float(usual[gains[0]]), residual)


def _second_moment(x: Floats) -> float:
    """Return the expected second moment about an axis [kg m^2]."""
    return float(max(x[0], LIGHTEST) * RADIUS**2)


def _errors(x: Floats, covariance: Floats) -> Floats:
    """Return the standard errors of mass and centre of mass, shape (4,)."""
    mass = x[0] if abs(x[0]) > 1e-6 else 1e-6
    slope = np.eye(4) / mass
    slope[0, 0] = 1.0
    slope[1:, 0] = -x[1:4] / mass**2
    variances = np.diagonal(slope @ covariance[:4, :4] @ slope.T)
    return np.asarray(np.sqrt(variances + LEAST_COM_ERROR**2 * (np.arange(4) > 0)))
