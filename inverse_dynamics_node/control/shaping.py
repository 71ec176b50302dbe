"""Converts computed efforts into commands that respect limits and do not jump."""

from __future__ import annotations

from collections.abc import Sequence
import enum
import math
from typing import Any

import numpy as np

from ..dynamics.jit import compile_for, compiled
from ..robot.model import Booleans, Floats
from .laws import Law, Reference

_BEGUN = math.nextafter(1.0, 0.0)  # largest fraction of a blend that has begun
_BRIEF = 0.03  # [s]; after a shorter pause, efforts continue without a blend
LARGEST = 1e300
"""Largest accepted effort [N m or N]; the sum of two such efforts is finite."""
# Rows of `CommandShaper._rows`. Each column belongs to a commanded joint.
_INDEX, _ADDED, _SCALE, _LIMIT, _RATE, _WANTED, _JUMP, _EXCESS, _COMMAND = range(9)
NOMINAL_STEP = 0.02
"""Each command advances ramps by at most this time [s], or by one period of the loop if longer."""
_LEAST_PAUSE = 0.1  # [s]; a shorter interval is not an interruption
_PAUSE = 4.0  # [nominal steps]; a shorter interval is not an interruption
_ZEROS_TIME = 0.5  # [s]; a dry run sends zeros for this long after the ramp, in case some are lost
_SETTLING = 0.2  # [s]; old messages may arrive for this long after an interruption


class _Way(enum.Enum):
    """How the last command was produced."""

    FOLLOWING = enum.auto()
    HOLDING = enum.auto()
    FALLING = enum.auto()


class RampClock:
    """
    Measures the time step of ramps, blends and fades.

    The time step is the interval since the last command, but at most `NOMINAL_STEP` or one period
    of the loop. Ramps do not catch up after a pause, because the robot may have moved during the
    pause. They therefore take longer if commands are rare.

    ``period`` is the time between commands [s]; 0 if each joint state produces a command.

    """

    def __init__(self, period: float = 0.0) -> None:
        self._longest = max(NOMINAL_STEP, period)
        self._now = math.inf
        self._settling = 0.0  # [s]
        self._before = 0.0  # [s]; interval before `since`
        self.since = 0.0
        """Time since the last command [s]; 0 after the clock was set back."""
        self.step = 0.0
        """Time step of ramps for this command [s]."""

    def start(self) -> None:
        """Restart the clock; the next command does not advance ramps."""
        self._now, self._settling = math.inf, 0.0

    def advance(self, now: float) -> bool:
        """
        Advance to the time of a command [s]; return whether a blend must begin.

        A blend begins with the first command after `start`, and again with each command in
        the 0.2 s after an interruption. Possible interruptions are a suspended process, a stalled
        machine and a jump of the clock. A long interval after two others is none.

        """
        since, self._now = now - self._now, now
        usual = max(_LEAST_PAUSE, _PAUSE * self._longest, 2.0 * min(self._before, self.since))
        self._before, self.since = self.since, max(since, 0.0)
        self.step = min(self.since, self._longest)
        if 0.0 <= since <= usual:
            is_interrupted = self._settling > 0.0
            self._settling = max(0.0, self._settling - since)
        else:
            is_interrupted = True
            self._settling = _SETTLING if since > -math.inf else 0.0
        return is_interrupted


def ramp_fraction(elapsed: float, ramp: float) -> float:
    """Return the elapsed fraction of a ramp, from 0 to 1; times are in [s]."""
    return min(1.0, elapsed / ramp) if ramp > 0.0 else 1.0


class StopRamp:
    """Ramps a command down to zero."""

    def __init__(self) -> None:
        self._top: Floats = np.zeros(0)
        self._duration = self._passed = 0.0  # [s]

    def begin(self, command: Floats, duration: float) -> None:
        """Start a ramp from ``command`` down to zero over ``duration`` [s]."""
        self._top, self._duration, self._passed = command.copy(), duration, 0.0

    def advance(self, elapsed: float) -> None:
        """Advance the ramp by ``elapsed`` [s]."""
        self._passed += elapsed

    @property
    def time_left(self) -> float:
        """Time until the end of the ramp [s]; negative after the end."""
        return self._duration - self._passed

    @property
    def fraction(self) -> float:
        """Remaining fraction of the command, from 1 to 0."""
        return max(0.0, 1.0 - ramp_fraction(self._passed, self._duration))

    def command(self) -> Floats:
        """Return the current command as a new array."""
        return self.fraction * self._top


