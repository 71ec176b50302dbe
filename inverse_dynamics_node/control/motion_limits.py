"""
Notices an arm that runs away, and keeps efforts from driving joints beyond their limits.

The efforts are right only if the model, the signs and the order of the joints are right. Four
observations show that something is wrong: a joint is too fast, a position changes faster than the
joint can move, the velocities of a joint contradict its positions, and the arm is too far from
its reference. `MotionLimits` makes the first three, and `Supervisor` makes the last. Each of
them is the reason for a limit stop. In a limit stop, the efforts fall to zero within `LIMIT_RAMP`
and are not damped, because the sign of a command may be what is wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
import enum
import math
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..dynamics.jit import compile_for, compiled
from ..robot.model import Floats
from .joint_states import State
from .settings import Settings

LIMIT_RAMP = 0.01
"""Time in which the efforts fall to zero in a limit stop [s]."""
_FADING = 0.1  # fraction of the speed limit over which efforts in the direction of motion fade
_RETURN = 0.2  # [s]; time in which faded efforts return
_QUICK_RETURN = 0.03  # [s]; the same for efforts that have begun to oppose the motion
_OVERSHOOT = 1.1  # [speed limits]; a joint that follows a reference at its limit may overshoot
_LEAST_TIME = 0.004  # [s]; the states must exceed the limit for this time
_BURST = 0.06  # [s]; states may be delayed for this long and then arrive together
_SHORTEST = 0.002  # [s]; shortest interval for a speed that is taken from positions
_FILTER = 0.05  # [s]; time constant of a speed that is taken from positions
_COARSE = 0.02  # [rad or m]; steps of coarse encoders
_MOST_JUMPS = 2.5  # jumps within about a second, before positions are said to alternate
_LONGEST = 0.5  # [s]; after a longer interval between states, the history begins anew
# Velocities contradict positions if the integral of the velocity differs from the change of
# position. The permitted difference is a constant, plus a fraction of the larger value, plus a
# fraction of the way to and fro. Changes older than about a second are forgotten, so that noise
# does not add up. The way to and fro counts because the times of arrival are not those of the
# measurement: joint states may arrive together after a pause, or from a simulation that runs more
# slowly for a moment.
_LEAST_ERROR, _RELATIVE_ERROR, _MEMORY = 0.02, 0.35, 1.0  # [rad or m], no unit, [s]
_OF_PATH, _LONGEST_PAUSE = 0.15, 0.1  # no unit, [s]
# A change of position is a step of the efforts, not motion, if it is faster than this multiple of
# the speed limit. Messages may be late by _LATENESS, but not after a pause of _LONGEST_PAUSE. The
# speed limit is taken to be within _SPEEDS: at least, by default, and at most.
_FACTOR, _LATENESS = 2.0, 0.03  # [speed limits], [s]
_SPEEDS = ((0.1, 2.0, 5.0), (1.0, 10.0, 30.0))  # [m/s] of prismatic joints, [rad/s] of others
_LARGEST_STEP = 1e6  # [rad or m]; larger steps are cut to this size
# Rows of `MotionLimits._rows`. The first m columns belong to the commanded joints.
_ROWS = 19
_INDEX, _SPEED, _IS_CONTINUOUS, _FASTEST, _TIME, _POSITION, _VELOCITY, _SHARE = range(8)
# The history of a joint; see `observe_joints`.
_ABOVE, _BELOW, _JUMPS, _PACE, _OVER, _WAY = range(8, 14)
_INTEGRAL, _PATH, _ROOM_ABOVE, _ROOM_BELOW, _IS_KNOWN = range(14, _ROWS)


class Finding(enum.IntEnum):
    """What is wrong with the motion of a joint."""

    NOTHING = 0
    TOO_FAST = 1
    CONTRADICTION = 2
    JUMP = 3
    ALTERNATION = 4


class Observation(NamedTuple):
    """What a joint state shows, compared with those before it."""

    finding: Finding
    """What is wrong with the motion of a commanded joint."""
    text: str
    """A sentence about it, or ''."""
    has_moved: bool
    """Whether a commanded joint has moved too fast for a motion."""
    has_jumped: bool
    """Whether any joint of the robot has moved too fast for a motion."""


_NOTHING = Observation(Finding.NOTHING, '', has_moved=False, has_jumped=False)


class MotionLimits:
    """
    Compares the motion of the commanded joints with their limits.

    Two speed limits apply. While a joint follows a reference, its limit is ``velocity_limits``.
    While the arm floats, holds its position or is guided by hand, the limit is the fraction
    ``guiding_speed`` of it. Efforts in the direction of motion fade over the last tenth of the
    limit, so that an arm that is pushed by hand becomes heavier. Whoever pushes on meets the
    resistance of the arm's own weight and inertia. At twice this fraction, the arm is stopped.

    A joint that follows a reference at more than 1.1 times its limit is driven by the efforts. The
    arm is then stopped, unless the joint becomes slower.

    A one-sided spring and damper keeps each joint from its position limits. It begins
    ``limit_margin`` before the limit. It never pulls towards the limit, so it takes energy out of
    the motion.

    A position that changes at more than twice the speed limit is a jump, and not a motion. The
    caller must then blend the efforts. Nothing else is observed of joints that are not commanded.

    ``index`` contains the indices of the m commanded joints among the n joints of the robot.

    """

    def __init__(self, dynamics: InverseDynamics, index: list[int]) -> None:
        self._dynamics, self._index = dynamics, index
        robot = dynamics.robot
        joints = [*index, *(i for i in range(len(robot.joint_names)) if i not in index)]
        self._rows = np.zeros((_ROWS, len(joints)))
        self._rows[_INDEX], self._rows[_IS_CONTINUOUS] = joints, robot.is_continuous[joints]
        self._rows[_FASTEST] = _plausible(robot.velocity_limits, robot.is_prismatic_joint)[joints]
        self._rows[_TIME] = -math.inf
        self._commanded = self._rows[:, : len(index)]  # a view
        self._of_urdf = self._commanded[_FASTEST].copy()
        self._found = np.zeros(2)
        self._none = np.zeros(len(index))
        self.reset()
        compile_for(
            observe_joints,
            'UniTuple(i8, 2)(f8[:,::1], i8, f8[::1], f8[::1], f8[::1], b1[::1], f8, f8[::1])',
        )
        compile_for(restrain, 'void(f8[:,::1], f8[::1], f8[::1], f8, f8)')

    @property
    def speeds(self) -> Floats:
        """Largest velocities while a reference is followed, shape (m,) [rad/s or m/s]."""
        speeds: Floats = self._commanded[_SPEED].copy()
        return speeds

    def apply(self, settings: Settings, of_joint: Mapping[str, Floats]) -> None:
        """Change the limits; ``of_joint`` is the result of `Settings.expanded`."""
        robot, given = self._dynamics.robot, of_joint['velocity_limits']
        speed = np.where(given < 0.0, robot.velocity_limits[self._index], given)
        speed[speed == 0.0] = math.inf
        margin, stiffness = of_joint['limit_margin'], of_joint['limit_stiffness']
        self._commanded[_SPEED], self._guiding = speed, settings.guiding_speed
        fastest = _plausible(speed, robot.is_prismatic_joint[self._index])
        self._commanded[_FASTEST] = np.maximum(self._of_urdf, fastest)
        self._stiffness = stiffness
        self._lower = robot.lower[self._index] + margin
        self._upper = robot.upper[self._index] - margin
        self._has_springs = bool((stiffness > 0.0).any())

    def reset(self) -> None:
        """Forget the motion so far, but not the positions."""
        self._rows[[_IS_KNOWN, _JUMPS]] = 0.0
        self._rows[_SHARE] = 1.0

    def observe(self, state: State, *, is_following: bool) -> Observation:
        """
        Compare a joint state with the limits, and with the joint states before it.

        The same state may be given again. ``is_following`` says whether the arm follows a
        reference.

        """
        factor = _OVERSHOOT if is_following else 2.0 * self._guiding
        found, jump = observe_joints(
            self._rows,
            len(self._index),
            state.q,
            state.qd,
            state.times,
            state.has_velocity,
            factor,
            self._found,
        )
        if not found and not jump:
            return _NOTHING
        finding = Finding(found)
        text = self._describe(finding, factor) if finding else ''
        return Observation(finding, text, jump > 1, jump > 0)

    def restrain(
        self, state: State, tau: Floats, added: Floats, step: float, *, is_following: bool
    ) -> Floats:
        """
        Return the efforts to add to ``tau``, so that no effort drives a joint beyond its limits.

        ``tau`` contains the computed efforts of all joints, shape (n,), and ``added`` the efforts
        to add to those of the commanded joints, shape (m,) [N m or N]. ``step`` is the time step
        of ramps [s].

        """
        result: Floats = added.copy()
        restrain(self._rows, tau, result, 1.0 if is_following else self._guiding, step)
        if self._has_springs:
            result += self.springs(state)
        return result

    def springs(self, state: State) -> Floats:
        """Return the efforts that push joints away from their limits, shape (m,) [N m or N]."""
        q, qd = state.q[self._index], state.qd[self._index]
        depth = np.maximum(q - self._upper, 0.0) - np.maximum(self._lower - q, 0.0)
        depth[self._stiffness == 0.0] = 0.0
        if not depth.any():
            return self._none
        inertia = self._dynamics.mass_matrix(state.q).diagonal()[self._index]
        damping = 2.0 * np.sqrt(self._stiffness * inertia)
        side = np.sign(depth)
        pushing: Floats = -side * np.maximum(0.0, side * (self._stiffness * depth + damping * qd))
        return pushing

    def _describe(self, finding: Finding, factor: float) -> str:
        k, value, robot = int(self._found[0]), float(self._found[1]), self._dynamics.robot
        name = robot.joint_names[self._index[k]]
        unit = 'm' if robot.is_prismatic_joint[self._index[k]] else 'rad'
        if finding is Finding.TOO_FAST:
            limit = min(1.0, factor) * self._rows[_SPEED, k]
            text = f'{name} moved at {value:.3g} {unit}/s, limit {limit:.3g} {unit}/s'
        elif finding is Finding.JUMP:
            text = f'{name} jumped by {value:.3g} {unit}, which no motion explains'
        elif finding is Finding.ALTERNATION:
            text = (
                f'{name} jumps to and fro by {abs(value):.3g} {unit}: does more than one node '
                'publish its state?'
            )
        else:
            text = (
                f'the velocities of {name} contradict its positions: it moved by {value:.3g} '
                f'{unit}, but its velocities add up to {self._rows[_INTEGRAL, k]:.3g} {unit}'
            )
        if finding is not Finding.JUMP:
            self.reset()
        return text


def _plausible(speed: Floats, is_prismatic: Any) -> Floats:
    """Return speed limits within `_SPEEDS`; the default replaces an infinite limit."""
    least, usual, most = np.where(is_prismatic, *np.array(_SPEEDS)[:, :, None])
    limits: Floats = np.clip(np.where(np.isfinite(speed), speed, usual), least, most)
    return limits


@compiled
def observe_joints(
    rows: Any,
    m: int,
    q: Any,
    qd: Any,
    times: Any,
    has_velocity: Any,
    factor: float,
    found: Any,
) -> tuple[int, int]:
    """
    Follow the motion of the joints; return a `Finding` and a jump.

    The jump is 2 if one of the ``m`` commanded joints has moved too fast for a motion, 1 if only
    another joint has, and otherwise 0.

    ``rows`` has one column for each joint, commanded joints first. ``q``, ``qd``, ``times`` and
    ``has_velocity`` have one value for each joint of the robot. ``factor`` is the stop limit, as a
    multiple of the speed limit. ``found`` receives the number of the joint, and its speed
    [rad/s or m/s] or its change of position [rad or m]. The rows of the history are:

    - `_ABOVE`, `_BELOW`: how far the joint may move in each direction before it moves too fast for
      a motion; grows at `_FACTOR` times the speed limit, and shrinks as the joint moves
    - `_JUMPS`: the number of jumps within about a second
    - `_PACE`: the velocity, or that of the positions if no velocity is measured
    - `_OVER`: the time for which the velocity has exceeded the stop limit
    - `_WAY`, `_INTEGRAL`, `_PATH`: change of position, integral of the velocity, and the way to
      and fro, over about a second
    - `_ROOM_ABOVE`, `_ROOM_BELOW`: like `_ABOVE` and `_BELOW`, for the stop limit and for states
      that are delayed for longer
    - `_IS_KNOWN`: 0 if the rows from `_JUMPS` on have to begin anew

    """
    finding, jump = 0, 0
    for k in range(rows.shape[1]):
        i = int(rows[_INDEX, k])
        elapsed = times[i] - rows[_TIME, k]
        if elapsed == 0.0 and q[i] == rows[_POSITION, k]:
            continue
        velocity, last = qd[i], rows[_VELOCITY, k]
        step = min(max(q[i] - rows[_POSITION, k], -_LARGEST_STEP), _LARGEST_STEP)
        if rows[_IS_CONTINUOUS, k] != 0.0 and abs(step) < _LARGEST_STEP:
            step -= 2.0 * math.pi * np.rint(step / (2.0 * math.pi))
        rows[_TIME, k], rows[_POSITION, k], rows[_VELOCITY, k] = times[i], q[i], velocity
        most = _FACTOR * rows[_FASTEST, k]
        if elapsed == math.inf:
            rows[_ABOVE, k] = rows[_BELOW, k] = most * _LATENESS
        else:
            is_late = not 0.0 <= elapsed <= _LONGEST_PAUSE
            gained = most * min(max(elapsed, 0.0), _LONGEST_PAUSE)
            above = gained - step + (0.0 if is_late else rows[_ABOVE, k])
            below = gained + step + (0.0 if is_late else rows[_BELOW, k])
            most *= 0.0 if is_late else _LATENESS
            rows[_ABOVE, k] = min(max(above, 0.0), most)
            rows[_BELOW, k] = min(max(below, 0.0), most)
            if min(above, below) < 0.0:
                jump = max(jump, 2 if k < m else 1)
        if k >= m:
            continue
        speed = rows[_SPEED, k]
        room = 2.0 * speed * _BURST + _COARSE
        is_known = rows[_IS_KNOWN, k] != 0.0 and 0.0 <= elapsed <= _LONGEST
        is_jump = False
        if is_known:
            rows[_JUMPS, k] = max(0.0, rows[_JUMPS, k] - elapsed)
            fastest = max(speed, abs(velocity), abs(last))
            is_jump = abs(step) > room + 2.0 * fastest * elapsed
        if is_jump:
            rows[_JUMPS, k] += 1.0
            finding, found[0], found[1] = 4 if rows[_JUMPS, k] > _MOST_JUMPS else 3, k, step
        if is_jump or not is_known:
            rows[_IS_KNOWN, k] = 1.0
            rows[_PACE:_ROOM_ABOVE, k] = 0.0
            rows[_PATH, k] = _LONGEST_PAUSE / _OF_PATH * abs(velocity)  # old states may follow
            rows[_ROOM_ABOVE, k] = rows[_ROOM_BELOW, k] = room
            continue
        limit = factor * speed
        shown = step / max(elapsed, _SHORTEST)
        above = rows[_ROOM_ABOVE, k] + limit * elapsed - step
        below = rows[_ROOM_BELOW, k] + limit * elapsed + step
        if not min(above, below) >= 0.0 and speed < math.inf and finding == 0:
            finding, found[0], found[1] = 1, k, abs(shown)
        rows[_ROOM_ABOVE, k] = min(max(above, 0.0), room)
        rows[_ROOM_BELOW, k] = min(max(below, 0.0), room)
        if not has_velocity[i]:
            rows[_PACE, k] += (shown - rows[_PACE, k]) * min(1.0, elapsed / _FILTER)
            continue
        rows[_PACE, k] = velocity
        over = rows[_OVER, k]
        if abs(velocity) <= limit:
            rows[_OVER, k] = -1.0
        else:
            is_slowing = abs(velocity) < abs(last) and velocity * last > 0.0
            rows[_OVER, k] = over + elapsed if over >= 0.0 and not is_slowing else 0.0
            if finding == 0 and rows[_OVER, k] >= _LEAST_TIME:
                finding, found[0], found[1] = 1, k, abs(velocity)
        memory = max(0.0, 1.0 - elapsed / _MEMORY)
        way = memory * (rows[_WAY, k] + step)
        integral = memory * (rows[_INTEGRAL, k] + 0.5 * elapsed * (last + velocity))
        path = memory * (rows[_PATH, k] + abs(step))
        rows[_WAY, k], rows[_INTEGRAL, k], rows[_PATH, k] = way, integral, path
        bound = _LEAST_ERROR + _RELATIVE_ERROR * max(abs(way), abs(integral)) + _OF_PATH * path
        if finding < 2 and not abs(way - integral) <= bound:
            finding, found[0], found[1] = 2, k, way
    return finding, jump


@compiled
def restrain(rows: Any, tau: Any, added: Any, factor: float, elapsed: float) -> None:
    """
    Reduce efforts that drive joints at their speed limits.

    ``added`` has one value for each commanded joint, and is changed in place. ``factor`` is the
    limit as a multiple of the speed limit. An effort falls within `_QUICK_RETURN` at the fastest,
    so that it does not step. It returns within `_RETURN`, so that it does not chatter. ``elapsed``
    is the time step of ramps [s].

    """
    # Without numba, floats do not cause warnings, as numpy scalars do.
    for k in range(len(added)):
        limit, pace = factor * float(rows[_SPEED, k]), float(rows[_PACE, k])
        effort = float(tau[int(rows[_INDEX, k])]) + float(added[k])
        is_driving = effort * pace > 0.0
        last = rows[_SHARE, k]
        share = min(1.0, last + elapsed / (_RETURN if is_driving else _QUICK_RETURN))
        if is_driving and abs(pace) > (1.0 - _FADING) * limit:
            least = last - elapsed / _QUICK_RETURN
            share = min(share, max(0.0, least, (limit - abs(pace)) / (_FADING * limit)))
        rows[_SHARE, k] = share
        if share < 1.0:
            added[k] -= (1.0 - share) * effort
