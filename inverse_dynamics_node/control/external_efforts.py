"""What the measured efforts have that the model does not explain: contact, most likely."""

from __future__ import annotations

import math

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.model import Floats

_LONGEST = 0.5  # [s]; after a longer gap between states the filters begin anew


class ExternalEffortEstimator:
    r"""
    Measured effort minus model, smoothed.

    Velocities are differentiated by the same low-pass that smooths the efforts: with :math:`L` for
    it, :math:`L[\tau - C(q, \dot q)\,\dot q - g(q) - ...] - M(q)\,\frac{d}{dt} L[\dot q]`. So both
    sides lag alike, and a motion that the model explains leaves nothing.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with n joints; what acts on it counts as part of the model.
    cutoff : float
        Of the first-order low-pass [Hz].

    """

    def __init__(self, dynamics: InverseDynamics, cutoff: float = 10.0) -> None:
        self.dynamics = dynamics
        self.cutoff = cutoff
        n = len(dynamics.robot.joint_names)
        self._velocities, self._accelerations, self._unexplained, self._rest = np.zeros((4, n))
        self._time = math.inf

    def update(self, time: float, q: Floats, qd: Floats, measured: Floats) -> Floats:
        """
        Take in one state.

        Parameters
        ----------
        time : float
            Of the state [s].
        q, qd, measured : ndarray, shape (n,)
            Positions [rad or m], velocities [rad/s or m/s], efforts [N m or N]; NaN for efforts
            that are not measured.

        Returns
        -------
        residual : ndarray, shape (n,)
            [N m or N]; minus what the world does for the joints, as far as the model is right. NaN
            where nothing is measured.

        Raises
        ------
        JointStateError
            If a position or velocity is not finite.

        """
        elapsed = time - self._time
        unexplained = measured - self.dynamics.efforts(q, qd, self._rest)
        share = 1.0
        if not 0.0 <= elapsed <= _LONGEST:
            self._accelerations = self._rest
        else:
            share = -math.expm1(-2.0 * math.pi * self.cutoff * elapsed)
            if elapsed:
                self._accelerations = share * (qd - self._velocities) / elapsed
        self._time = time
        self._velocities = self._velocities + share * (qd - self._velocities)
        # Where a joint begins to be measured, there is nothing to smooth with.
        before = np.where(np.isnan(self._unexplained), unexplained, self._unexplained)
        self._unexplained = before + share * (unexplained - before)
        residual: Floats = self._unexplained - self.dynamics.mass_matrix(q) @ self._accelerations
        return residual
