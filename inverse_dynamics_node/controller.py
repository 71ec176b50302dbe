"""
From state and reference to command: limits, ramps, and what happens when an input stops coming.

No ROS, and no clock: time comes in as an argument.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import enum
import math
from typing import NamedTuple

import numpy as np

from .dynamics import InverseDynamics
from .errors import ConfigurationError, JointStateError
from .model import Booleans, Floats, RobotModel
from .state import State


class Phase(enum.Enum):
    """What the controller is doing."""

    WAITING = 'no complete joint state yet'
    RUNNING = 'following the reference'
    HOLDING = 'no fresh reference: accelerations of zero'
    STATE_LOST = 'no fresh joint state: efforts go to zero'
    NO_SOLUTION = 'state or reference beyond all reason: efforts go to zero'
    STOPPED = 'stopped: efforts go to zero'


class Reference(NamedTuple):
    """What the commanded joints are to do."""

    accelerations: Floats
    """Shape (m,) [rad/s^2 or m/s^2]."""
    efforts: Floats
    """Added to the command, shape (m,) [N m or N]."""
    time: float
    """When it arrived [s]."""


class Command(NamedTuple):
    """What to send to the robot."""

    efforts: Floats
    """Shape (m,) [N m or N]; finite; valid until the next step."""
    is_saturated: Booleans
    """Which of the efforts were cut to their limits, shape (m,)."""


@dataclass(frozen=True)
class Settings:
    """How the controller treats its inputs and outputs. Times in [s]."""

    state_timeout: float = 0.1
    """A joint state older than this is lost."""
    reference_timeout: float = 0.5
    """A reference older than this counts no more; 0: a reference holds until the next."""
    start_ramp: float = 0.5
    """Time for the efforts to rise from zero to their full values."""
    stop_ramp: float = 0.5
    """Time for the efforts to fall from their full values to zero."""
    use_urdf_effort_limits: bool = True
    """Whether the efforts stay within the limits in the robot description."""


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

    Raises
    ------
    ConfigurationError
        If a joint cannot be commanded.

    """

    def __init__(
        self,
        dynamics: InverseDynamics,
        joints: Sequence[str] = (),
        settings: Settings | None = None,
    ) -> None:
        self.dynamics = dynamics
        self.settings = settings or Settings()
        self.joints = tuple(joints) or dynamics.robot.joint_names
        self.phase = Phase.WAITING
        self.gain = 0.0
        self._index = _index_of(self.joints, dynamics.robot)
        limits = dynamics.robot.effort_limits[self._index]
        self._limits = (
            limits if self.settings.use_urdf_effort_limits else np.full_like(limits, math.inf)
        )
        self._qdd = np.zeros(len(dynamics.robot.joint_names))
        self._tau = np.zeros_like(self._qdd)
        self._efforts = np.zeros(len(self.joints))
        self._is_saturated = np.zeros(len(self.joints), dtype=bool)
        self._time = math.inf  # of the last step; nothing has elapsed at the first
        self._is_stopping = False

    def stop(self) -> None:
        """Let the efforts fall to zero from the next step on, and stay there."""
        self._is_stopping = True

    def start(self) -> None:
        """Let the efforts rise from zero at the next step with a fresh state."""
        self._is_stopping = False
        self._time = math.inf
        self.gain = 0.0

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
            None before the first complete joint state.

        """
        # No step counts for more than the state may be old: after a stall the ramps go on from
        # where they were, not from where they would have been.
        elapsed = min(max(0.0, now - self._time), self.settings.state_timeout)
        self._time = now
        if state is None:
            return None
        self.phase = self._next_phase(now, state, reference)
        if self.phase is Phase.RUNNING or self.phase is Phase.HOLDING:
            self._compute(state, reference if self.phase is Phase.RUNNING else None)
        if self.phase is Phase.RUNNING or self.phase is Phase.HOLDING:
            self.gain = min(1.0, self.gain + _share(elapsed, self.settings.start_ramp))
        else:
            # The last efforts fade out; without a fresh state there are no better ones.
            self.gain = max(0.0, self.gain - _share(elapsed, self.settings.stop_ramp))
        return Command(self.gain * self._efforts, self._is_saturated)

    def _next_phase(self, now: float, state: State, reference: Reference | None) -> Phase:
        """Judge the inputs by their age; one below zero is from before the clock was reset."""
        if self._is_stopping:
            return Phase.STOPPED
        if not 0.0 <= now - state.time <= self.settings.state_timeout:
            return Phase.STATE_LOST
        if reference is None:
            return Phase.HOLDING
        timeout = self.settings.reference_timeout or math.inf
        return Phase.RUNNING if 0.0 <= now - reference.time <= timeout else Phase.HOLDING

    def _compute(self, state: State, reference: Reference | None) -> None:
        """Compute the efforts, within their limits; if there are none, the last ones stay."""
        self._qdd[self._index] = 0.0 if reference is None else reference.accelerations
        try:
            self.dynamics.efforts(state.q, state.qd, self._qdd, out=self._tau)
        except JointStateError:
            self.phase = Phase.NO_SOLUTION
            return
        efforts = self._tau[self._index]
        if reference is not None:
            with np.errstate(all='ignore'):
                efforts += reference.efforts
            if not np.isfinite(efforts).all():
                self.phase = Phase.NO_SOLUTION
                return
        np.greater(np.abs(efforts), self._limits, out=self._is_saturated)
        np.clip(efforts, -self._limits, self._limits, out=self._efforts)


def _share(elapsed: float, ramp: float) -> float:
    return elapsed / ramp if ramp > 0.0 else 1.0


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
