"""Describes motions as Fourier series that start and end at rest in the same pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
import math

import numpy as np

from ...dynamics.trajectory import Trajectory
from ...robot.model import Floats


@dataclass(frozen=True, eq=False)
class FourierSeries:
    """
    A motion of several joints as a Fourier series.

    Velocity and acceleration are zero at both ends, so that the motion can be repeated.

    """

    joint_names: tuple[str, ...]
    """Names of the moving joints."""
    duration: float
    """Duration of the motion, equal to the period of the first harmonic [s]."""
    coefficients: Floats
    """Factors of the basis functions, shape (joints, 2 * harmonics - 1) [rad or m]."""

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return (int(self.coefficients.shape[1]) + 1) // 2

    def sample(self, times: Floats) -> tuple[Floats, Floats, Floats]:
        """Return positions, velocities and accelerations at `times` [s], shape (times, joints)."""
        q, qd, qdd = (
            part @ self.coefficients.T for part in basis(times, self.duration, self.harmonics)
        )
        return q, qd, qdd

    def trajectory(self, rate: float, speed: float = 1.0) -> Trajectory:
        """
        Sample the motion at a rate [Hz].

        The first and last points are exactly at rest. With a `speed` of 0.2, the motion takes five
        times as long.

        """
        count = max(2, math.ceil(self.duration / speed * rate - 1e-9) + 1)
        times = np.linspace(0.0, self.duration, count)
        q, qd, qdd = self.sample(times)
        q[-1] = q[0]
        qd[[0, -1]] = qdd[[0, -1]] = 0.0
        return Trajectory(self.joint_names, times / speed, q, speed * qd, speed**2 * qdd)


def basis(times: Floats, duration: float, harmonics: int) -> tuple[Floats, Floats, Floats]:
    """
    Evaluate the basis functions and their first and second derivatives.

    With h harmonics, the functions are a constant, h - 1 combinations of sines, and h - 1
    combinations of cosines. The derivatives are zero at both ends. `duration` is the period of the
    first harmonic [s]. Returns three arrays of shape (times, 2 h - 1).

    """
    orders = np.arange(1.0, harmonics + 1.0)
    rates = 2.0 * math.pi / duration * orders
    angles = times[:, np.newaxis] * rates
    sines, cosines = np.sin(angles), np.cos(angles)
    of_sines, of_cosines = _combinations(harmonics)
    zeros = np.zeros((len(times), 1))
    return (
        np.hstack([zeros + 1.0, sines @ of_sines, cosines @ of_cosines]),
        np.hstack([zeros, (cosines * rates) @ of_sines, (-sines * rates) @ of_cosines]),
        np.hstack([zeros, (-sines * rates**2) @ of_sines, (-cosines * rates**2) @ of_cosines]),
    )


@cache
def _combinations(harmonics: int) -> tuple[Floats, Floats]:
    """Return sine and cosine coefficients. Each column gives a function that starts at rest."""
    orders = np.arange(1.0, harmonics + 1.0)
    # The division by the orders gives all combinations similar speeds.
    of_sines = _null_space(np.ones(harmonics)) / orders[:, np.newaxis]
    of_cosines = _null_space(orders) / orders[:, np.newaxis]
    return of_sines, of_cosines


def _null_space(row: Floats) -> Floats:
    """Return an orthonormal basis of the null space of `row`, as columns."""
    _, _, directions = np.linalg.svd(row[np.newaxis])
    return np.asarray(directions[1:].T)
