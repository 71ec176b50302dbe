"""
Turns computed efforts into commands: scale, offset, limits, and no jump between commands.

No ROS, and no clock: the time is an argument.
"""

from __future__ import annotations

from collections.abc import Sequence
import enum
import math
from typing import Any

import numpy as np

from ..dynamics.jit import compile_for, compiled
from ..robot.model import Booleans, Floats

_BRIEF = 0.03  # [s]; after a pause of the computed efforts up to this long there is no blend
LARGEST = 1e300
"""Larger efforts are rejected, so that sums and differences of two are finite."""
# Rows of `CommandShaper._rows`, one column per commanded joint.
_INDEX, _ADDED, _SCALE, _OFFSET, _LIMIT, _RATE, _WANTED, _JUMP, _EXCESS, _COMMAND = range(10)
NOMINAL_STEP = 0.01
"""Ramps advance by at most this long in one command, unless commands are usually rarer [s]."""
_LONGEST_STEP = 0.5  # [s]; at most this long even then
_MEMORY = 8.0  # usual steps in which the usual step follows a change; it grows by at most 1/4
_LEAST_PAUSE = 0.1  # [s]; shorter times between steps are no interruption
_PAUSE = 4.0  # usual steps; neither are these
_SETTLING = 0.2  # [s]; after an interruption, for messages that were sent before its end


class _Way(enum.Enum):
    """How the last command was produced."""

    FOLLOWING = enum.auto()
    HOLDING = enum.auto()
    FALLING = enum.auto()


class RampClock:
    """
    Measures the time by which ramps, blends and fades advance with the next command.

    This is the time since the last command, but at most one nominal step: 10 ms, or the period of
    the loop if it is longer. On a machine or with a driver that is always slower, it is the usual
    time between commands, which is a mean with the lengths as weights: several messages in a row
    thus do not hide the pauses between them. A single pause makes it at most 25 % longer.

    A pause may end with old messages, a late timer or a jump of the clock. The robot has moved in
    the meantime, but the commands have not: nothing may catch up.

    Parameters
    ----------
    period : float
        Time between commands [s]; 0 if there is one for every joint state.

    """

    def __init__(self, period: float = 0.0) -> None:
        self._shortest = self._usual = max(NOMINAL_STEP, period)
        self._longest = max(_LONGEST_STEP, period)
        self._now = math.inf
        self._settling = 0.0  # [s]
        self.since = 0.0
        """Time since the last command [s]; 0 after the clock was set back."""
        self.step = 0.0
        """Time by which ramps advance [s]."""

    def start(self) -> None:
        """Let no time pass until the next command."""
        self._now, self._settling = math.inf, 0.0

    def advance(self, now: float) -> bool:
        """
        Advance to the time of the next command.

        Parameters
        ----------
        now : float
            The time [s].

        Returns
        -------
        is_interrupted : bool
            Whether the command must be blended: at a start, and when and shortly after the process
            was suspended, the machine stalled, or the clock jumped.

        """
        since, self._now = now - self._now, now
        usual = self._usual
        self.since = since if since > 0.0 else 0.0  # faster than max()
        self.step = since if 0.0 < since < usual else min(self.since, usual)
        if 0.0 <= since <= max(_LEAST_PAUSE, _PAUSE * usual):
            is_interrupted = self._settling > 0.0
            self._settling = max(0.0, self._settling - since)
        else:
            is_interrupted = True
            self._settling = _SETTLING if since > -math.inf else 0.0
        if since > self._shortest or usual > self._shortest:
            counted = min(self.since, 2.0 * usual)
            usual += (counted - usual) * counted / (_MEMORY * usual)
            self._usual = min(max(usual, self._shortest), self._longest)
        return is_interrupted


def ramp_fraction(elapsed: float, ramp: float) -> float:
    """Return how much of a ramp has passed, 0 to 1; times in [s]."""
    return min(1.0, elapsed / ramp) if ramp > 0.0 else 1.0


class StopRamp:
    """Scales a command down to zero."""

    def __init__(self) -> None:
        self._top: Floats = np.zeros(0)
        self._duration = self._passed = 0.0  # [s]

    def begin(self, command: Floats, duration: float) -> None:
        """Begin at a command, which is copied, and reach zero after a time [s]."""
        self._top, self._duration, self._passed = command.copy(), duration, 0.0

    def advance(self, elapsed: float) -> None:
        """Advance by a time [s]."""
        self._passed += elapsed

    @property
    def time_left(self) -> float:
        """Time until the end of the ramp; negative after it [s]."""
        return self._duration - self._passed

    @property
    def fraction(self) -> float:
        """How much of the command is left, 1 to 0."""
        return max(0.0, 1.0 - ramp_fraction(self._passed, self._duration))

    def command(self) -> Floats:
        """Return the command at present, as a new array."""
        return self.fraction * self._top


