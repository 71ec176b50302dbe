"""A fault is a cause of a difference between measured and modelled efforts."""

from __future__ import annotations

import enum
from typing import NamedTuple

USUAL_SCALE = (0.5, 2.0)  # factors in this range are errors of a model, not another unit
SAME_FACTOR = 1.1  # factors with a smaller ratio are regarded as equal


def is_usual(factor: float) -> bool:
    """Return whether a factor may be an error of the model, and not another unit."""
    return USUAL_SCALE[0] < factor < USUAL_SCALE[1]


class FaultKind(enum.Enum):
    """A kind of fault."""

    SIGN = 'sign'
    SCALE = 'scale'
    """The efforts of some joints are in a wrong unit, or are motor currents."""
    VELOCITY = 'velocity'
    """The velocities of some joints contradict their positions."""
    VELOCITY_LAG = 'velocity_lag'
    POSITIONS = 'positions'
    """The positions are in a wrong unit, such as degrees."""
    REVERSED_AXIS = 'reversed_axis'
    """Position, velocity and effort of a joint have the wrong sign."""
    DELAY = 'delay'
    """The efforts are delayed relative to the positions."""
    UNIT = 'unit'
    """The efforts of all joints are in the same wrong unit."""
    ORDER = 'order'
    """The efforts of some joints are recorded under the names of other joints."""
    NOT_MEASURED = 'not_measured'
    """The measured effort is constant and contradicts the model."""
    OFFSET = 'offset'
    ROTOR_INERTIA = 'rotor_inertia'
    GRAVITY_COMPENSATED = 'gravity_compensated'
    """The measured efforts unexpectedly contain no gravity."""
    GRAVITY_MEASURED = 'gravity_measured'
    """The measured efforts unexpectedly contain gravity."""
    MOUNTING = 'mounting'
    """The direction of gravity differs from the direction in the model."""
    PAYLOAD = 'payload'
    BODIES = 'bodies'
    """The inertial parameters of several links are wrong."""
    EXTERNAL_FORCE = 'external_force'
    UNEXPLAINED = 'unexplained'


class GravityConvention(NamedTuple):
    """Whether commanded and measured efforts should contain gravity."""

    in_commands: bool = True
    in_measured: bool = True


WITH_GRAVITY = GravityConvention()


class Fault(NamedTuple):
    """A fault with its joints and fitted values."""

    kind: FaultKind
    joints: tuple[str, ...] = ()
    """Joints with the fault. The tuple is empty if the whole robot has the fault."""
    values: tuple[float, ...] = ()
    """
    Fitted values of the fault.

    For wrong signs, scales and units, the values are factors. Offsets and constant efforts are in
    N m or N. Rotor inertias are in kg m^2 or kg. The values of a payload are the mass [kg] and the
    coordinates of the centre of mass [m]. Unknown coordinates are NaN. The values of a mounting
    are the components of gravity in the frame of the base link [m/s^2]. Delays and lags are in
    seconds. The values of velocities are factors: 0 if they are zero during a motion, and NaN if
    they are not proportional to the real velocities.
    """
    error: float = 0.0
    """Standard error of the mass of a payload [kg]."""
    angle: float = 0.0
    """Angle between fitted gravity and the gravity of the model [rad]."""
    link: str = ''
    """Link that carries the payload."""
    sources: tuple[str, ...] = ()
    """For the kind `ORDER`, the names under which the efforts of ``joints`` were recorded."""
    unknown: tuple[str, ...] = ()
    """Joints whose unit is unknown because friction dominates the effort."""
    is_every_joint: bool = False
    """Whether all joints that show more than friction have the fault."""
    is_commanded: bool = True
    """Whether commanded efforts should contain gravity."""
    interval: tuple[float, float] | None = None
    """Start and end of a temporary fault [s], or None for a permanent fault."""

    @property
    def is_same_factor(self) -> bool:
        """Whether the factors of all joints are nearly equal."""
        return max(self.values) < SAME_FACTOR * min(self.values)
