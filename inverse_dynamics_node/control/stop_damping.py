"""Damps the motion during a stop, so that an arm without brakes sinks slowly."""

from __future__ import annotations

import math

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.model import Floats
from .joint_states import State
from .settings import Settings
from .shaping import ramp_fraction

AT_REST = 'the arm is at rest'
"""The usual reason why the damping ends."""
TIMEOUT = 20.0
"""Longest time for which a stop is damped [s]; then the damping fades over the stop ramp."""
# An arm that moves less than this distance within this time is at rest.
_REST_WAY, _REST_TIME = 2e-3, 0.5  # [rad or m], [s]
# A joint shakes if its velocity turns by _TURN or more, to and fro, within _SHAKING each time. A
# hanging arm swings more slowly.
_TURN, _SHAKING = 0.3, 0.25  # [rad/s or m/s], [s]
_PERMITTED = 0.4  # rate of decay times delay, without overshoot
_LARGEST_SHARE = 0.5  # fraction of its velocity that a joint may lose between two commands


class StopDamping:
    """
    Damps the motion of the commanded joints from the start of a stop ramp until rest.

    The damping effort is ``-r D M(q) qd``, with the mass matrix M of the commanded joints. D is
    the setting ``stop_damping``. Without gravity, each velocity would decay at the rate D. With
    gravity, the arm sinks at the speed at which damping balances gravity. The factor r rises from
    0 to 1 over the stop ramp. The damping ends when the arm is at rest, or after a timeout.

    The damping never drives the arm. The power of the damping is never positive. The damping
    efforts computed from one joint state cannot, even together, reverse the measured velocity. The
    damping ends at once when joint states are lost, and in a limit stop, because damping would
    drive a joint whose velocity or effort has the wrong sign.

    The damping falls at once, for example after a late joint state, and rises slowly, within the
    stop ramp. States that are always late by a time T make a damped arm shake if the rate of decay
    exceeds about 1 / T. The velocity of a joint then turns about every 2 T. If it does so three
    times, the damping falls to a rate that such a delay permits.

    ``index`` contains the indices of the m commanded joints among the n joints of the robot.

    """

    def __init__(self, dynamics: InverseDynamics, index: list[int]) -> None:
        self._dynamics, self._index = dynamics, index
        self.is_active = False
        """Whether the motion is damped, now or from the next command on."""
        self._report = ''
        self._scale = self.limits = np.zeros(len(index))
        self._longest = 0.0  # [s]; longest recent interval between commands
        self._passed = -1.0  # [s] since the first command of the stop; at first negative
        self._applied = 0.0  # [1/s]; rate of decay that the last command applied
        self._is_new = True  # whether the next command does not raise the damping
        self._q = self._qd = self._times = self._rest = np.zeros(len(index))
        # Of each joint: where its velocity turns, when it turned [s], and how often it shook.
        self._direction = self._extreme = self._turned = self._shaken = np.zeros(len(index))
        self._largest = 0.0  # [1/s]; largest rate of decay that the delay permits
        self._rest_since = 0.0  # [s]

    def begin(self, settings: Settings, scale: Floats, limits: Floats) -> None:
        """
        Damp the motion from the next command on, if ``settings.stop_damping`` is positive.

        ``scale`` contains the factors that convert efforts into commands, shape (m,). ``limits``
        contains the largest permitted commands, shape (m,) [N m or N]. Later changes of the
        settings do not affect this stop.

        """
        self._scale, self.limits, self._longest = scale, limits, 0.0
        self.is_active = settings.stop_damping > 0.0
        self._settings, self._passed, self._report = settings, -1.0, ''
        self._applied, self._is_new, self._largest = 0.0, True, settings.stop_damping
        self._direction, self._shaken = np.ones(len(self._index)), np.zeros(len(self._index))
        self._extreme = self._turned = np.full(len(self._index), -math.inf)
        self._rest = np.full(len(self._index), math.inf)

    def end(self, report: str = '') -> None:
        """End the damping until the next stop begins; ``report`` says why, if it matters."""
        self.is_active, self._report = False, report or self._report

    def take_report(self) -> str:
        """Return why the damping has ended since the last call, or ''."""
        report, self._report = self._report, ''
        return report

    def fall(self) -> None:
        """Let the damping fall to zero at once; it rises again within the stop ramp."""
        self._applied, self._is_new = 0.0, True

    def efforts(self, now: float, state: State | None, step: float, since: float) -> Floats | None:
        """
        Compute the efforts to add to the stop ramp; None if the motion is not damped.

        ``step`` is the time by which ramps advance. ``since`` is the time since the last command.
        All times are in [s]. The result, shape (m,) [N m or N], is already multiplied by the
        ``scale`` given to `begin`, but the limits are not applied yet.

        """
        if not self.is_active:
            return None
        is_first = self._passed < 0.0
        self._passed = 0.0 if is_first else self._passed + step
        settings = self._settings
        problem = self._follow(now, state, is_first)
        late = max(0.0, self._passed - TIMEOUT)
        left = 1.0 - ramp_fraction(late, settings.stop_ramp) if late else 1.0
        if not problem and self._is_at_rest():
            problem = AT_REST
        if not problem and not left:
            problem = f'the arm still moves after {TIMEOUT:g} s'
        if problem:
            self.end(problem)
            return None
        assert state is not None
        wanted = left * min(self._largest, self._rate(now - state.time, since))
        rise = ramp_fraction(0.0 if self._is_new else step, settings.stop_ramp)
        self._is_new = False
        self._applied = min(wanted, self._applied + rise * settings.stop_damping)
        return self._damp(state, self._applied)

    def _follow(self, now: float, state: State | None, is_first: bool) -> str:
        """Store the motion of the commanded joints; return why it is unknown, or ''."""
        timeout = self._settings.state_timeout
        if state is None or not 0.0 <= now - state.time <= timeout:
            return 'the joint states are lost'
        q, qd, times = (x[self._index] for x in (state.q, state.qd, state.times))
        elapsed = times - self._times
        if not is_first and not ((elapsed >= 0.0) & (elapsed <= timeout)).all():
            return 'the joint states were lost'
        self._q, self._qd, self._times = q, qd, times
        self._heed_shaking(now, qd)
        return ''

    def _heed_shaking(self, now: float, qd: Floats) -> None:
        """Lower the damping if the velocities show that the states are late."""
        turns = self._direction * (self._extreme - qd) > _TURN
        interval = now - self._turned
        self._shaken = np.where(turns, (interval < _SHAKING) * (self._shaken + 1.0), self._shaken)
        delay = np.min(interval, where=turns & (self._shaken > 1.0), initial=_SHAKING)
        if 0.0 < delay < _SHAKING:
            self._largest = min(self._largest, _PERMITTED / delay)
        self._turned = np.where(turns, now, self._turned)
        self._direction = np.where(turns, -self._direction, self._direction)
        is_new = turns | (self._direction * (qd - self._extreme) > 0.0)
        self._extreme = np.where(is_new, qd, self._extreme)

    def _is_at_rest(self) -> bool:
        is_falling = self._passed < self._settings.stop_ramp
        if is_falling or not (np.abs(self._q - self._rest) <= _REST_WAY).all():
            self._rest, self._rest_since = self._q, self._passed
        return self._passed - self._rest_since >= _REST_TIME

    def _rate(self, age: float, since: float) -> float:
        """
        Return the rate of decay [1/s].

        ``age`` is the age of the state [s]. ``since`` is the time since the last command [s]. A
        command acts until the next command, but is based on an older velocity. The rate falls with
        the square of the age, so that the commands computed from one state cannot, even together,
        reverse the measured velocity. The rate is computed for the longest recent interval between
        commands, because commands may be sent in bursts.

        """
        self._longest = since = max(since, 0.98 * self._longest)
        horizon = max(_LARGEST_SHARE / self._settings.stop_damping, since)
        age = max(age + since, horizon)
        return _LARGEST_SHARE * horizon / age**2

    def _damp(self, state: State, rate: float) -> Floats:
        # A joint with a scale of zero cannot be damped, and must not affect other joints.
        qd = np.where(self._scale == 0.0, 0.0, self._qd)
        mass_matrix = self._dynamics.mass_matrix(state.q)[np.ix_(self._index, self._index)]
        with np.errstate(all='ignore'):
            efforts = -rate * (mass_matrix @ qd)
            is_damping = qd @ efforts <= 0.0  # also false for NaN
        return self._scale * efforts if is_damping else np.zeros(len(qd))
