"""Functions that complete and refine trajectories, and compute their efforts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..errors import shortened, TrajectoryError, unknown_name
from ..robot.model import Floats, Integers
from .inverse_dynamics import InverseDynamics

MOST_NUMBERS = 2e7
"""Largest allowed value of states times joints; more would need gigabytes of memory."""


class Trajectory(NamedTuple):
    """Positions of m joints at k times, and optionally velocities and accelerations."""

    joint_names: tuple[str, ...]
    times: Floats
    """The k times, strictly ascending, shape (k,) [s]."""
    positions: Floats
    """Positions of m joints at k times, shape (k, m) [rad or m]."""
    velocities: Floats | None = None
    """Velocities of m joints at k times, shape (k, m) [rad/s or m/s]; None if unknown."""
    accelerations: Floats | None = None
    """Accelerations of m joints, shape (k, m) [rad/s^2 or m/s^2]; None if unknown."""


def complete(trajectory: Trajectory) -> tuple[Trajectory, tuple[str, ...]]:
    """
    Derive missing velocities and accelerations; return the result, and a note for each derivation.

    Missing velocities are derived from a cubic spline through the positions, at rest at both ends.
    If velocities are missing, missing accelerations are derived from the same spline. Otherwise,
    missing accelerations are derived from a cubic spline through the velocities, with not-a-knot
    ends. For a single point, missing velocities and accelerations are zero. An invalid trajectory
    raises a TrajectoryError.

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
    Insert states if points are far apart in time; return the result and the old points' indices.

    In the result, consecutive states are at most ``longest_step`` [s] apart. Quintic polynomials
    connect the points, as in ros2_control's joint trajectory controller. The polynomials match the
    positions, velocities and accelerations of the points. If `complete` has derived velocities and
    accelerations from the positions, the polynomials equal the cubic spline. Missing velocities or
    accelerations, or too many states, raise a TrajectoryError.

    """
    times, velocities, accelerations = whole.times, whole.velocities, whole.accelerations
    steps = np.diff(times)
    wanted = np.maximum(1.0, np.ceil(steps / longest_step - 1e-6))
    total, most = float(np.sum(wanted)), max(MOST_NUMBERS / len(whole.joint_names), len(steps))
    if not total <= most:
        k = int(np.argmax(steps))
        raise TrajectoryError(
            f'{total:.3g} states are too many, expected at most {most:.3g}. The trajectory lasts '
            f'{times[-1] - times[0]:.3g} s. The longest step is from point {k} at '
            f'{times[k]:.10g} s to point {k + 1} at {times[k + 1]:.10g} s. Check the times, or '
            'evaluate fewer states per second'
        )
    counts = wanted.astype(np.int64)
    points: Integers = np.concatenate([[0], np.cumsum(counts)])
    if velocities is None or accelerations is None:
        raise TrajectoryError('the trajectory lacks velocities or accelerations, expected both')
    if len(times) == 1 or np.all(counts == 1):
        return whole, points
    within = np.arange(points[-1]) - np.repeat(points[:-1], counts)
    fine = np.repeat(times[:-1], counts) + within * np.repeat(steps / counts, counts)
    given = np.stack([whole.positions, velocities, accelerations])
    polynomials = quintic(given[:, :-1], given[:, 1:], steps[:, None])
    of_state = np.repeat(polynomials, counts, axis=1)
    values = evaluate(
        of_state, (within / np.repeat(counts, counts))[:, None], np.repeat(steps, counts)[:, None]
    )
    values[:, points[:-1]] = given[:, :-1]  # exactly, without rounding
    values = np.concatenate([values, given[:, -1:]], axis=1)
    return Trajectory(whole.joint_names, np.append(fine, times[-1]), *values), points


def quintic(start: Floats, end: Floats, duration: Floats | float) -> Floats:
    """
    Return the coefficients of the quintic polynomials between two states, shape (6, ...).

    ``start`` and ``end`` contain position, velocity and acceleration, shape (3, ...), and
    ``duration`` [s] is positive. `evaluate` takes the coefficients, in ascending order.

    """
    q, v, a = start[0], duration * start[1], 0.5 * duration**2 * start[2]
    way = end[0] - (q + v + a)
    turn, bend = duration * end[1] - (v + 2.0 * a), duration**2 * end[2] - 2.0 * a
    return np.stack(
        [
            q,
            v,
            a,
            10.0 * way - 4.0 * turn + 0.5 * bend,
            -15.0 * way + 7.0 * turn - bend,
            6.0 * way - 3.0 * turn + 0.5 * bend,
        ]
    )


def evaluate(polynomials: Floats, fraction: Floats | float, duration: Floats | float) -> Floats:
    """
    Return position, velocity and acceleration of polynomials of `quintic`, shape (3, ...).

    ``fraction`` is the fraction of the ``duration`` [s] that has passed, from 0 to 1.

    """
    c0, c1, c2, c3, c4, c5 = polynomials
    u = fraction
    position = c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))
    velocity = c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))
    acceleration = 2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))
    return np.stack([position, velocity / duration, acceleration / duration**2])


def trajectory_efforts(
    dynamics: InverseDynamics, trajectory: Trajectory, others: Floats | None = None
) -> Floats:
    """
    Compute the efforts at the k points of a trajectory of m joints, shape (k, m) [N m or N].

    The trajectory must have velocities and accelerations. The trajectory may contain only some of
    the n joints of the robot, in any order. The columns of the result are in the order of the
    trajectory's joints. All other joints rest at the positions in ``others``, shape (n,) [rad or
    m], by default at zero. Unknown or repeated joint names raise a TrajectoryError.

    """
    states, index = whole_states(dynamics, trajectory, others)
    # One state at a time, because the first large batch on a machine compiles code for seconds.
    tau = [dynamics.efforts(*state) for state in zip(*states, strict=True)]
    efforts: Floats = np.reshape(tau, states[0].shape)[:, index]
    return efforts


def whole_states(
    dynamics: InverseDynamics, trajectory: Trajectory, others: Floats | None = None
) -> tuple[tuple[Floats, Floats, Floats], list[int]]:
    """
    Return q, qd and qdd of all n joints of the robot at k points, each of shape (k, n).

    The arguments and errors are those of `trajectory_efforts`. The second result contains the
    indices of the trajectory's joints among the joints of the robot.

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
    from scipy.interpolate import CubicSpline  # imported here, because scipy loads slowly

    try:
        with np.errstate(all='ignore'):
            # For two or three points, scipy uses a line or a parabola.
            derivative: Floats = CubicSpline(times, values, bc_type=ends)(times, order)
    except ValueError:  # raised if a slope is not finite
        derivative = np.full_like(values, np.nan)
    if not np.isfinite(derivative).all():
        raise TrajectoryError(
            'the spline overflows: points are too far apart for the time between them'
        )
    return derivative


