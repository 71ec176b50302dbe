"""
The information that the efforts of a motion contain about masses and friction.

Efforts are linear in the unknowns: tau = Y(q, qd, qdd) pi + a qdd + d qd + c tanh(qd / w) + o.
Only some combinations of the parameters pi of the bodies have an effect, the base parameters: as
many columns of Y are used. With the weighted columns W of a motion, the information is W^T W, and
its inverse is the covariance of the unknowns.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Floats, Integers
from ..base_parameters import base_parameters, NAMES
from .limits import MotionLimits
from .states import random_states, States, whole_states

OF_JOINT = ('armature', 'damping', 'Coulomb', 'offset')
WIDTH = 0.02
"""Width of smoothed Coulomb friction, as a fraction of the largest speed."""
_SAMPLES = 400
"""Random states from which the columns are selected."""


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
        is_rigid = self.columns < self.rigid_count
        Y = self.dynamics.regressor(*whole_states(self.limits, states))
        rigid = Y[:, self.limits.index][:, :, self.columns[is_rigid]]
        others = self._of_joints(states, self.columns[~is_rigid] - self.rigid_count)
        columns: Floats = np.concatenate([rigid, others], axis=2)
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
        is_rigid = self.columns < self.rigid_count
        of_bodies = np.zeros((k, len(self.limits.rest), self.rigid_count))
        rows = np.array(self.limits.index)[:, np.newaxis]
        of_bodies[:, rows, self.columns[is_rigid]] = scaled[:, :, is_rigid]
        flat = of_bodies.reshape(k, -1)
        of_joints = np.zeros((len(OF_JOINT), k, m))
        for u in np.flatnonzero(~is_rigid):
            kind, joint = divmod(int(self.columns[u]) - self.rigid_count, m)
            of_joints[kind, :, joint] = scaled[:, joint, u]

        def total(states: States) -> Floats:
            Y = self.dynamics.regressor(*whole_states(self.limits, states)).reshape(
                -1, *flat.shape
            )
            kinds = self._drive_terms(states).reshape(len(OF_JOINT), -1, k, m)
            sums: Floats = np.einsum('rka,ka->rk', Y, flat)
            sums += np.einsum('irkj,ikj->rk', kinds, of_joints)
            return sums.ravel()

        return total

    def names(self) -> list[tuple[str, str]]:
        """Return the body or joint, and the kind of each unknown."""
        bodies, joints = self.dynamics.robot.body_names[1:], self.limits.joint_names
        names = []
        for column in self.columns.tolist():
            if column < self.rigid_count:
                body, kind = divmod(column, len(NAMES))
                names.append((bodies[body], NAMES[kind]))
            else:
                kind, joint = divmod(column - self.rigid_count, len(joints))
                names.append((joints[joint], OF_JOINT[kind]))
        return names

    def _of_joints(self, states: States, chosen: Integers) -> Floats:
        """Return the columns of armature, damping, Coulomb friction and offsets."""
        kinds = self._drive_terms(states)
        _, k, m = kinds.shape
        columns = np.zeros((k, m, len(chosen)))
        for u, column in enumerate(chosen.tolist()):
            kind, joint = divmod(column, m)
            columns[:, joint, u] = kinds[kind, :, joint]
        return columns

    def _drive_terms(self, states: States) -> Floats:
        """Return the factors of the kinds in `OF_JOINT`, shape (4, k, m)."""
        step = np.tanh(states.qd / self.width)
        return np.stack([states.qdd, states.qd, step, np.ones_like(step)])
