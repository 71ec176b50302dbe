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

from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.kinematics import path_to
from ...robot.model import Floats, Integers, RobotModel
from ..columns import base_parameters, NAMES
from .limits import MotionLimits, random_states, States, whole_states

OF_JOINT = ('armature', 'damping', 'Coulomb', 'offset')
WIDTH = 0.02
"""Width w of smoothed Coulomb friction, as a fraction of the largest speed of the joint."""
_STATES = 400
"""Number of random states that are used to find the base parameters."""
_VISIBLE = 100.0
"""
Largest standard error of an unknown at the random states, relative to the whole robot.

Columns that differ only by the rounding of the description give larger errors. The error of a mass
is relative to the moving mass, that of a first moment to mass x reach, and that of a moment of
inertia to mass x reach^2.
"""
_PRODUCTS = 20
"""Number of matrix products for one information matrix."""
_TINY = 1e-9
"""Value that is added to the diagonal of the information matrix to keep it invertible."""
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
        robot = dynamics.robot
        self.rigid_count = len(NAMES) * (len(robot.parent) - 1)
        self.columns: Integers = np.arange(self.rigid_count + len(OF_JOINT) * len(noise))
        self.scale: Floats = np.ones(len(self.columns))
        states = random_states(limits, _STATES, np.random.default_rng(1))
        matrix = self.weighted(states).reshape(-1, len(self.columns))
        sizes = np.sqrt(np.mean(matrix**2, axis=0))
        nonzero = np.flatnonzero(sizes > 1e-12 * np.max(sizes))
        leading = base_parameters(matrix[:, nonzero] / sizes[nonzero]).leading
        columns = np.sort(nonzero[leading])
        largest = np.full(len(sizes), np.inf)
        largest[: self.rigid_count] = np.tile(_VISIBLE * _units(robot), len(robot.parent) - 1)
        while True:
            triangle = np.linalg.qr(matrix[:, columns] / sizes[columns], mode='r')
            errors = np.linalg.norm(np.linalg.inv(triangle), axis=1) / sizes[columns]
            ratios = errors / largest[columns]
            if ratios.max() < 1.0:
                break
            columns = np.delete(columns, ratios.argmax())
        self.columns, self.scale = columns, sizes[columns]

    def weighted(self, states: States) -> Floats:
        """Return the result of `of_efforts`, divided by noise and scale."""
        return self.of_efforts(states) / (self.noise[:, np.newaxis] * self.scale)

    def information(self, states: States) -> Floats:
        """Return the information matrix per state; the number of states is divisible by 20."""
        u = len(self.columns)
        # Small products are slow, and large ones start threads, which cost more than they save.
        columns = self.weighted(states).reshape(_PRODUCTS, -1, u)
        products = columns.transpose(0, 2, 1) @ columns
        return np.asarray(np.sum(products, axis=0) / len(states.q) + _TINY * np.eye(u))

    def of_efforts(self, states: States) -> Floats:
        """Return the effort per unit of each unknown, shape (states, moving joints, unknowns)."""
        Y = self.dynamics.regressor(*whole_states(self.limits, states))
        step = np.tanh(states.qd / (WIDTH * self.limits.speeds))
        drive_terms = np.stack([states.qdd, states.qd, step, np.ones_like(step)])
        rigid = self.columns[self.columns < self.rigid_count]
        kind, joint = np.divmod(self.columns[len(rigid) :] - self.rigid_count, len(self.noise))
        columns: Floats = np.zeros((*states.q.shape, len(self.columns)))
        columns[:, :, : len(rigid)] = Y[:, self.limits.index][:, :, rigid]
        columns[:, joint, len(rigid) + np.arange(len(joint))] = drive_terms[kind, :, joint].T
        return columns


def _units(robot: RobotModel) -> Floats:
    """Return the moving mass, mass x reach, or mass x reach^2, for each inertial parameter."""
    lengths = np.linalg.norm(robot.p_PL, axis=1)
    reach = max(sum(lengths[path_to(robot, body)]) for body in range(len(lengths)))
    reach = max(reach, float(np.linalg.norm(robot.com, axis=1).max()))
    orders = np.repeat([0, 1, 2], [1, 3, 6])
    return np.asarray(robot.mass[1:].sum() * reach**orders)


class ExpectedErrors(NamedTuple):
    """
    Standard errors of the unknowns due to the assumed noise.

    If the efforts depend only on a combination of parameters, the error of the combination is
    assigned to one of these parameters. The errors of the others are NaN.

    """

    of_joints: Floats
    """Errors of the terms in `OF_JOINT`, shape (moving joints, 4)."""
    of_bodies: Floats
    """
    Error of mass [kg], and largest errors of first moments [kg m] and inertia [kg m^2].

    The shape is (bodies except the base, 3).
    """


def expected_errors(unknowns: Unknowns, information: Floats) -> ExpectedErrors:
    """Compute standard errors from an information matrix, shape (unknowns, unknowns)."""
    errors = np.full(unknowns.rigid_count + len(OF_JOINT) * len(unknowns.noise), np.nan)
    covariance = np.linalg.inv(information)
    errors[unknowns.columns] = np.sqrt(np.diagonal(covariance)) / unknowns.scale
    of_bodies = errors[: unknowns.rigid_count].reshape(-1, len(NAMES))
    return ExpectedErrors(
        errors[unknowns.rigid_count :].reshape(len(OF_JOINT), -1).T,
        np.stack([np.fmax.reduce(of_bodies[:, group], axis=1) for group in _GROUPS], axis=1),
    )
