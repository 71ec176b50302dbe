"""The node's parameters: one table, checked before any value is used."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
import math
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np

from ..control.settings import LoadSettings, Mode, PerJoint, Settings, StalePolicy
from ..dynamics.inverse_dynamics import FRICTION_WIDTH, STANDARD_GRAVITY
from ..errors import ConfigurationError, did_you_mean

if TYPE_CHECKING:  # --help prints the parameters without ROS
    from rcl_interfaces.msg import ParameterDescriptor
    from rclpy.node import Node


class BaseMotion(Enum):
    """How the base moves."""

    FIXED = 'fixed'
    IMU = 'imu'
    """As an inertial measurement unit on it says."""


class MissingInertial(Enum):
    """What to do about links that have a shape, but no mass."""

    WARN = 'warn'
    REFUSE = 'refuse'


class Executor(Enum):
    """What spins the node."""

    EVENTS = 'events'
    SINGLE_THREADED = 'single_threaded'


class _Kind(NamedTuple):
    expected: str
    convert: Callable[[Any], Any]
    """Returns the value as the node uses it; raises TypeError or ValueError."""


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError
    return value


def _number(value: Any) -> float:
    """Take 500 for 500.0: on a command line it is what people type."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TypeError
    return float(value)


def _vector(value: Any) -> tuple[float, ...]:
    if isinstance(value, str) or len(value) != 3:
        raise ValueError
    return tuple(_number(x) for x in value)


def _names(value: Any) -> tuple[str, ...]:
    """Take an empty list, which ROS passes on as no value, and one of an empty name, for none."""
    if isinstance(value, str):
        raise TypeError
    return tuple(_text(name) for name in value or () if name)


def _numbers(value: Any) -> PerJoint:
    """Take one number for all joints, or one for each."""
    if isinstance(value, int | float):
        return _number(value)
    if isinstance(value, str) or not len(value):
        raise TypeError
    return tuple(_number(x) for x in value)


def _choice(kind: type[Enum]) -> _Kind:
    return _Kind(f'one of {", ".join(choice.value for choice in kind)}', kind)


_TEXT = _Kind('a text', _text)
_FLAG = _Kind('true or false', _flag)
_NUMBER = _Kind('a finite number', _number)
_VECTOR = _Kind('three finite numbers, all with a decimal point or all without', _vector)
_NUMBERS = _Kind('a finite number, or a list of one for each commanded joint', _numbers)
_NAMES = _Kind('a list of names', _names)


class Parameter(NamedTuple):
    """One parameter: what it may be, and what it is for."""

    kind: _Kind
    default: Any
    description: str
    minimum: float = -1e9
    maximum: float = 1e9
    is_live: bool = True
    """Whether a change applies at once; if not, when the node is configured again."""
    is_read_only: bool = False
    """Whether the value is read when the process starts, and never again."""

    @property
    def range(self) -> tuple[float, float] | None:
        """Smallest and largest number; None if the values are not numbers."""
        if self.kind in (_NUMBER, _NUMBERS, _VECTOR):
            return self.minimum, self.maximum
        return None

    def check(self, value: Any) -> Any:
        """Return the value as the node uses it, or raise a ConfigurationError."""
        try:
            converted = self.kind.convert(value)
        except (TypeError, ValueError):
            raise ConfigurationError(f'is {value!r}, expected {self.kind.expected}') from None
        if self.range:
            numbers = converted if isinstance(converted, tuple) else (converted,)
            if not all(self.minimum <= number <= self.maximum for number in numbers):
                raise ConfigurationError(
                    f'is {value}, expected {self.minimum:g} to {self.maximum:g}'
                )
        return converted

    def descriptor(self) -> ParameterDescriptor:
        from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor

        if self.is_read_only:
            applies = 'read when the process starts'
        else:
            applies = 'applies at once' if self.is_live else 'read when the node is configured'
        # Dynamic typing, because rclpy would refuse 500 for 500.0; check() makes up for it. It
        # also checks the range of integers and lists: rclpy does so for single doubles only.
        descriptor = ParameterDescriptor(
            description=self.description,
            additional_constraints=f'expected {self.kind.expected}; {applies}',
            dynamic_typing=True,
            read_only=self.is_read_only,
        )
        if self.range:
            lowest, highest = self.range
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=lowest, to_value=highest)
            ]
        return descriptor