class CommandShaper:
    """
    Turns computed efforts into commands without jumps.

    For each command, advance `clock`, then call `follow`, `hold` or `fall`. Only new joint states
    and references change the commands at once. All other changes use a ramp or a blend:

    - The start ramp multiplies the computed efforts by `gain`.
    - A blend fades out the difference between the last command and the computed efforts.
    - The stop ramp scales the last command down to zero.

    A change during a blend starts a new blend from the last command. The first command of a blend
    repeats the last command, unless that did so too. The difference therefore fades even if every
    command starts a blend.

    A brief pause between calls of `follow` does not start a blend. Otherwise, intermittent joint
    states would start many blends, and each blend first repeats the last command. The commands
    would then hardly follow the joints.

    ``index`` contains the indices of the m commanded joints among the n joints of the robot.
    ``period`` is the time between commands [s]; 0 if each joint state produces a command.

    """

    def __init__(self, index: Sequence[int], period: float = 0.0) -> None:
        m = len(index)
        self.clock = RampClock(period)
        self._rows = np.zeros((9, m))
        self._rows[_INDEX] = index
        self.command: Floats = self._rows[_COMMAND]
        """The last command, shape (m,) [N m or N]; the next command overwrites it."""
        self._flags = np.zeros((2, m), dtype=bool)
        self.is_saturated: Booleans = self._flags[0]
        """Which efforts of the last command were cut to their limits, shape (m,)."""
        self.is_slowed: Booleans = self._flags[1]
        """Which efforts of the last command changed less because of a rate limit, shape (m,)."""
        self.gain = 0.0
        """Factor for the computed efforts; rises from 0 to 1 over the start ramp."""
        self._has_rates = False
        self._start_ramp = self._stop_ramp = 0.0
        self._way = _Way.HOLDING
        self._is_new = False  # whether a blend begins with the next command
        self._left = self._duration = 0.0  # remaining fraction and duration [s] of the blend
        self._has_repeated = False  # whether the last command was the first of a blend
        self._pause = math.inf  # [s] since the last `follow`; inf: the next starts a blend
        self._stop = StopRamp()
        self._is_damped = False  # whether the last command contains damping
        self._top_gain = self._top_left = 0.0  # `gain` and `_left` when the stop began
        compile_for(blend_efforts, 'b1(f8[::1], f8[:,::1], b1[:,::1], f8, f8, b1, b1, f8)')

    def configure(
        self,
        scale: Floats,
        limits: Floats,
        rate_limits: Floats,
        start_ramp: float,
        stop_ramp: float,
    ) -> None:
        """
        Change the settings; the caller must then call `begin`.

        All arrays have shape (m,). A command is ``scale`` times the computed effort. ``limits``
        bounds the magnitude of the commands [N m or N]. ``rate_limits`` bounds the rate of change
        [N m/s or N/s]. Limits may be infinite. The start ramp and each blend last for
        ``start_ramp`` [s]. A change of ``stop_ramp`` [s] does not affect a stop ramp in progress.

        """
        self._rows[[_SCALE, _LIMIT]] = scale, limits
        # The rates must be finite, because 0 s times infinity is NaN.
        self._rows[_RATE] = np.minimum(rate_limits, LARGEST)
        self._has_rates = bool(np.isfinite(rate_limits).any())
        self._start_ramp, self._stop_ramp = start_ramp, stop_ramp

    def begin(self, tau: Floats | None = None, added: Floats | float = 0.0) -> None:
        """
        Start to blend from the last command to the computed efforts.

        The blend lasts for ``start_ramp``, or for the rest of a blend in progress if that is
        longer. During a stop ramp, the blend waits for the next `follow`.

        After a change of settings, ``tau`` contains the efforts that the new settings give for the
        inputs of the last command, shape (n,) [N m or N]. ``added`` contains efforts to add to
        those of the commanded joints, shape (m,) [N m or N]. Only the difference between the last
        command and ``tau`` fades, so that the next command follows new inputs at once. Without
        ``tau``, the next command equals the last command.

        """
        if self._way is _Way.FALLING:
            self._pause = math.inf
            return
        has_followed = self._way is _Way.FOLLOWING and not self._is_new
        self._start_blend()
        if self._is_new and has_followed and tau is not None:
            self._rows[_ADDED] = added
            gain = self.gain if self._start_ramp else 1.0
            if blend_efforts(tau, self._rows, self._flags, gain, 1.0, True, self._has_rates, 0.0):
                self.gain, self._is_new = gain, False

    def _start_blend(self) -> None:
        self._duration = max(self._start_ramp, self._left * self._duration)
        self._left = 1.0 if self._duration > 0.0 else 0.0
        self._is_new = self._left > 0.0

    def reset(self) -> None:
        """Start from zero with the next command."""
        self.command[:] = 0.0
        self.gain = self._left = self._duration = 0.0
        self._way, self._is_new, self._pause = _Way.HOLDING, False, math.inf
        self._has_repeated = False
        self.clock.start()

    @property
    def time_to_fall(self) -> float:
        """Time to ramp the last command down to zero [s]."""
        if self._way is not _Way.FALLING:
            return self._stop_ramp
        return max(self._stop_ramp if self._is_damped else 0.0, self._stop.time_left)

    @property
    def continues(self) -> bool:
        """Whether the last command, or a command in the last 30 ms, came from `follow`."""
        is_brief = self._pause + self.clock.since <= _BRIEF and not self._is_new
        return self._way is _Way.FOLLOWING or is_brief

    def follow(self, tau: Floats, added: Floats) -> bool:
        """
        Command the computed efforts; return False if an effort is NaN or exceeds `LARGEST`.

        ``tau`` contains the computed efforts of all joints, shape (n,) [N m or N]. ``added``
        contains efforts to add to those of the commanded joints, shape (m,) [N m or N]. If the
        result is False, the command stays the same.

        """
        self._rows[_ADDED] = added
        elapsed, gain = self.clock.step, self.gain
        is_start = not self.continues
        if is_start:
            self._has_repeated = False
            self._start_blend()
        left, repeats = self._rest_of_blend() if self._left else (0.0, False)
        if gain < 1.0 and not repeats:
            gain = min(1.0, gain + ramp_fraction(elapsed, self._start_ramp))
        are_finite: bool = blend_efforts(
            tau, self._rows, self._flags, gain, left, self._is_new, self._has_rates, elapsed
        )
        if are_finite:
            self._way, self._is_new = _Way.FOLLOWING, False
            self.gain, self._left = gain, min(left, _BEGUN)
            self._has_repeated = repeats and not is_start
        return are_finite

    def _rest_of_blend(self) -> tuple[float, bool]:
        """Return the fraction of the blend that is left, and whether the command is repeated."""
        if self._left == 1.0 and not self._has_repeated:
            return 1.0, True
        return max(0.0, self._left - self.clock.step / self._duration), False

    def hold(self) -> None:
        """Repeat the last command, without damping."""
        if self._way is _Way.FALLING:
            self.command[:] = self._stop.command()
            self._pause = math.inf
        elif self._is_new:  # the next computed efforts must be blended in
            self._pause = math.inf
        else:
            self._pause = 0.0 if self._way is _Way.FOLLOWING else self._pause + self.clock.since
        self._way, self._is_new = _Way.HOLDING, False
        self._has_repeated = self._left == 1.0
        self._flags[:] = False

    def _begin_fall(self, duration: float) -> None:
        self._top_gain, self._top_left = self.gain, self._left
        self._stop.begin(self.command, duration)

    def fall(
        self,
        damping: Floats | None = None,
        limits: Floats | None = None,
        within: float = math.inf,
    ) -> None:
        """
        Ramp the commands down to zero, starting from the last command.

        ``damping`` contains efforts to add to the ramp, shape (m,) [N m or N]. If a command plus
        damping would exceed its limit, all damping efforts are scaled down by the same factor, so
        that the damping still opposes the motion.
        ``limits`` has shape (m,) [N m or N]; the default is the limits passed to `configure`.
        A ramp that would last longer than ``within`` [s] is replaced by one that lasts so long.

        """
        if self._way is _Way.FALLING:
            self._stop.advance(self.clock.step)
            self._pause += self.clock.since
        else:
            self._pause = 0.0 if self._way is _Way.FOLLOWING and not self._is_new else math.inf
            self._way, self._is_new = _Way.FALLING, False
            self._begin_fall(self._stop_ramp)
        if self.time_to_fall > within:
            self._begin_fall(within)
        fraction = self._stop.fraction
        # Scale the gain and the blend too, because computed efforts may soon continue.
        self.gain, self._left = fraction * self._top_gain, fraction * self._top_left
        self.command[:] = self._stop.command()
        self._is_damped = damping is not None
        if damping is not None:
            limits = self._rows[_LIMIT] if limits is None else limits
            self.command[:] = add_within(self.command, damping, limits)
        self._flags[:] = False


