"""Computes efforts from joint states and references."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import ConfigurationError, JointStateError
from ..robot.model import Booleans, Floats, RobotModel
from .command_shaping import ramp_fraction
from .filters import LowPass
from .joint_states import LATE_AFTER, State
from .settings import Mode, Settings
from .supervision import Phase

_PLAUSIBLE = 1e9  # [SI units]; a larger input is reported as the cause of infinite efforts


class Reference(NamedTuple):
    """Desired motion of the commanded joints."""

    accelerations: Floats
    """Accelerations, shape (m,) [rad/s^2 or m/s^2]."""
    efforts: Floats
    """Efforts to add to the computed efforts, shape (m,) [N m or N]."""
    time: float
    """Time at which the reference arrived [s]."""
    positions: Floats | None = None
    """Positions, shape (m,) [rad or m], if given."""
    velocities: Floats | None = None
    """Velocities, shape (m,) [rad/s or m/s], if given."""


class ControlLaw:
    """
    Computes efforts from joint states and references, according to the control mode.

    The dynamics include all n joints of the robot. Uncommanded joints are assumed to have zero
    acceleration. ``index`` contains the indices of the m commanded joints among the n joints.

    """

    def __init__(self, dynamics: InverseDynamics, index: list[int]) -> None:
        self.dynamics = dynamics
        self._index = _compact_index(index)
        self._is_continuous = dynamics.robot.is_continuous[self._index]
        n = len(dynamics.robot.joint_names)
        self._qdd, self._tau, self._rest = np.zeros((3, n))
        self.velocities: Floats = self._rest
        """Velocities that produced the last efforts, shape (n,) [rad/s or m/s]."""
        self._no_efforts = self.added = np.zeros(len(index))
        """
        Efforts to add to the computed efforts, shape (m,) [N m or N]. These efforts come
        from the reference, joint impedance or hand guiding.
        """
        self.equilibrium: Floats | None = None
        """
        Positions at which joint impedance holds the commanded joints, shape (m,) [rad or m]. None
        means the positions measured in the next step.
        """
        self._last_q, self._last_qd = np.zeros((2, n))
        self._last_reference: Reference | None = None
        self._has_last_inputs = False  # whether the inputs above produced the last command
        self._velocity_filter = LowPass(np.zeros(n))
        self._followed: Floats | None = None  # last reference positions of computed torque

    def apply(self, settings: Settings, of_joint: Mapping[str, Floats]) -> None:
        """Change the settings; ``of_joint`` is the result of `Settings.expanded`."""
        self.settings, self._of_joint = settings, of_joint
        self._timeouts = np.full(len(self._qdd), LATE_AFTER)
        self._timeouts[self._index] = settings.state_timeout
        self._velocity_filter.cutoff = settings.velocity_filter_cutoff
        self._has_guiding_damping = bool(of_joint['guiding_damping'].any())

    def reset(self) -> None:
        """Forget the inputs of the last command, and restart the velocity filter."""
        self._velocity_filter.reset()
        self._has_last_inputs = False

    def phase(self, now: float, state: State, reference: Reference | None) -> Phase:
        """Decide whether the reference is followed, and return the phase."""
        is_held = self.settings.mode is Mode.JOINT_IMPEDANCE
        without_reference = Phase.HOLDING if is_held else Phase.FLOATING
        if reference is None or self.settings.mode is Mode.GRAVITY_COMPENSATION:
            return without_reference
        timeout = self.settings.reference_timeout or math.inf
        # The age may be negative after the clock was set back.
        if not 0.0 <= now - reference.time <= timeout:
            return without_reference
        if not self._is_far(state, reference):
            return Phase.RUNNING
        return Phase.HOLDING_TOO_FAR if is_held else Phase.TOO_FAR

    def efforts(self, now: float, state: State, reference: Reference | None) -> Floats | None:
        """
        Compute the efforts of all joints, shape (n,) [N m or N]; return None if one is not finite.

        Without a reference, all accelerations are zero, and joint impedance holds the joints at
        `equilibrium`. The result does not include `added`, and is valid until the next call.
        ``now`` is the time [s].

        """
        mode, positions = self.settings.mode, reference.positions if reference else None
        self._followed = positions if mode is Mode.COMPUTED_TORQUE else None
        if mode is not Mode.JOINT_IMPEDANCE:
            self.equilibrium = None
        elif positions is not None:
            self.equilibrium = positions
        elif self.equilibrium is None:
            self.equilibrium = state.q[self._index].copy()
        qd = self._smooth(now, state)
        # Copy the state, because the next message overwrites its arrays.
        self._last_q[:], self._last_qd[:] = state.q, qd
        self._last_reference, self._has_last_inputs = reference, True
        return self._efforts(state.q, qd, reference)

    def forget(self) -> None:
        """Record that this law did not compute the last command."""
        self._followed, self._has_last_inputs = None, False

    def last_efforts(self) -> Floats | None:
        """Recompute efforts from the inputs of the last command; None if no inputs are stored."""
        if not self._has_last_inputs:
            return None
        return self._efforts(self._last_q, self._last_qd, self._last_reference)

    def is_closed(self, phase: Phase) -> bool:
        """Return whether a reference is followed with feedback of the positions."""
        is_closed = self.settings.mode in (Mode.COMPUTED_TORQUE, Mode.JOINT_IMPEDANCE)
        return is_closed and phase is Phase.RUNNING

    @property
    def followed(self) -> Reference | None:
        """The reference that the last command followed, if any."""
        return self._last_reference if self._has_last_inputs else None

    def distance(self, start: Floats, target: Floats) -> Floats:
        """Return target minus start, shape (m,); continuous joints take the shorter way."""
        return shorter_way(target - start, self._is_continuous)

    def cause_of_failure(self) -> str:
        """
        Name the joint and the value that prevented finite efforts in the last step.

        If all inputs are plausible, the value is a computed effort.

        """
        added, efforts = np.zeros((2, len(self._tau)))
        added[self._index] = self.added
        scale = self._of_joint['effort_scale']
        with np.errstate(all='ignore'):
            efforts[self._index] = scale * (self._tau[self._index] + self.added)
        values = {
            'position': self._last_q,
            'velocity': self._last_qd,
            'acceleration': self._qdd,
            'added effort': added,
        }
        name, joint = _largest(values)
        if abs(values[name][joint]) <= _PLAUSIBLE:
            values = {'computed effort': efforts}
            name, joint = _largest(values)
        joint_name = self.dynamics.robot.joint_names[joint]
        return f"the {name} of joint '{joint_name}' is {values[name][joint]:.4g}"

    def _is_far(self, state: State, reference: Reference) -> bool:
        """Return whether the reference is too far from the joints, or has jumped too far."""
        limit = self.settings.max_tracking_error
        is_held = self.settings.mode is Mode.JOINT_IMPEDANCE
        is_closed = is_held or self.settings.mode is Mode.COMPUTED_TORQUE
        if not limit or not is_closed or reference.positions is None:
            return False
        start = self.equilibrium if is_held else self._followed
        if start is None:
            start = state.q[self._index]
        return bool(np.abs(self.distance(start, reference.positions)).max() > limit)

    def _smooth(self, now: float, state: State) -> Floats:
        """Filter the measured velocities."""
        if not self._velocity_filter.cutoff:
            return state.qd
        # The filter of a late joint restarts, because the joint is assumed to be at rest.
        is_late = now - state.times > self._timeouts
        return self._velocity_filter.update(state.times, state.qd, self._timeouts, is_late)

    def _efforts(self, q: Floats, qd: Floats, reference: Reference | None) -> Floats | None:
        mode = self.settings.mode
        is_guided = mode is Mode.GRAVITY_COMPENSATION
        self.velocities = self._rest if is_guided else qd
        if reference is None:
            self._qdd[self._index], self.added = 0.0, self._no_efforts
        else:
            qdd = reference.accelerations
            if mode is Mode.COMPUTED_TORQUE:
                qdd = self._with_feedback(q, qd, reference)
            self._qdd[self._index] = qdd
            self.added = reference.efforts
        if mode is Mode.JOINT_IMPEDANCE:
            self.added = self.added + self._impedance(q, qd, reference)
        try:
            if is_guided:
                self.added = self._guidance(q, qd)
            self.dynamics.efforts(q, self.velocities, self._qdd, out=self._tau)
        except JointStateError:
            return None
        return self._tau

    def _with_feedback(self, q: Floats, qd: Floats, reference: Reference) -> Floats:
        """Add feedback to the accelerations of the reference."""
        qdd = reference.accelerations
        with np.errstate(all='ignore'):
            if reference.positions is not None:
                distance = self.distance(q[self._index], reference.positions)
                qdd = qdd + self._of_joint['kp'] * distance
            velocities: Floats | float | None = reference.velocities
            if velocities is None and reference.positions is not None:
                velocities = 0.0  # without damping the arm would swing forever
            if velocities is not None:
                qdd = qdd + self._of_joint['kd'] * (velocities - qd[self._index])
        return qdd

    def _impedance(self, q: Floats, qd: Floats, reference: Reference | None) -> Floats:
        """Return the efforts of the springs and dampers, shape (m,) [N m or N]."""
        velocities: Floats | float | None = reference.velocities if reference else None
        if velocities is None:
            velocities = 0.0
        q, qd = q[self._index], qd[self._index]
        equilibrium = q if self.equilibrium is None else self.equilibrium
        with np.errstate(all='ignore'):
            spring = self._of_joint['stiffness'] * self.distance(q, equilibrium)
            damper = self._of_joint['impedance_damping'] * (velocities - qd)
            efforts: Floats = spring + damper
        return efforts

    def _guidance(self, q: Floats, qd: Floats) -> Floats:
        """Return friction compensation minus guiding damping, shape (m,) [N m or N]."""
        efforts = self._no_efforts
        with np.errstate(all='ignore'):
            if self.dynamics.has_drive_terms:
                friction = self.dynamics.effort_terms(q, qd, self._rest).friction
                efforts = self._of_joint['friction_scale'] * friction[self._index]
            if self._has_guiding_damping:
                efforts = efforts - self._of_joint['guiding_damping'] * qd[self._index]
        return efforts


class DriveReference:
    """
    Computes positions and velocities to send with the efforts.

    A drive with its own gains adds ``kp (q_command - q) + kd (qd_command - qd)`` to the effort.
    While ``law`` follows a reference, the drive receives this reference. Otherwise, the drive
    receives the measured motion, so that the gains add nothing. One replaces the other gradually,
    because the gains of the drive are unknown, and may carry a part of the weight of the arm.

    """

    def __init__(self, law: ControlLaw) -> None:
        self._law = law
        self.weight = 0.0
        """Weight of the reference, from 0 to 1; the measured motion has the remaining weight."""
        self._positions: Floats = np.zeros(0)
        self._velocities: Floats = np.zeros(0)

    def motion(
        self,
        q: Floats,
        qd: Floats,
        elapsed: float,
        ramps: tuple[float, float],
        farthest: float,
        *,
        is_computing: bool,
    ) -> tuple[Floats, Floats]:
        """
        Return positions [rad or m] and velocities [rad/s or m/s] to send, shape (m,).

        ``q`` and ``qd`` are the measured motion of the commanded joints, shape (m,). The weight of
        the reference rises within the first of the two ``ramps`` and falls within the second [s].
        ``elapsed`` is the time step of ramps [s]; see `RampClock`. A reference is not sent if any
        joint is farther than ``farthest`` [rad or m] from it, or if it jumps farther; 0 means any
        distance. Unless ``is_computing``, the drive is led to rest at the measured positions.

        """
        reference = self._law.followed if is_computing else None
        if not is_computing:
            qd = np.zeros_like(qd)
        if reference is not None and self._accepts(q, reference, farthest):
            self.weight = min(1.0, self.weight + ramp_fraction(elapsed, ramps[0]))
            rest = qd if reference.positions is None else np.zeros_like(qd)
            self._positions = q.copy() if reference.positions is None else reference.positions
            self._velocities = rest if reference.velocities is None else reference.velocities
        else:
            self.weight = max(0.0, self.weight - ramp_fraction(elapsed, ramps[1]))
        if not self.weight:
            return q, qd
        distance = self._law.distance(q, self._positions)
        return q + self.weight * distance, qd + self.weight * (self._velocities - qd)

    def _accepts(self, q: Floats, reference: Reference, farthest: float) -> bool:
        if reference.positions is None or not farthest:
            return True
        starts = [q, self._positions] if self.weight else [q]
        return all(
            np.abs(self._law.distance(start, reference.positions)).max() <= farthest
            for start in starts
        )


def shorter_way(distance: Floats, is_continuous: Booleans) -> Floats:
    """Remove the full turns of continuous joints from distances, shape (m,) [rad or m]."""
    turns = np.round(distance / (2.0 * math.pi))
    return np.where(is_continuous, distance - 2.0 * math.pi * turns, distance)


def _compact_index(index: list[int]) -> Any:
    """Return consecutive indices as a slice, which is faster, and other indices as an array."""
    first = index[0]
    if index == list(range(first, first + len(index))):
        return slice(first, first + len(index))
    return np.array(index)


def joint_index(joints: Sequence[str], robot: RobotModel) -> list[int]:
    """Return the indices of joints in the robot; raise a ConfigurationError for invalid names."""
    if not joints:
        raise ConfigurationError(f"robot '{robot.name}' has no movable joints")
    if len(set(joints)) != len(joints):
        raise ConfigurationError(f'parameter joints lists a joint twice: {", ".join(joints)}')
    unknown = [name for name in joints if name not in robot.joint_names]
    if unknown:
        raise ConfigurationError(
            f"parameter joints lists '{unknown[0]}', expected only movable joints of robot "
            f"'{robot.name}' that mimic no other joint: {', '.join(robot.joint_names)}"
        )
    return robot.joint_indices(joints)


def _largest(arrays: Mapping[str, Floats]) -> tuple[str, int]:
    """Return the array name and the index of the largest magnitude; NaN is treated as infinite."""
    sizes = np.nan_to_num(np.abs(list(arrays.values())), nan=math.inf, posinf=math.inf)
    row, joint = np.unravel_index(np.argmax(sizes), sizes.shape)
    return list(arrays)[int(row)], int(joint)