_OF_URDF = -1.0
_SETTINGS = Settings()
_LOADS = LoadSettings()
LOCKED = 'locked_positions'
_QOS = 'qos_overrides'  # of rclpy
PARAMETERS = {
    'robot_description': Parameter(
        _TEXT,
        '',
        'The URDF, as XML text. Empty: from robot_description_file, else from the topic',
        is_live=False,
    ),
    'robot_description_file': Parameter(
        _TEXT,
        '',
        'URDF file: a path, package://PACKAGE/PATH or file:///PATH',
        is_live=False,
    ),
    'joints': Parameter(
        _NAMES,
        [''],
        'The joints to command, in the order of ~/commands and ~/desired_accelerations. '
        'Empty: every movable joint, in the order of the URDF. The dynamics include all '
        'joints',
        is_live=False,
    ),
    'base_link': Parameter(
        _TEXT,
        '',
        'Link in whose frame gravity, imu and ~/base_wrench are expressed; not moved by any '
        'joint. Empty: the root link',
        is_live=False,
    ),
    'on_missing_inertial': Parameter(
        _choice(MissingInertial),
        MissingInertial.WARN.value,
        'warn, or refuse a robot description with links that have a shape, but no <inertial>',
        is_live=False,
    ),
    'update_rate': Parameter(
        _NUMBER,
        0.0,
        'Commands per second [Hz], at least 1; 0: one for every joint state',
        0.0,
        10_000.0,
        is_live=False,
    ),
    'mode': Parameter(
        _choice(Mode),
        _SETTINGS.mode.value,
        'inverse_dynamics: the accelerations of the reference. computed_torque: these, with '
        'feedback of position and velocity. gravity_compensation: hold the arm and ignore the'
        ' reference',
    ),
    'gravity': Parameter(
        _VECTOR,
        list(STANDARD_GRAVITY),
        'Free-fall acceleration in the frame of the base link [m/s^2]; ~/gravity changes it too',
        -100.0,
        100.0,
    ),
    'base_motion': Parameter(
        _choice(BaseMotion),
        BaseMotion.FIXED.value,
        'fixed: at rest, with gravity from the parameter. imu: as measured on imu, which '
        'replaces gravity',
        is_live=False,
    ),
    'imu_orientation': Parameter(
        _VECTOR,
        [0.0, 0.0, 0.0],
        'Roll, pitch and yaw of the IMU in the frame of the base link [rad]',
        -7.0,
        7.0,
    ),
    'imu_filter_cutoff': Parameter(
        _NUMBER,
        _LOADS.imu_filter_cutoff,
        'Cutoff of a first-order low-pass for the motion of the base [Hz]; 0: no filter',
        0.0,
    ),
    'imu_timeout': Parameter(
        _NUMBER,
        _LOADS.imu_timeout,
        'Without a message on imu for this long, gravity stays and the angular velocity is '
        'zero [s]',
        0.005,
        60.0,
    ),
    'load_ramp': Parameter(
        _NUMBER,
        _LOADS.load_ramp,
        'Time in which a payload is ramped in, gravity changes by 9.8 m/s^2, or a lost '
        'external wrench fades out [s]',
        0.0,
        60.0,
    ),
    'wrench_timeout': Parameter(
        _NUMBER,
        _LOADS.wrench_timeout,
        'An external wrench that is not renewed for this long fades out [s]',
        0.0,
        60.0,
    ),
    'external_efforts_cutoff': Parameter(
        _NUMBER,
        10.0,
        'Cutoff of the first-order low-pass of ~/external_efforts [Hz]',
        0.01,
        10_000.0,
    ),
    'include_gravity': Parameter(
        _FLAG, True, 'False if the driver compensates gravity itself: UR, Franka, KUKA FRI'
    ),
    'include_friction': Parameter(
        _FLAG, False, 'Add the efforts that overcome friction: damping and coulomb'
    ),
    'damping': Parameter(
        _NUMBERS,
        _OF_URDF,
        'Viscous friction of the commanded joints [N m s/rad, N s/m]; -1: that of the URDF',
        _OF_URDF,
    ),
    'coulomb': Parameter(
        _NUMBERS,
        _OF_URDF,
        'Coulomb friction of the commanded joints [N m, N]; -1: that of the URDF',
        _OF_URDF,
    ),
    'coulomb_width': Parameter(
        _NUMBER,
        FRICTION_WIDTH,
        'Speed over which Coulomb friction is smoothed [rad/s, m/s]',
        1e-6,
        100.0,
    ),
    'armature': Parameter(
        _NUMBERS,
        0.0,
        'Inertia of rotors and gears, reflected to the commanded joints [kg m^2, kg]',
        0.0,
    ),
    'kp': Parameter(_NUMBERS, _SETTINGS.kp, 'Position gain of computed_torque [1/s^2]', 0.0),
    'kd': Parameter(
        _NUMBERS,
        _SETTINGS.kd,
        'Velocity gain of computed_torque [1/s]',
        0.0,
    ),
    'max_position_jump': Parameter(
        _NUMBER,
        _SETTINGS.max_position_jump,
        'computed_torque: largest distance of a new reference from the measured position, and'
        ' largest step of a reference [rad, m]; 0: unlimited',
        0.0,
    ),
    'velocity_filter_cutoff': Parameter(
        _NUMBER,
        _SETTINGS.velocity_filter_cutoff,
        'Cutoff of a first-order low-pass for measured velocities [Hz]; 0: no filter',
        0.0,
    ),
    'effort_scale': Parameter(_NUMBERS, _SETTINGS.effort_scale, 'Factor for the efforts'),
    'effort_offset': Parameter(
        _NUMBERS, _SETTINGS.effort_offset, 'Added to the scaled efforts [N m, N]'
    ),
    'use_urdf_effort_limits': Parameter(
        _FLAG,
        _SETTINGS.use_urdf_effort_limits,
        'Keep efforts within <limit effort> of the URDF',
    ),
    'effort_limits': Parameter(
        _NUMBERS, 0.0, 'Tighter limits of the efforts [N m, N]; 0: none', 0.0
    ),
    'effort_rate_limits': Parameter(
        _NUMBERS,
        0.0,
        'How fast efforts may change, except along the stop ramp [N m/s, N/s]; 0: unlimited',
        0.0,
    ),
    'state_timeout': Parameter(
        _NUMBER,
        _SETTINGS.state_timeout,
        'A state of a commanded joint older than this is lost [s]',
        0.005,
        60.0,
    ),
    'uncommanded_state_timeout': Parameter(
        _NUMBER,
        _SETTINGS.uncommanded_state_timeout,
        'A joint that is not commanded and was last reported longer ago is taken to be at rest '
        'where it was [s]; it never stops the arm',
        0.005,
        60.0,
    ),
    'reference_timeout': Parameter(
        _NUMBER,
        _SETTINGS.reference_timeout,
        'A reference older than this is ignored: accelerations are zero [s]; 0: it holds '
        'until the next',
        0.0,
        3600.0,
    ),
    'on_stale_state': Parameter(
        _choice(StalePolicy),
        _SETTINGS.on_stale_state.value,
        'Efforts after the joint state is lost: zero (along the stop ramp), or hold (the last'
        ' ones)',
    ),
    'start_ramp': Parameter(
        _NUMBER,
        _SETTINGS.start_ramp,
        'Time for the efforts to rise from zero, and for blends after live changes [s]',
        0.0,
        60.0,
    ),
    'stop_ramp': Parameter(
        _NUMBER,
        _SETTINGS.stop_ramp,
        'Time for the efforts to fall to zero [s]; ros2 launch cuts it short after 5 s',
        0.0,
        60.0,
    ),
    'autostart': Parameter(
        _FLAG,
        True,
        'Configure and activate once, as soon as there is a robot description',
        is_live=False,
        is_read_only=True,
    ),
    'executor': Parameter(
        _choice(Executor),
        Executor.EVENTS.value,
        'events, or single_threaded, which is slower',
        is_live=False,
        is_read_only=True,
    ),
    'allow_unknown_parameters': Parameter(
        _FLAG,
        False,
        'Ignore parameters that this node does not have, for a file that several nodes share. '
        'False: the node does not start with them, because a mistyped limit is not a limit',
        is_live=False,
        is_read_only=True,
    ),
}
PER_JOINT = frozenset(name for name, p in PARAMETERS.items() if p.kind is _NUMBERS)
"""Parameters with one number for all commanded joints, or one for each."""


