"""
Settings of the control loop.

Each setting is also a parameter of the node, and is declared only once.
"""

# ruff: noqa: RUF009 -- setting() returns a dataclasses.field

from __future__ import annotations

from dataclasses import dataclass, field, fields
import enum
import math
from typing import Any

import numpy as np

from ..errors import ConfigurationError
from ..robot.model import Floats


class Mode(enum.Enum):
    """How the reference is used."""

    INVERSE_DYNAMICS = 'inverse_dynamics'
    """Use the accelerations of the reference."""
    COMPUTED_TORQUE = 'computed_torque'
    """Use the accelerations of the reference, plus feedback of positions and velocities."""
    GRAVITY_COMPENSATION = 'gravity_compensation'
    """For hand guiding: ignore the reference, and use zero accelerations and velocities."""
    JOINT_IMPEDANCE = 'joint_impedance'
    """Use the accelerations of the reference; add springs and dampers towards the reference."""


class MeasuredGravity(enum.Enum):
    """Whether the efforts that the driver measures contain gravity."""

    AS_COMMANDED = 'as_commanded'
    """The measured efforts contain gravity if the commands contain gravity."""
    INCLUDED = 'included'
    EXCLUDED = 'excluded'

    def is_included(self, in_commands: bool) -> bool:
        """
        Return whether measured efforts contain gravity.

        ``in_commands`` says whether the commands contain gravity.

        """
        if self is MeasuredGravity.AS_COMMANDED:
            return in_commands
        return self is MeasuredGravity.INCLUDED


class StalePolicy(enum.Enum):
    """How the efforts change when the joint state is lost."""

    ZERO = 'zero'
    """Ramp the efforts down to zero."""
    HOLD = 'hold'
    """Keep the last efforts; for arms that have reliable sensors and would otherwise fall."""


class ContactPolicy(enum.Enum):
    """What the arm does after a contact."""

    FLOAT = 'float'
    """Float as in `Mode.GRAVITY_COMPENSATION`, until the node is enabled."""
    STOP = 'stop'
    """Let the efforts fall to zero, as when the node is disabled."""


PerJoint = float | tuple[float, ...]
"""One number for all commanded joints, or one for each."""


def setting(default: Any, summary: str, details: str = '', **properties: Any) -> Any:
    """
    Declare a setting that is also a parameter of the node.

    If ``default`` is infinite, the default of the parameter is 0, which means unlimited. The other
    arguments are those of `Parameter` in node/parameter_types.py.

    """
    given = default.value if isinstance(default, enum.Enum) else default
    given = 0.0 if given == math.inf else given
    declaration = {'default': given, 'summary': summary, 'details': details, **properties}
    return field(default=default, metadata=declaration)


