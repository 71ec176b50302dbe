"""
From state and reference to command: modes, limits, ramps, and what to do when an input is lost.

No ROS, and no clock: time comes in as an argument.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
import enum
import math
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import ConfigurationError, JointStateError
from ..robot.model import Booleans, Floats, RobotModel
from .blending import Blending
from .filters import LowPass
from .joint_states import State
from .settings import expand_per_joint, Mode, Settings, StalePolicy


class Phase(enum.Enum):
    """What the controller is doing."""

    WAITING = 'waiting for the first complete joint state'
    RUNNING = 'following the reference'
    HOLDING = 'holding position'
    TOO_FAR = 'holding position: the reference is too far away'
    STATE_LOST = 'joint states lost'
    NO_SOLUTION = 'no usable efforts for this joint state and reference'
    STOPPED = 'stopped'


_PATIENCE = 0.02  # [s]; how much later than expected a step may come
_LEAST_RECOVERY = 0.2  # [s]; shortest time without a gap after which lost states are used again
_TOLERATED_DROP = 0.05  # of the gain; after a loss that cost less, there is nothing to wait for
COMPUTING_PHASES = (Phase.RUNNING, Phase.HOLDING, Phase.TOO_FAR)
"""Phases in which efforts are computed from a fresh state."""


class Reference(NamedTuple):
    """What the commanded joints are to do."""

    accelerations: Floats
    """Shape (m,) [rad/s^2 or m/s^2]."""
    efforts: Floats
    """Added to the command, shape (m,) [N m or N]."""
    time: float
    """When it arrived [s]."""
    positions: Floats | None = None
    """Shape (m,) [rad or m]; None where the reference has none."""
    velocities: Floats | None = None
    """Shape (m,) [rad/s or m/s]; None where the reference has none."""


class Command(NamedTuple):
    """What to send to the robot."""

    efforts: Floats
    """Shape (m,) [N m or N]; finite; valid until the next step."""
    is_saturated: Booleans
    """Which of the efforts were cut to their limits, shape (m,)."""
    is_slowed: Booleans
    """Which of them may not change as fast as they should, shape (m,)."""


class Controller:
    """
    Computes one command a step; the same inputs always give the same commands.

    All joints of the robot count in the dynamics; those that are not commanded are taken to keep
    their velocity.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with n joints.
    joints : sequence of str
        The m joints to command, in the order of the commands; empty for all, in the robot's order.
    settings : Settings
        See there.
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
        self.phase = Phase.WAITING
        self._period = period
        index = _index_of(self.joints, dynamics.robot)
        self._index = _shortest(index)
        self._is_continuous = dynamics.robot.is_continuous[self._index]
        n = len(dynamics.robot.joint_names)
        self._qdd, self._tau = np.zeros((2, n))
        self._rest = self._velocities = np.zeros(n)
        self._blending = Blending(index)
        self._result = Command(
            self._blending.command, self._blending.is_saturated, self._blending.is_slowed
        )
        self._is_stopping = False
        self._time = math.inf
        self._velocity_filter = LowPass(np.zeros(n))
        self._lost_gain = 0.0  # gain at which the states were lost
        self._fresh_since = math.inf  # arrival of the first state after the last gap
        self._followed: Floats | None = None  # where a loop closed here was to be, last step
        self.apply(settings or Settings())

    def apply(self, settings: Settings) -> None:
        """
        Change the settings from the next step on, which continues from the last command.

        Raises
        ------
        ConfigurationError
            If a list does not have one number for each commanded joint; nothing has changed then.

        """
        m = len(self.joints)
        arrays = {
            field.name: expand_per_joint(field.name, getattr(settings, field.name), m)
            for field in fields(settings)
            if field.type == 'PerJoint'
        }
        limits = arrays['effort_limits']
        if settings.use_urdf_effort_limits:
            limits = np.minimum(limits, self.dynamics.robot.effort_limits[self._index])
        self.settings, self._of_joint = settings, arrays
        self._timeouts = np.full(len(self._qdd), settings.uncommanded_state_timeout)
        self._timeouts[self._index] = settings.state_timeout
        self.limits = limits
        self._velocity_filter.cutoff = settings.velocity_filter_cutoff
        self._blending.configure(
            self.scale,
            self.offset,
            limits,
            arrays['effort_rate_limits'],
            settings.start_ramp,
            settings.stop_ramp,
        )

    def blend(self) -> None:
        """
        Let the next command continue from the last one, and the difference fade.

        For changes of the computed efforts that are not motion: settings, the robot description,
        gravity. The difference fades within the start ramp.

        """
        self._blending.begin()

    @property
    def gain(self) -> float:
        """Share of the computed efforts in the command: 0 to 1 along the start ramp."""
        return self._blending.gain

    @property
    def has_effort(self) -> bool:
        """Whether an effort of the last command is not zero."""
        return bool(self._blending.command.any())

    @property
    def scale(self) -> Floats:
        """What every computed effort is multiplied with, shape (m,)."""
        return self._of_joint['effort_scale']

    @property
    def offset(self) -> Floats:
        """What is added to it then, shape (m,) [N m or N]."""
        return self._of_joint['effort_offset']

    @property
    def motion(self) -> tuple[Floats, Floats]:
        """Velocities and accelerations that the last efforts are for, each of shape (n,)."""
        return self._velocities, self._qdd

    @property
    def is_stopping(self) -> bool:
        """Whether the efforts are told to be zero."""
        return self._is_stopping

    def stop(self) -> None:
        """Let the efforts fall to zero from the next step on, and stay there."""
        self._is_stopping = True

    def resume(self) -> None:
        """Let the efforts rise again, from wherever a stop has got them to."""
        self._is_stopping = False

    def start(self) -> None:
        """Let the efforts rise from zero at the next step with a fresh state."""
        self._is_stopping = False
        self._time = math.inf  # at the first step nothing has elapsed
        self._velocity_filter.reset()
        self._blending.reset()
        self.phase = Phase.WAITING

    def continue_from(self, other: Controller) -> None:
        """
        Go on where the controller of another description of the robot is, without a jump.

        Parameters
        ----------
        other : Controller
            Of the same commanded joints; not to be used any more.

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
        self.phase, self._time = other.phase, other._time
        self._is_stopping = other._is_stopping
        self._lost_gain, self._fresh_since = other._lost_gain, other._fresh_since
        self._blending.continue_from(other._blending)

    def step(self, now: float, state: State | None, reference: Reference | None) -> Command | None:
        """
        Compute the command for one time.

        Parameters
        ----------
        now : float
            The time, of the same clock as those of state and reference [s].
        state : State or None
            The latest joint state; None if there has been no complete one.
        reference : Reference or None
            The latest reference, if there has been one.

        Returns
        -------
        command : Command or None
            None before the first complete joint state since the start.

        """
        # A longer gap means that the process was suspended or the machine stalled. Ramps resume
        # where they were instead of catching up.
        longest = max(self.settings.state_timeout, 2.0 * self._period) + _PATIENCE
        since = now - self._time
        elapsed = since if 0.0 <= since <= longest else 0.0
        if elapsed != since:
            self.blend()
        self._time = now
        if state is None and self.phase is Phase.WAITING:
            return None
        self.phase = self._next_phase(now, state, reference)
        is_closed = self.settings.mode is Mode.COMPUTED_TORQUE and self.phase is Phase.RUNNING
        self._followed = reference.positions if is_closed and reference else None
        if state is not None and self.phase in COMPUTING_PHASES:
            followed = reference if self.phase is Phase.RUNNING else None
            if self._compute(state, followed) and self._blending.follow(self._tau, elapsed):
                return self._result
            self.phase = Phase.NO_SOLUTION
        if self.phase is Phase.STOPPED or self.settings.on_stale_state is StalePolicy.ZERO:
            # Late steps shorten the stop ramp by no more than they may be late, but do shorten it:
            # on a machine that is always late, the efforts still get to zero.
            self._blending.fall(min(max(0.0, since), longest))
        else:
            self._blending.hold(elapsed)
        return self._result

    def _next_phase(self, now: float, state: State | None, reference: Reference | None) -> Phase:
        """Judge the inputs by their age; one below zero is from before the clock was reset."""
        if self._is_stopping:
            return Phase.STOPPED
        if self._is_lost(now, state) or state is None:
            return Phase.STATE_LOST
        if reference is None or self.settings.mode is Mode.GRAVITY_COMPENSATION:
            return Phase.HOLDING
        timeout = self.settings.reference_timeout or math.inf
        if not 0.0 <= now - reference.time <= timeout:
            return Phase.HOLDING
        return Phase.TOO_FAR if self._is_far(state, reference) else Phase.RUNNING

    @property
    def recovery_time(self) -> float:
        """Time without a gap after which states that were lost are used again [s]."""
        return max(2.0 * self.settings.state_timeout, _LEAST_RECOVERY)

    def _is_lost(self, now: float, state: State | None) -> bool:
        """
        Return whether the state is too old or inconsistent, or was until recently.

        Intermittent states would otherwise raise and lower the efforts without end, which shakes
        the arm.

        """
        was_lost = self.phase is Phase.STATE_LOST
        if state is None:
            # A joint of a new robot description was never reported. Its first state ends the loss.
            self._lost_gain = 0.0
            return True
        is_fresh = 0.0 <= now - state.time <= self.settings.state_timeout
        if not (is_fresh and state.is_consistent):
            if not was_lost:
                self._lost_gain = self.gain
            self._fresh_since = math.inf
            return True
        if not was_lost or self.gain >= self._lost_gain - _TOLERATED_DROP:
            return False
        self._fresh_since = min(self._fresh_since, state.time)
        return state.time - self._fresh_since < self.recovery_time

    def _is_far(self, state: State, reference: Reference) -> bool:
        """Tell whether following the reference would be a jump: from the joints, or under way."""
        limit = self.settings.max_position_jump
        if not limit or self.settings.mode is not Mode.COMPUTED_TORQUE:
            return False
        if reference.positions is None:
            return False
        come_from = state.q[self._index] if self._followed is None else self._followed
        return bool(np.abs(self._distance(come_from, reference.positions)).max() > limit)

    def _distance(self, come_from: Floats, go_to: Floats) -> Floats:
        """Return how far the joints have to go; the short way round for continuous ones."""
        distance = go_to - come_from
        turns = np.round(distance / (2.0 * math.pi))
        return np.where(self._is_continuous, distance - 2.0 * math.pi * turns, distance)

    def _smooth(self, state: State) -> Floats:
        """Low-pass the measured velocities."""
        if not self._velocity_filter.cutoff:
            return state.qd
        times = np.asarray(state.time if state.times is None else state.times)
        # A late joint has been set to rest: apply that without waiting for its next state.
        is_late = self._time - times > self._timeouts
        return self._velocity_filter.update(times, state.qd, self._timeouts, is_late)

    def _compute(self, state: State, reference: Reference | None) -> bool:
        """Compute the efforts of all joints; return whether there is a solution."""
        mode = self.settings.mode
        qd = self._smooth(state)
        self._velocities = self._rest if mode is Mode.GRAVITY_COMPENSATION else qd
        added = self._blending.added
        if reference is None:
            self._qdd[self._index] = added[:] = 0.0
        else:
            qdd = reference.accelerations
            if mode is Mode.COMPUTED_TORQUE:
                qdd = self._resolved(state.q, qd, reference)
            self._qdd[self._index] = qdd
            added[:] = reference.efforts
        try:
            self.dynamics.efforts(state.q, self._velocities, self._qdd, out=self._tau)
        except JointStateError:
            return False
        return True

    def _resolved(self, q: Floats, qd: Floats, reference: Reference) -> Floats:
        """Return the accelerations that also take the joints back to the reference."""
        qdd = reference.accelerations
        with np.errstate(all='ignore'):
            if reference.positions is not None:
                distance = self._distance(q[self._index], reference.positions)
                qdd = qdd + self._of_joint['kp'] * distance
            velocities: Floats | float | None = reference.velocities
            if velocities is None and reference.positions is not None:
                velocities = 0.0  # without damping the arm would swing for ever
            if velocities is not None:
                error = velocities - qd[self._index]
                qdd = qdd + self._of_joint['kd'] * error
        return qdd


def _shortest(index: list[int]) -> Any:
    """Return an index as a slice, where it is one: numpy takes a third of the time for it."""
    first = index[0]
    if index == list(range(first, first + len(index))):
        return slice(first, first + len(index))
    return np.array(index)


def _index_of(joints: Sequence[str], robot: RobotModel) -> list[int]:
    """Find the joints to command among those of the robot."""
    if not joints:
        raise ConfigurationError(f"robot '{robot.name}' has no movable joints")
    if len(set(joints)) != len(joints):
        raise ConfigurationError(f'joints names a joint twice: {", ".join(joints)}')
    unknown = [name for name in joints if name not in robot.joint_names]
    if unknown:
        raise ConfigurationError(
            f"joints names '{unknown[0]}', which robot '{robot.name}' does not have or cannot be "
            f'commanded (fixed, or mimicking another); it has {", ".join(robot.joint_names)}'
        )
    return [robot.joint_names.index(name) for name in joints]