@dataclass(frozen=True)
class Configuration:
    """All parameters, checked."""

    robot_description: str
    robot_description_file: str
    joints: tuple[str, ...]
    base_link: str
    on_missing_inertial: MissingInertial
    update_rate: float
    gravity: tuple[float, float, float]
    base_motion: BaseMotion
    imu_orientation: tuple[float, float, float]
    external_efforts_cutoff: float
    include_gravity: bool
    include_friction: bool
    damping: PerJoint
    coulomb: PerJoint
    coulomb_width: float
    armature: PerJoint
    autostart: bool
    executor: Executor
    allow_unknown_parameters: bool
    settings: Settings
    load_settings: LoadSettings
    locked_positions: dict[str, float]
    """By joint [rad or m]."""

    @property
    def period(self) -> float:
        """Time between commands [s]; 0 for one for every joint state."""
        return 1.0 / self.update_rate if self.update_rate else 0.0


def declare_parameters(node: Node) -> None:
    """
    Declare every parameter, with the values from the command line and parameter files.

    Raises
    ------
    ConfigurationError
        Naming every parameter that is unknown, or whose value cannot be used.

    """
    from rcl_interfaces.msg import ParameterDescriptor

    given = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    locked = [name for name in given if name.startswith(f'{LOCKED}.')]
    values = {name: parameter.default for name, parameter in PARAMETERS.items()}
    values.update({name: given[name] for name in (*PARAMETERS, *locked) if name in given})
    problems = _problems(values)
    if values['allow_unknown_parameters'] is not True:
        unknown = unknown_parameters(node)
        problems += unknown
        if unknown:
            problems.append(
                'to ignore unknown parameters, for example in a file that several nodes share, '
                'set allow_unknown_parameters to true'
            )
    if problems:
        # Before anything is declared, where rclpy would stop at the first value out of range.
        raise ConfigurationError(*problems)
    for name, parameter in PARAMETERS.items():
        try:
            node.declare_parameter(name, parameter.default, parameter.descriptor())
        except Exception as error:
            raise ConfigurationError(f"parameter '{name}': {error}") from None
    # The joints are known when a robot description has been loaded; until then, allow any.
    for name in locked:
        node.declare_parameter(
            name,
            0.0,
            ParameterDescriptor(
                description='Position of this joint until joint_states reports it [rad or m]',
                dynamic_typing=True,
            ),
        )


