"""Collects positions, velocities, efforts and arrival times of joints by joint name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
import math
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.jit import compile_for, compiled
from ..errors import ConfigurationError, did_you_mean, JointStateError
from ..robot.model import Booleans, Floats, Integers

LATE_AFTER = 1.0
"""Time after which an uncommanded joint without new states counts as late [s]."""
_VELOCITY_TIMEOUT = 0.05  # [s]
_MOST_FOREIGN_NAMES = 64  # remembered names that are not joints of this robot
_LONGEST_NAME = 100  # [characters]; longer names take too long to compare
LONG_AGO = -1e300
"""Time stored for a locked joint that was never reported [s]; finite, so that ages are finite."""
LARGEST = 1e9
"""Largest accepted position or velocity [rad, m, rad/s, m/s], so that efforts are finite."""
# Rows of the known state, with one column per joint of the robot.
POSITION, VELOCITY, TIME, EFFORT = range(4)
# Rows of a message, with one column per joint in the message.
_POSITION, _VELOCITY, _EFFORT = range(3)
# Rows of the flags, with one column per joint of the robot.
_HAS_VELOCITY, _LOST = range(2)
# Results of `store_joint_state`: `ABSURD`, or the sum of some of the other flags.
ABSURD, STORED, CHANGED = -1, 1, 2

Numbers = Sequence[float] | Floats


class State(NamedTuple):
    """The joint state of the whole robot at one time."""

    q: Floats
    """Joint positions, shape (n,) [rad or m]."""
    qd: Floats
    """Joint velocities, shape (n,) [rad/s or m/s]."""
    time: float
    """Oldest arrival time among the commanded joints [s]."""
    times: Floats
    """Arrival time of each joint's state, shape (n,) [s]."""
    has_velocity: Booleans
    """Which joints have a measured velocity, shape (n,)."""
    delay: float = 0.0
    """Time from measurement to arrival [s], if known."""


class Events(NamedTuple):
    """What has happened to the joint states since the last step, apart from motion."""

    has_changed: bool = False
    """
    Whether what is known of a joint has changed. The possible causes are:

    - The states of an uncommanded joint have become late, or arrive in time again.
    - A locked joint was reported for the first time.
    - The velocity of a joint was reported for the first time.
    - The velocity of a joint is missing in new reports.
    """
    lost_velocities: tuple[str, ...] = ()
    """Joints whose velocities are no longer reported."""


_NO_EVENTS = Events()


@dataclass
class Layout:
    """Joint names of a message, and the places to store its values."""

    names: tuple[str, ...]
    """All names in the message."""
    places: Integers
    """Indices of the k known joints, in the robot (row 0) and in the message (row 1)."""
    received: Floats
    """Positions, velocities and efforts of the last message, shape (3, number of names)."""