def _check(trajectory: Trajectory) -> None:
    names, times = trajectory.joint_names, trajectory.times
    if not len(times):
        raise TrajectoryError('the trajectory has no points, expected at least one')
    shape = len(times), len(names)
    for quantity, values in zip(trajectory._fields[2:], trajectory[2:], strict=True):
        if values is None:
            continue
        if values.shape != shape:
            raise TrajectoryError(f'{quantity} have shape {values.shape}, expected {shape}')
        if not np.isfinite(values).all():
            point, joint = np.argwhere(~np.isfinite(values))[0]
            raise TrajectoryError(
                f"{quantity} of joint '{shortened(names[joint])}' are {values[point, joint]} at "
                f'point {point}, expected finite numbers'
            )
    if not np.isfinite(times).all():
        raise TrajectoryError(
            f'one of the times is {times[~np.isfinite(times)][0]}, expected finite times'
        )
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if len(late):
        point = int(late[0]) + 1
        raise TrajectoryError(
            f'point {point} is at {times[point]:g} s, expected a time later than '
            f'{times[point - 1]:g} s, the time of point {point - 1}'
        )


def joint_index(names: Sequence[str], known: Sequence[str]) -> list[int]:
    """Return the index in ``known`` of each name; invalid names raise a TrajectoryError."""
    if not names:
        raise TrajectoryError('the trajectory has no joint names')
    unknown = [name for name in names if name not in known]
    if unknown:
        raise TrajectoryError(unknown_name('joint', unknown[0], known))
    if len(set(names)) != len(names):
        twice = next(name for k, name in enumerate(names) if name in names[:k])
        raise TrajectoryError(f"joint '{shortened(twice)}' is named twice")
    return [known.index(name) for name in names]