def values_of(node: Node) -> dict[str, Any]:
    """Return the values of all parameters, by name."""
    locked = node.get_parameters_by_prefix(LOCKED)
    names = [*PARAMETERS, *(f'{LOCKED}.{joint}' for joint in locked)]
    return {name: node.get_parameter(name).value for name in names}


def read_configuration(node: Node) -> Configuration:
    """
    Read all parameters.

    Raises
    ------
    ConfigurationError
        Naming every parameter that cannot be used.

    """
    return checked_configuration(values_of(node))


def checked_configuration(values: dict[str, Any]) -> Configuration:
    """Check all values as a whole, and report all problems at once."""
    problems = _problems(values)
    if problems:
        raise ConfigurationError(*problems)
    checked = {name: parameter.check(values[name]) for name, parameter in PARAMETERS.items()}
    locked = {
        name.removeprefix(f'{LOCKED}.'): _number(value)
        for name, value in values.items()
        if name not in PARAMETERS
    }
    for name in ('effort_limits', 'effort_rate_limits'):
        checked[name] = _unlimited_where_zero(checked[name])
    settings = Settings(**{name: checked.pop(name) for name in vars(_SETTINGS)})
    loads = LoadSettings(**{name: checked.pop(name) for name in vars(_LOADS)})
    return Configuration(
        **checked, settings=settings, load_settings=loads, locked_positions=locked
    )


def _problems(values: dict[str, Any]) -> list[str]:
    """Describe each value that cannot be used, alone or beside the others."""
    checked: dict[str, Any] = {}
    problems = []
    for name, parameter in PARAMETERS.items():
        try:
            checked[name] = parameter.check(values[name])
        except ConfigurationError as error:
            problems.append(f"parameter '{name}' {error}")
    for name, value in values.items():
        if name not in PARAMETERS:
            try:
                _number(value)
            except TypeError:
                problems.append(f"parameter '{name}' is {value!r}, expected a finite number")
    if checked.get('robot_description') and checked.get('robot_description_file'):
        problems.append('parameters robot_description and robot_description_file are both set')
    if 0.0 < checked.get('update_rate', 0.0) < 1.0:
        problems.append(
            f"parameter 'update_rate' is {checked['update_rate']:g}, expected 0 or at least 1"
        )
    # These must not be negative, except for the -1 that stands for the value in the URDF.
    for name in ('damping', 'coulomb'):
        numbers = np.atleast_1d(checked.get(name, 0.0))
        if ((numbers < 0.0) & (numbers != _OF_URDF)).any():
            problems.append(f"parameter '{name}' is {values[name]}, expected -1 or numbers from 0")
    return problems


def _unlimited_where_zero(numbers: PerJoint) -> PerJoint:
    if isinstance(numbers, tuple):
        return tuple(number or math.inf for number in numbers)
    return numbers or math.inf


def unknown_parameters(node: Node) -> list[str]:
    """
    Describe each given name that is not a parameter of this node, with the closest name.

    To be called when rclpy has declared its own parameters.

    """
    known = [*PARAMETERS, *node._parameters, LOCKED]
    problems = []
    for name in node._parameter_overrides:
        head, dot, tail = name.partition('.')
        if name in known or (dot and head in (LOCKED, _QOS)):
            continue
        hint = did_you_mean(name, known) or did_you_mean(head, known)
        if LOCKED in hint:
            hint = f"; did you mean '{LOCKED}.{tail or '<joint>'}'?"
        problems.append(f"unknown parameter '{name}'{hint}")
    return problems


def unused_qos_overrides(node: Node) -> list[str]:
    """Describe each QoS override that no publisher or subscription of the node has declared."""
    declared = [name for name in node._parameters if name.startswith(f'{_QOS}.')]
    return [
        f"parameter '{name}' matches no publisher or subscription of this node"
        + did_you_mean(name, declared)
        for name in node._parameter_overrides
        if name.startswith(f'{_QOS}.') and name not in declared
    ]
