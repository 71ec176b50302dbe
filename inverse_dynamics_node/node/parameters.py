"""
The parameters of the node.

Each parameter is a field of `Configuration` or of its base classes in control/settings.py. The
ROS parameters, ``--help``, config/inverse_dynamics.yaml and the table in doc/interface.md are
generated from these fields. After a change of a field, run `make parameters`.
"""

# ruff: noqa: RUF009 -- parameter() returns a dataclasses.field

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import Enum
import math
from typing import get_type_hints

from ..control.settings import (
    LARGEST_GRAVITY,
    MeasuredGravity,
    PerJoint,
    Settings,
)
from ..dynamics.inverse_dynamics import FRICTION_WIDTH, STANDARD_GRAVITY
from .parameter_types import kind_of, NUMBER, Parameter, parameter

VALUE_OF_URDF = -1.0
"""Value of `damping` or `coulomb` that stands for the value in the robot description."""


PRIORITY = 50
"""Value for which 0 stands in `thread_priority`; ros2_control_node has the same."""


class BaseMotion(Enum):
    """How the motion of the base is known."""

    FIXED = 'fixed'
    IMU = 'imu'
    """An inertial measurement unit measures the motion of the base."""


@dataclass(frozen=True, kw_only=True)
class Configuration(Settings):
    """The checked values of all parameters."""

    robot_description: str = parameter(
        '',
        'The URDF, as XML text',
        'If empty, the URDF comes from `robot_description_file`; if that is empty too, from the '
        'topic',
        is_live=False,
    )
    robot_description_file: str = parameter(
        '',
        'URDF or xacro file: a path, `package://PACKAGE/PATH` or `file:///PATH`',
        'The name of a xacro file must end in `.xacro`; arguments `name:=value` may follow. The '
        'parameter cannot be changed at run time, because the file may contain code that xacro '
        'evaluates, and a message on the topic is never taken as a file name',
        is_live=False,
        is_read_only=True,
    )
    joints: tuple[str, ...] = parameter(
        [''],
        'The joints to command, in the order of `~/commands` and `~/desired_accelerations`',
        'If empty, all movable joints are commanded, in the order of the URDF. The dynamics '
        'always include all joints',
        is_live=False,
    )
    base_link: str = parameter(
        '',
        'Link in whose frame gravity and `imu` are expressed. Empty: root link',
        'No movable joint may lie between this link and the root link',
        is_live=False,
    )
    tool_link: str = parameter(
        '',
        'Link of `~/tool_wrench`. Empty: that of `inverse_dynamics check`',
        'By default, the last link of the longest chain, or a link fixed to it whose name is that '
        'of a tool',
        is_live=False,
    )
    update_rate: float = parameter(
        0.0,
        'Commands per second. 0: one command for every joint state',
        unit='Hz',
        minimum=1.0,
        maximum=10_000.0,
        special=0.0,
        is_live=False,
    )
    dry_run: bool = parameter(
        False,
        'Compute, check and publish everything, but send no `~/commands`',
        'When a dry run starts, the commands fall to zero within `stop_ramp`, zeros follow for '
        '0.5 s, and then nothing is sent. When a dry run ends, the commands rise within '
        '`start_ramp`',
        default_note='false; true in the launch file',
    )
    ignore_controller_joints: bool = parameter(
        False,
        'Send commands even if the controller says that it commands other joints',
        'By default, no commands begin while a controller of ros2_control that receives them has '
        'other `joints`, or the same in another order',
    )
    autostart: bool = parameter(
        True,
        'Configure and activate once, as soon as there is a robot description',
        is_live=False,
        is_read_only=True,
    )
    thread_priority: int = parameter(
        0,
        f'`SCHED_FIFO` priority of the control loop and the middleware. 0: {PRIORITY}, if the '
        'machine permits it',
        'Without permission, the threads keep normal priority. The diagnostics then warn only if '
        'a priority is given',
        minimum=0,
        maximum=99,
        is_live=False,
        is_read_only=True,
    )
    allow_unknown_parameters: bool = parameter(
        False,
        'Ignore unknown parameters, for example in a file that several nodes share',
        'By default, the node does not start with unknown parameters, because a limit with a '
        'mistyped name would have no effect',
        is_live=False,
        is_read_only=True,
    )
    gravity: tuple[float, float, float] = parameter(
        list(STANDARD_GRAVITY),
        'Free-fall acceleration in the frame of the base link. Messages on `~/gravity` replace it',
        unit='m/s^2',
        minimum=-LARGEST_GRAVITY,
        maximum=LARGEST_GRAVITY,
    )
    base_motion: BaseMotion = parameter(
        BaseMotion.FIXED.value,
        'How the motion of the base is known',
        '`fixed`: the base is at rest, and the parameter `gravity` applies. `imu`: messages on '
        'the topic `imu` replace `gravity`, and nothing is commanded before the first message',
        is_live=False,
    )
    imu_orientation: tuple[float, float, float] = parameter(
        [0.0, 0.0, 0.0],
        'Roll, pitch and yaw of the IMU in the frame of the base link, as in a URDF',
        unit='rad',
        minimum=-7.0,
        maximum=7.0,
        is_live=False,
    )
    include_gravity: bool = parameter(
        True,
        'Set to false if the driver compensates gravity itself, as for UR, Franka and KUKA FRI',
    )
    measured_gravity: MeasuredGravity = parameter(
        MeasuredGravity.AS_COMMANDED.value,
        'Whether the measured efforts contain gravity',
        '`as_commanded`: yes if `include_gravity` is true. Franka and KUKA FRI add gravity to the '
        'commands, and their measured efforts contain gravity: choose `included` here, and set '
        '`include_gravity` to false. The choice affects `~/external_efforts`, '
        '`inverse_dynamics watch` and `compare`, but not the commands',
    )
    measured_effort_scale: PerJoint = parameter(
        1.0,
        'Factor that converts the measured efforts to N m or N',
        'If the driver reports currents, give the effort per ampere of each joint. If the driver '
        'reports efforts with the opposite sign, give a negative number',
    )
    include_friction: bool = parameter(
        False,
        'Add the efforts that overcome friction',
        'The added efforts are `damping` * qd + (`coulomb` + `load_friction` * |load|) * '
        'tanh(qd / `coulomb_width`); `load_friction` describes the load. In mode '
        '`gravity_compensation`, only the share `friction_scale` is added',
    )
    damping: PerJoint = parameter(
        VALUE_OF_URDF,
        'Viscous friction of the commanded joints. -1: value in the URDF',
        unit='N m s/rad, N s/m',
        minimum=0.0,
        special=VALUE_OF_URDF,
    )
    coulomb: PerJoint = parameter(
        VALUE_OF_URDF,
        'Coulomb friction of the commanded joints. -1: value in the URDF',
        unit='N m, N',
        minimum=0.0,
        special=VALUE_OF_URDF,
    )
    coulomb_width: PerJoint = parameter(
        FRICTION_WIDTH,
        'Speed below which Coulomb friction is smoothed',
        unit='rad/s, m/s',
        minimum=1e-6,
        maximum=100.0,
    )
    load_friction: PerJoint = parameter(
        0.0,
        'Coulomb friction per unit of load on the gear, in addition to `coulomb`: 0.05 adds 5 % '
        'of the load',
        'The load is the effort that moves and holds the links, including payloads, springs and '
        'external wrenches. `armature` and friction act on the motor side and are not part of '
        'the load',
        minimum=0.0,
        maximum=10.0,
    )
    armature: PerJoint = parameter(
        0.0,
        'Inertia of rotors and gears, reflected to the commanded joints',
        unit='kg m^2, kg',
        minimum=0.0,
    )
    drive_coupling: PerJoint = parameter(
        0.0,
        'Turns of the drive of a joint per turn of the previous joint, as in coupled wrists',
        'Friction and `armature` are computed from the motion of the drive, and act on this joint '
        'and the previous joint. Must be 0 for a joint attached to the base link',
        minimum=-100.0,
        maximum=100.0,
    )
    spring_stiffness: PerJoint = parameter(
        0.0,
        'Stiffness of a spring or counterweight at each commanded joint',
        'The model includes this spring even if `include_gravity` is false. For the virtual '
        'springs of `joint_impedance`, set `stiffness` instead. If the robot has no real spring, '
        'the commands push the joint away from `spring_rest`. Must be 0 for a continuous joint',
        unit='N m/rad, N/m',
    )
    spring_rest: PerJoint = parameter(
        0.0,
        'Joint position at which the spring of `spring_stiffness` exerts no effort',
        unit='rad, m',
    )
    locked_positions: dict[str, float] = field(default_factory=dict)
    """Positions [rad or m] of uncommanded joints by name, used until joint states arrive."""

    @property
    def period(self) -> float:
        """Time between commands [s]; 0 means one command for every joint state."""
        return 1.0 / self.update_rate if self.update_rate else 0.0


LOCKED = 'locked_positions'
"""Prefix of the parameters ``locked_positions.<joint>``."""
LOCKED_POSITION = Parameter(
    NUMBER,
    None,
    'Position assumed for a joint that is not commanded, until `joint_states` reports it',
    'A joint with this parameter never counts as missing or lost',
    unit='rad, m',
    minimum=-math.inf,
    maximum=math.inf,
    is_live=False,
)
_HINTS = get_type_hints(Configuration)
_OF_CORE = {each.name for each in fields(Settings)}
PARAMETERS = {
    each.name: Parameter(kind_of(_HINTS[each.name]), **each.metadata)
    # Parameters of the robot and the process come first, then those of the control loop.
    for each in sorted(fields(Configuration), key=lambda each: each.name in _OF_CORE)
    if each.metadata
}
"""All parameters by name, except ``locked_positions.<joint>``."""