class CommandShaper:
    """
    Turns computed efforts into commands, each of which continues from the one before.

    A command differs from the last one by no more than new joint states and references explain.
    Everything else is a ramp that advances by `clock.step`, or is blended. After `clock` has been
    advanced, `follow`, `hold` or `fall` produces a command. The start ramp multiplies the computed
    efforts by `gain`. A blend adds the difference between the last command and the computed
    efforts, and lets it fade. The stop ramp scales the command at which it began. Each of
    them starts from the last command sent.

    A change during a blend starts a new blend that contains the rest of the old one. As soon as
    two commands in a row do so, blends advance all the same: however often something changes, the
    difference fades like that of a first-order low-pass, with the start ramp as its time
    constant.

    After a brief pause, such as a joint state that comes a little late, there is no new blend.
    Intermittent states would otherwise restart it again and again, and a blend that restarts
    repeats the last command instead of following the joints.

    Parameters
    ----------
    index : sequence of int
        Positions of the m commanded joints among the n joints of the robot.
    period : float
        Time between commands [s]; 0 if there is one for every joint state.

    """

    def __init__(self, index: Sequence[int], period: float = 0.0) -> None:
        m = len(index)
        self.clock = RampClock(period)
        self._rows = np.zeros((10, m))
        self._rows[_INDEX] = index
        self.command: Floats = self._rows[_COMMAND]
        """The last command, shape (m,) [N m or N]; the next one is written in its place."""
        self._flags = np.zeros((2, m), dtype=bool)
        self.is_saturated: Booleans = self._flags[0]
        """Which efforts of the last command were cut to their limits, shape (m,)."""
        self.is_slowed: Booleans = self._flags[1]
        """Which efforts of the last command were slowed by a rate limit, shape (m,)."""
        self.gain = 0.0
        """Factor of the computed efforts: 0 before the start ramp, 1 after it."""
        self._has_rates = False
        self._start_ramp = self._stop_ramp = 0.0
        self._way = _Way.HOLDING
        self._is_new = False  # whether a blend begins with the next command
        self._left = self._duration = 0.0  # fraction of the blend that is left, and its length [s]
        # Whether ramp and blend do not advance with the next command, and whether they did not
        # with the last one.
        self._is_paused = self._was_paused = False
        self._pause = math.inf  # [s] since computed efforts were followed; inf: blend in any case
        self._stop = StopRamp()
        self._is_damped = False  # whether the last command contains damping
        self._top_gain = self._top_left = 0.0  # gain and fraction of the blend before it
        compile_for(blend_efforts, 'b1(f8[::1], f8[:,::1], b1[:,::1], f8, f8, b1, b1, f8)')

    def configure(
        self,
        scale: Floats,
        offset: Floats,
        limits: Floats,
        rate_limits: Floats,
        start_ramp: float,
        stop_ramp: float,
    ) -> None:
        """
        Change the settings; call `begin` when all changes have been made.

        Parameters
        ----------
        scale : ndarray, shape (m,)
            Factors for the computed efforts.
        offset : ndarray, shape (m,)
            Added to the scaled efforts [N m or N].
        limits : ndarray, shape (m,)
            Largest magnitudes of the commands; may be infinite [N m or N].
        rate_limits : ndarray, shape (m,)
            Fastest changes of the commands; may be infinite [N m/s or N/s].
        start_ramp : float
            Time of the start ramp and of blends [s].
        stop_ramp : float
            Time of the stop ramp [s]; a ramp under way keeps its time.

        """
        self._rows[[_SCALE, _OFFSET, _LIMIT]] = scale, offset, limits
        # Finite, because 0 s times infinity is NaN.
        self._rows[_RATE] = np.minimum(rate_limits, LARGEST)
        self._has_rates = bool(np.isfinite(rate_limits).any())
        self._start_ramp, self._stop_ramp = start_ramp, stop_ramp

    def begin(self, tau: Floats | None = None, added: Floats | float = 0.0) -> None:
        """
        Blend from the last command into the computed efforts, within the start ramp.

        A blend under way does not end sooner because of it. During a stop ramp, the blend waits
        for the next computed efforts.

        Parameters
        ----------
        tau : ndarray, shape (n,), optional
            Efforts computed from the inputs of the last command, after a change of settings
            [N m or N]. Only the difference to these fades, and the next command contains all
            that the inputs have changed since. By default, it equals the last command.
        added : ndarray, shape (m,), optional
            Efforts to add to these [N m or N].

        """
        if self._way is _Way.FALLING:
            self._pause = math.inf
            return
        # The start ramp begins with a blend, so that neither ends sooner.
        self._duration = max(self._start_ramp, self._left * self._duration)
        self._left = 1.0 if self._duration > 0.0 else 0.0
        self._is_paused = self._left > 0.0 and not self._was_paused
        has_followed = self._way is _Way.FOLLOWING and not self._is_new
        self._is_new = self._left > 0.0
        if self._is_new and has_followed and tau is not None:
            self._rows[_ADDED] = added
            gain = self.gain if self._start_ramp else 1.0
            if blend_efforts(tau, self._rows, self._flags, gain, 1.0, True, self._has_rates, 0.0):
                self.gain, self._is_new = gain, False

    def reset(self) -> None:
        """Start at zero with the next command."""
        self.command[:] = 0.0
        self.gain = self._left = self._duration = 0.0
        self._way, self._is_new, self._pause = _Way.HOLDING, False, math.inf
        self._is_paused = self._was_paused = False
        self.clock.start()

    @property
    def time_to_fall(self) -> float:
        """Time until the commands are zero, if they fall from now on or already do [s]."""
        if self._way is not _Way.FALLING:
            return self._stop_ramp
        return max(self._stop_ramp if self._is_damped else 0.0, self._stop.time_left)

    def continue_from(self, other: CommandShaper) -> None:
        """Continue from the last command of another robot description with the same joints."""
        self.clock = other.clock
        self.command[:], self._stop = other.command, other._stop
        self.gain, self._top_gain, self._top_left = other.gain, other._top_gain, other._top_left
        self._left, self._duration = other._left, other._duration
        self._way, self._was_paused = other._way, other._was_paused
        self.begin()

    @property
    def continues(self) -> bool:
        """Whether efforts were followed by the last command, or until a moment ago."""
        is_brief = self._pause + self.clock.since <= _BRIEF and not self._is_new
        return self._way is _Way.FOLLOWING or is_brief

    def follow(self, tau: Floats, added: Floats) -> bool:
        """
        Command computed efforts.

        Parameters
        ----------
        tau : ndarray, shape (n,)
            Computed efforts of all joints [N m or N].
        added : ndarray, shape (m,)
            Efforts to add to those of the commanded joints [N m or N].

        Returns
        -------
        are_finite : bool
            False if an effort is not finite or beyond `LARGEST`; nothing has changed then.

        """
        self._rows[_ADDED] = added
        gain, left, duration = self.gain, self._left, self._duration
        is_new, elapsed = self._is_new, self.clock.step
        if self.continues:
            if not self._is_paused:
                gain = min(1.0, gain + ramp_fraction(elapsed, self._start_ramp))
                left = max(0.0, left - elapsed / duration) if left else 0.0
        else:
            self._is_paused = False  # a new blend does not advance anyway
            duration = max(self._start_ramp, left * duration)
            is_new = duration > 0.0
            left = 1.0 if is_new else 0.0
            gain = gain if self._start_ramp else 1.0
        are_finite: bool = blend_efforts(
            tau, self._rows, self._flags, gain, left, is_new, self._has_rates, elapsed
        )
        if are_finite:
            self._way, self._is_new = _Way.FOLLOWING, False
            self.gain, self._left, self._duration = gain, left, duration
            self._was_paused, self._is_paused = self._is_paused, False
        return are_finite

    def hold(self) -> None:
        """Repeat the last command; if a limit was tightened, reduce it over a blend."""
        elapsed = self.clock.step
        if self._way is _Way.FALLING:
            self._way, self._pause = _Way.HOLDING, math.inf
            self.command[:] = self._stop.command()  # without damping
            self.begin()
        elif self._way is _Way.FOLLOWING:
            self._way, self._pause = _Way.HOLDING, 0.0
        else:
            self._pause += self.clock.since
        command, limit, excess = self.command, self._rows[_LIMIT], self._rows[_EXCESS]
        if self._is_new:
            excess[:] = np.maximum(0.0, np.abs(command) - limit)
            self._is_new, self._pause = False, math.inf
        if self._left and self._pause > _BRIEF and not self._is_paused:
            self._left = max(0.0, self._left - elapsed / self._duration)
        self._was_paused, self._is_paused = self._is_paused, False
        change = np.maximum(0.0, np.abs(command) - limit - self._left * excess)
        if self._has_rates:
            change = np.minimum(change, self._rows[_RATE] * elapsed)
        command -= np.copysign(change, command)
        self._flags[:] = False

    def fall(self, damping: Floats | None = None, limits: Floats | None = None) -> None:
        """
        Ramp the commands down to zero, starting from the last one.

        Parameters
        ----------
        damping : ndarray, shape (m,), optional
            To be added; all of it is reduced by one factor where the sum would exceed a limit, so
            that it still opposes the motion [N m or N].
        limits : ndarray, shape (m,), optional
            Limits for this sum; by default, the present ones [N m or N].

        """
        if self._way is _Way.FALLING:
            self._stop.advance(self.clock.step)
            self._pause += self.clock.since
        else:
            self._pause = 0.0 if self._way is _Way.FOLLOWING and not self._is_new else math.inf
            self._way, self._is_new = _Way.FALLING, False
            self._is_paused = self._was_paused = False
            self._top_gain, self._top_left = self.gain, self._left
            self._stop.begin(self.command, self._stop_ramp)
        fraction = self._stop.fraction
        # Scale gain and blend too: after a brief pause, computed efforts continue from there.
        self.gain, self._left = fraction * self._top_gain, fraction * self._top_left
        self.command[:] = self._stop.command()
        self._is_damped = damping is not None
        if damping is not None:
            limits = self._rows[_LIMIT] if limits is None else limits
            self.command[:] = add_within(self.command, damping, limits)
        self._flags[:] = False


