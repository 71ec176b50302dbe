"""
Computes how accurately the efforts of a motion determine masses and friction.

Efforts are linear in the unknowns: tau = Y(q, qd, qdd) pi + a qdd + d qd + c tanh(qd / w) + o.
The vector pi contains the inertial parameters of the bodies. Each joint has an armature a, a
damping d, a Coulomb friction c that is smoothed over the speed w, and an offset o.

Before a motion, each unknown has a usual error: descriptions are wrong by 15 %. The matrix W
contains the efforts for the usual error of each unknown, for all samples of a motion, divided by
the standard deviation of their noise. The information matrix is W^T W. The inverse of E + W^T W,
where E is the identity, is the covariance of the unknowns after the motion, in usual errors.
"""

from __future__ import annotations

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Floats, Integers
from ..columns import NAMES, usual_errors
from .limits import MotionLimits, random_states, States, whole_states

OF_JOINT = ('armature', 'damping', 'Coulomb', 'offset')
NOISE = 0.01
"""Assumed standard deviation of measured efforts, as a fraction of the effort limit."""
SAMPLES_PER_SECOND = 10.0
"""Assumed rate of independent samples in the smoothed measured efforts [Hz]."""
WIDTH = 0.02
"""Width w of smoothed Coulomb friction, as a fraction of the largest speed of the joint."""
_LINK_ERROR = 0.15
"""Usual relative error of the masses and mass distributions of links."""
_DRIVE_ERROR = 0.1
"""Usual error of each term of a joint at its largest speed, as a fraction of the effort limit."""
_IMPROVED = 0.5
"""A smaller fraction of the usual error means that a motion determines an unknown."""
_LEAST_NOISE = 1e-6
"""Smallest assumed noise [N m or N]."""
_LEAST_INFORMATION = 1e-3
"""An unknown is left out if one state gives less information about it, on average."""
_STATES = 400
"""Number of random states that show which unknowns change the efforts."""
_PRODUCTS = 20
"""Number of matrix products for one information matrix."""


class Unknowns:
    """
    The unknowns that change the efforts of the moving joints.

    `noise` is the standard deviation of the measured effort of each moving joint [N m or N]. All
    unknowns are ten parameters for each body except the base, followed by one value per moving
    joint for each term in `OF_JOINT`. `columns` contains the indices of those that are computed,
    and `usual` the usual errors of all.

    """

    def __init__(self, dynamics: InverseDynamics, limits: MotionLimits) -> None:
        self.dynamics, self.limits = dynamics, limits
        robot, states = dynamics.robot, random_states(limits, _STATES, np.random.default_rng(1))
        efforts = np.abs(dynamics.efforts(*whole_states(limits, states)))[:, limits.index]
        given = robot.effort_limits[limits.index]
        largest = np.where(np.isfinite(given), given, np.max(efforts, axis=0))
        self.noise = np.maximum(NOISE * largest, _LEAST_NOISE)
        self.rigid_count = len(NAMES) * (len(robot.parent) - 1)
        ones = np.ones(len(largest))
        units = np.stack([2.0 * limits.speeds, limits.speeds, ones, ones])
        drives = _DRIVE_ERROR * largest / units
        self.usual: Floats = np.append(usual_errors(robot, _LINK_ERROR), drives)
        self.columns: Integers = np.arange(len(self.usual))
        shown = np.mean(np.sum(self.weighted(states) ** 2, axis=1), axis=0)
        self.columns = np.flatnonzero(shown > _LEAST_INFORMATION)

    def information(self, states: States, duration: float) -> Floats:
        """
        Return the information matrix of a motion that repeats `states`.

        `duration` is the duration of the motion [s]. The number of states is divisible by 20.
        """
        u = len(self.columns)
        # Small products are slow, and large ones start threads, which cost more than they save.
        columns = self.weighted(states).reshape(_PRODUCTS, -1, u)
        products = columns.transpose(0, 2, 1) @ columns
        rows = SAMPLES_PER_SECOND * duration / len(states.q)
        return np.asarray(rows * np.sum(products, axis=0))

    def weighted(self, states: States) -> Floats:
        """Return the effort per usual error, in units of the noise, shape (states, m, columns)."""
        Y = self.dynamics.regressor(*whole_states(self.limits, states))
        step = np.tanh(states.qd / (WIDTH * self.limits.speeds))
        drive_terms = np.stack([states.qdd, states.qd, step, np.ones_like(step)])
        rigid = self.columns[self.columns < self.rigid_count]
        kind, joint = np.divmod(self.columns[len(rigid) :] - self.rigid_count, len(self.noise))
        columns: Floats = np.zeros((*states.q.shape, len(self.columns)))
        columns[:, :, : len(rigid)] = Y[:, self.limits.index][:, :, rigid]
        columns[:, joint, len(rigid) + np.arange(len(joint))] = drive_terms[kind, :, joint].T
        return columns * (self.usual[self.columns] / self.noise[:, np.newaxis])

    def expected_errors(self, information: Floats) -> tuple[Floats, Floats]:
        """
        Return the standard errors after a motion; NaN where it does not halve the usual error.

        The first result has the errors of the terms in `OF_JOINT`, shape (moving joints, 4). The
        second result has the error of the mass [kg], and the largest errors of first moments
        [kg m] and inertia [kg m^2], shape (bodies except the base, 3).

        """
        relative = np.full(len(self.usual), np.nan)
        covariance = np.linalg.inv(np.eye(len(information)) + information)
        relative[self.columns] = np.sqrt(np.diagonal(covariance))
        errors = np.where(relative < _IMPROVED, relative * self.usual, np.nan)
        of_bodies = errors[: self.rigid_count].reshape(-1, len(NAMES))
        groups = [of_bodies[:, :1], of_bodies[:, 1:4], of_bodies[:, 4:]]
        return (
            errors[self.rigid_count :].reshape(len(OF_JOINT), -1).T,
            np.stack([np.fmax.reduce(group, axis=1) for group in groups], axis=1),
        )
