"""
The information that the efforts of a motion contain about masses and friction.

Efforts are linear in the unknowns: tau = Y(q, qd, qdd) pi + a qdd + d qd + c tanh(qd / w) + o.
Only some combinations of the parameters pi of the bodies have an effect, the base parameters: as
many columns of Y are used. With the weighted columns W of a motion, the information is W^T W, and
its inverse is the covariance of the unknowns.
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
"""Width of smoothed Coulomb friction, as a fraction of the largest speed."""
_SAMPLES = 400
"""Random states from which the columns are selected."""
_STATES = 500
"""Random states within the limits for the error of predicted efforts."""
_GROUPS = (slice(0, 1), slice(1, 4), slice(4, 10))
"""Mass, first moments and moments of inertia among the parameters of a body."""


class Unknowns:
    """
    The unknowns that the efforts of the moving joints can determine.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot of n joints and b bodies.
    limits : MotionLimits
        The m joints that move, and their limits.
    noise : ndarray, shape (m,)
        Standard deviation of the measured efforts [N m or N].

    Attributes
    ----------
    columns : ndarray, shape (u,)
        Indices of the selected columns: ten for each body except the base, then m for each of
        `OF_JOINT`.
    scale : ndarray, shape (u,)
        Typical size of the weighted column of each unknown, by which it is divided.

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
        """Return the scaled columns of the unknowns over the noise, shape (k, m, u)."""
        return self.of_efforts(states) / (self.noise[:, np.newaxis] * self.scale)

    def of_efforts(self, states: States) -> Floats:
        """Return the derivatives of the efforts by the unknowns, shape (k, m, u)."""
        Y = self.dynamics.regressor(*whole_states(self.limits, states))
        drive_terms = self._drive_terms(states)
        rigid, own, kind, joint = self._split()
        columns: Floats = np.zeros((*states.q.shape, len(self.columns)))
        columns[:, :, rigid] = Y[:, self.limits.index][:, :, self.columns[rigid]]
        columns[:, joint, own] = drive_terms[kind, :, joint].T
        return columns

    def weighted_sum(self, weights: Floats) -> Callable[[States], Floats]:
        """
        Return a function that sums the entries of `weighted`, each times a weight.

        It does so without selecting columns, which takes longer than the sum.

        Parameters
        ----------
        weights : ndarray, shape (k, m, u)
            A weight for each entry at k samples.

        Returns
        -------
        total : callable
            Takes states at the k samples, r times, of shape (r k, m); returns sums, shape (r k,).

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
        """Return indices of the unknowns of bodies and of joints; kind and joint of the latter."""
        is_rigid = self.columns < self.rigid_count
        kind, joint = np.divmod(self.columns[~is_rigid] - self.rigid_count, len(self.noise))
        return np.flatnonzero(is_rigid), np.flatnonzero(~is_rigid), kind, joint

    def _drive_terms(self, states: States) -> Floats:
        """Return the factors of the kinds in `OF_JOINT`, shape (4, k, m)."""
        step = np.tanh(states.qd / self.width)
        return np.stack([states.qdd, states.qd, step, np.ones_like(step)])


@dataclass(frozen=True, eq=False)
class ExpectedErrors:
    """
    Standard errors due to the assumed noise; NaN where the efforts determine no such unknown.

    The unknowns of bodies are base parameters: where only a combination of parameters has an
    effect, the error is that of the combination, listed under one of its members.

    """

    joint_names: tuple[str, ...]
    """The m joints that move."""
    noise: Floats
    """Assumed standard deviation of measured efforts, shape (m,) [N m or N]."""
    of_joints: Floats
    """Errors of the kinds in `OF_JOINT`, shape (m, 4)."""
    efforts: Floats
    """RMS errors of the efforts in random states within the limits, shape (m,) [N m or N]."""
    body_names: tuple[str, ...]
    """The bodies without the base."""
    of_bodies: Floats
    """Largest errors of mass [kg], first moments [kg m], inertia [kg m^2], shape (b - 1, 3)."""
    count: int
    """Number of unknowns."""


def expected_errors(unknowns: Unknowns, information: Floats) -> ExpectedErrors:
    """Compute the standard errors that follow from the information of a motion, shape (u, u)."""
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