@dataclass(frozen=True)
class Settings:
    """How the control loop treats its inputs and outputs."""

    mode: Mode = setting(
        Mode.INVERSE_DYNAMICS,
        'How the reference is used',
        '`inverse_dynamics` uses the accelerations of the reference. `computed_torque` adds '
        'feedback of position and velocity. `gravity_compensation` ignores the reference: the '
        'arm floats and can be guided by hand. In `joint_impedance`, a spring and a damper hold '
        'each joint at the reference, or at its position if there is no reference',
    )
    kp: PerJoint = setting(100.0, 'Position gain of `computed_torque`', unit='1/s^2', minimum=0.0)
    kd: PerJoint = setting(20.0, 'Velocity gain of `computed_torque`', unit='1/s', minimum=0.0)
    stiffness: PerJoint = setting(
        10.0, 'Stiffness of the springs of `joint_impedance`', unit='N m/rad, N/m', minimum=0.0
    )
    impedance_damping: PerJoint = setting(
        1.0, 'Damping of `joint_impedance`', unit='N m s/rad, N s/m', minimum=0.0
    )
    friction_scale: PerJoint = setting(
        0.5,
        'Share of the friction that `gravity_compensation` compensates',
        'Needs `include_friction`; uses measured velocities. Other modes compensate all friction. '
        'With 0.5, the arm does not drive itself unless the friction is given as more than twice '
        'its value',
        minimum=0.0,
        maximum=1.0,
    )
    guiding_damping: PerJoint = setting(
        0.0,
        'Viscous damping that opposes motion in mode `gravity_compensation`',
        unit='N m s/rad, N s/m',
        minimum=0.0,
    )
    max_tracking_error: float = setting(
        0.5,
        'Largest distance between the arm and its reference in `computed_torque` and '
        '`joint_impedance`. 0: unlimited',
        'A reference that begins or jumps farther away from the last one, from the measured '
        'position or from the position that `joint_impedance` holds is not followed. An arm that '
        'falls farther behind the reference that it follows is stopped',
        unit='rad, m',
        minimum=0.0,
    )
    effort_reach: float = setting(
        0.0,
        'Distance from the reference beyond which `computed_torque` adds no efforts of the '
        'reference. 0: unlimited',
        'The effort of a joint ends when the joint is farther than this from the positions of the '
        'reference, in the direction of the effort. `inverse_dynamics probe` uses this',
        unit='rad, m',
        minimum=0.0,
    )
    velocity_filter_cutoff: float = setting(
        0.0,
        'Cutoff of the first-order low-pass for measured velocities. 0: no filter',
        unit='Hz',
        minimum=0.0,
    )
    effort_scale: PerJoint = setting(1.0, 'Factor that multiplies the efforts')
    use_urdf_effort_limits: bool = setting(
        True, 'Keep efforts within `<limit effort>` of the URDF'
    )
    effort_limits: PerJoint = setting(
        math.inf,
        'Effort limits in addition to those of the URDF. 0: none',
        'After a limit is lowered, efforts beyond the limit fall to it within `start_ramp`',
        unit='N m, N',
        minimum=0.0,
        is_unlimited_at_zero=True,
    )
    effort_rate_limits: PerJoint = setting(
        math.inf,
        'Largest rate of change of the efforts, except during the stop ramp. 0: unlimited',
        unit='N m/s, N/s',
        minimum=0.0,
        is_unlimited_at_zero=True,
    )
    state_timeout: float = setting(
        0.1,
        'Age after which the state of a commanded joint counts as lost',
        unit='s',
        minimum=0.005,
        maximum=60.0,
    )
    velocity_limits: PerJoint = setting(
        -1.0,
        'Speed limits of the commanded joints. -1: value in the URDF, 0: none',
        'Beyond its limit, no effort acts in the direction in which a joint moves. A joint that '
        'follows a reference beyond its limit stops the arm, as does any joint at twice the limit '
        'that applies',
        unit='rad/s, m/s',
        minimum=0.0,
        special=-1.0,
    )
    guiding_speed: float = setting(
        0.5,
        'Fraction of the speed limits that applies while the arm follows no reference',
        'The arm then floats, holds its position or is guided by hand. At twice this fraction, '
        'the arm is stopped',
        minimum=0.05,
        maximum=1.0,
    )
    limit_margin: PerJoint = setting(
        0.1,
        'Distance from a position limit at which the spring of `limit_stiffness` begins',
        unit='rad, m',
        minimum=0.0,
    )
    limit_stiffness: PerJoint = setting(
        0.0,
        'Stiffness of a spring that pushes a joint away from its position limits. 0: no spring',
        'The spring acts in every mode, and is damped. It never pulls towards the limit',
        unit='N m/rad, N/m',
        minimum=0.0,
    )
    contact_limits: PerJoint = setting(
        math.inf,
        'Largest external effort of a joint; a larger one for 0.15 s is a contact. 0: unlimited',
        'Needs measured efforts, and a model with friction: see `~/external_efforts`. After a '
        'contact, no reference and no trajectory is followed until `~/enable` with true. This is '
        'not a safety function',
        unit='N m, N',
        minimum=0.0,
        is_unlimited_at_zero=True,
    )
    on_contact: ContactPolicy = setting(
        ContactPolicy.FLOAT,
        'What the arm does after a contact',
        '`float`: as in `gravity_compensation`. `stop`: ramp to zero, as `~/enable` false does',
    )
    reference_timeout: float = setting(
        0.5,
        'Age after which a reference is ignored. 0: a reference is used until the next one',
        'Without a reference, the accelerations are taken as zero',
        unit='s',
        minimum=0.0,
        maximum=3600.0,
    )
    on_stale_state: StalePolicy = setting(
        StalePolicy.ZERO,
        'Efforts after a loss of the joint state',
        '`zero`: ramp to zero within `stop_ramp`. `hold`: keep the last efforts',
    )
    start_ramp: float = setting(
        0.5,
        'Time for the efforts to rise from zero, and to blend after a live change of parameters',
        unit='s',
        minimum=0.0,
        maximum=60.0,
    )
    stop_ramp: float = setting(
        0.5,
        'Time for the efforts to fall to zero',
        'A change does not affect a ramp in progress. `ros2 launch` ends the ramp after 5 s, '
        'unless the launch file sets `sigterm_timeout`',
        unit='s',
        minimum=0.0,
        maximum=60.0,
    )
    stop_damping: float = setting(
        0.0,
        'Rate at which the motion decays during a stop, for an arm without brakes. 0: no damping',
        'With a larger rate, the arm sinks more slowly. With 50, an arm of usual proportions '
        'sinks at 0.3 m/s. A change applies from the next stop on',
        unit='1/s',
        minimum=0.0,
        maximum=200.0,
    )

    wrench_timeout: float = setting(
        0.1,
        'Time without a new message after which an external wrench ends',
        unit='s',
        minimum=0.0,
        maximum=60.0,
    )

    def expanded(self, m: int) -> dict[str, Floats]:
        """
        Return each setting of type `PerJoint` as an array of shape (m,), by name.

        If a setting has neither one value nor m values, a ConfigurationError is raised.

        """
        arrays: dict[str, Floats] = {}
        for name in (each.name for each in fields(self) if each.type == 'PerJoint'):
            values = getattr(self, name)
            if np.size(values) not in (1, m):
                raise ConfigurationError(
                    f'{name} has {np.size(values)} numbers, expected one, or one for each of {m} '
                    'joints'
                )
            arrays[name] = np.full(m, values, dtype=np.float64)
        return arrays


LARGEST_GRAVITY = 100.0
"""Largest accepted component of gravity [m/s^2], about ten times the gravity of the earth."""
