"""Whole trajectories: what a planner left out derived by splines, and the efforts all along."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..errors import shortened, TrajectoryError, unknown_name
from ..robot.model import Floats, Integers
from .batch import FEWEST
from .inverse_dynamics import InverseDynamics

_FEWEST_TO_SMOOTH = 16
"""Points: what the filter is run in with is longer than less."""


class Trajectory(NamedTuple):
    """Where m joints are to be at k times."""

    joint_names: tuple[str, ...]
    times: Floats
    """Shape (k,) [s], each later than the one before."""
    positions: Floats
    """Shape (k, m) [rad or m]."""
    velocities: Floats | None = None
    """Shape (k, m) [rad/s or m/s]; None where they are to be derived."""
    accelerations: Floats | None = None
    """Shape (k, m) [rad/s^2 or m/s^2]; None where they are to be derived."""


def complete(trajectory: Trajectory) -> tuple[Trajectory, tuple[str, ...]]:
    """
    Derive the velocities and accelerations that a trajectory lacks.

    Parameters
    ----------
    trajectory : Trajectory
        With k points of m joints.

    Returns
    -------
    whole : Trajectory
        With velocities and accelerations.
    derived : tuple of str
        What was derived, and how, in words; empty if nothing was.

    Raises
    ------
    TrajectoryError
        If there is no point, shapes do not fit, times do not rise, or a value is not finite.

    Notes
    -----
    Velocities are those of the cubic spline through the positions that begins and ends at rest;
    accelerations those of the cubic spline through the velocities whose third derivative is
    continuous at the first and last inner points. A single point is at rest.

    """
    _check(trajectory)
    times, velocities = trajectory.times, trajectory.velocities
    accelerations = trajectory.accelerations
    derived = []
    if velocities is None:
        spline = 'a cubic spline through the positions, at rest at both ends'
        derived.append(f'velocities derived from {spline}')
        velocities = _derivative(times, trajectory.positions, 'clamped', 1)
        if accelerations is None:
            derived.append(f'accelerations derived from {spline}')
            accelerations = _derivative(times, trajectory.positions, 'clamped', 2)
    elif accelerations is None:
        derived.append('accelerations derived from a cubic spline through the velocities')
        accelerations = _derivative(times, velocities, 'not-a-knot', 1)
    whole = trajectory._replace(velocities=velocities, accelerations=accelerations)
    return whole, tuple(derived)


def refine(whole: Trajectory, longest_step: float) -> tuple[Trajectory, Integers]:
    """
    Put states between the points of a trajectory that are far apart.

    Parameters
    ----------
    whole : Trajectory
        With velocities and accelerations, from `complete`.
    longest_step : float
        Time between states of the result, at most [s].

    Returns
    -------
    fine : Trajectory
        All points of the trajectory, and states between them.
    points : ndarray of int, shape (k,)
        Where the points are in it.

    Raises
    ------
    TrajectoryError
        If velocities or accelerations are missing.

    Notes
    -----
    Between two points runs the polynomial of fifth degree that meets position, velocity and
    acceleration at both, as in ros2_control's joint trajectory controller. Where `complete` has
    derived both from positions, it is the same cubic spline.

    """
    times, velocities, accelerations = whole.times, whole.velocities, whole.accelerations
    steps = np.diff(times)
    counts = np.maximum(1, np.ceil(steps / longest_step - 1e-6)).astype(np.int64)
    points: Integers = np.concatenate([[0], np.cumsum(counts)])
    if velocities is None or accelerations is None:
        raise TrajectoryError('no velocities or no accelerations, expected a complete trajectory')
    if len(times) == 1 or np.all(counts == 1):
        return whole, points
    from scipy.interpolate import BPoly

    within = np.arange(points[-1]) - np.repeat(points[:-1], counts)
    fine = np.repeat(times[:-1], counts) + within * np.repeat(steps / counts, counts)
    fine = np.append(fine, times[-1])
    given = (whole.positions, velocities, accelerations)
    spline = BPoly.from_derivatives(times, np.stack(given, axis=1))
    values = [spline(fine, order) for order in range(3)]
    for value, at_points in zip(values, given, strict=True):
        value[points] = at_points  # to the last bit
    return Trajectory(whole.joint_names, fine, *values), points


def smooth(trajectory: Trajectory, cutoff: float) -> Trajectory:
    """
    Derive velocities and accelerations of measured positions without their noise.

    Parameters
    ----------
    trajectory : Trajectory
        With k points of m joints; its velocities and accelerations do not count.
    cutoff : float
        Faster changes than this are taken for noise [Hz].

    Returns
    -------
    smooth : Trajectory
        With velocities and accelerations, at k evenly spaced times.

    Raises
    ------
    TrajectoryError
        If the points are too few or too far apart for the cut-off, or not as `complete` has them.

    Notes
    -----
    A Butterworth low-pass of second order that runs forwards and backwards, so that nothing comes
    late; then differences. Gravity efforts, which change with positions, hardly feel it.

    """
    _check(trajectory)
    k = len(trajectory.times)
    rate = (k - 1) / float(trajectory.times[-1] - trajectory.times[0]) if k > 1 else 0.0
    if k < _FEWEST_TO_SMOOTH or not 0.0 < cutoff < 0.5 * rate:
        raise TrajectoryError(
            f'{k} points at {rate:.3g} Hz cannot be smoothed at {cutoff:g} Hz, expected '
            f'{_FEWEST_TO_SMOOTH} or more, at more than twice that'
        )
    from scipy.signal import butter, sosfiltfilt

    times = np.linspace(trajectory.times[0], trajectory.times[-1], k)
    even = [np.interp(times, trajectory.times, column) for column in trajectory.positions.T]
    low_pass = butter(2, cutoff, fs=rate, output='sos')
    run_in = min(k - 1, int(3.0 * rate / cutoff))  # points; what it remembers has faded by then
    positions = sosfiltfilt(low_pass, np.stack(even, axis=1), axis=0, padlen=run_in)
    velocities = np.gradient(positions, times, axis=0, edge_order=2)
    accelerations = np.gradient(velocities, times, axis=0, edge_order=2)
    return Trajectory(trajectory.joint_names, times, positions, velocities, accelerations)


def trajectory_efforts(
    dynamics: InverseDynamics, trajectory: Trajectory, others: Floats | None = None
) -> Floats:
    """
    Compute the efforts all along a trajectory.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with n joints.
    trajectory : Trajectory
        Of any m of them, in any order, with velocities and accelerations.
    others : ndarray, shape (n,), optional
        Positions at which the robot's other joints rest [rad or m]; zero if left out.

    Returns
    -------
    efforts : ndarray, shape (k, m)
        In the order of the trajectory's joints [N m or N].

    Raises
    ------
    TrajectoryError
        If the robot has no such joint, or one is named twice.

    """
    states, index = whole_states(dynamics, trajectory, others)
    tau = np.empty_like(states[0])
    # In pieces: the first large batch compiles for seconds, which a control loop does not have.
    for start in range(0, len(tau), FEWEST - 1):
        q, qd, qdd = (values[start : start + FEWEST - 1] for values in states)
        tau[start : start + FEWEST - 1] = dynamics.efforts(q, qd, qdd)
    efforts: Floats = tau[:, index]
    return efforts


def whole_states(
    dynamics: InverseDynamics, trajectory: Trajectory, others: Floats | None = None
) -> tuple[tuple[Floats, Floats, Floats], list[int]]:
    """
    Spread a trajectory over all joints of a robot.

    Parameters
    ----------
    dynamics, trajectory, others
        As for `trajectory_efforts`.

    Returns
    -------
    states : tuple of q, qd, qdd
        Of all joints of the robot at every point, each of shape (k, n).
    index : list of int
        Where the trajectory's joints are among the robot's.

    Raises
    ------
    TrajectoryError
        If the robot has no such joint, or one is named twice.

    """
    names = dynamics.robot.joint_names
    index = joint_index(trajectory.joint_names, names)
    k, n = len(trajectory.times), len(names)
    q, qd, qdd = np.zeros((3, k, n))
    if others is not None:
        q[:] = others
    q[:, index] = trajectory.positions
    qd[:, index] = trajectory.velocities
    qdd[:, index] = trajectory.accelerations
    return (q, qd, qdd), index


def _derivative(times: Floats, values: Floats, ends: str, order: int) -> Floats:
    if len(times) == 1:
        return np.zeros_like(values)
    from scipy.interpolate import CubicSpline  # a third of a second, for who needs it only

    try:
        with np.errstate(all='ignore'):
            # Two or three points have no inner ones enough; scipy takes a line or a parabola then.
            derivative: Floats = CubicSpline(times, values, bc_type=ends)(times, order)
    except ValueError:  # of slopes that are not finite
        derivative = np.full_like(values, np.nan)
    if not np.isfinite(derivative).all():
        raise TrajectoryError('points are too far apart in too short a time for any spline')
    return derivative


def _check(trajectory: Trajectory) -> None:
    names, times = trajectory.joint_names, trajectory.times
    if not len(times):
        raise TrajectoryError('no points, expected at least one')
    shape = len(times), len(names)
    for what, values in zip(trajectory._fields[2:], trajectory[2:], strict=True):
        if values is None:
            continue
        if values.shape != shape:
            raise TrajectoryError(f'{what} have shape {values.shape}, expected {shape}')
        if not np.isfinite(values).all():
            point, joint = np.argwhere(~np.isfinite(values))[0]
            raise TrajectoryError(
                f"{what} of joint '{shortened(names[joint])}' at point {point}: "
                f'{values[point, joint]}, expected a finite number'
            )
    if not np.isfinite(times).all():
        raise TrajectoryError(f'a time is {times[~np.isfinite(times)][0]}, expected finite times')
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if len(late):
        point = int(late[0]) + 1
        raise TrajectoryError(
            f'point {point} is at {times[point]:g} s, expected later than point {point - 1} '
            f'at {times[point - 1]:g} s'
        )


def joint_index(names: Sequence[str], known: Sequence[str]) -> list[int]:
    """Find joints among those that are known; raise a TrajectoryError where that cannot be."""
    if not names:
        raise TrajectoryError('no joint names')
    unknown = [name for name in names if name not in known]
    if unknown:
        raise TrajectoryError(unknown_name('joint', unknown[0], known))
    if len(set(names)) != len(names):
        twice = next(name for k, name in enumerate(names) if name in names[:k])
        raise TrajectoryError(f"joint '{shortened(twice)}' is named twice")
    return [known.index(name) for name in names]
