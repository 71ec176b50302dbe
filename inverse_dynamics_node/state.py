"""What is known of the joints: positions and velocities by name, and how old they are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np

from .compilation import compile_for, compiled
from .errors import ConfigurationError, did_you_mean, JointStateError
from .model import Booleans, Floats, Integers

_LONG_AGO = -1e300  # [s]; finite, for no time since then is not a number


Numbers = Sequence[float] | Floats


class State(NamedTuple):
    """The whole robot at one time."""

    q: Floats
    """Joint positions, shape (n,) [rad or m]."""
    qd: Floats
    """Joint velocities, shape (n,) [rad/s or m/s]."""
    time: float
    """When the joint heard from least recently was heard from [s]."""
    times: Floats | None = None
    """When each joint was heard from, shape (n,) [s]; None if all at once."""


@dataclass
class _Layout:
    """Where the numbers of one publisher belong, and what is known of them."""

    places: Integers
    """Of the joints that are named, shape (2, k): among ours, and the same among theirs."""
    heard: Floats
    """Positions, velocities and efforts of the last message, shape (3, names)."""
    is_of_concern: bool
    """Whether there are any."""
    is_whole: bool
    """Whether all that have to be heard from are named."""
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

    Raises
    ------
    ConfigurationError
        If a locked joint is not among the n, or its position is not finite.

    """

    def __init__(
        self, joint_names: Sequence[str], locked: Mapping[str, float] | None = None
    ) -> None:
        self.joint_names = tuple(joint_names)
        self._known = np.zeros((4, len(self.joint_names)))
        self.q, self.qd, self.times, self.efforts = self._known
        """Efforts as measured, where they were asked for and sent [N m or N]."""
        self.times[:], self.efforts[:] = -math.inf, math.nan
        self.has_unlocked = False
        """Whether a locked joint was heard from for the first time; who asks puts it back."""
        self._has_velocity = np.zeros(len(self.joint_names), dtype=bool)
        self._index = {name: i for i, name in enumerate(self.joint_names)}
        self._layouts: dict[tuple[str, ...], _Layout] = {}
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
        self._time = self._oldest()
        compile_for(take_in, 'b1(f8[:,::1], i8[:,::1], f8[:,::1], f8, b1)')

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
        arguments = (heard, layout.places, self._known, now, has_efforts)
        if not (layout.is_measured and take_in(*arguments)):
            self._check(layout)
            take_in(*arguments)
        self._time = now if layout.is_whole else self._oldest()
        return layout.is_of_concern

    @property
    def time(self) -> float:
        """When the joint heard from least recently was heard from, -inf if never [s]."""
        return self._time

    def state(self) -> State | None:
        """Return what is known, or None as long as a joint has not been heard from."""
        if self._time == -math.inf:
            return None
        return State(self.q, self.qd, self._time, self.times)

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

    def take_over(self, other: JointStateCollector) -> None:
        """Take over all that another has heard of the same joints."""
        for name, i in self._index.items():
            k = other._index.get(name)
            if k is not None and other.times[k] > _LONG_AGO:
                self.q[i], self.qd[i], self.times[i] = other.q[k], other.qd[k], other.times[k]
                self.efforts[i], self._has_velocity[i] = other.efforts[k], other._has_velocity[k]
        self._time = self._oldest()

    def missing(self) -> list[str]:
        """Name the joints never heard from."""
        return [self.joint_names[i] for i in np.flatnonzero(self.times == -math.inf)]

    def stale(self, now: float, timeout: float) -> list[str]:
        """Name the joints last heard from too long ago, or before a clock was put back [s]."""
        age = now - self.times
        is_stale = self.is_free & ~((age >= 0.0) & (age <= timeout))
        return [self.joint_names[i] for i in np.flatnonzero(is_stale)]

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
            if len(self._layouts) >= 16:  # more publishers than that are no publishers
                self._layouts.clear()
            is_whole = bool(0 < self.is_free.sum() == self.is_free[ours].sum())
            places, heard = np.array([ours, theirs], np.int64), np.zeros((3, len(names)))
            layout = self._layouts[names] = _Layout(places, heard, len(ours) > 0, is_whole)
        return layout

    def _check(self, layout: _Layout) -> None:
        """Put zeros for velocities that nobody measures, or raise a JointStateError."""
        ours, theirs = layout.places
        q, qd = layout.heard[:2, theirs]
        is_finite = np.isfinite(qd)
        self._refuse('position', q, np.isfinite(q), ours)
        # Where there has been a velocity, none is a fault.
        self._refuse('velocity', qd, is_finite | ~self._has_velocity[ours], ours)
        self._has_velocity[ours] |= is_finite
        self.has_unlocked |= bool((self.times[ours] == _LONG_AGO).any())
        layout.is_measured = bool(self._has_velocity[ours].all())
        layout.heard[1, theirs] = np.where(is_finite, qd, 0.0)

    def _refuse(self, what: str, values: Floats, is_good: Booleans, ours: Integers) -> None:
        if not is_good.all():
            k = int(np.argmin(is_good))
            raise JointStateError(f"{what} of joint '{self.joint_names[ours[k]]}' is {values[k]}")

    def _oldest(self) -> float:
        return float(np.min(self.times, initial=math.inf, where=self.is_free))


@compiled
def take_in(heard: Any, places: Any, known: Any, now: float, has_efforts: bool) -> bool:
    """
    Write what was heard of joints where it belongs, or nothing of it.

    Parameters
    ----------
    heard : ndarray, shape (3, l)
        Positions, velocities and efforts of the l joints of a message.
    places : ndarray, shape (2, k)
        Of those that count: among the n that are known, and among the l.
    known : ndarray, shape (4, n)
        Receives positions, velocities, times and efforts.
    now : float
        The time [s].
    has_efforts : bool
        Whether there are any.

    Returns
    -------
    are_finite : bool
        Whether all positions and velocities are.

    """
    ours, theirs = places[0], places[1]
    for k in range(len(ours)):
        q, qd = heard[0, theirs[k]], heard[1, theirs[k]]
        if not (math.isfinite(q) and math.isfinite(qd)):
            return False
    for k in range(len(ours)):
        i, j = ours[k], theirs[k]
        known[0, i], known[1, i], known[2, i] = heard[0, j], heard[1, j], now
        if has_efforts:
            known[3, i] = heard[2, j]
    return True
