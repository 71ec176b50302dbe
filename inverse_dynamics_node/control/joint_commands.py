"""The motion in the complete command, for drives that close a loop of their own."""

from __future__ import annotations

import numpy as np

from ..robot.model import Floats
from .command_shaping import ramp_fraction
from .control_law import ControlLaw, Reference


class DriveReference:
    """
    Positions and velocities to send with the efforts.

    Such a drive adds ``kp (q_command - q) + kd (qd_command - qd)`` to the effort. It is sent the
    reference while the reference is followed. Otherwise it is sent the measured motion, so that
    its gains add nothing. A ramp leads from one to the other, because the gains are not known
    here.

    Parameters
    ----------
    law : ControlLaw
        Knows the reference that is followed.

    """

    def __init__(self, law: ControlLaw) -> None:
        self._law = law
        self.weight = 0.0
        """Weight of the reference, 0 to 1."""

    def motion(
        self, q: Floats, qd: Floats, elapsed: float, start_ramp: float, farthest: float
    ) -> tuple[Floats, Floats]:
        """
        Return the positions and velocities to send.

        Parameters
        ----------
        q, qd : ndarray, shape (m,)
            Measured motion of the commanded joints [rad or m], [rad/s or m/s].
        elapsed : float
            Time by which ramps advance [s]; see `RampClock`.
        start_ramp : float
            Time in which the reference replaces the measured motion [s].
        farthest : float
            Largest distance of the reference from the joints [rad or m]; if it is farther away,
            the measured motion is sent. 0: unlimited.

        Returns
        -------
        positions, velocities : ndarray, shape (m,)
            [rad or m], [rad/s or m/s].

        """
        reference = self._law.followed
        distance = self._distance(q, reference)
        if reference is None or (farthest and np.abs(distance).max() > farthest):
            self.weight = 0.0
            return q, qd
        self.weight = min(1.0, self.weight + ramp_fraction(elapsed, start_ramp))
        velocities = reference.velocities
        if velocities is None:
            # A reference without any motion leaves the drive where it is.
            velocities = np.zeros_like(qd) if reference.positions is not None else qd
        return q + self.weight * distance, qd + self.weight * (velocities - qd)

    def rest(self, q: Floats) -> tuple[Floats, Floats]:
        """Return positions and velocities of a robot that is left where it is."""
        self.weight = 0.0
        return q, np.zeros_like(q)

    def _distance(self, q: Floats, reference: Reference | None) -> Floats:
        if reference is None or reference.positions is None:
            return np.zeros_like(q)
        return self._law.distance(q, reference.positions)
