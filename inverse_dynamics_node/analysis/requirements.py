"""The efforts, speeds and powers that a trajectory requires, for choosing motors and gears."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..dynamics.inverse_dynamics import EffortTerms, InverseDynamics
from ..dynamics.trajectory import Trajectory, whole_states
from ..robot.model import Booleans, Floats

_ROUNDING = 1e-6
"""A limit is not exceeded by what a file with six digits rounds away."""


class EffortRequirements(NamedTuple):
    """Efforts at k times of a trajectory of m joints, and what follows from them."""

    efforts: Floats
    """Shape (k, m) [N m or N]."""
    terms: EffortTerms
    """What they are made of, each of shape (k, m) [N m or N]."""
    peak: Floats
    """The largest effort, with its sign, shape (m,) [N m or N]."""
    peak_time: Floats
    """When that is, shape (m,) [s]."""
    rms: Floats
    """Root of the mean over time of the squared effort, shape (m,) [N m or N]."""
    rms_terms: Floats
    """The same for each of the terms, shape (5, m) [N m or N]."""
    speed: Floats
    """The largest speed, shape (m,) [rad/s or m/s]."""
    power: Floats
    """The largest of effort times velocity, shape (m,) [W]; 0 where the joint only brakes."""
    braking: Floats
    """The largest of what the joint takes back, shape (m,) [W]; 0 where it never does."""
    effort_limits: Floats
    """Shape (m,) [N m or N]; inf where there is none."""
    velocity_limits: Floats
    """Shape (m,) [rad/s or m/s]; inf where there is none."""
    is_too_strong: Booleans
    """Whether an effort is beyond its limit, shape (m,)."""
    is_too_fast: Booleans
    """Whether a speed is beyond its limit, shape (m,)."""
    is_too_far: Booleans
    """Whether a position is beyond its limits, shape (m,)."""


def effort_requirements(
    dynamics: InverseDynamics, trajectory: Trajectory, others: Floats | None = None
) -> EffortRequirements:
    """
    Compute the requirements of a trajectory on the joints that it moves.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with n joints, and what acts on it.
    trajectory : Trajectory
        Of any m of them, in any order, with velocities and accelerations.
    others : ndarray, shape (n,), optional
        Positions at which the robot's other joints rest [rad or m]; zero if left out.

    Returns
    -------
    requirements : EffortRequirements
        In the order of the trajectory's joints.

    Raises
    ------
    TrajectoryError
        If the robot has no such joint, or one is named twice.
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
    """Return the root mean square over time, by trapezoids: points need not be equally far."""
    if len(times) == 1:
        alone: Floats = np.abs(values[0])
        return alone
    steps = np.diff(times)[:, np.newaxis]
    squares = np.sum(0.5 * steps * (values[1:] ** 2 + values[:-1] ** 2), axis=0)
    rms: Floats = np.sqrt(squares / (times[-1] - times[0]))
    return rms
