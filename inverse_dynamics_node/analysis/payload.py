"""
The payload that a robot carries, from recordings with and without it.

The efforts of two runs of one motion differ by those of the payload, which are linear in its ten
inertial parameters. Wrong links, friction and offsets are in both runs, and cancel. Without an
empty run, the links are unknowns as well, with the usual errors of robot descriptions. What these
errors could add to the payload is then part of the standard error.
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
    BASIS,
    moved_inside,
    PARAMETERS,
    parameters_of_pseudo_inertias,
    pseudo_inertias,
    rigid_body,
    RigidBody,
)
from .columns import body_columns, direction_of, payload_columns, SECOND_MOMENTS
from .identification.fit import weights_of
from .identification.preparation import measured_joints, prepare_all
from .recordings.resampling import pieces, resampler
from .recordings.signals import Motion, Recording

STILL = 0.01  # [rad/s or m/s]; below this speed of all joints the arm rests
LEAST_REST = 0.5  # [s] in a pose
SETTLING = 0.2  # [s] at both ends of a rest that are left out
NEAR = 0.1  # [rad, m, rad/s or m/s]; largest difference between states of both runs
LEAST_MATCHED = 0.5  # fraction of the loaded run that has to be in the empty run too
WINDOW = 0.15  # [s] of smoothing
BLOCKS = 10  # contiguous parts whose spread is part of the standard errors
WIDTH = 0.05  # [rad/s or m/s] over which Coulomb friction is smoothed
GAIN = 0.01  # relative error of the gain of each measured effort
GAIN_ALONE = 0.05  # the same without an empty run, where it acts on the weight of the arm
LINK_ERROR = 0.15  # relative error of the masses of links, and of their distribution
APPARENT = 0.25  # [kg] that empty arms seem to carry; 0.02 to 1.5 on real ones
REACH_OF_LINKS = 0.1  # [m] from the link to where this seems to be
RADIUS = 0.05  # [m]; radius of gyration of a payload, where the recording does not show it
REACH = 0.5  # [m] within which the centre of mass of a payload is
MOST_COM_ERROR = 0.05  # [m]; coordinates with a larger standard error are unknown
CERTAIN = 3.0  # standard errors that a mass has to be above zero
LIGHTEST = 0.1  # [kg]; the extent of lighter payloads does not matter
_SMALLEST = 1e-6  # [kg]
_ROUNDS, _STEPS = 6, 2


@dataclass(frozen=True, eq=False)
class PayloadEstimate:
    """A measured payload, and its standard errors."""

    link: str
    """Link that carries it."""
    body: RigidBody
    """In the frame of the link, always physical; see `unknown`."""
    mass_error: float
    """[kg]."""
    com_error: Floats
    """Shape (3,) [m]."""
    shows_inertia: bool
    """Whether the inertia was measured; otherwise that of a ball is assumed."""
    joint_names: tuple[str, ...]
    """The m joints with measured efforts."""
    times: Floats
    """Shape (R,) [s]."""
    measured: Floats
    """Efforts that are neither those of the empty arm nor of friction, shape (R, m) [N m or N]."""
    fitted: Floats
    """Efforts of the payload, shape (R, m) [N m or N]."""
    duration: float
    """Duration of the part of the loaded run that was used [s]."""
    poses: int
    """Number of poses in which the arm rested; 0 for a motion."""
    matched: float
    """Fraction of the loaded run that is in the empty run too; NaN without an empty run."""

    @property
    def residuals(self) -> Floats:
        """Efforts that are not explained, shape (R, m) [N m or N]."""
        return self.measured - self.fitted

    @property
    def unknown(self) -> tuple[str, ...]:
        """Coordinates of the centre of mass that the recordings do not show."""
        large = self.com_error > MOST_COM_ERROR
        return tuple(axis for axis, is_large in zip('xyz', large, strict=True) if is_large)

    @property
    def is_certain(self) -> bool:
        """Whether there is a payload."""
        return bool(self.body.mass > CERTAIN * self.mass_error)


class _Samples(NamedTuple):
    """States of the robot with n joints, and efforts of m joints, at k times."""

    times: Floats
    states: tuple[Floats, Floats, Floats]
    efforts: Floats

    def at(self, index: Integers) -> _Samples:
        q, qd, qdd = (signal[index] for signal in self.states)
        return _Samples(self.times[index], (q, qd, qdd), self.efforts[index])


class _Rows(NamedTuple):
    """Rows of the regression of m joints, shape (R, m, ...) each, except times and blocks."""

    times: Floats
    """(R,) [s]."""
    payload: Floats
    """(R, m, 10)."""
    links: Floats
    """(R, m, 10 b); b is 0 if there is an empty run."""
    terms: Floats
    """Of each joint alone, (R, m, t): offset, drift, friction."""
    arm: Floats
    """Modelled efforts of the arm, which a wrong gain multiplies too."""
    target: Floats
    """Efforts to explain."""
    block: Integers
    """Contiguous part that a row belongs to, shape (R,)."""

    def where(self, chosen: Booleans) -> _Rows:
        """Return some of the rows."""
        return self._replace(**{name: values[chosen] for name, values in self._asdict().items()})


def measure_payload(
    robot: RobotModel,
    loaded: Recording,
    empty: Recording | None,
    link: str,
    gravity: Floats | Sequence[float],
) -> PayloadEstimate:
    """
    Measure the payload on a link.

    Parameters
    ----------
    robot : RobotModel
        The robot without the payload.
    loaded, empty : Recording
        The same motion, or the same poses, with and without the payload; without an empty
        recording, the robot description has to be right.
    link : str
        Link that carries the payload.
    gravity : array_like, shape (3,)
        Free-fall acceleration in the frame of the base link [m/s^2].

    Raises
    ------
    RecordingError
        If a recording is too short, or the runs have too few states in common.

    """
    runs = [loaded] if empty is None else [loaded, empty]
    joints = measured_joints(robot, runs)
    prepared, _ = prepare_all(robot, runs, joints)
    motions = [run.motion for run in prepared]
    dynamics = InverseDynamics(robot, gravity)
    dynamics.set_friction(0.0, 0.0)
    rests = [_rests(motion) for motion in motions]
    is_still = all(_is_still(motion, own) for motion, own in zip(motions, rests, strict=True))
    if is_still:
        loaded_samples, *others = (
            _poses(motion, own) for motion, own in zip(motions, rests, strict=True)
        )
    else:
        loaded_samples, *others = (
            _Samples(m.times, (m.q, m.qd, m.qdd), m.efforts) for m in motions
        )
    is_near, partners = np.ones(len(loaded_samples.times), dtype=bool), None
    if others:
        index, is_near = _match(robot, loaded_samples, others[0])
        partners = others[0].at(index)
        if np.mean(is_near) < LEAST_MATCHED:
            raise RecordingError(
                f'the empty run is another motion: {np.mean(is_near):.0%} of the loaded run passes'
                f' within {NEAR:g} rad (m) and {NEAR:g} rad/s (m/s) of it, expected at least '
                f'{LEAST_MATCHED:.0%}; run the same motion, or the same poses, twice'
            )
    motion = None if is_still else motions[0]
    rows = _rows(dynamics, link, joints, loaded_samples, partners, is_near, motion)
    fit = _Fit(rows, robot, is_still)
    return fit.estimate(
        link,
        tuple(robot.joint_names[j] for j in joints),
        float(np.ptp(rows.times)),
        len(rows.times) if is_still else 0,
        float(np.mean(is_near)) if others else math.nan,
    )


# ---- Samples -------------------------------------------------------------------------------


def _rests(motion: Motion) -> list[slice]:
    """Return the parts in which the arm rests in a pose."""
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


def _is_still(motion: Motion, rests: Sequence[slice]) -> bool:
    return bool(sum(each.stop - each.start for each in rests) > 0.5 * len(motion.times))


def _poses(motion: Motion, rests: Sequence[slice]) -> _Samples:
    """Return the mean of each rest; joints do not move in it."""
    q, efforts = (
        np.array([np.mean(signal[each], axis=0) for each in rests])
        for signal in (motion.q, motion.efforts)
    )
    times = np.array([float(np.mean(motion.times[each])) for each in rests])
    return _Samples(times, (q, np.zeros_like(q), np.zeros_like(q)), efforts)


def _match(robot: RobotModel, loaded: _Samples, empty: _Samples) -> tuple[Integers, Booleans]:
    """Return the nearest empty sample of each loaded one, and whether it is near."""
    from scipy.spatial import cKDTree

    q, q_empty = loaded.states[0], empty.states[0].copy()
    turns = np.round((np.mean(q, axis=0) - np.mean(q_empty, axis=0)) / (2.0 * np.pi))
    q_empty += np.where(robot.is_continuous, 2.0 * np.pi * turns, 0.0)
    points = np.hstack([q, loaded.states[1]])
    others = np.hstack([q_empty, empty.states[1]])
    _, index = cKDTree(others).query(points)
    return index, np.asarray((np.abs(points - others[index]) < NEAR).all(axis=1))


def _rows(
    dynamics: InverseDynamics,
    link: str,
    joints: Sequence[int],
    loaded: _Samples,
    empty: _Samples | None,
    is_near: Booleans,
    motion: Motion | None,
) -> _Rows:
    """Return the rows of the regression; the motion is that of the loaded run, if it moves."""
    robot = dynamics.robot
    payload = payload_columns(robot, dynamics.gravity, link, loaded.states)[:, joints]
    target = loaded.efforts - dynamics.efforts(*loaded.states)[:, joints]
    arm, load = loaded.efforts - target, np.abs(loaded.efforts)
    links = np.zeros((*target.shape, 0))
    if empty is None:
        bodies = np.flatnonzero(robot.mass[1:] > 0.0) + 1
        links = body_columns(dynamics, loaded.states, bodies.tolist())[:, joints]
    else:
        target = target - (empty.efforts - dynamics.efforts(*empty.states)[:, joints])
        arm, load = np.zeros_like(target), load - np.abs(empty.efforts)
    ones = np.ones_like(target)
    times = loaded.times
    if motion is None:  # at rest, friction is a part of the offset
        block: Integers = np.arange(len(times))
        rows = _Rows(times, payload, links, ones[..., None], arm, target, block)
        return rows.where(is_near)
    smooth = resampler(motion, WINDOW)
    place = (times - times[0]) / float(np.ptp(times))  # 0 to 1
    speed = loaded.states[1][:, joints]
    direction = direction_of(speed, WIDTH)
    continuous = [ones, ones * place[:, None], speed]
    if empty is None:
        continuous.append(loaded.states[2][:, joints])
    terms = [
        smooth(np.stack(continuous, -1)),
        smooth.discontinuous(np.stack([direction, load * direction], -1)),
    ]
    block = np.minimum(smooth(place) * BLOCKS, BLOCKS - 1).astype(int)
    both = smooth(np.concatenate([payload, links], -1))
    rows = _Rows(
        smooth.times,
        both[..., :PARAMETERS],
        both[..., PARAMETERS:],
        np.concatenate(terms, -1),
        smooth(arm),
        smooth(target),
        block,
    )
    used = smooth(is_near.astype(float)) > 1.0 - 1e-6
    return rows.where(used)


# ---- The fit -------------------------------------------------------------------------------


class _Fit:
    """
    Least squares for payload, links and joints, with what is known of them beforehand.

    The unknowns of the payload are its mass m, its first moment h and its second moment S about
    the centre of mass; the efforts are linear in m, h and S + h h^T / m.
    """

    def __init__(self, rows: _Rows, robot: RobotModel, is_still: bool) -> None:
        self.rows, self.is_still = rows, is_still
        _, m, t = rows.terms.shape
        b = rows.links.shape[2]
        self.first, t = PARAMETERS + b, t + 1
        self.size = self.first + t * m
        self.own = [
            np.r_[np.arange(self.first), self.first + t * j + np.arange(t)] for j in range(m)
        ]
        self.gains = np.arange(self.first, self.size, t)
        self.gain_error = GAIN_ALONE if b else GAIN
        self.links_prior = _links_prior(robot) if b else np.zeros((0, 0))
        self.weights = self._weights(rows.target)
        x = np.zeros(self.size)
        x[0], x[4:7] = 1.0, RADIUS**2
        for _ in range(_ROUNDS):
            self._assemble(x)
            matrix, vector = self._normal()
            for _ in range(_STEPS):
                x = self._solve(matrix, vector, x)
            self.weights = self._weights(self._residual(x))
        self.x = x
        # The spread between blocks contains what varies slowly, which residuals hide.
        noise, between = self._noise(), self._between()
        self.weights = self.weights / max(1.0, float(np.mean(between / noise)))
        for _ in range(_STEPS):
            self.x = self._solve(*self._normal(), self.x)

    def _assemble(self, x: Floats) -> None:
        """Collect the columns of each joint and, last, the target; a wrong gain is linearised."""
        rows = self.rows
        gain = (rows.arm + rows.payload @ _parameters(x))[..., None]
        table = np.concatenate(
            [rows.payload, rows.links, gain, rows.terms, rows.target[..., None]], -1
        )
        self.tables = [np.ascontiguousarray(table[:, j]) for j in range(table.shape[1])]
        self.products = {
            int(block): [A[rows.block == block].T @ A[rows.block == block] for A in self.tables]
            for block in np.unique(rows.block)
        }

    def _weights(self, residual: Floats) -> Floats:
        if not self.is_still:
            return weights_of(residual)
        freedom = max(len(residual) - 2.0, 1.0)
        squares = np.sum(residual**2, axis=0) / freedom
        return np.asarray(1.0 / (squares + 0.05 * np.mean(squares) + 1e-12))

    def _residual(self, x: Floats) -> Floats:
        factors = np.r_[-_parameters(x), -x[PARAMETERS:], 1.0]
        return np.column_stack(
            [A @ factors[np.r_[own, -1]] for A, own in zip(self.tables, self.own, strict=True)]
        )

    def _normal(self, without: int | None = None) -> tuple[Floats, Floats]:
        """Return matrix and vector of the normal equations, without one of the blocks."""
        matrix, vector = np.zeros((self.size, self.size)), np.zeros(self.size)
        for block, products in self.products.items():
            for own, weight, product in zip(self.own, self.weights, products, strict=True):
                if block != without:
                    matrix[np.ix_(own, own)] += weight * product[:-1, :-1]
                    vector[own] += weight * product[:-1, -1]
        return matrix, vector

    def _linearised(self, matrix: Floats, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the matrix for the unknowns near x, with their prior, and the prior's mean."""
        slope = np.eye(self.size)
        slope[:PARAMETERS, :PARAMETERS] = _slope(x)
        mass = max(x[0], LIGHTEST)
        moment = mass * RADIUS**2
        mean = np.zeros(self.size)
        mean[4:7] = moment
        precision = np.zeros(self.size)
        precision[0] = 1e-6
        precision[1:4] = 1.0 / (REACH * mass) ** 2
        precision[4:10] = 1.0 / moment**2
        precision[self.first :] = 1e-9 * (np.diagonal(matrix)[self.first :] + 1e-9)
        precision[self.gains] = 1.0 / self.gain_error**2
        known = slope.T @ matrix @ slope + np.diag(precision)
        links = slice(PARAMETERS, self.first)
        known[links, links] += self.links_prior
        return slope, known, precision * mean

    def _solve(self, matrix: Floats, vector: Floats, x: Floats) -> Floats:
        slope, known, prior = self._linearised(matrix, x)
        shift = np.zeros(self.size)
        shift[:PARAMETERS] = _parameters(x) - slope[:PARAMETERS, :PARAMETERS] @ x[:PARAMETERS]
        right = slope.T @ (vector - matrix @ shift) + prior
        found = np.linalg.solve(known, right)
        return np.asarray(found)

    def _noise(self) -> Floats:
        """Return the variances due to noise, without those of gains and links, shape (4,)."""
        _, known, _ = self._linearised(self._normal()[0], self.x)
        own = np.setdiff1d(np.r_[:PARAMETERS, self.first : self.size], self.gains)
        return _variance(np.asarray(np.linalg.inv(known[np.ix_(own, own)])), self.x)

    def _between(self) -> Floats:
        """Return the variances from the spread of fits without one block each, shape (4,)."""
        if len(self.products) < 2:
            return np.zeros(4)
        others = [_solution(self._solve(*self._normal(k), self.x)) for k in self.products]
        spread = np.array(others) - np.mean(others, axis=0)
        return np.asarray((1.0 - 1.0 / len(others)) * np.sum(spread**2, axis=0))

    def estimate(
        self, link: str, names: tuple[str, ...], duration: float, poses: int, matched: float
    ) -> PayloadEstimate:
        """Return the payload with its standard errors."""
        inverse: Floats = np.asarray(np.linalg.inv(self._linearised(self._normal()[0], self.x)[1]))
        variance = _variance(inverse, self.x)
        if len(self.links_prior):
            offset = REACH_OF_LINKS / max(self.x[0], LIGHTEST)
            variance += (APPARENT * np.array([1.0, offset, offset, offset])) ** 2
        errors = np.sqrt(variance)
        second = 4 + np.arange(3)
        moment = max(self.x[0], LIGHTEST) * RADIUS**2
        shown = bool(np.sqrt(np.trace(inverse[np.ix_(second, second)])) < 0.5 * moment)
        efforts = self.rows.payload @ _parameters(self.x)
        return PayloadEstimate(
            link,
            _body(self.x),
            float(errors[0]),
            errors[1:],
            shown,
            names,
            self.rows.times,
            efforts + self._residual(self.x),
            efforts,
            duration,
            poses,
            matched,
        )


