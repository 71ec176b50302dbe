"""Trajectories: missing velocities and accelerations from splines, and the efforts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..errors import shortened, TrajectoryError, unknown_name
from ..robot.model import Floats, Integers
from .batch import LANES
from .inverse_dynamics import InverseDynamics

MOST_NUMBERS = 2e7
"""Largest product of states and joints to insert; the results of more take gigabytes."""
_FEWEST_TO_SMOOTH = 16
"""Fewest points that are longer than the padding of the filter."""


class Trajectory(NamedTuple):
    """Desired positions of m joints at k times."""

    joint_names: tuple[str, ...]
    times: Floats
    """Shape (k,) [s], strictly ascending."""
    positions: Floats
    """Shape (k, m) [rad or m]."""
    velocities: Floats | None = None
    """Shape (k, m) [rad/s or m/s]; None to derive them from the positions."""
    accelerations: Floats | None = None
    """Shape (k, m) [rad/s^2 or m/s^2]; None to derive them."""


def complete(trajectory: Trajectory) -> tuple[Trajectory, tuple[str, ...]]:
    """
    Derive missing velocities and accelerations.

    Parameters
    ----------
    trajectory : Trajectory
        Trajectory with k points of m joints.

    Returns
    -------
    whole : Trajectory
        The trajectory with velocities and accelerations.
    derived : tuple of str
        A description of each derived quantity; empty if there is none.

    Raises
    ------
    TrajectoryError
        If there are no points, a shape is wrong, the times do not ascend, or a value is not
        finite.

    Notes
    -----
    Velocities are those of the cubic spline through the positions that begins and ends at rest.
    Accelerations are those of the cubic spline through the velocities whose third derivative is
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
    Insert states between points of a trajectory that are far apart.

    Parameters
    ----------
    whole : Trajectory
        Trajectory with velocities and accelerations, from `complete`.
    longest_step : float
        Longest time between states of the result [s].

    Returns
    -------
    fine : Trajectory
        All points of the trajectory, and the states between them.
    points : ndarray of int, shape (k,)
        Indices of the original points in it.

    Raises
    ------
    TrajectoryError
        If velocities or accelerations are missing, or if the states would not fit into memory.

    Notes
    -----
    Two points are connected by the quintic polynomial that matches position, velocity and
    acceleration at both, as in ros2_control's joint trajectory controller. If `complete` has
    derived both from the positions, this equals the cubic spline.

    """
    times, velocities, accelerations = whole.times, whole.velocities, whole.accelerations
    steps = np.diff(times)
    wanted = np.maximum(1.0, np.ceil(steps / longest_step - 1e-6))
    total, most = float(np.sum(wanted)), max(MOST_NUMBERS / len(whole.joint_names), len(steps))
    if not total <= most:
        k = int(np.argmax(steps))
        raise TrajectoryError(
            f'{total:.3g} states are too many, expected at most {most:.3g}: the trajectory lasts '
            f'{times[-1] - times[0]:.3g} s; point {k} is at {times[k]:.10g} s, point {k + 1} at '
            f'{times[k + 1]:.10g} s. Check the times, or evaluate fewer states per second'
        )
    counts = wanted.astype(np.int64)
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
        value[points] = at_points  # exactly, without rounding
    return Trajectory(whole.joint_names, fine, *values), points


def smooth(trajectory: Trajectory, cutoff: float) -> Trajectory:
    """
    Derive velocities and accelerations from noisy measured positions.

    Parameters
    ----------
    trajectory : Trajectory
        Trajectory with k points of m joints; its velocities and accelerations are ignored.
    cutoff : float
        Cut-off frequency of the low-pass filter [Hz].

    Returns
    -------
    smooth : Trajectory
        Trajectory with velocities and accelerations, at k evenly spaced times.

    Raises
    ------
    TrajectoryError
        If the points are too few or too far apart for the cut-off frequency, or invalid as for
        `complete`.

    Notes
    -----
    A second-order Butterworth low-pass runs forwards and backwards, which causes no delay, before
    central differences. It hardly changes gravity efforts, which depend on positions.

    """
    _check(trajectory)
    k = len(trajectory.times)
    rate = (k - 1) / float(trajectory.times[-1] - trajectory.times[0]) if k > 1 else 0.0
    if k < _FEWEST_TO_SMOOTH or not 0.0 < cutoff < 0.5 * rate:
        raise TrajectoryError(
            f'{k} points at {rate:.3g} Hz cannot be smoothed at {cutoff:g} Hz, expected '
            f'{_FEWEST_TO_SMOOTH} or more, at more than {2.0 * cutoff:g} Hz'
        )
    from scipy.signal import butter, sosfiltfilt

    times = np.linspace(trajectory.times[0], trajectory.times[-1], k)
    even = [np.interp(times, trajectory.times, column) for column in trajectory.positions.T]
    low_pass = butter(2, cutoff, fs=rate, output='sos')
    run_in = min(k - 1, int(3.0 * rate / cutoff))  # points; longer than the transient
    positions = sosfiltfilt(low_pass, np.stack(even, axis=1), axis=0, padlen=run_in)
    velocities = np.gradient(positions, times, axis=0, edge_order=2)
    accelerations = np.gradient(velocities, times, axis=0, edge_order=2)
    return Trajectory(trajectory.joint_names, times, positions, velocities, accelerations)


def trajectory_efforts(
    dynamics: InverseDynamics, trajectory: Trajectory, others: Floats | None = None
) -> Floats:
    """
    Compute the efforts along a trajectory.

    Parameters
    ----------
    dynamics : InverseDynamics
        Dynamics of a robot with n joints.
    trajectory : Trajectory
        Trajectory of m of these joints, in any order, with velocities and accelerations.
    others : ndarray, shape (n,), optional
        Positions at which the other joints rest [rad or m], by default zero.

    Returns
    -------
    efforts : ndarray, shape (k, m)
        Efforts in the order of the trajectory's joints [N m or N].

    Raises
    ------
    TrajectoryError
        If a joint does not exist, or is named twice.

    """
    states, index = whole_states(dynamics, trajectory, others)
    tau = np.empty_like(states[0])
    # In pieces, because the first large batch compiles for seconds, too long for a control loop.
    for start in range(0, len(tau), LANES - 1):
        q, qd, qdd = (values[start : start + LANES - 1] for values in states)
        tau[start : start + LANES - 1] = dynamics.efforts(q, qd, qdd)
    efforts: Floats = tau[:, index]
    return efforts


def whole_states(
    dynamics: InverseDynamics, trajectory: Trajectory, others: Floats | None = None
) -> tuple[tuple[Floats, Floats, Floats], list[int]]:
    """
    Extend a trajectory to all joints of a robot.

    Parameters
    ----------
    dynamics, trajectory, others
        As for `trajectory_efforts`.

    Returns
    -------
    states : tuple of q, qd, qdd
        States of all joints of the robot at every point, each of shape (k, n).
    index : list of int
        Indices of the trajectory's joints among those of the robot.

    Raises
    ------
    TrajectoryError
        If a joint does not exist, or is named twice.

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
    from scipy.interpolate import CubicSpline  # takes a third of a second to import

    try:
        with np.errstate(all='ignore'):
            # For two or three points scipy uses a line or a parabola.
            derivative: Floats = CubicSpline(times, values, bc_type=ends)(times, order)
    except ValueError:  # raised if a slope is not finite
        derivative = np.full_like(values, np.nan)
    if not np.isfinite(derivative).all():
        raise TrajectoryError(
            'the spline overflows: positions are too far apart for the time between them'
        )
    return derivative


def _check(trajectory: Trajectory) -> None:
    names, times = trajectory.joint_names, trajectory.times
    if not len(times):
        raise TrajectoryError('no points, expected at least one')
    shape = len(times), len(names)
    for quantity, values in zip(trajectory._fields[2:], trajectory[2:], strict=True):
        if values is None:
            continue
        if values.shape != shape:
            raise TrajectoryError(f'{quantity} have shape {values.shape}, expected {shape}')
        if not np.isfinite(values).all():
            point, joint = np.argwhere(~np.isfinite(values))[0]
            raise TrajectoryError(
                f"{quantity} of joint '{shortened(names[joint])}' at point {point}: "
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
    """Return the indices of joints among known ones; raise a TrajectoryError if one is invalid."""
    if not names:
        raise TrajectoryError('no joint names')
    unknown = [name for name in names if name not in known]
    if unknown:
        raise TrajectoryError(unknown_name('joint', unknown[0], known))
    if len(set(names)) != len(names):
        twice = next(name for k, name in enumerate(names) if name in names[:k])
        raise TrajectoryError(f"joint '{shortened(twice)}' is named twice")
    return [known.index(name) for name in names]