class JointStateCollector:
    """
    Collects joint states by joint name; each message may contain any joints in any order.

    Every joint has its own arrival time, because the drivers of an arm and a gripper often share a
    topic.

    ``joint_names`` are the n joints of the robot. Other joints are ignored. ``locked`` contains
    positions [rad or m] for joints that might never be reported. A locked position applies until
    the first report of the joint. Locked joints are never missing and never stale. ``commanded``
    lists the joints that need a fresh state. By default, all joints that are not locked need a
    fresh state. A ConfigurationError is raised if a locked joint is unknown or commanded, or if a
    locked position is not finite.

    """

    def __init__(
        self,
        joint_names: Sequence[str],
        locked: Mapping[str, float] | None = None,
        commanded: Sequence[str] = (),
    ) -> None:
        self.joint_names = tuple(joint_names)
        n = len(self.joint_names)
        self._known = np.zeros((4, n))
        self.q, self.qd, self.times, self.efforts = self._known
        """Last known states, each array of shape (n,); unmeasured efforts are NaN."""
        self.times[:], self.efforts[:] = -math.inf, math.nan
        self._events = _NO_EVENTS
        self.velocity_timeout = _VELOCITY_TIMEOUT
        """Time after a joint's last velocity in which states without velocity are ignored [s]."""
        self._flags = np.zeros((2, n), dtype=bool)
        self._has_velocity, self._has_lost_velocity = self._flags
        self._index = {name: i for i, name in enumerate(self.joint_names)}
        self.foreign_names: list[str] = []
        """Some of the reported names that are not joints of the robot."""
        self._lock(locked or {}, commanded)
        self._is_free = self.times == -math.inf  # not locked
        self._is_commanded = self._is_free & [
            not commanded or name in commanded for name in self.joint_names
        ]
        self._is_resting = np.zeros(n, dtype=bool)
        self._has_resting = False
        compile_kernels()
        self.delay = 0.0
        """Time from measurement to arrival of the states, set by the caller if known [s]."""
        self.time = self._other_time = -math.inf
        """Oldest arrival time among the commanded joints [s]; -inf until all were reported."""
        self._find_oldest()

    def layout(self, names: tuple[str, ...]) -> Layout:
        """Prepare to store messages with these names; raise a JointStateError for a duplicate."""
        in_message = [k for k, name in enumerate(names) if name in self._index]
        in_robot = [self._index[names[k]] for k in in_message]
        if len(set(in_robot)) != len(in_robot):
            [(joint, _)] = Counter(names[k] for k in in_message).most_common(1)
            raise JointStateError(f"joint '{joint}' is named twice")
        self._remember_foreign_names(names)
        places = np.array([in_robot, in_message], np.int64)
        return Layout(names, places, np.zeros((3, len(names))))

    def store(
        self,
        now: float,
        layout: Layout,
        positions: Numbers,
        velocities: Numbers,
        efforts: Numbers = (),
    ) -> bool:
        """
        Store one joint state, or raise an error and store nothing.

        ``now`` is the time of arrival [s]. ``layout`` is the result of the method `layout` for the
        names in the message. ``positions`` has one value for each name. ``velocities`` and the
        measured ``efforts`` have one value for each name, or are empty.

        NaN means that a value is not reported in this message. A joint without position is
        ignored, as if the message did not name it. A joint without velocity is ignored too if it
        had a velocity less than `velocity_timeout` ago. Otherwise, its velocity is stored as zero.
        An unmeasured effort is stored as NaN.

        The result is true if the state of any joint of the robot was stored. A message without
        joints of the robot is ignored. Otherwise, a JointStateError is raised if the lengths
        differ, or if a position or velocity exceeds `LARGEST`.

        """
        names = layout.names
        if not layout.places.size:
            return False
        if len(positions) != len(names):
            raise JointStateError(f'received {len(names)} names, but {len(positions)} positions')
        if len(velocities) not in (0, len(names)):
            raise JointStateError(f'received {len(names)} names, but {len(velocities)} velocities')
        if len(efforts) not in (0, len(names)):
            raise JointStateError(f'received {len(names)} names, but {len(efforts)} efforts')
        received = layout.received
        received[0] = positions
        # Drivers omit unmeasured velocities, or send NaN instead.
        received[1] = velocities if len(velocities) else math.nan
        has_efforts = len(efforts) > 0
        if has_efforts:
            received[2] = efforts
        result = store_joint_state(
            received,
            layout.places,
            self._known,
            self._flags,
            now,
            self.velocity_timeout,
            has_efforts,
        )
        if result == ABSURD:
            raise self._absurd(layout)
        if result & CHANGED:
            lost = tuple(self._named(self._has_lost_velocity))
            lost = tuple(dict.fromkeys(self._events.lost_velocities + lost))
            self._events = Events(True, lost)
            self._has_lost_velocity[:] = False
        if result & STORED:
            self._find_oldest()
        return bool(result & STORED)

    def at(self, now: float) -> tuple[State | None, Events]:
        """Return the latest state, and what has happened since the last call; ``now`` in [s]."""
        self._rest_late(now)
        events, self._events = self._events, _NO_EVENTS
        return self.state(), events

    def state(self) -> State | None:
        """Return the latest state; None until all unlocked joints have been reported."""
        if self.time == -math.inf or self._other_time == -math.inf:
            return None
        return State(self.q, self.qd, self.time, self.times, self._has_velocity, self.delay)

    def missing(self) -> list[str]:
        """Return the unlocked joints that were never reported."""
        return self._named(self.times == -math.inf)

    def stale(self, now: float, timeout: float) -> list[str]:
        """Return the commanded joints whose last report is older than the timeout [s]."""
        return self._named(self._is_commanded & self._is_old(now, timeout))

    def late(self, now: float) -> dict[str, float]:
        """
        Return, by name, the time since the last report of each late joint [s].

        A joint is late if this time exceeds `LATE_AFTER`. Commanded and locked joints are not
        included, nor are joints without a report.

        """
        is_late = self._is_free & ~self._is_commanded & self._is_old(now, LATE_AFTER)
        is_late &= self.times > LONG_AGO
        return {self.joint_names[i]: float(now - self.times[i]) for i in np.flatnonzero(is_late)}

    def _rest_late(self, now: float) -> None:
        """Let late, uncommanded joints rest, because they would keep their velocity forever."""
        are_fresh = 0.0 <= now - self._other_time <= LATE_AFTER or self._other_time == math.inf
        if are_fresh and not self._has_resting:
            return
        is_resting = ~self._is_commanded & (self.times > LONG_AGO) & self._is_old(now, LATE_AFTER)
        if (is_resting != self._is_resting).any():
            self._events = self._events._replace(has_changed=True)
        self._is_resting, self._has_resting = is_resting, bool(is_resting.any())
        self.qd[is_resting] = 0.0

    def unseen(self) -> list[str]:
        """Return the locked joints that were never reported."""
        return self._named(self.times == LONG_AGO)

    def without_velocity(self) -> list[str]:
        """Return the joints that are reported without a velocity."""
        return self._named((self.times > LONG_AGO) & ~self._has_velocity)

    def _remember_foreign_names(self, names: tuple[str, ...]) -> None:
        for name in names:
            if len(self.foreign_names) >= _MOST_FOREIGN_NAMES:
                return
            is_known = name in self._index or name in self.foreign_names
            if not is_known and len(name) <= _LONGEST_NAME:
                self.foreign_names.append(name)

    def _lock(self, locked: Mapping[str, float], commanded: Sequence[str]) -> None:
        unknown = [name for name in locked if name not in self._index]
        if unknown:
            joints = ', '.join(self.joint_names)
            raise ConfigurationError(
                *(
                    f"locked_positions lists '{name}', expected only joints of the robot: {joints}"
                    + did_you_mean(name, self.joint_names)
                    for name in unknown
                )
            )
        for name, position in locked.items():
            if not abs(position) <= LARGEST:  # also false for NaN
                raise ConfigurationError(
                    f"locked position of joint '{name}' is {position}, expected a number of at "
                    f'most {LARGEST:g}'
                )
            self.q[self._index[name]] = position
            self.times[self._index[name]] = LONG_AGO
        for name in commanded:
            if name in locked:
                raise ConfigurationError(f"joint '{name}' is both commanded and locked")

    def _absurd(self, layout: Layout) -> JointStateError:
        """Name the first value beyond `LARGEST` of a message."""
        in_robot, in_message = layout.places
        values = layout.received[:2, in_message]
        row, k = np.argwhere(np.abs(values) > LARGEST)[0]
        quantity, joint = ('position', 'velocity')[row], self.joint_names[in_robot[k]]
        return JointStateError(
            f"{quantity} of joint '{joint}' is {values[row, k]}, expected at most {LARGEST:g}"
        )

    def _named(self, flags: Booleans) -> list[str]:
        return list(compress(self.joint_names, flags))

    def _is_old(self, now: float, timeout: float) -> Booleans:
        age = now - self.times
        is_old: Booleans = ~((age >= 0.0) & (age <= timeout))
        return is_old

    def _find_oldest(self) -> None:
        self.time, self._other_time = find_oldest(self.times, self._is_commanded)