def _links_prior(robot: RobotModel) -> Floats:
    """
    Return the inverse covariance of the changes of links with mass, shape (10 b, 10 b).

    It is the curvature of the entropic divergence between bodies, which depends on neither units
    nor frames, see `identification.fit`.

    """
    from scipy.linalg import block_diag

    blocks = []
    for body in np.flatnonzero(robot.mass[1:] > 0.0) + 1:
        link = RigidBody(robot.mass[body], robot.com[body], robot.inertia[body])
        changes = np.linalg.inv(pseudo_inertias(moved_inside(link.parameters()))) @ BASIS
        blocks.append(np.einsum('kij,lji->kl', changes, changes) / LINK_ERROR**2)
    return np.asarray(block_diag(*blocks))


def _parameters(x: Floats) -> Floats:
    """Return the factors of `payload_columns`, shape (10,)."""
    outer = np.outer(x[1:4], x[1:4]) / max(x[0], LIGHTEST)
    return np.asarray(np.r_[x[:4], x[4:10] + [outer[i, j] for i, j in SECOND_MOMENTS]])


def _slope(x: Floats) -> Floats:
    """Return the derivatives of `_parameters`, shape (10, 10)."""
    slope = np.eye(PARAMETERS)
    m, h = max(x[0], LIGHTEST), x[1:4]
    for row, (i, j) in enumerate(SECOND_MOMENTS, start=4):
        slope[row, 0] = -h[i] * h[j] / m**2 * (x[0] > LIGHTEST)
        slope[row, 1 + i] += h[j] / m
        slope[row, 1 + j] += h[i] / m
    return slope


def _solution(x: Floats) -> Floats:
    """Return mass and centre of mass, shape (4,)."""
    return np.asarray(np.r_[x[0], x[1:4] / _divisor(x)])


def _divisor(x: Floats) -> float:
    """Return the mass, or a small one in place of none."""
    return float(x[0]) if abs(x[0]) > _SMALLEST else _SMALLEST


def _variance(covariance: Floats, x: Floats) -> Floats:
    """Return the variances of mass and centre of mass, shape (4,)."""
    slope = np.zeros((4, 4))
    slope[0, 0] = 1.0
    slope[1:, 0] = -x[1:4] / _divisor(x) ** 2
    slope[1:, 1:] = np.eye(3) / _divisor(x)
    return np.asarray(np.diagonal(slope @ covariance[:4, :4] @ slope.T).copy())


def _body(x: Floats) -> RigidBody:
    matrix = np.zeros((4, 4))
    p = _parameters(x)
    matrix[3, 3], matrix[3, :3], matrix[:3, 3] = p[0], p[1:4], p[1:4]
    for value, (i, j) in zip(p[4:], SECOND_MOMENTS, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return rigid_body(moved_inside(parameters_of_pseudo_inertias(matrix)))
