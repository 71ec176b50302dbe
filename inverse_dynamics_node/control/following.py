"""
Follows whole trajectories: generates the reference of each command, and holds the last position.

`plan` checks a trajectory and connects its points. `Following` leads from the present reference to
the plan, along the plan, and to rest. Its references never jump.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.trajectory import complete, evaluate, joint_index, quintic, refine, Trajectory
from ..errors import TrajectoryError
from ..robot.kinematics import whole_turns
from ..robot.model import Booleans, Floats, Integers
from .laws import Reference

_APPROACH = 0.1  # [s]; a first point that is due later is approached on a quintic polynomial
_FADE = 0.5  # [s]; time in which the difference between present reference and trajectory fades
_LONGEST_BRAKING, _SHORTEST_BRAKING = 2.0, 0.1  # [s]
LONGEST_GAP = 0.2
"""Longest time between joint states that does not end a trajectory [s]."""
_CHECK_STEP, _MOST_CHECKS = 0.01, 1e5  # [s]; distance and number of the states that are checked
_AT_REST = 1e-3  # [rad/s or m/s]
_LEAST_ROOM = 0.1  # of the speed limit, for the way to a plan that nearly reaches this limit
_AT_THE_END = np.array([[1.0], [0.0], [0.0]])  # of position, velocity and acceleration
_ROUNDING = 1e-6  # relative or absolute; limits may be exceeded so much


class JointLimits(NamedTuple):
    """What a plan must respect, for each of the m commanded joints."""

    joints: tuple[str, ...]
    units: tuple[str, ...]
    """Units of the positions."""
    is_continuous: Booleans
    lower: Floats
    """Lowest position, shape (m,) [rad or m]."""
    upper: Floats
    """Highest position, shape (m,) [rad or m]."""
    speeds: Floats
    """Largest velocity, shape (m,) [rad/s or m/s]."""


class Plan(NamedTuple):
    """A checked trajectory of j of the m commanded joints; it ends at rest."""

    joints: list[int]
    """Indices of the j joints among the commanded joints."""
    times: Floats
    """Times of k points since the start of the trajectory, shape (k,) [s]."""
    states: Floats
    """Positions, velocities and accelerations, shape (3, k, j)."""
    speeds: Floats
    """Largest speed of each joint, shape (j,) [rad/s or m/s]."""
    accelerations: Floats
    """Largest acceleration of each joint, shape (j,) [rad/s^2 or m/s^2]."""


def plan(trajectory: Trajectory, limits: JointLimits, present: Floats, begin: float = 0.0) -> Plan:
    """
    Check a trajectory, and connect its points by quintic polynomials.

    Missing velocities and accelerations are derived as by `complete`, but the acceleration at
    rest at either end is zero. ``present`` is the present reference of the commanded joints: its
    positions, velocities and accelerations, shape (3, m). The motion begins at the time ``begin``
    [s] of the trajectory. If the first point is due later, the motion leads from the present
    reference to the first point. A trajectory that cannot be followed raises a TrajectoryError.

    """
    joints = joint_index(trajectory.joint_names, limits.joints)
    of_joints = JointLimits._make(np.array(each)[joints] for each in limits)
    whole, is_approached = _with_start(trajectory, of_joints, present[:, joints], begin)
    times, states = whole.times, _states(whole)
    for end in (0, -1):
        states[2, end, np.abs(states[1, end]) <= _AT_REST] = 0.0
    step = max(_CHECK_STEP, float(times[-1] - times[0]) / _MOST_CHECKS)
    fine, points = refine(whole._replace(accelerations=states[2]), step)
    motion = _states(fine)
    _check(motion, points, of_joints, present[0, joints], first=-1 if is_approached else 0)
    return Plan(joints, times, states, *np.abs(motion[1:]).max(axis=1))


def _states(whole: Trajectory) -> Floats:
    return np.array([whole.positions, whole.velocities, whole.accelerations], dtype=np.float64)


def _with_start(
    trajectory: Trajectory, limits: JointLimits, present: Floats, begin: float
) -> tuple[Trajectory, bool]:
    """Return the complete trajectory from ``begin`` on, and whether a point was added to it."""
    whole, _ = complete(trajectory)  # also checks the trajectory
    shift = whole_turns(present[0] - whole.positions[0], limits.is_continuous)
    given: list[Floats | None] = [trajectory.positions + shift, *trajectory[3:]]
    whole = whole._replace(positions=whole.positions + shift)
    wait = float(whole.times[0]) - begin
    if wait <= 0.0:
        return whole, False
    start = present
    if wait < _APPROACH:  # too short for the way from the present reference
        q, qd, qdd = _states(whole)
        given, start = [q, qd, qdd], np.array([q[0] - wait * qd[0], qd[0], 0.0 * qdd[0]])
    rows: Any = (
        None if values is None else np.vstack([first, values])
        for first, values in zip(start, given, strict=True)
    )
    times = np.append(begin, whole.times)
    return complete(Trajectory(trajectory.joint_names, times, *rows))[0], True


def _check(
    motion: Floats, points: Integers, limits: JointLimits, present: Floats, first: int
) -> None:
    """
    Raise a TrajectoryError unless a motion is within the limits and ends at rest.

    ``motion`` contains the points and states between them, shape (3, states, j). ``points`` are
    the indices of the points among the states, and ``first`` is the number of the first point.

    """

    def complain(is_wrong: Booleans, values: Floats, what: str, per: str, expected: str) -> None:
        if not is_wrong.any():
            return
        # A point of the trajectory says more than a state between two points.
        rows = points if is_wrong[points].any() else np.arange(len(values))
        worst = np.argmax(np.where(is_wrong[rows], np.abs(values[rows]), -1.0))
        row, j = divmod(int(worst), values.shape[1])
        after = int(np.searchsorted(points, rows[row]))
        is_point = points[after] == rows[row] and after + first >= 0
        before = '' if is_point else 'before '
        limit = expected.format(limits.lower[j], limits.upper[j], limits.speeds[j])
        raise TrajectoryError(
            f"{before}point {max(after + first, 0)}: joint '{limits.joints[j]}' {what} "
            f'{values[rows[row], j]:.4g} {limits.units[j]}{per}, expected {limit}'
        )

    q, qd, _ = motion
    lower, upper = np.minimum(limits.lower, present), np.maximum(limits.upper, present)
    is_outside = (q < lower - _ROUNDING) | (q > upper + _ROUNDING)
    complain(is_outside, q, 'is at', '', '{0:.4g} to {1:.4g}')
    is_fast = np.abs(qd) > limits.speeds * (1.0 + _ROUNDING)
    complain(is_fast, qd, 'moves at', '/s', 'at most {2:.4g}')
    is_moving = np.zeros_like(is_fast)
    is_moving[-1] = np.abs(qd[-1]) > _AT_REST
    complain(is_moving, qd, 'moves at', '/s', '0 at the last point')


_REST = Plan([], np.zeros(1), np.zeros((3, 1, 0)), np.zeros(0), np.zeros(0))
"""A plan of no joint, so that all come to rest."""


class Following:
    """
    Generates the references of the commanded joints along plans.

    A plan begins at the present reference. The difference between the present reference and the
    plan, in position, velocity and acceleration, fades on a quintic polynomial. Joints that are
    not in the plan come to rest and are held, as is the last position of the plan.

    """

    def __init__(self, limits: JointLimits) -> None:
        self.limits, m = limits, len(limits.joints)
        self.plan: Plan | None = None
        """The plan that is followed or held, if any."""
        self.next: Plan | None = None
        """The plan that begins later, if any."""
        self.reason = ''
        """Why the last plan has ended before its last point, or ''."""
        self.state: Floats = np.zeros((3, m))
        """Positions, velocities and accelerations of the last reference, shape (3, m)."""
        self.error: Floats = np.zeros(m)
        """Distances of the arm from the last reference, shape (m,) [rad or m]."""
        self.largest_error: Floats = np.zeros(m)
        """Largest distances since the plan began, shape (m,) [rad or m]."""
        self._rest, self._fade, self._durations = self.state, np.zeros((6, m)), np.ones(m)
        self._accelerations, self._no_efforts = np.zeros((2, m))
        self._time = self._passed = self._wait = 0.0  # [s]

    @property
    def is_active(self) -> bool:
        """Whether there is a reference, from a trajectory or at its last position."""
        return self.plan is not None

    @property
    def time_left(self) -> float:
        """Time until the reference comes to rest [s]."""
        if self.next is not None:
            return self._wait + float(self.next.times[-1])
        if self.plan is None:
            return 0.0
        fade = float(self._durations.max()) - self._passed
        return max(0.0, float(self.plan.times[-1]) - self._time, fade)

    @property
    def progress(self) -> float:
        """Fraction of the time of the plan that has passed, from 0 to 1."""
        left = self.time_left
        passed = 0.0 if self.next is not None else self._passed
        return passed / (passed + left) if left else 1.0

    def start(self, plan: Plan, time: float, present: Floats, farthest: float = math.inf) -> None:
        """
        Follow a plan from the present reference on, which has shape (3, m).

        ``time`` is the time of the trajectory [s]. If it is negative, the present motion goes on
        until the trajectory starts. A TrajectoryError is raised if the trajectory has ended, or if
        the plan is more than ``farthest`` [rad or m] away.

        """
        if time > plan.times[-1]:
            raise TrajectoryError(f'the trajectory ended {time - plan.times[-1]:.3g} s ago')
        begin = _at(plan, max(time, 0.0))[0]
        if self.is_active and time < 0.0:
            there = self._after(-time)
        else:
            # The arm may have turned since the plan was made.
            there = present = present.copy()
            way = begin - present[0, plan.joints]
            present[0, plan.joints] += whole_turns(way, self.limits.is_continuous[plan.joints])
        distance = np.abs(begin - there[0, plan.joints])
        j = int(np.argmax(distance))
        if distance[j] > farthest:
            name, unit = (each[plan.joints[j]] for each in self.limits[:2])
            raise TrajectoryError(
                f"joint '{name}' is {distance[j]:.4g} {unit} from the trajectory where it begins, "
                f'expected at most {farthest:g} {unit}'
            )
        if time >= 0.0:
            self._begin(plan, time, present)
            return
        if not self.is_active:
            self._begin(_REST, 0.0, present)
        self.next, self._wait = plan, -time

    def end(self, reason: str) -> None:
        """Stop generating references."""
        if self.is_active:
            self.plan = self.next = None
            self.reason = reason

    def reference(self, now: float, elapsed: float) -> Reference:
        """Return the reference at time ``now``, ``elapsed`` along from the last one [s]."""
        self._time, self._passed = self._time + elapsed, self._passed + elapsed
        if self.next is not None:
            self._wait -= elapsed
            if self._wait <= 0.0:
                self._begin(self.next, -self._wait, self._after(self._wait))
        self.state = self._after(0.0)
        q, qd, qdd = self.state
        return Reference(qdd, self._no_efforts, now, q, qd)

    def compare(self, distance: Floats) -> None:
        """Store how far the arm is from the last reference, shape (m,) [rad or m]."""
        self.error = np.abs(distance)
        self.largest_error = np.maximum(self.largest_error, self.error)

    def hold(self, present: Floats, reason: str) -> None:
        """Come to rest from a motion of shape (3, m), such as that of the arm, and hold."""
        if self.is_active:
            self._begin(_REST, 0.0, present)
            self.reason = reason

    def _begin(self, plan: Plan, time: float, present: Floats) -> None:
        ends, durations = self._braking(present)
        ends[plan.joints] = 0.0
        self._rest = np.stack([ends, 0.0 * ends, 0.0 * ends])
        offset = present - self._rest
        offset[:, plan.joints] -= _at(plan, time)
        # The way adds at most what the plan leaves of the speed limit, or a tenth of it.
        way = 1.875 * np.abs(offset[0, plan.joints])
        limits = self.limits.speeds[plan.joints]
        room = np.maximum(limits - plan.speeds, _LEAST_ROOM * limits)
        durations[plan.joints] = np.maximum(_FADE, way / room)
        self._fade, self._durations = quintic(offset, 0.0 * offset, durations), durations
        self.plan, self.next, self.reason, self.state = plan, None, '', present
        self._time, self._passed = time, 0.0
        self._accelerations[plan.joints] = plan.accelerations
        self.largest_error = np.zeros(len(durations))

    def _braking(self, present: Floats) -> tuple[Floats, Floats]:
        """
        Return where the joints come to rest, and after which time [s], shape (m,).

        With this time, the deceleration is at most the largest acceleration of the plan, if the
        present acceleration is. A joint that is near its limit brakes harder.

        """
        q, qd, qdd = present
        lower, upper = np.minimum(self.limits.lower, q), np.maximum(self.limits.upper, q)
        room = np.where(qd > 0.0, upper - q, q - lower)
        speed = np.abs(qd) + 1e-9  # not zero
        time = np.minimum(2.25 * speed / (self._accelerations + 1e-9), 2.0 * room / speed)
        time = np.clip(time, _SHORTEST_BRAKING, _LONGEST_BRAKING)
        return np.clip(q + time * (0.5 * qd + time * qdd / 12.0), lower, upper), time

    def _after(self, wait: float) -> Floats:
        """Return the reference in ``wait`` [s], shape (3, m)."""
        assert self.plan is not None
        state: Floats = self._rest.copy()
        fraction = (self._passed + wait) / self._durations
        if fraction.min() < 1.0:
            state += evaluate(self._fade, np.minimum(fraction, 1.0), self._durations)
        state[:, self.plan.joints] += _at(self.plan, self._time + wait)
        return state


def _at(plan: Plan, time: float) -> Floats:
    """Return the state of a plan, shape (3, j); the last one after the end."""
    time = max(time, float(plan.times[0]))
    k = int(np.searchsorted(plan.times, time, side='right')) - 1
    if k == len(plan.times) - 1:
        at_rest: Floats = plan.states[:, -1] * _AT_THE_END
        return at_rest
    duration = plan.times[k + 1] - plan.times[k]
    polynomials = quintic(plan.states[:, k], plan.states[:, k + 1], duration)
    return evaluate(polynomials, (time - plan.times[k]) / duration, duration)