def add_within(command: Floats, damping: Floats, limit: Floats) -> Floats:
    """Add as much of a vector as keeps all commands within their limits; each of shape (m,)."""
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
    Turn computed efforts into the next command if all are finite; otherwise change nothing.

    Parameters
    ----------
    tau : ndarray, shape (n,)
        Computed efforts of all joints [N m or N].
    rows : ndarray, shape (10, m)
        One column per commanded joint. Inputs: its index among the n joints, the effort to add,
        scale, offset, limit and rate limit. Outputs: the computed effort, the difference and the
        excess over the limit at the start of a blend, and the command, which is the last command
        on entry.
    flags : ndarray of bool, shape (2, m)
        Receives which efforts are cut to their limits, and which are slowed by a rate limit.
    gain : float
        Factor of the computed efforts.
    left : float
        Fraction of the difference that is left.
    is_new : bool
        Whether a blend begins with the difference to the last command.
    has_rates : bool
        Whether there are rate limits.
    elapsed : float
        Time by which ramps advance [s].

    Returns
    -------
    are_finite : bool

    """
    # Convert to float: without numba, this is faster than numpy scalars, and does not warn.
    m = rows.shape[1]
    for k in range(m):
        effort = float(tau[int(rows[_INDEX, k])]) + float(rows[_ADDED, k])
        effort = effort * float(rows[_SCALE, k]) + float(rows[_OFFSET, k])
        if not abs(effort) <= LARGEST:  # also false for NaN
            return False
        rows[_WANTED, k] = effort
    for k in range(m):
        wanted, limit = float(rows[_WANTED, k]), float(rows[_LIMIT, k])
        last = float(rows[_COMMAND, k])
        effort = min(max(wanted, -limit), limit)
        flags[0, k] = effort != wanted
        effort *= gain
        if is_new:
            rows[_JUMP, k] = last - effort
            # A command beyond a limit that has just been tightened stays there at first.
            rows[_EXCESS, k] = max(0.0, abs(last) - limit)
        if is_new and left == 1.0:
            effort = last  # without rounding
        elif left != 0.0:
            bound = limit + left * float(rows[_EXCESS, k])
            blended = effort + left * float(rows[_JUMP, k])
            effort = min(max(blended, -bound), bound)
            flags[0, k] |= effort != blended
        if has_rates:
            change = float(rows[_RATE, k]) * elapsed
            wanted = effort
            effort = min(max(wanted, last - change), last + change)
            flags[1, k] = effort != wanted
        rows[_COMMAND, k] = effort
    if not has_rates:
        flags[1, :] = False
    return True
