"""Computes efforts from joint states and references; each mode has a law of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import ConfigurationError, JointStateError
from ..robot.kinematics import whole_turns
from ..robot.model import Booleans, Floats, RobotModel
from .filters import LowPass
from .joint_states import LATE_AFTER, State
from .settings import Mode, Settings


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


class Law:
    """
    Computes the efforts of the accelerations that a reference requests.

    This is the law of the mode ``inverse_dynamics``, and the base class of the other laws. A
    subclass changes the velocities, the accelerations and the efforts to add in `_inputs`.

    The dynamics include all n joints of the robot. Uncommanded joints are assumed to have zero
    acceleration. ``index`` contains the indices of the m commanded joints among the n joints.

    """

    uses_reference = True
    """Whether references are followed at all."""
    is_closed = False
    """Whether a reference is followed with feedback of the positions."""
    holds = False
    """Whether the arm holds its position without a reference."""
    gains: tuple[str, str] | None = None
    """Settings with the gains of the velocities and of the positions, if there is feedback."""

    def __init__(self, dynamics: InverseDynamics, index: list[int]) -> None:
        self.dynamics = dynamics
        self._index = _compact_index(index)
        self._is_continuous = dynamics.robot.is_continuous[self._index]
        self._has_turns = bool(self._is_continuous.any())
        n = len(dynamics.robot.joint_names)
        self._qdd, self._tau, self._rest = np.zeros((3, n))
        self.velocities: Floats = self._rest
        """Velocities that produced the last efforts, shape (n,) [rad/s or m/s]."""
        self._no_efforts = self.added = np.zeros(len(index))
        """Efforts to add to the computed efforts, shape (m,) [N m or N]."""
        self.equilibrium: Floats | None = None
        """Positions from which the next reference must not be far, shape (m,) [rad or m]."""
        self._last_q, self._last_qd = np.zeros((2, n))
        self._last_reference: Reference | None = None
        self._has_last_inputs = False  # whether the inputs above produced the last command
        self._velocity_filter = LowPass(np.zeros(n))

    def apply(self, settings: Settings, of_joint: Mapping[str, Floats]) -> None:
        """Change the settings; ``of_joint`` is the result of `Settings.expanded`."""
        self._of_joint = of_joint
        self._timeouts = np.full(len(self._qdd), LATE_AFTER)
        self._timeouts[self._index] = settings.state_timeout
        self._velocity_filter.cutoff = settings.velocity_filter_cutoff

    def reset(self) -> None:
        """Forget the inputs of the last command, and restart the velocity filter."""
        self._velocity_filter.reset()
        self.forget()

    def efforts(self, now: float, state: State, reference: Reference | None) -> Floats | None:
        """
        Compute the efforts of all joints, shape (n,) [N m or N]; return None if one is not finite.

        Without a reference, all accelerations are zero. The result does not include `added`, and
        is valid until the next call. ``now`` is the time [s].

        """
        qd = self._smooth(now, state)
        self._lead(state, reference)
        # Copy the state, because the next message overwrites its arrays.
        self._last_q[:], self._last_qd[:] = state.q, qd
        self._last_reference, self._has_last_inputs = reference, True
        return self._efforts(state.q, qd, reference)

    def forget(self) -> None:
        """Record that this law did not compute the last command."""
        self._has_last_inputs = False

    def release(self) -> None:
        """Forget the position that the law holds, because the arm may have moved away."""

    def last_efforts(self) -> Floats | None:
        """Recompute efforts from the inputs of the last command; None if no inputs are stored."""
        if not self._has_last_inputs:
            return None
        return self._efforts(self._last_q, self._last_qd, self._last_reference)

    @property
    def followed(self) -> Reference | None:
        """The reference that the last command followed, if any."""
        return self._last_reference if self._has_last_inputs else None

    def unstable_gains(self, q: Floats, delay: float) -> tuple[Booleans, Floats]:
        """
        Return which joints may oscillate if velocities are late by ``delay`` [s], shape (m,).

        A delay T makes damping unstable if it exceeds about I / T, and stiffness if it exceeds
        about I / T^2. The second result is I, shape (m,): the inertia of each joint [kg m^2 or
        kg], or 1 if the law multiplies gains by it.

        """
        assert self.gains is not None
        inertia = np.ones(len(self._no_efforts))
        if self.holds:
            inertia = self.dynamics.mass_matrix(q).diagonal()[self._index]
        damping, stiffness = (self._of_joint[name] for name in self.gains)
        return (delay * damping > inertia) | (delay**2 * stiffness > inertia), inertia

    def measured(self, state: State) -> Floats:
        """Return the positions of the commanded joints, shape (m,) [rad or m]."""
        positions: Floats = state.q[self._index]
        return positions

    def distance(self, start: Floats, target: Floats) -> Floats:
        """Return target minus start, shape (m,); continuous joints take the shorter way."""
        way: Floats = target - start
        if self._has_turns:
            way = way - whole_turns(way, self._is_continuous)
        return way

    def _smooth(self, now: float, state: State) -> Floats:
        """Filter the measured velocities."""
        if not self._velocity_filter.cutoff:
            return state.qd
        # The filter of a late joint restarts, because the joint is assumed to be at rest.
        is_late = now - state.times > self._timeouts
        return self._velocity_filter.update(state.times, state.qd, self._timeouts, is_late)

    def _lead(self, state: State, reference: Reference | None) -> None:
        """Set the equilibrium for this state and reference."""

    def _efforts(self, q: Floats, qd: Floats, reference: Reference | None) -> Floats | None:
        try:
            inputs = self._inputs(q, qd, reference)
            self.velocities, self._qdd[self._index], self.added = inputs
            self.dynamics.efforts(q, self.velocities, self._qdd, out=self._tau)
        except JointStateError:
            return None
        return self._tau

    def _inputs(
        self, q: Floats, qd: Floats, reference: Reference | None
    ) -> tuple[Floats, Floats | float, Floats]:
        """Return velocities (n,), accelerations (m,) and efforts to add (m,)."""
        if reference is None:
            return qd, 0.0, self._no_efforts
        return qd, reference.accelerations, reference.efforts


class ComputedTorque(Law):
    """Adds feedback of positions and velocities to the accelerations of the reference."""

    is_closed = True
    gains = 'kd', 'kp'

    def apply(self, settings: Settings, of_joint: Mapping[str, Floats]) -> None:
        """Change the settings; ``of_joint`` is the result of `Settings.expanded`."""
        super().apply(settings, of_joint)
        self._reach = settings.effort_reach

    def forget(self) -> None:
        """Record that this law did not compute the last command."""
        super().forget()
        self.equilibrium = None

    def _lead(self, state: State, reference: Reference | None) -> None:
        self.equilibrium = reference.positions if reference else None

    @np.errstate(all='ignore')
    def _inputs(
        self, q: Floats, qd: Floats, reference: Reference | None
    ) -> tuple[Floats, Floats | float, Floats]:
        if reference is None:
            return super()._inputs(q, qd, reference)
        qdd, positions = reference.accelerations, reference.positions
        velocities: Floats | float | None = reference.velocities
        added = reference.efforts
        if positions is not None:
            distance = self.distance(q[self._index], positions)
            qdd = qdd + self._of_joint['kp'] * distance
            if self._reach:
                added = np.where(-np.sign(added) * distance < self._reach, added, 0.0)
            if velocities is None:
                velocities = 0.0  # without damping the arm would swing forever
        if velocities is not None:
            qdd = qdd + self._of_joint['kd'] * (velocities - qd[self._index])
        return qd, qdd, added


class JointImpedance(Law):
    """
    Adds springs and dampers towards the positions of the reference.

    Without a reference, the springs hold the last positions of the reference, or the positions
    that were measured when the law began or was released.

    """

    is_closed = holds = True
    gains = 'impedance_damping', 'stiffness'

    def release(self) -> None:
        """Forget the position that the law holds, because the arm may have moved away."""
        self.equilibrium = None

    def _lead(self, state: State, reference: Reference | None) -> None:
        if reference is not None and reference.positions is not None:
            self.equilibrium = reference.positions
        elif self.equilibrium is None:
            self.equilibrium = state.q[self._index].copy()

    @np.errstate(all='ignore')
    def _inputs(
        self, q: Floats, qd: Floats, reference: Reference | None
    ) -> tuple[Floats, Floats | float, Floats]:
        _, qdd, added = super()._inputs(q, qd, reference)
        velocities: Floats | float | None = reference.velocities if reference else None
        if velocities is None:
            velocities = 0.0
        start = q[self._index]
        equilibrium = start if self.equilibrium is None else self.equilibrium
        spring = self._of_joint['stiffness'] * self.distance(start, equilibrium)
        damper = self._of_joint['impedance_damping'] * (velocities - qd[self._index])
        return qd, qdd, added + spring + damper


class HandGuiding(Law):
    """
    Ignores the reference, so that the arm can be guided by hand.

    Accelerations and velocities are taken as zero. A share of the friction is compensated, and
    damping is added.

    """

    uses_reference = False

    @np.errstate(all='ignore')
    def _inputs(
        self, q: Floats, qd: Floats, reference: Reference | None
    ) -> tuple[Floats, Floats | float, Floats]:
        added = self._no_efforts
        if self.dynamics.has_drive_terms:
            friction = self.dynamics.effort_terms(q, qd, self._rest).friction
            added = self._of_joint['friction_scale'] * friction[self._index]
        damping = self._of_joint['guiding_damping'] * qd[self._index]
        return self._rest, 0.0, added - damping


LAWS: dict[Mode, type[Law]] = {
    Mode.INVERSE_DYNAMICS: Law,
    Mode.COMPUTED_TORQUE: ComputedTorque,
    Mode.JOINT_IMPEDANCE: JointImpedance,
    Mode.GRAVITY_COMPENSATION: HandGuiding,
}
"""The law of each mode."""


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
    try:
        return robot.joint_indices(joints)
    except ConfigurationError as error:
        raise ConfigurationError(f'parameter joints: {error}') from None
