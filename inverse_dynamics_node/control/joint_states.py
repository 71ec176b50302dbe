"""What is known of the joints: positions and velocities by name, and how old they are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import difflib
import math
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.jit import compile_for, compiled
from ..errors import ConfigurationError, did_you_mean, JointStateError
from ..robot.model import (
    Booleans,
    Floats,
    Integers,
    RobotModel,
)
from .alternation import (
    alternating,
    copy_track,
    make_tracks,
    track,
)

_MOST_STRANGERS = 64  # names of joints of others to remember
_LONGEST_NAME = 100  # of those [characters]; comparing longer ones takes time
_NOT_FINITE, _CONSISTENT, _ALTERNATING = range(3)  # results of `store_joint_state`
_LONG_AGO = -1e300  # [s]; finite, for no time since then is not a number


Numbers = Sequence[float] | Floats


class State(NamedTuple):
    """The whole robot at one time."""

    q: Floats
    """Joint positions, shape (n,) [rad or m]."""
    qd: Floats
    """Joint velocities, shape (n,) [rad/s or m/s]."""
    time: float
    """Oldest arrival among the commanded joints [s]."""
    times: Floats | None = None
    """When each joint was heard from, shape (n,) [s]; None if all at once."""
    is_consistent: bool = True
    """False while positions of a commanded joint alternate faster than it can move."""


@dataclass
class _Layout:
    """Where the numbers of one publisher belong, and what is known of them."""

    places: Integers
    """Of the joints that are named, shape (2, k): among ours, and the same among theirs."""
    heard: Floats
    """Positions, velocities and efforts of the last message, shape (3, names)."""
    is_of_concern: bool
    """Whether there are any."""
    is_measured: bool = False
    """Whether each of the joints has had a velocity."""


class JointStateCollector:
    """
    Collects joint states that arrive by name, in any order, of all joints or of some.

    An arm's driver and a gripper's often publish on one topic, each its own joints: so every joint
    has a time of its own.

    Parameters
    ----------
    joint_names : sequence of str
        The n joints to know; others are ignored.
    locked : mapping of str to float
        Positions at which joints count until they are heard from, if they ever are [rad or m].
        Such joints are never missing and never stale.
    commanded : sequence of str
        Joints whose state must be fresh; empty for all that are not locked.
    robot : RobotModel, optional
        Gives the speed limits for telling motion from positions that alternate.

    Raises
    ------
    ConfigurationError
        If a locked joint is not among the n, or its position is not finite.

    """

    def __init__(
        self,
        joint_names: Sequence[str],
        locked: Mapping[str, float] | None = None,
        commanded: Sequence[str] = (),
        robot: RobotModel | None = None,
    ) -> None:
        self.joint_names = tuple(joint_names)
        self._known = np.zeros((4, len(self.joint_names)))
        self.q, self.qd, self.times, self.efforts = self._known
        """Efforts as measured, where they were asked for and sent [N m or N]."""
        self.times[:], self.efforts[:] = -math.inf, math.nan
        self.has_jumped = False
        """
        Set when a joint that is not commanded may have jumped, because it was locked or late until
        now, became late, or was reported by several publishers; cleared by the reader.
        """
        self.late_count = 0
        """How many joints that are neither commanded nor locked were late at `rest_late`."""
        self._has_velocity = np.zeros(len(self.joint_names), dtype=bool)
        self._index = {name: i for i, name in enumerate(self.joint_names)}
        self._layouts: dict[tuple[str, ...], _Layout] = {}
        self._strangers: list[str] = []
        unknown = [name for name in locked or {} if name not in self._index]
        if unknown:
            joints = ', '.join(self.joint_names)
            raise ConfigurationError(
                *(
                    f"locked_positions names '{name}'; joints are {joints}"
                    + did_you_mean(name, self.joint_names)
                    for name in unknown
                )
            )
        for name, position in (locked or {}).items():
            if not math.isfinite(position):
                raise ConfigurationError(f"locked position of joint '{name}' is {position}")
            self.q[self._index[name]] = position
            self.times[self._index[name]] = _LONG_AGO
        self.is_free = self.times == -math.inf
        """Which joints count only where they are heard to be, shape (n,)."""
        self._is_commanded = self.is_free & [
            not commanded or name in commanded for name in self.joint_names
        ]
        self._tracks = make_tracks(len(self.joint_names), robot)
        self._is_alternating = np.zeros(len(self.joint_names), dtype=bool)
        self._has_alternating, self._is_consistent = False, True
        self._is_resting = np.zeros(len(self.joint_names), dtype=bool)
        self._has_resting = False
        compile_for(find_oldest, 'UniTuple(f8, 2)(f8[::1], b1[::1])')
        self._find_oldest()
        compile_for(track, 'b1(f8[:,::1], i8, f8, f8)')
        compile_for(
            store_joint_state, 'i8(f8[:,::1], i8[:,::1], f8[:,::1], f8[:,::1], b1[::1], f8, b1)'
        )

    def update(
        self,
        now: float,
        names: Sequence[str],
        positions: Numbers,
        velocities: Numbers,
        efforts: Numbers = (),
    ) -> bool:
        """
        Take in one joint state, or nothing of it.

        Parameters
        ----------
        now : float
            The time of arrival [s].
        names, positions, velocities : sequences of equal length
            Velocities may be empty, or NaN for joints that never had one: zero then.
        efforts : sequence, optional
            Measured efforts; none, or as many.

        Returns
        -------
        is_of_concern : bool
            Whether it was about any of these joints.

        Raises
        ------
        JointStateError
            If the lengths differ, or a value that is needed is not finite; nothing has changed.

        """
        if len(positions) != len(names):
            raise JointStateError(f'{len(names)} names, but {len(positions)} positions')
        if len(velocities) not in (0, len(names)):
            raise JointStateError(f'{len(names)} names, but {len(velocities)} velocities')
        if len(efforts) not in (0, len(names)):
            raise JointStateError(f'{len(names)} names, but {len(efforts)} efforts')
        layout = self._layout(tuple(names))
        heard = layout.heard
        heard[0] = positions
        # Drivers leave out a velocity that they do not measure, or fill in NaN.
        heard[1] = velocities if len(velocities) else math.nan
        has_efforts = len(efforts) > 0
        if has_efforts:
            heard[2] = efforts
        arguments = (heard, layout.places, self._known, self._tracks, self._is_commanded)
        result = (
            store_joint_state(*arguments, now, has_efforts) if layout.is_measured else _NOT_FINITE
        )
        if result == _NOT_FINITE:
            self._check(layout)
            result = store_joint_state(*arguments, now, has_efforts)
        if result == _ALTERNATING or self._has_alternating:
            self._find_alternating()
        if layout.is_of_concern:
            self._find_oldest()
        return layout.is_of_concern

    @property
    def time(self) -> float:
        """Oldest arrival among the commanded joints, -inf if one was never reported [s]."""
        return self._time

    @property
    def is_consistent(self) -> bool:
        """False while positions of a commanded joint alternate faster than it can move."""
        return self._is_consistent

    @property
    def has_alternating(self) -> bool:
        """Whether positions of any joint alternate faster than it can move."""
        return self._has_alternating

    def state(self) -> State | None:
        """Return the latest state, or None as long as a joint has never been reported."""
        if self._time == -math.inf or self._other_time == -math.inf:
            return None
        return State(self.q, self.qd, self._time, self.times, self._is_consistent)

    def check_free(self, names: Sequence[str]) -> None:
        """
        Refuse joints that count where they are said to be.

        Raises
        ------
        ConfigurationError
            If one of them does.

        """
        for name in names:
            if not self.is_free[self._index[name]]:
                raise ConfigurationError(f"joint '{name}' is both commanded and locked")

    def continue_from(self, other: JointStateCollector) -> None:
        """Take over all that another has heard of the same joints."""
        for name, i in self._index.items():
            k = other._index.get(name)
            if k is not None and other.times[k] > _LONG_AGO:
                self.q[i], self.qd[i], self.times[i] = other.q[k], other.qd[k], other.times[k]
                self.efforts[i], self._has_velocity[i] = other.efforts[k], other._has_velocity[k]
                copy_track(self._tracks, i, other._tracks, k)
        self._find_alternating()
        self._find_oldest()

    def missing(self) -> list[str]:
        """Name the joints never heard from."""
        return [self.joint_names[i] for i in np.flatnonzero(self.times == -math.inf)]

    def similar_names(self) -> list[str]:
        """Return reported names that are not joints of this robot, but resemble missing ones."""
        closest: list[str] = []
        for name in self.missing():
            closest += difflib.get_close_matches(name, self._strangers, 1)
        return list(dict.fromkeys(closest))

    def stale(self, now: float, timeout: float) -> list[str]:
        """Name the commanded joints last reported too long ago or before a clock reset [s]."""
        is_stale = self._is_commanded & self._is_old(now, timeout)
        return [self.joint_names[i] for i in np.flatnonzero(is_stale)]

    def late(self, now: float, timeout: float) -> dict[str, float]:
        """
        Find joints that are neither commanded nor locked and were last reported too long ago.

        Parameters
        ----------
        now, timeout : float
            Times [s].

        Returns
        -------
        ages : dict of str to float
            Time since each was reported, by name [s]; not those that were never reported.

        """
        is_late = self.is_free & ~self._is_commanded & self._is_old(now, timeout)
        is_late &= self.times > _LONG_AGO
        return {self.joint_names[i]: float(now - self.times[i]) for i in np.flatnonzero(is_late)}

    def alternating(self) -> dict[str, tuple[float, float]]:
        """Find joints whose positions alternate faster than they can move, with two of them."""
        found = alternating(self._tracks)
        return {self.joint_names[i]: positions for i, positions in found.items()}

    def rest_late(self, now: float, timeout: float) -> None:
        """
        Assume that joints that are not commanded are at rest from when they are late.

        Without that, a joint that stopped would act with its last velocity forever.

        Parameters
        ----------
        now, timeout : float
            Times [s].

        """
        are_fresh = 0.0 <= now - self._other_time <= timeout or self._other_time == math.inf
        if are_fresh and not self._has_resting:
            return
        is_resting = ~self._is_commanded & (self.times > _LONG_AGO) & self._is_old(now, timeout)
        self.has_jumped |= bool((is_resting != self._is_resting).any())
        self._is_resting, self._has_resting = is_resting, bool(is_resting.any())
        self.late_count = int(np.count_nonzero(is_resting & self.is_free))
        self.qd[is_resting] = 0.0

    def unseen(self) -> list[str]:
        """Name the joints that count at their locked position."""
        return [self.joint_names[i] for i in np.flatnonzero(self.times == _LONG_AGO)]

    def without_velocity(self) -> list[str]:
        """Name the joints that were heard from, but never with a velocity."""
        heard = self.times > _LONG_AGO
        return [self.joint_names[i] for i in np.flatnonzero(heard & ~self._has_velocity)]

    def _layout(self, names: tuple[str, ...]) -> _Layout:
        """Find which of our joints are named, and where; a publisher repeats its names forever."""
        layout = self._layouts.get(names)
        if layout is None:
            theirs = [k for k, name in enumerate(names) if name in self._index]
            ours = [self._index[names[k]] for k in theirs]
            if len(set(ours)) != len(ours):
                joint, _ = Counter(ours).most_common(1)[0]
                raise JointStateError(f"joint '{self.joint_names[joint]}' is named twice")
            self._remember_strangers(names)
            if len(self._layouts) >= 16:  # more publishers than that are no publishers
                self._layouts.clear()
            places, heard = np.array([ours, theirs], np.int64), np.zeros((3, len(names)))
            layout = self._layouts[names] = _Layout(places, heard, len(ours) > 0)
        return layout

    def _remember_strangers(self, names: tuple[str, ...]) -> None:
        for name in names:
            if len(self._strangers) >= _MOST_STRANGERS:
                return
            is_ours = name in self._index or name in self._strangers
            if not is_ours and len(name) <= _LONGEST_NAME:
                self._strangers.append(name)

    def _check(self, layout: _Layout) -> None:
        """Put zeros for velocities that nobody measures, or raise a JointStateError."""
        ours, theirs = layout.places
        q, qd = layout.heard[:2, theirs]
        is_finite = np.isfinite(qd)
        self._refuse('position', q, np.isfinite(q), ours)
        # Where there has been a velocity, none is a fault.
        self._refuse('velocity', qd, is_finite | ~self._has_velocity[ours], ours)
        self._has_velocity[ours] |= is_finite
        self.has_jumped |= bool((self.times[ours] == _LONG_AGO).any())
        layout.is_measured = bool(self._has_velocity[ours].all())
        layout.heard[1, theirs] = np.where(is_finite, qd, 0.0)

    def _refuse(self, what: str, values: Floats, is_good: Booleans, ours: Integers) -> None:
        if not is_good.all():
            k = int(np.argmin(is_good))
            raise JointStateError(f"{what} of joint '{self.joint_names[ours[k]]}' is {values[k]}")

    def _is_old(self, now: float, timeout: float) -> Booleans:
        age = now - self.times
        is_old: Booleans = ~((age >= 0.0) & (age <= timeout))
        return is_old

    def _find_alternating(self) -> None:
        before, after = self._is_alternating, np.zeros(len(self.joint_names), dtype=bool)
        after[list(alternating(self._tracks))] = True
        self.has_jumped |= bool((before != after)[~self._is_commanded].any())
        self._is_alternating = after
        self._has_alternating = bool(after.any())
        self._is_consistent = not (after & self._is_commanded).any()

    def _find_oldest(self) -> None:
        self._time, self._other_time = find_oldest(self.times, self._is_commanded)


@compiled
def find_oldest(times: Any, is_commanded: Any) -> tuple[float, float]:
    """
    Find the oldest arrivals.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Arrival of each joint's state [s].
    is_commanded : ndarray of bool, shape (n,)
        Which joints are commanded.

    Returns
    -------
    commanded, others : float
        Oldest arrival among the commanded joints and among the others, without locked joints that
        were never reported; inf if there are none [s].

    """
    commanded = others = math.inf
    for i in range(len(times)):
        if is_commanded[i]:
            commanded = min(commanded, times[i])
        elif times[i] != _LONG_AGO:
            others = min(others, times[i])
    return commanded, others


@compiled
def store_joint_state(
    heard: Any,
    places: Any,
    known: Any,
    tracks: Any,
    is_commanded: Any,
    now: float,
    has_efforts: bool,
) -> int:
    """
    Write what was heard of joints where it belongs, or nothing of it.

    Parameters
    ----------
    heard : ndarray, shape (3, l)
        Positions, velocities and efforts of the l joints of a message.
    places : ndarray, shape (2, k)
        Of those that count: among the n that are known, and among the l.
    known : ndarray, shape (4, n)
        Receives positions, velocities, times and efforts. A joint that is not commanded keeps its
        position, at rest, while its positions alternate.
    tracks : ndarray, shape (10, n)
        See `alternation.make_tracks`.
    is_commanded : ndarray of bool, shape (n,)
        Which joints are commanded.
    now : float
        The time [s].
    has_efforts : bool
        Whether there are any.

    Returns
    -------
    result : int
        `_NOT_FINITE` if a position or velocity is not finite, `_ALTERNATING` if positions of a
        joint alternate faster than it can move, otherwise `_CONSISTENT`.

    """
    ours, theirs = places[0], places[1]
    for k in range(len(ours)):
        q, qd = heard[0, theirs[k]], heard[1, theirs[k]]
        if not (math.isfinite(q) and math.isfinite(qd)):
            return _NOT_FINITE
    result = _CONSISTENT
    for k in range(len(ours)):
        i, j = ours[k], theirs[k]
        elapsed = max(0.0, now - known[2, i]) if known[2, i] > _LONG_AGO else -1.0
        is_alternating = track(tracks, i, heard[0, j], elapsed)
        if is_alternating:
            result = _ALTERNATING
        if is_alternating and not is_commanded[i]:
            known[1, i] = 0.0
        else:
            known[0, i], known[1, i] = heard[0, j], heard[1, j]
        known[2, i] = now
        if has_efforts:
            known[3, i] = heard[2, j]
    return result
