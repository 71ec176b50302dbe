"""Why measured and modelled efforts differ: the words that `compare` and `watch` share."""

from __future__ import annotations

import enum
from typing import NamedTuple

SAME_FACTOR = 1.1  # factors with a smaller ratio are regarded as equal


class FaultKind(enum.Enum):
    """A cause of a difference between measured and modelled efforts."""

    SIGN = 'sign'
    SCALE = 'scale'
    """The efforts of joints are in another unit, or are motor currents."""
    POSITIONS = 'positions'
    """The positions are in another unit, such as degrees."""
    REVERSED_AXIS = 'reversed_axis'
    """Position, velocity and effort of a joint have the opposite sign."""
    DELAY = 'delay'
    """The efforts are later than the positions."""
    UNIT = 'unit'
    """The efforts of all joints are in the same other unit."""
    ORDER = 'order'
    """The efforts of joints are recorded under each other's names."""
    NOT_MEASURED = 'not_measured'
    """The measured effort never changes, although the modelled one does."""
    OFFSET = 'offset'
    ROTOR_INERTIA = 'rotor_inertia'
    GRAVITY_COMPENSATED = 'gravity_compensated'
    """The measured efforts lack gravity."""
    GRAVITY_MEASURED = 'gravity_measured'
    """They contain it, although the driver is said to leave it out."""
    MOUNTING = 'mounting'
    """Gravity has another direction than in the model."""
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
    """RMS residual of one joint without a fault and with it; friction is fitted in both cases."""

    joint: str
    is_prismatic: bool
    before: float
    """[N m or N], as recorded."""
    after: float
    """[N m or N], as recorded."""
    measured: float
    """RMS of the measured effort [N m or N], as recorded."""


class Fault(NamedTuple):
    """One explanation of a difference between measured and modelled efforts."""

    kind: FaultKind
    joints: tuple[str, ...] = ()
    """Joints whose efforts it explains; empty if it concerns the whole robot."""
    values: tuple[float, ...] = ()
    """
    Factor, inertia [kg m^2, kg] or offset [N m, N] of each joint; mass [kg] and centre of mass [m]
    of a payload, NaN where unknown; gravity in the frame of the base link [m/s^2] of a mounting.
    """
    changes: tuple[Change, ...] = ()
    """Joints whose residual it reduces, the largest reduction first."""
    error: float = 0.0
    """Standard error of the mass of a payload [kg]."""
    angle: float = 0.0
    """Angle of a mounting to that in the model [rad]."""
    link: str = ''
    """Link that carries the payload."""
    sources: tuple[str, ...] = ()
    """Names under which the efforts of ``joints`` were recorded, if in another order."""
    unknown: tuple[str, ...] = ()
    """Joints whose unit is unknown because friction dominates."""
    is_every_joint: bool = False
    """Whether it applies to all joints that show more than friction."""
    is_motor_side: bool = False
    """Whether the efforts contain the friction of the gears, as those of motor currents do."""
    is_commanded: bool = True
    """Whether commands contain the gravity that is compensated or measured."""
    interval: tuple[float, float] | None = None
    """Start and end [s] if it applies to a part of the recording."""

    @property
    def is_same_factor(self) -> bool:
        """Whether all factors are equal, as those of a unit are."""
        return max(self.values) < SAME_FACTOR * min(self.values)
