"""Estimates external joint efforts (contact) as measured minus modelled effort."""

from __future__ import annotations

import math

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.model import Floats
from .filters import LowPass

_LONGEST_GAP = 0.5  # [s]; after a longer gap between states the filter restarts


class ExternalEffortEstimator:
    r"""
    Low-pass filtered difference between measured and modelled joint efforts.

    Accelerations are not measured. They are derived from velocities that went through the same
    low-pass :math:`L` as the efforts: :math:`L[\tau - C(q, \dot q)\,\dot q - g(q) - ...] -
    M(q)\,\frac{d}{dt} L[\dot q]`. Both terms lag alike, so that they cancel for a motion that the
    model explains.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with n joints; its payloads, wrenches and friction are part of the model.
    cutoff : float
        Cutoff of the first-order low-pass [Hz].

    """

    def __init__(self, dynamics: InverseDynamics, cutoff: float = 10.0) -> None:
        self.dynamics = dynamics
        n = len(dynamics.robot.joint_names)
        self.scale = np.ones(n)
        """From measured values to efforts in N m or N, shape (n,)."""
        self.filter = LowPass(np.zeros((2, n)), cutoff)
        """Filters velocities and measured minus modelled efforts at zero acceleration."""
        self._rest = self._accelerations = np.zeros(n)
        self._time = math.inf

    @property
    def cutoff(self) -> float:
        """Cutoff of the low-pass [Hz]."""
        return self.filter.cutoff

    def update(self, time: float, q: Floats, qd: Floats, measured: Floats) -> Floats:
        """
        Update the estimate with one joint state.

        Parameters
        ----------
        time : float
            Time of the state [s].
        q, qd, measured : ndarray, shape (n,)
            Positions [rad or m], velocities [rad/s or m/s], efforts in the unit of the driver; NaN
            for efforts that are not measured.

        Returns
        -------
        efforts : ndarray, shape (n,)
            Measured minus modelled efforts [N m or N]: external forces appear with the opposite
            sign, and so do errors of the model. NaN where no effort is measured.

        Raises
        ------
        JointStateError
            If a position or velocity is not finite.

        """
        elapsed = time - self._time
        self._time = time
        unexplained = self.scale * measured - self.dynamics.efforts(q, qd, self._rest)
        last_velocities, _ = self.filter.value
        # A joint whose effort is measured for the first time restarts: NaN is not finite.
        sample = np.array([qd, unexplained])
        velocities, unexplained = self.filter.update(time, sample, _LONGEST_GAP)
        if not 0.0 <= elapsed <= _LONGEST_GAP:
            self._accelerations = self._rest
        elif elapsed:
            self._accelerations = (velocities - last_velocities) / elapsed
        efforts: Floats = unexplained - self.dynamics.mass_matrix(q) @ self._accelerations
        return efforts