class _Sent(enum.Enum):
    COMPUTED = enum.auto()
    FALLING = enum.auto()
    NOTHING = enum.auto()


class DryRun:
    """
    Selects the efforts to send, during normal operation and during dry runs.

    At the start of a dry run, the commands fall to zero over the stop ramp, because a receiver
    holds the last command forever. Zeros follow for half a second. Then nothing is sent, so that
    another node may command the robot. The computed efforts are not affected.

    """

    def __init__(self, *, is_active: bool = False) -> None:
        self._sent = _Sent.NOTHING if is_active else _Sent.COMPUTED
        self._last: Floats | None = None
        self._ramp = StopRamp()

    @property
    def is_active(self) -> bool:
        """Whether a dry run is active, in which the computed efforts are not sent."""
        return self._sent is not _Sent.COMPUTED

    @property
    def has_effort(self) -> bool:
        """Whether the last command that was sent contains a nonzero effort."""
        return self._last is not None and bool(self._last.any())

    @property
    def has_sent(self) -> bool:
        """Whether this node sends commands, on which the robot may depend."""
        return self._last is not None

    def end(self) -> None:
        """End the dry run; the caller must let the computed efforts rise from zero."""
        self._sent = _Sent.COMPUTED

    def begin(self, time_to_fall: float) -> None:
        """
        Start a dry run, in which the commands first fall to zero.

        ``time_to_fall`` is the time until the commands are zero [s].

        """
        if self._last is None:
            self._sent = _Sent.NOTHING
        elif self._sent is _Sent.COMPUTED:
            self._sent = _Sent.FALLING
            self._ramp.begin(self._last, time_to_fall)

    def select(self, efforts: Floats, elapsed: float) -> Floats | None:
        """
        Return the efforts to send, shape (m,) [N m or N]; None if nothing is sent.

        ``elapsed`` is the time by which ramps advance [s]; see `RampClock`.

        """
        if self._sent is _Sent.COMPUTED:
            self._last = efforts
        elif self._sent is _Sent.FALLING:
            self._ramp.advance(elapsed)
            if self._ramp.time_left < -_ZEROS_TIME and not self.has_effort:
                self._sent, self._last = _Sent.NOTHING, None
            else:
                self._last = self._ramp.command()
        return self._last


