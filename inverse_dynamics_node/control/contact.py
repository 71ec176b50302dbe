"""Estimates external joint efforts, such as those due to contact, from measured efforts."""

from __future__ import annotations

import math

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.model import Floats
from .filters import LowPass

CUTOFF = 10.0
"""Cutoff of the low-pass for external efforts [Hz]."""
_LONGEST_GAP = 0.5  # [s]; after a longer gap between states, the filter restarts


class ExternalEffortEstimator:
    r"""
    Estimates external joint efforts from the differences between measured and modelled efforts.

    Accelerations are the derivatives of filtered velocities. The same low-pass :math:`L` filters
    velocities and efforts. `update` returns :math:`L[\tau - C(q, \dot q)\,\dot q - g(q) - ...] -
    M(q)\,\frac{d}{dt} L[\dot q]`. Both terms of the difference have the same lag, so that the
    terms cancel if the model explains the motion.

    ``dynamics`` is the model of a robot with n joints, including payloads, wrenches and friction.

    """

    def __init__(self, dynamics: InverseDynamics) -> None:
        self.dynamics = dynamics
        n = len(dynamics.robot.joint_names)
        self.scale = np.ones(n)
        """Factors that convert measured values into efforts [N m or N], shape (n,)."""
        self.filter = LowPass(np.zeros((2, n)), CUTOFF)
        """Row 0: velocities. Row 1: measured efforts minus those modelled at zero acceleration."""
        self._rest = self._accelerations = np.zeros(n)
        self._time = math.inf

    def update(self, time: float, q: Floats, qd: Floats, measured: Floats) -> Floats:
        """
        Update the estimate with one joint state; return measured minus modelled efforts.

        The result [N m or N] is the negative of the external efforts, plus errors of the model.
        ``measured`` contains efforts in the units of the driver. Unmeasured efforts are NaN in
        ``measured`` and in the result. All arrays have shape (n,). A JointStateError is raised if
        a position or velocity is not finite.

        """
        elapsed = time - self._time
        self._time = time
        unexplained = self.scale * measured - self.dynamics.efforts(q, qd, self._rest)
        last_velocities, _ = self.filter.value
        # The filter of a joint restarts at its first measured effort, because NaN is not finite.
        sample = np.array([qd, unexplained])
        velocities, unexplained = self.filter.update(time, sample, _LONGEST_GAP)
        if not 0.0 <= elapsed <= _LONGEST_GAP:
            self._accelerations = self._rest
        elif elapsed:
            self._accelerations = (velocities - last_velocities) / elapsed
        efforts: Floats = unexplained - self.dynamics.mass_matrix(q) @ self._accelerations
        return efforts