def compile_kernels() -> None:
    """Compile all functions for joint states before the control loop starts."""
    compile_for(find_oldest, 'UniTuple(f8, 2)(f8[::1], b1[::1])')
    compile_for(store_joint_state, 'i8(f8[:,::1], i8[:,::1], f8[:,::1], b1[:,::1], f8, f8, b1)')


@compiled
def find_oldest(times: Any, is_commanded: Any) -> tuple[float, float]:
    """
    Return the oldest arrival time of the commanded joints, and that of the other joints [s].

    ``times`` contains the arrival time of each joint's state, shape (n,). Locked joints that were
    never reported are ignored. The time of a group without joints is inf.

    """
    commanded = others = math.inf
    for i in range(len(times)):
        if is_commanded[i]:
            commanded = min(commanded, times[i])
        elif times[i] != LONG_AGO:
            others = min(others, times[i])
    return commanded, others


@compiled
def store_joint_state(
    received: Any,
    places: Any,
    known: Any,
    flags: Any,
    now: float,
    velocity_timeout: float,
    has_efforts: bool,
) -> int:
    """
    Store the reported joints of a message; if a value is absurd, change nothing.

    - ``received`` contains positions, velocities and efforts of the l joints in a message, shape
      (3, l). NaN means that a value is not reported.
    - ``places`` contains the indices of the k joints to store, shape (2, k). Row 0 refers to the
      robot, row 1 to the message.
    - ``known`` receives positions, velocities, times and efforts, shape (4, n).
    - ``flags`` says which joints have a velocity, and which have lost it, shape (2, n).
    - ``now`` is the time [s]. ``velocity_timeout`` is as in `JointStateCollector` [s].

    The result is `ABSURD` if a position or velocity exceeds `LARGEST`. Otherwise, the result is
    the sum of any of the following flags:

    - `STORED`: a joint was stored.
    - `CHANGED`: what is known of a joint has changed; see `Events`.

    """
    in_robot, in_message = places[0], places[1]
    for j in in_message:
        if abs(received[_POSITION, j]) > LARGEST or abs(received[_VELOCITY, j]) > LARGEST:
            return ABSURD
    result = 0
    for k in range(len(in_robot)):
        i, j = in_robot[k], in_message[k]
        position, velocity, last = received[_POSITION, j], received[_VELOCITY, j], known[TIME, i]
        has_velocity, had_velocity = not math.isnan(velocity), flags[_HAS_VELOCITY, i]
        # A velocity that is missing briefly is a fault. A velocity that stays missing may have
        # come from another publisher, such as ros2 topic pub.
        is_required = had_velocity and last <= now < last + velocity_timeout
        if math.isnan(position) or (is_required and not has_velocity):
            continue
        is_known = last > LONG_AGO
        if has_velocity:
            is_new = is_known and not had_velocity
        else:
            velocity, is_new = 0.0, had_velocity
            if had_velocity:
                flags[_LOST, i] = True
        flags[_HAS_VELOCITY, i] = has_velocity
        if is_new or last == LONG_AGO:
            result |= CHANGED
        known[POSITION, i] = position
        known[VELOCITY, i] = velocity
        known[TIME, i] = now
        if has_efforts:
            known[EFFORT, i] = received[_EFFORT, j]
        result |= STORED
    return result
