"""Efforts, speeds and powers that a trajectory requires, for the choice of motors and gears."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..dynamics.effort_terms import EffortTerms
from ..dynamics.inverse_dynamics import InverseDynamics
from ..dynamics.trajectory import Trajectory, whole_states
from ..robot.model import Booleans, Floats

_ROUNDING = 1e-6
"""Excess over a limit that is ignored, because files may have only six digits."""


class EffortRequirements(NamedTuple):
    """Requirements of a trajectory with k times and m joints."""

    efforts: Floats
    """Joint efforts, shape (k, m) [N m or N]."""
    terms: EffortTerms
    """Terms of the efforts, each of shape (k, m) [N m or N]."""
    peak: Floats
    """Effort with the largest absolute value, with its sign, shape (m,) [N m or N]."""
    peak_time: Floats
    """Time of the peak, shape (m,) [s]."""
    rms: Floats
    """Root mean square of the effort over time, shape (m,) [N m or N]."""
    rms_terms: Floats
    """Root mean square of each term over time, shape (5, m) [N m or N]."""
    speed: Floats
    """Largest speed, shape (m,) [rad/s or m/s]."""
    power: Floats
    """Largest product of effort and velocity, shape (m,) [W]; 0 if the joint only brakes."""
    braking: Floats
    """Largest power that the joint absorbs, shape (m,) [W]; 0 if it never brakes."""
    effort_limits: Floats
    """Shape (m,) [N m or N]; inf if there is none."""
    velocity_limits: Floats
    """Shape (m,) [rad/s or m/s]; inf if there is none."""
    is_too_strong: Booleans
    """Whether the peak effort exceeds its limit, shape (m,)."""
    is_too_fast: Booleans
    """Whether the largest speed exceeds its limit, shape (m,)."""
    is_too_far: Booleans
    """Whether a position is outside its limits, shape (m,)."""


def effort_requirements(
    dynamics: InverseDynamics, trajectory: Trajectory, others: Floats | None = None
) -> EffortRequirements:
    """
    Compute the requirements of a trajectory for the joints that it moves.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot with n joints, and the loads on it.
    trajectory : Trajectory
        Trajectory of any m of them, in any order, with velocities and accelerations.
    others : ndarray, shape (n,), optional
        Positions of the other joints [rad or m]; default: zero.

    Returns
    -------
    requirements : EffortRequirements
        Requirements of the joints in the order of the trajectory.

    Raises
    ------
    TrajectoryError
        If the robot does not have one of the joints, or a joint is named twice.
    JointStateError
        If a value is not finite.

    """
    robot = dynamics.robot
    (q, qd, qdd), index = whole_states(dynamics, trajectory, others)
    efforts = dynamics.efforts(q, qd, qdd)[:, index]
    terms = EffortTerms(*(term[:, index] for term in dynamics.effort_terms(q, qd, qdd)))
    velocities, positions = qd[:, index], q[:, index]
    largest = np.argmax(np.abs(efforts), axis=0)
    power = efforts * velocities
    speed = np.max(np.abs(velocities), axis=0)
    peak = efforts[largest, range(len(index))]
    return EffortRequirements(
        efforts=efforts,
        terms=terms,
        peak=peak,
        peak_time=trajectory.times[largest],
        rms=_rms(trajectory.times, efforts),
        rms_terms=np.array([_rms(trajectory.times, term) for term in terms]),
        speed=speed,
        power=np.max(power, axis=0, initial=0.0),
        braking=np.max(-power, axis=0, initial=0.0),
        effort_limits=robot.effort_limits[index],
        velocity_limits=robot.velocity_limits[index],
        is_too_strong=np.abs(peak) > robot.effort_limits[index] * (1.0 + _ROUNDING),
        is_too_fast=speed > robot.velocity_limits[index] * (1.0 + _ROUNDING),
        is_too_far=np.any(
            (positions < robot.lower[index] - _ROUNDING)
            | (positions > robot.upper[index] + _ROUNDING),
            axis=0,
        ),
    )


def _rms(times: Floats, values: Floats) -> Floats:
    """Return the root mean square over time by the trapezoidal rule; steps may differ."""
    if len(times) == 1:
        single: Floats = np.abs(values[0])
        return single
    steps = np.diff(times)[:, np.newaxis]
    squares = np.sum(0.5 * steps * (values[1:] ** 2 + values[:-1] ** 2), axis=0)
    rms: Floats = np.sqrt(squares / (times[-1] - times[0]))
    return rms
