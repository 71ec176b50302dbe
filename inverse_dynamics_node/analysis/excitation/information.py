"""
Computes how accurately the efforts of a motion determine masses and friction.

Efforts are linear in the unknowns: tau = Y(q, qd, qdd) pi + a qdd + d qd + c tanh(qd / w) + o.
The vector pi contains the inertial parameters of the bodies. Each joint has an armature a, a
damping d, a Coulomb friction c that is smoothed over the speed w, and an offset o. Efforts depend
only on certain combinations of inertial parameters, called base parameters. One column of Y is
used for each base parameter.

The matrix W contains these columns of Y and the columns of a, d, c and o, for all samples of a
motion. Each row of W belongs to one measured effort, and is divided by the standard deviation of
its noise. The information matrix is W^T W. The inverse of the information matrix is the covariance
of the unknowns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Floats, Integers
from ..columns import base_parameters, NAMES
from .limits import MotionLimits, random_states, States, whole_states

OF_JOINT = ('armature', 'damping', 'Coulomb', 'offset')
WIDTH = 0.02
"""Width w of smoothed Coulomb friction, as a fraction of the largest speed of the joint."""
_SAMPLES = 400
"""Number of random states that are used to find the base parameters."""
_STATES = 500
"""Number of random states at which the errors of predicted efforts are computed."""
_GROUPS = (slice(0, 1), slice(1, 4), slice(4, 10))
"""Indices of mass, first moments and moments of inertia among the parameters of a body."""


class Unknowns:
    """
    The unknowns that the efforts of the moving joints can determine.

    `noise` is the standard deviation of the measured effort of each moving joint [N m or N].
    `columns` contains the indices of the columns that were selected as unknowns. The full matrix
    has ten columns for each body except the base, followed by one column per moving joint for each
    term in `OF_JOINT`. `scale` contains the RMS of each selected column after division by the
    noise.

    """

    def __init__(self, dynamics: InverseDynamics, limits: MotionLimits, noise: Floats) -> None:
        self.dynamics, self.limits, self.noise = dynamics, limits, noise
        self.width: Floats = WIDTH * limits.speeds
        self.rigid_count = len(NAMES) * (len(dynamics.robot.parent) - 1)
        self.columns: Integers = np.arange(self.rigid_count + len(OF_JOINT) * len(noise))
        self.scale: Floats = np.ones(len(self.columns))
        states = random_states(limits, _SAMPLES, np.random.default_rng(1))
        matrix = self.weighted(states).reshape(-1, len(self.columns))
        sizes = np.sqrt(np.mean(matrix**2, axis=0))
        nonzero = np.flatnonzero(sizes > 1e-12 * np.max(sizes))
        leading = base_parameters(matrix[:, nonzero] / sizes[nonzero]).leading
        self.columns = np.sort(nonzero[leading])
        self.scale = sizes[self.columns]

    def weighted(self, states: States) -> Floats:
        """Return the result of `of_efforts`, divided by noise and scale."""
        return self.of_efforts(states) / (self.noise[:, np.newaxis] * self.scale)

    def of_efforts(self, states: States) -> Floats:
        """Return the effort per unit of each unknown, shape (states, moving joints, unknowns)."""
        Y = self.dynamics.regressor(*whole_states(self.limits, states))
        drive_terms = self._drive_terms(states)
        rigid, own, kind, joint = self._split()
        columns: Floats = np.zeros((*states.q.shape, len(self.columns)))
        columns[:, :, rigid] = Y[:, self.limits.index][:, :, self.columns[rigid]]
        columns[:, joint, own] = drive_terms[kind, :, joint].T
        return columns

    def weighted_sum(self, weights: Floats) -> Callable[[States], Floats]:
        """
        Return a function that computes the sum of `weights * weighted(states)` for each state.

        `weights` has the shape (samples, moving joints, unknowns). The function accepts r states
        per sample, in arrays of shape (r * samples, moving joints). Columns that are not
        selected get a weight of zero, because removing these columns would take longer.

        """
        k, m, _ = weights.shape
        scaled = weights / (self.noise[:, np.newaxis] * self.scale)
        rigid, own, kind, joint = self._split()
        of_bodies = np.zeros((k, len(self.limits.rest), self.rigid_count))
        rows = np.array(self.limits.index)[:, np.newaxis]
        of_bodies[:, rows, self.columns[rigid]] = scaled[:, :, rigid]
        flat = of_bodies.reshape(k, -1)
        of_joints = np.zeros((len(OF_JOINT), k, m))
        of_joints[kind, :, joint] = scaled[:, joint, own].T

        def total(states: States) -> Floats:
            Y = self.dynamics.regressor(*whole_states(self.limits, states)).reshape(
                -1, *flat.shape
            )
            kinds = self._drive_terms(states).reshape(len(OF_JOINT), -1, k, m)
            sums: Floats = np.einsum('rka,ka->rk', Y, flat)
            sums += np.einsum('irkj,ikj->rk', kinds, of_joints)
            return sums.ravel()

        return total

    def _split(self) -> tuple[Integers, Integers, Integers, Integers]:
        """
        Return the indices of body unknowns and of joint unknowns.

        Also returns the term and the joint of each joint unknown.

        """
        is_rigid = self.columns < self.rigid_count
        kind, joint = np.divmod(self.columns[~is_rigid] - self.rigid_count, len(self.noise))
        return np.flatnonzero(is_rigid), np.flatnonzero(~is_rigid), kind, joint

    def _drive_terms(self, states: States) -> Floats:
        """Return efforts per unit of each term in `OF_JOINT`, shape (4, states, moving joints)."""
        step = np.tanh(states.qd / self.width)
        return np.stack([states.qdd, states.qd, step, np.ones_like(step)])


@dataclass(frozen=True, eq=False)
class ExpectedErrors:
    """
    Standard errors of the unknowns due to the assumed noise.

    If the efforts depend only on a combination of parameters, the error of the combination is
    assigned to one of these parameters. The errors of the others are NaN.

    """

    joint_names: tuple[str, ...]
    """Names of the moving joints."""
    noise: Floats
    """Assumed standard deviation of measured efforts, shape (moving joints,) [N m or N]."""
    of_joints: Floats
    """Errors of the terms in `OF_JOINT`, shape (moving joints, 4)."""
    efforts: Floats
    """RMS errors of predicted efforts at random states, shape (moving joints,) [N m or N]."""
    body_names: tuple[str, ...]
    """Names of all bodies except the base."""
    of_bodies: Floats
    """
    Error of mass [kg], and largest errors of first moments [kg m] and inertia [kg m^2].

    The shape is (bodies, 3).
    """
    count: int
    """Number of unknowns."""


def expected_errors(unknowns: Unknowns, information: Floats) -> ExpectedErrors:
    """Compute standard errors from an information matrix, shape (unknowns, unknowns)."""
    limits, covariance = unknowns.limits, np.linalg.inv(information)
    errors = np.sqrt(np.diagonal(covariance)) / unknowns.scale
    m, robot = len(limits.joint_names), unknowns.dynamics.robot
    everything = np.full(unknowns.rigid_count + len(OF_JOINT) * m, np.nan)
    everything[unknowns.columns] = errors
    of_bodies = everything[: unknowns.rigid_count].reshape(-1, len(NAMES))
    groups = [np.where(np.isnan(of_bodies), -1.0, of_bodies)[:, group] for group in _GROUPS]
    largest = np.stack([np.max(group, axis=1) for group in groups], axis=1)
    states = random_states(limits, _STATES, np.random.default_rng(2))
    columns = unknowns.of_efforts(states) / unknowns.scale
    variances = np.einsum('kju,uv,kjv->kj', columns, covariance, columns, optimize=True)
    return ExpectedErrors(
        limits.joint_names,
        unknowns.noise,
        everything[unknowns.rigid_count :].reshape(len(OF_JOINT), m).T,
        np.sqrt(np.mean(variances, axis=0)),
        robot.body_names[1:],
        np.where(largest < 0.0, np.nan, largest),
        len(errors),
    )
