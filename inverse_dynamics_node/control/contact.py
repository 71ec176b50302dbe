"""Estimates what acts on the arm from outside, such as contact, from measured efforts."""

from __future__ import annotations

import math

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.model import Booleans, Floats
from .filters import LowPass

CUTOFF = 10.0
"""Cutoff of the low-pass for external efforts [Hz]."""
LEAST_LEVER = 0.05
"""Change of the joint efforts per force [m] below which a direction of the wrench is damped."""
_LENGTH = 0.3  # [m]; weighs moments: 0.3 N m is equivalent to 1 N
_SHOWN = 0.95  # share of a component that the efforts must show
COMPONENTS = ('force x', 'force y', 'force z', 'moment x', 'moment y', 'moment z')
_CONTACT_TIME = 0.15  # [s]; shorter external efforts are no contact
_LONGEST_GAP = 0.5  # [s]; after a longer gap between states, the filter restarts


class ContactDetector:
    """Finds a joint whose external effort stays beyond its limit; there are ``m`` joints."""

    def __init__(self, m: int) -> None:
        self._since = np.full(m, math.inf)  # time since which each effort is beyond its limit [s]
        self._last = math.inf  # time of the last efforts [s]

    def find(self, time: float, efforts: Floats, limits: Floats) -> int | None:
        """
        Return the index of the joint with a contact, or None.

        ``efforts`` and ``limits`` are external efforts and their limits, shape (m,) [N m or N].
        An effort that is not measured is NaN.

        """
        size = np.abs(efforts)
        # After a longer gap, the low-pass has restarted from a single sample.
        first = self._since if 0.0 <= time - self._last <= _LONGEST_GAP else math.inf
        self._since = np.where(size > limits, np.minimum(first, time), math.inf)
        self._last = time
        lasts = time - self._since >= _CONTACT_TIME
        return int(np.argmax(np.where(lasts, size / limits, 0.0))) if lasts.any() else None


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


def tool_wrench(
    dynamics: InverseDynamics, q: Floats, link: str, efforts: Floats
) -> tuple[Floats, Booleans]:
    r"""
    Return the wrench that explains external efforts, and which components they show.

    ``efforts`` are those of `ExternalEffortEstimator.update`, shape (n,) [N m or N], and may be
    NaN. The wrench contains the force [N] and the moment [N m] that the world exerts on the
    ``link``, about its origin and in its frame, shape (6,). It is the least-squares solution of
    :math:`-J^\top F = e`. A direction in which a force of 1 N, or a moment of 0.3 N m, changes
    the efforts by less than `LEAST_LEVER` is damped, so that errors of the efforts are never
    multiplied by more than its inverse. A component of which less than 95 % can be recovered is
    not shown: it is nearer to zero than the real one, and includes parts of others.

    """
    R = dynamics.pose(q, link)[:3, :3]
    is_measured = np.isfinite(efforts)
    linear, angular = dynamics.jacobian(q, link)[:, is_measured].reshape(2, 3, -1)
    rows = np.concatenate([R.T @ linear, _LENGTH * R.T @ angular])
    directions, levers, modes = np.linalg.svd(rows, full_matrices=False)
    damped = levers / np.maximum(levers, LEAST_LEVER) ** 2
    wrench = -directions @ (damped * (modes @ efforts[is_measured]))
    wrench[3:] *= _LENGTH
    return wrench, directions**2 @ (damped * levers) >= _SHOWN
