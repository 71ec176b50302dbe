"""Damps the motion during a stop, so that an arm without brakes sinks slowly."""

from __future__ import annotations

import math

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import JointStateError
from ..robot.model import Floats
from .command_shaping import ramp_fraction
from .control_law import shorter_way
from .joint_states import State
from .settings import Settings

AT_REST = 'the arm is at rest'
"""The usual reason why the damping ends."""
TIMEOUT = 20.0
"""Longest time for which a stop is damped [s]; then the damping fades over the stop ramp."""
# An arm that moves less than this distance within this time is at rest.
_REST_WAY, _REST_TIME = 2e-3, 0.5  # [rad or m], [s]
# Velocities contradict positions if the integral of the velocity differs from the change of
# position. The permitted difference is a constant plus a fraction of the larger value plus an
# allowance. Changes older than about a second are forgotten, so that noise does not add up. In
# simulations with a delay of 5 ms and a noise of 0.01 rad/s, the constant had to be at least 0.003
# for a stop from rest, and 0.015 for a stop from up to 2 rad/s, without the allowance. With the
# allowance, a wrong sign was detected within 0.02 s at 2 rad/s, and within 0.12 s after a stop
# from rest.
_LEAST_ERROR, _RELATIVE_ERROR, _MEMORY = 0.02, 0.5, 1.0  # [rad or m], no unit, [s]
# After a pause of the computer, joint states arrive together, and the first of them are old. The
# allowance permits this. It is the time between two states, at most _LONGEST_PAUSE, multiplied by
# the smaller of their speeds, so that a single wrong velocity does not increase it. The largest
# product counts, and fades within about a second. A pause right before the stop counts too. In 216
# simulated stops with pauses of 10 to 90 ms, the damping ended too early in 4 stops with the
# allowance, and in 30 without it.
_LONGEST_PAUSE = 0.1  # [s]
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
    damping ends at once when joint states are lost. The damping also ends when velocities
    contradict positions, because damping would drive a joint whose reported velocity has the wrong
    sign.

    ``index`` contains the indices of the m commanded joints among the n joints of the robot.

    """

    def __init__(self, dynamics: InverseDynamics, index: list[int]) -> None:
        self._dynamics, self._index = dynamics, index
        self._is_continuous = dynamics.robot.is_continuous[index]
        self.is_active = False
        """Whether the motion is damped, now or from the next command on."""
        self.report = ''
        """Reason why the damping has ended; whoever reads the reason resets it to ''."""
        self._scale = self.limits = np.zeros(len(index))
        self._longest = 0.0  # [s]; longest recent interval between commands
        self._passed = -1.0  # [s] since the first command of the stop; at first negative
        self._q = self._qd = self._times = np.zeros(len(index))
        self._rest_since = 0.0  # [s]
        self._rest = self._way = self._integral = self._allowance = self._q
        self._pause = 0.0  # [s]; before the first command of the stop

    def begin(self, settings: Settings, scale: Floats, limits: Floats) -> None:
        """
        Damp the motion from the next command on, if ``settings.stop_damping`` is positive.

        ``scale`` contains the factors that convert efforts into commands, shape (m,). ``limits``
        contains the largest permitted commands, shape (m,) [N m or N]. Later changes of the
        settings do not affect this stop.

        """
        self._scale, self.limits, self._longest = scale, limits, 0.0
        self.is_active = settings.stop_damping > 0.0
        self._settings, self._passed, self.report = settings, -1.0, ''
        self._way, self._integral, self._allowance = np.zeros((3, len(self._index)))
        self._rest = np.full(len(self._index), math.inf)

    def end(self, report: str = '') -> None:
        """End the damping until the next stop begins."""
        self.is_active, self.report = False, report or self.report

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
        if is_first:
            self._pause = since
        problem = self._track(now, state, is_first)
        settings = self._settings
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
        factor = min(left, ramp_fraction(self._passed, settings.stop_ramp))
        return self._damp(state, factor * self._rate(now - state.time, since))

    def _track(self, now: float, state: State | None, is_first: bool) -> str:
        """Compare velocities with changes of position; return a problem, or ''."""
        timeout = self._settings.state_timeout
        if state is None or not 0.0 <= now - state.time <= timeout or not state.is_consistent:
            return 'the joint states are lost or contradictory'
        q, qd, times = (x[self._index] for x in (state.q, state.qd, state.times))
        if not is_first:
            elapsed = times - self._times
            if not ((elapsed >= 0.0) & (elapsed <= timeout)).all():
                return 'the joint states were lost'
            way = shorter_way(q - self._q, self._is_continuous)
            memory = np.maximum(0.0, 1.0 - elapsed / _MEMORY)
            self._way = memory * (self._way + way)
            self._integral = memory * (self._integral + 0.5 * elapsed * (self._qd + qd))
            pause = np.minimum(np.maximum(elapsed, self._pause), _LONGEST_PAUSE)
            slower = np.minimum(np.abs(self._qd), np.abs(qd))
            self._allowance = np.maximum(pause * slower, memory * self._allowance)
            self._pause = 0.0
        self._q, self._qd, self._times = q, qd, times
        size = np.maximum(np.abs(self._way), np.abs(self._integral))
        bound = _LEAST_ERROR + _RELATIVE_ERROR * size + self._allowance
        is_wrong = ~(np.abs(self._way - self._integral) <= bound)
        if is_wrong.any():
            joint = self._dynamics.robot.joint_names[self._index[int(np.argmax(is_wrong))]]
            return f'the velocities of {joint} contradict its positions'
        return ''

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
        try:
            mass_matrix = self._dynamics.mass_matrix(state.q)[np.ix_(self._index, self._index)]
        except JointStateError:
            return np.zeros(len(qd))
        with np.errstate(all='ignore'):
            efforts = -rate * (mass_matrix @ qd)
            is_damping = qd @ efforts <= 0.0  # also false for NaN
        return self._scale * efforts if is_damping else np.zeros(len(qd))
