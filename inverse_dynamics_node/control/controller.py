"""
The controller: computes commands from joint states and references, and handles lost inputs.

No ROS, and no clock: time is an argument.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import ConfigurationError, JointStateError
from ..robot.model import Booleans, Floats, RobotModel
from .command_shaping import CommandShaper
from .filters import LowPass
from .joint_states import State
from .settings import Mode, Settings, StalePolicy
from .supervision import COMPUTING_PHASES, Phase, recovery_time, StateSupervisor

# Settings that change the inputs of the computation; others only change what follows from them.
_INPUT_SETTINGS = (
    'mode',
    'state_timeout',
    'uncommanded_state_timeout',
    'reference_timeout',
    'max_position_jump',
    'velocity_filter_cutoff',
)
_PLAUSIBLE = 1e9  # in SI units; a larger input is the cause of efforts that are not finite


class Reference(NamedTuple):
    """Desired motion of the commanded joints."""

    accelerations: Floats
    """Shape (m,) [rad/s^2 or m/s^2]."""
    efforts: Floats
    """Added to the command, shape (m,) [N m or N]."""
    time: float
    """Time of arrival [s]."""
    positions: Floats | None = None
    """Shape (m,) [rad or m]; None if the reference has none."""
    velocities: Floats | None = None
    """Shape (m,) [rad/s or m/s]; None if the reference has none."""


class ControlLaw:
    """
    Computes efforts from joint states and references, in one of the three modes.

    The dynamics include all joints of the robot; those that are not commanded are assumed to have
    zero acceleration.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with n joints.
    index : list of int
        Positions of the m commanded joints among the n joints.

    """

    def __init__(self, dynamics: InverseDynamics, index: list[int]) -> None:
        self.dynamics = dynamics
        self._index = _compact_index(index)
        self._is_continuous = dynamics.robot.is_continuous[self._index]
        n = len(dynamics.robot.joint_names)
        self._qdd, self._tau, self._rest = np.zeros((3, n))
        self._velocities = self._rest
        self._no_efforts = self.added = np.zeros(len(index))
        """Efforts of the reference, to be added to the computed ones, shape (m,) [N m or N]."""
        self._last_q, self._last_qd = np.zeros((2, n))
        self._last_reference: Reference | None = None
        self._has_last_inputs = False  # whether these led to the last command
        self._velocity_filter = LowPass(np.zeros(n))
        self._followed: Floats | None = None  # reference positions of the last step with feedback

    def apply(self, settings: Settings, of_joint: Mapping[str, Floats]) -> None:
        """Change the settings; ``of_joint`` has those that are expanded, see `Settings`."""
        self.settings, self._of_joint = settings, of_joint
        self._timeouts = np.full(len(self._qdd), settings.uncommanded_state_timeout)
        self._timeouts[self._index] = settings.state_timeout
        self._velocity_filter.cutoff = settings.velocity_filter_cutoff

    def reset(self) -> None:
        """Forget the inputs of the last command."""
        self._velocity_filter.reset()
        self._has_last_inputs = False

    def phase(self, now: float, state: State, reference: Reference | None) -> Phase:
        """Return whether the reference is followed, and if not, why."""
        if reference is None or self.settings.mode is Mode.GRAVITY_COMPENSATION:
            return Phase.HOLDING
        timeout = self.settings.reference_timeout or math.inf
        # After a reset of the clock, the age is negative.
        if not 0.0 <= now - reference.time <= timeout:
            return Phase.HOLDING
        return Phase.TOO_FAR if self._is_far(state, reference) else Phase.RUNNING

    def efforts(self, now: float, state: State, reference: Reference | None) -> Floats | None:
        """
        Compute the efforts of all joints.

        Parameters
        ----------
        now : float
            The time [s].
        state : State
            The joint state.
        reference : Reference or None
            The reference to follow; None for zero accelerations.

        Returns
        -------
        tau : ndarray, shape (n,), or None
            Valid until the next call [N m or N]; None if there is no solution.

        """
        is_closed = self.settings.mode is Mode.COMPUTED_TORQUE
        self._followed = reference.positions if is_closed and reference else None
        qd = self._smooth(now, state)
        # The arrays of the state change with the next message.
        self._last_q[:], self._last_qd[:] = state.q, qd
        self._last_reference, self._has_last_inputs = reference, True
        return self._efforts(state.q, qd, reference)

    def forget(self) -> None:
        """Note that the last command was not computed."""
        self._followed, self._has_last_inputs = None, False

    def last_efforts(self) -> Floats | None:
        """Compute efforts anew from the inputs of the last command; None if there are none."""
        if not self._has_last_inputs:
            return None
        return self._efforts(self._last_q, self._last_qd, self._last_reference)

    @property
    def motion(self) -> tuple[Floats, Floats]:
        """Velocities and accelerations of the last computed efforts, each of shape (n,)."""
        return self._velocities, self._qdd

    def cause_of_failure(self, scale: Floats) -> str:
        """Name the joint and the value that left the last step without a solution."""
        added, efforts = np.zeros((2, len(self._tau)))
        added[self._index] = self.added
        with np.errstate(all='ignore'):
            efforts[self._index] = scale * (self._tau[self._index] + added[self._index])
        inputs = {
            'position': self._last_q,
            'velocity': self._velocities,
            'acceleration': self._qdd,
            'added effort': added,
        }
        return _describe_overflow(self.dynamics.robot.joint_names, inputs, efforts)

    def _is_far(self, state: State, reference: Reference) -> bool:
        """Return whether the reference is too far from the joints, or has jumped too far."""
        limit = self.settings.max_position_jump
        is_closed = self.settings.mode is Mode.COMPUTED_TORQUE
        if not limit or not is_closed or reference.positions is None:
            return False
        start = state.q[self._index] if self._followed is None else self._followed
        return bool(np.abs(self._distance(start, reference.positions)).max() > limit)

    def _distance(self, start: Floats, target: Floats) -> Floats:
        """Return target minus start; continuous joints take the shorter way."""
        distance = target - start
        turns = np.round(distance / (2.0 * math.pi))
        return np.where(self._is_continuous, distance - 2.0 * math.pi * turns, distance)

    def _smooth(self, now: float, state: State) -> Floats:
        """Low-pass the measured velocities."""
        if not self._velocity_filter.cutoff:
            return state.qd
        times = np.full(len(state.q), state.time) if state.times is None else state.times
        # A late joint has been set to rest: apply that without waiting for its next state.
        is_late = now - times > self._timeouts
        return self._velocity_filter.update(times, state.qd, self._timeouts, is_late)

    def _efforts(self, q: Floats, qd: Floats, reference: Reference | None) -> Floats | None:
        mode = self.settings.mode
        self._velocities = self._rest if mode is Mode.GRAVITY_COMPENSATION else qd
        if reference is None:
            self._qdd[self._index], self.added = 0.0, self._no_efforts
        else:
            qdd = reference.accelerations
            if mode is Mode.COMPUTED_TORQUE:
                qdd = self._with_feedback(q, qd, reference)
            self._qdd[self._index] = qdd
            self.added = reference.efforts
        try:
            self.dynamics.efforts(q, self._velocities, self._qdd, out=self._tau)
        except JointStateError:
            return None
        return self._tau

    def _with_feedback(self, q: Floats, qd: Floats, reference: Reference) -> Floats:
        """Return the accelerations of computed torque."""
        qdd = reference.accelerations
        with np.errstate(all='ignore'):
            if reference.positions is not None:
                distance = self._distance(q[self._index], reference.positions)
                qdd = qdd + self._of_joint['kp'] * distance
            velocities: Floats | float | None = reference.velocities
            if velocities is None and reference.positions is not None:
                velocities = 0.0  # without damping the arm would swing forever
            if velocities is not None:
                qdd = qdd + self._of_joint['kd'] * (velocities - qd[self._index])
        return qdd


class Command(NamedTuple):
    """Efforts to send to the robot."""

    efforts: Floats
    """Shape (m,) [N m or N]; finite; valid until the next step."""
    is_saturated: Booleans
    """Which efforts were cut to their limits, shape (m,)."""
    is_slowed: Booleans
    """Which efforts were slowed by a rate limit, shape (m,)."""
    sent: Floats | None = None
    """Efforts for the robot [N m or N]; None if nothing is sent, see `DryRun`."""


class Controller:
    """
    Computes one command per step; the same inputs always produce the same commands.

    The dynamics include all joints of the robot; those that are not commanded are assumed to have
    zero acceleration.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with n joints.
    joints : sequence of str
        The m joints to command, in the order of the commands; empty for all, in the robot's order.
    settings : Settings, optional
        Modes, limits, ramps and timeouts.
    period : float
        Time between steps [s]; 0 if there is a step for every joint state.

    Raises
    ------
    ConfigurationError
        If a joint cannot be commanded, or a setting does not fit the joints.

    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        joints: Sequence[str] = (),
        settings: Settings | None = None,
        period: float = 0.0,
    ) -> None:
        self.dynamics = dynamics
        self.joints = tuple(joints) or dynamics.robot.joint_names
        self._index = _joint_index(self.joints, dynamics.robot)
        self.supervisor = StateSupervisor()
        self.law = ControlLaw(dynamics, self._index)
        self._shaper = CommandShaper(self._index, period)
        command = self._shaper.command
        flags = self._shaper.is_saturated, self._shaper.is_slowed
        self._result = Command(command, *flags, sent=command)
        self._time = math.inf
        self.settings = settings or Settings()
        self.apply(self.settings)

    def apply(self, settings: Settings) -> None:
        """
        Change the settings from the next step on, which continues from the last command.

        To be called after other changes of the same kind, such as friction: the difference that
        all of them make to the last efforts fades within the start ramp.

        Raises
        ------
        ConfigurationError
            If a list does not have one number for each commanded joint; nothing has changed then.

        """
        arrays = settings.expanded(len(self.joints))
        limits = arrays['effort_limits']
        if settings.use_urdf_effort_limits:
            limits = np.minimum(limits, self.dynamics.robot.effort_limits[self._index])
        has_same_inputs = all(
            getattr(settings, name) == getattr(self.settings, name) for name in _INPUT_SETTINGS
        )
        self.settings, self._of_joint, self.limits = settings, arrays, limits
        self.law.apply(settings, arrays)
        self._shaper.configure(
            self.scale,
            self.offset,
            limits,
            arrays['effort_rate_limits'],
            settings.start_ramp,
            settings.stop_ramp,
        )
        if has_same_inputs:
            self._shaper.begin(self.law.last_efforts(), self.law.added)
        else:
            self.blend()

    def blend(self) -> None:
        """
        Continue from the last command, and fade out the difference within the start ramp.

        To be called after changes of the computed efforts that are not motion, such as the robot
        description or gravity.

        """
        self._shaper.begin()

    @property
    def phase(self) -> Phase:
        """What the last command was computed for."""
        return self.supervisor.phase

    @property
    def gain(self) -> float:
        """Factor of the computed efforts: rises from 0 to 1 along the start ramp."""
        return self._shaper.gain

    @property
    def has_effort(self) -> bool:
        """Whether an effort of the last command is not zero."""
        return bool(self._shaper.command.any())

    @property
    def scale(self) -> Floats:
        """Factors for the computed efforts, shape (m,)."""
        return self._of_joint['effort_scale']

    @property
    def offset(self) -> Floats:
        """Added to the scaled efforts, shape (m,) [N m or N]."""
        return self._of_joint['effort_offset']

    @property
    def ramp_step(self) -> float:
        """Time by which ramps advance with this command; see `RampClock` [s]."""
        return self._shaper.clock.step

    @property
    def time_to_fall(self) -> float:
        """Time until the efforts are zero, if they fall from now on or already do [s]."""
        return self._shaper.time_to_fall

    @property
    def motion(self) -> tuple[Floats, Floats]:
        """Velocities and accelerations of the last computed efforts, each of shape (n,)."""
        return self.law.motion

    def cause_of_failure(self) -> str:
        """Name the joint and the value that left the last step without a solution."""
        return self.law.cause_of_failure(self.scale)

    @property
    def is_stopping(self) -> bool:
        """Whether the efforts are to be zero; they may still be ramping down."""
        return self.supervisor.is_stopping

    def stop(self) -> None:
        """Ramp the efforts to zero from the next step on, and keep them there."""
        self.supervisor.is_stopping = True

    def resume(self) -> None:
        """Let the efforts rise again from the last command, however short the stop was."""
        if self.is_stopping:
            self.blend()  # after a brief stop too: the reference may have been dropped
        self.supervisor.is_stopping = False

    def start(self) -> None:
        """Let the efforts rise from zero, beginning at the next step with a fresh state."""
        self.supervisor.start()
        self.law.reset()
        self._shaper.reset()

    def continue_from(self, other: Controller) -> None:
        """
        Continue from the last command of the controller of another robot description.

        Parameters
        ----------
        other : Controller
            Must command the same joints, and must not be used afterwards.

        Raises
        ------
        ConfigurationError
            If it commands other joints.

        """
        if self.joints != other.joints:
            raise ConfigurationError(
                f'the joints to command are now {", ".join(self.joints)}, expected '
                f'{", ".join(other.joints)}'
            )
        self.supervisor, self._time = other.supervisor, other._time
        self._shaper.continue_from(other._shaper)

    def step(self, now: float, state: State | None, reference: Reference | None) -> Command | None:
        """
        Compute the command for one time.

        Parameters
        ----------
        now : float
            The time, on the clock of state and reference [s].
        state : State or None
            The latest joint state; None if there has been no complete one.
        reference : Reference or None
            The latest reference, if there has been one.

        Returns
        -------
        command : Command or None
            None before the first complete joint state since the start.

        """
        self.pass_time(now)
        return self.command(state, reference)

    def pass_time(self, now: float) -> None:
        """Advance to the time of the next command [s]; loads may then change by `ramp_step`."""
        self._time = now
        if self._shaper.clock.advance(now):
            self._shaper.begin()

    def command(self, state: State | None, reference: Reference | None) -> Command | None:
        """Compute the command for the time of `pass_time`; arguments as for `step`."""
        now, settings = self._time, self.settings
        phase = self.supervisor.blocking_phase(now, state, settings.state_timeout, self.gain)
        if phase is None:
            assert state is not None
            phase = self.law.phase(now, state, reference)
        self.supervisor.phase = phase
        if phase is Phase.WAITING:
            self._shaper.clock.start()
            return None
        tau = None
        if state is not None and phase in COMPUTING_PHASES:
            tau = self.law.efforts(now, state, reference if phase is Phase.RUNNING else None)
        else:
            self.law.forget()
        holds = phase is not Phase.STOPPED and settings.on_stale_state is StalePolicy.HOLD
        if not self._shaper.next(tau, self.law.added, holds=holds) and phase in COMPUTING_PHASES:
            self.supervisor.phase = Phase.NO_SOLUTION
        return self._result

    @property
    def recovery_time(self) -> float:
        """Time without a gap after which states that were lost are used again [s]."""
        return recovery_time(self.settings.state_timeout)


