"""Causes of differences between measured and modelled efforts, for `compare` and `watch`."""

from __future__ import annotations

import enum
from typing import NamedTuple

SAME_FACTOR = 1.1  # factors with a smaller ratio are regarded as equal


class FaultKind(enum.Enum):
    """A cause of a difference between measured and modelled efforts."""

    SIGN = 'sign'
    SCALE = 'scale'
    """The efforts of some joints are in another unit, or are motor currents."""
    POSITIONS = 'positions'
    """The positions are in another unit, such as degrees."""
    REVERSED_AXIS = 'reversed_axis'
    """Position, velocity and effort of a joint have the opposite sign."""
    DELAY = 'delay'
    """The efforts are delayed relative to the positions."""
    UNIT = 'unit'
    """The efforts of all joints are in the same wrong unit."""
    ORDER = 'order'
    """The efforts of some joints are recorded under the names of other joints."""
    NOT_MEASURED = 'not_measured'
    """The measured effort never changes, although the modelled effort does."""
    OFFSET = 'offset'
    ROTOR_INERTIA = 'rotor_inertia'
    GRAVITY_COMPENSATED = 'gravity_compensated'
    """The measured efforts lack gravity."""
    GRAVITY_MEASURED = 'gravity_measured'
    """The measured efforts contain gravity, although the driver should exclude gravity."""
    MOUNTING = 'mounting'
    """The direction of gravity differs from that of the model."""
    PAYLOAD = 'payload'
    BODIES = 'bodies'
    """The masses of several links are wrong."""
    EXTERNAL_FORCE = 'external_force'
    UNEXPLAINED = 'unexplained'


class GravityConvention(NamedTuple):
    """Which efforts contain gravity, according to the parameters of the node."""

    in_commands: bool = True
    in_measured: bool = True


WITH_GRAVITY = GravityConvention()


class Change(NamedTuple):
    """RMS residual of one joint, with fitted friction, before and after correction of a fault."""

    joint: str
    is_prismatic: bool
    before: float
    """RMS residual without the correction, in the unit of the recording [N m or N]."""
    after: float
    """RMS residual with the correction, in the unit of the recording [N m or N]."""
    measured: float
    """RMS of the measured effort, in the unit of the recording [N m or N]."""


class Fault(NamedTuple):
    """One explanation of a difference between measured and modelled efforts."""

    kind: FaultKind
    joints: tuple[str, ...] = ()
    """Joints with the fault; empty if the fault concerns the whole robot."""
    values: tuple[float, ...] = ()
    """
    For a fault of joints: a factor, a rotor inertia [kg m^2 or kg] or an effort [N m or N] of each
    joint. For a payload: mass [kg] and centre of mass [m]; unknown coordinates are NaN. For a
    mounting: gravity in the frame of the base link [m/s^2]. For a delay: one time [s].
    """
    changes: tuple[Change, ...] = ()
    """Joints whose residuals the correction reduces; the largest reduction comes first."""
    error: float = 0.0
    """Standard error of the mass of a payload [kg]."""
    angle: float = 0.0
    """Angle between the actual mounting and the mounting in the model [rad]."""
    link: str = ''
    """Link that carries the payload."""
    sources: tuple[str, ...] = ()
    """Names under which the efforts of ``joints`` were recorded, if the order is wrong."""
    unknown: tuple[str, ...] = ()
    """Joints whose unit of effort is unknown because friction dominates."""
    is_every_joint: bool = False
    """Whether all joints have the fault; joints that show only friction are ignored."""
    is_motor_side: bool = False
    """Whether the efforts contain the friction of the gears, as motor currents do."""
    is_commanded: bool = True
    """Whether commanded efforts contain gravity."""
    interval: tuple[float, float] | None = None
    """Start and end of a temporary fault [s]; None for a permanent fault."""

    @property
    def is_same_factor(self) -> bool:
        """Whether the factors are nearly equal, as if all efforts had the same unit."""
        return max(self.values) < SAME_FACTOR * min(self.values)