class DriveReference:
    """
    Computes positions and velocities to send with the efforts.

    A drive with its own gains adds ``kp (q_command - q) + kd (qd_command - qd)`` to the effort.
    While the law follows a reference, the drive receives this reference. Otherwise, the drive
    receives the measured motion, so that the gains add nothing. One replaces the other gradually,
    because the gains of the drive are unknown, and may carry a part of the weight of the arm.

    """

    def __init__(self) -> None:
        self._weight = 0.0  # of the reference; the measured motion has the remaining weight
        self._positions: Floats = np.zeros(0)
        self._velocities: Floats = np.zeros(0)

    @property
    def is_leading(self) -> bool:
        """Whether the drive receives a reference, or a part of it."""
        return self._weight > 0.0

    def reset(self) -> None:
        """Begin anew with the measured motion."""
        self._weight = 0.0

    def motion(
        self,
        law: Law,
        q: Floats,
        qd: Floats,
        elapsed: float,
        start_ramp: float,
        stop_ramp: float,
        farthest: float,
        *,
        is_computing: bool,
    ) -> tuple[Floats, Floats]:
        """
        Return positions [rad or m] and velocities [rad/s or m/s] to send, shape (m,).

        ``q`` and ``qd`` are the measured motion of the commanded joints, shape (m,). The weight of
        the reference rises within ``start_ramp`` and falls within ``stop_ramp`` [s]. ``elapsed``
        is the time step of ramps [s]; see `RampClock`. A reference is not sent if any joint is
        farther than ``farthest`` [rad or m] from it, or if it jumps farther; 0 means any
        distance. Unless ``is_computing``, the drive is led to rest at the measured positions.

        """
        reference = law.followed if is_computing else None
        if not is_computing:
            qd = np.zeros_like(qd)
        if reference is not None and self._accepts(law, q, reference, farthest):
            self._weight = min(1.0, self._weight + ramp_fraction(elapsed, start_ramp))
            rest = qd if reference.positions is None else np.zeros_like(qd)
            self._positions = q.copy() if reference.positions is None else reference.positions
            self._velocities = rest if reference.velocities is None else reference.velocities
        else:
            self._weight = max(0.0, self._weight - ramp_fraction(elapsed, stop_ramp))
        if not self._weight:
            return q, qd
        distance = law.distance(q, self._positions)
        return q + self._weight * distance, qd + self._weight * (self._velocities - qd)

    def _accepts(self, law: Law, q: Floats, reference: Reference, farthest: float) -> bool:
        if reference.positions is None or not farthest:
            return True
        starts = [q, self._positions] if self._weight else [q]
        return all(
            np.abs(law.distance(start, reference.positions)).max() <= farthest for start in starts
        )


