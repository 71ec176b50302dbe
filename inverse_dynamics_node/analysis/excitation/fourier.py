"""Motions as Fourier series that start and end at rest in the same pose."""

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
    A motion of m joints with h harmonics.

    Velocity and acceleration are zero at both ends, so that the motion can follow a pose at rest,
    and can be repeated.

    Attributes
    ----------
    joint_names : tuple of str
        The m joints.
    duration : float
        Duration of the motion, the period of the first harmonic [s].
    coefficients : ndarray, shape (m, 2 h - 1)
        Factors of the `basis` [rad or m].

    """

    joint_names: tuple[str, ...]
    duration: float
    coefficients: Floats

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return (int(self.coefficients.shape[1]) + 1) // 2

    def sample(self, times: Floats) -> tuple[Floats, Floats, Floats]:
        """
        Return positions, velocities and accelerations, each of shape (k, m).

        Parameters
        ----------
        times : ndarray, shape (k,)
            Times from 0 to the duration [s].

        """
        q, qd, qdd = (
            part @ self.coefficients.T for part in basis(times, self.duration, self.harmonics)
        )
        return q, qd, qdd

    def trajectory(self, rate: float, speed: float = 1.0) -> Trajectory:
        """
        Return the motion as points, the first and last of which are exactly at rest.

        Parameters
        ----------
        rate : float
            Points per second [Hz].
        speed : float
            Factor of the speed: 0.2 takes five times as long on the same path.

        """
        count = max(2, math.ceil(self.duration / speed * rate - 1e-9) + 1)
        times = np.linspace(0.0, self.duration, count)
        q, qd, qdd = self.sample(times)
        q[-1] = q[0]
        qd[[0, -1]] = qdd[[0, -1]] = 0.0
        return Trajectory(self.joint_names, times / speed, q, speed * qd, speed**2 * qdd)


def basis(times: Floats, duration: float, harmonics: int) -> tuple[Floats, Floats, Floats]:
    """
    Evaluate the functions of which a motion is a sum, and their first two derivatives.

    Parameters
    ----------
    times : ndarray, shape (k,)
        Times [s].
    duration : float
        Period of the first harmonic [s].
    harmonics : int
        Number of harmonics, h.

    Returns
    -------
    values, first, second : ndarray, shape (k, 2 h - 1)
        A constant, h - 1 combinations of the sines, and h - 1 of the cosines; their velocity and
        acceleration are zero at both ends.

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
    """Return the combinations of sines and cosines that are at rest at time 0, (h, h - 1) each."""
    orders = np.arange(1.0, harmonics + 1.0)
    # Amplitudes that fall with the order give all combinations similar speeds.
    of_sines = _null_space(np.ones(harmonics)) / orders[:, np.newaxis]
    of_cosines = _null_space(orders) / orders[:, np.newaxis]
    return of_sines, of_cosines


def _null_space(row: Floats) -> Floats:
    """Return an orthonormal basis of the vectors that are orthogonal to one, in columns."""
    _, _, directions = np.linalg.svd(row[np.newaxis])
    null_space: Floats = directions[1:].T
    return null_space