def _compact_index(index: list[int]) -> Any:
    """Return consecutive indices as a slice, with which numpy takes a third of the time."""
    first = index[0]
    if index == list(range(first, first + len(index))):
        return slice(first, first + len(index))
    return np.array(index)


def _joint_index(joints: Sequence[str], robot: RobotModel) -> list[int]:
    """Return the indices of the commanded joints among those of the robot."""
    if not joints:
        raise ConfigurationError(f"robot '{robot.name}' has no movable joints")
    if len(set(joints)) != len(joints):
        raise ConfigurationError(f'joints lists a joint twice: {", ".join(joints)}')
    unknown = [name for name in joints if name not in robot.joint_names]
    if unknown:
        raise ConfigurationError(
            f"joints names '{unknown[0]}', which robot '{robot.name}' does not have or cannot be "
            f'commanded (fixed, or mimicking another); it has {", ".join(robot.joint_names)}'
        )
    return robot.joint_indices(joints)


def _describe_overflow(
    joint_names: Sequence[str], inputs: Mapping[str, Floats], efforts: Floats
) -> str:
    """
    Name the joint and the value that are the cause of efforts that are not finite.

    Parameters
    ----------
    joint_names : sequence of str
        The n joints.
    inputs : mapping of str to ndarray, shape (n,)
        Inputs of the computation, by name.
    efforts : ndarray, shape (n,)
        Computed efforts [N m or N], for the case that the inputs are plausible.

    """
    name, joint = _largest(inputs)
    value = inputs[name][joint]
    if abs(value) <= _PLAUSIBLE:
        name, joint = _largest({'computed effort': efforts})
        value = efforts[joint]
    return f"the {name} of joint '{joint_names[joint]}' is {value:.4g}"


def _largest(arrays: Mapping[str, Floats]) -> tuple[str, int]:
    """Return the name and the index of the value with the largest magnitude; NaN is largest."""
    sizes = np.nan_to_num(np.abs(list(arrays.values())), nan=math.inf, posinf=math.inf)
    row, joint = np.unravel_index(np.argmax(sizes), sizes.shape)
    return list(arrays)[int(row)], int(joint)