def add_within(command: Floats, damping: Floats, limit: Floats) -> Floats:
    """Return the command plus the largest share of the damping that the limits permit."""
    bound = np.maximum(limit, np.abs(command))  # a limit may have been tightened
    room = bound - np.sign(damping) * command
    with np.errstate(all='ignore'):
        fractions = np.where(np.abs(damping) > room, room / np.abs(damping), 1.0)
    total: Floats = np.clip(command + fractions.min() * damping, -bound, bound)
    return total


@compiled
def blend_efforts(
    tau: Any,
    rows: Any,
    flags: Any,
    gain: float,
    left: float,
    is_new: bool,
    has_rates: bool,
    elapsed: float,
) -> bool:
    """
    Compute the next command; return False if an effort is NaN or exceeds `LARGEST`.

    - ``tau`` contains the computed efforts of all joints, shape (n,) [N m or N].
    - ``rows`` has shape (9, m), with one column per commanded joint.
    - Rows `_INDEX` to `_RATE` contain, in this order, the index of the joint in ``tau``, the
      effort to add, the scale, the limit and the rate limit.
    - Row `_WANTED` receives the effort after scaling.
    - Row `_JUMP` contains the last command minus the computed effort, at the start of the blend.
    - Row `_EXCESS` contains the excess of the last command over its limit, at the start of the
      blend.
    - Row `_COMMAND` contains the last command, and receives the next command unless the result is
      False.
    - ``flags`` has shape (2, m). Row 0 is set where an effort was cut to its limit. Row 1 is set
      where a rate limit slowed the change of an effort.

    ``gain`` is the factor for the computed efforts. ``left`` is the fraction of `_JUMP` and
    `_EXCESS` that has not faded yet. ``is_new`` says whether a blend begins with this command.
    ``has_rates`` says whether rate limits exist. ``elapsed`` is the time step for rate limits [s].

    """
    m = rows.shape[1]
    for k in range(m):
        effort = rows[_SCALE, k] * (tau[int(rows[_INDEX, k])] + rows[_ADDED, k])
        if not abs(effort) <= LARGEST:  # also false for NaN
            return False
        rows[_WANTED, k] = effort
    for k in range(m):
        wanted, limit, last = rows[_WANTED, k], rows[_LIMIT, k], rows[_COMMAND, k]
        effort = min(max(wanted, -limit), limit)
        flags[0, k] = effort != wanted
        effort *= gain
        if is_new:
            rows[_JUMP, k] = last - effort
            # At first, a command may exceed a limit that was tightened.
            rows[_EXCESS, k] = max(0.0, abs(last) - limit)
        if is_new and left == 1.0:
            effort = last  # without rounding errors
        elif left != 0.0:
            bound = limit + left * rows[_EXCESS, k]
            blended = effort + left * rows[_JUMP, k]
            effort = min(max(blended, -bound), bound)
            flags[0, k] |= effort != blended
        if has_rates:
            change = rows[_RATE, k] * elapsed
            wanted = effort
            effort = min(max(wanted, last - change), last + change)
            flags[1, k] = effort != wanted
        rows[_COMMAND, k] = effort
    if not has_rates:
        flags[1, :] = False
    return True
