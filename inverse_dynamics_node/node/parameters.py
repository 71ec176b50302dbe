"""The node's parameters: one table, checked before any value is used."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
import math
from typing import Any, NamedTuple

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from ..controller import Mode, PerJoint, Settings, StalePolicy
from ..dynamics import FRICTION_WIDTH, STANDARD_GRAVITY
from ..errors import ConfigurationError


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
    """Whether a change counts at once; if not, when the node is configured again."""

    def check(self, value: Any) -> Any:
        """Return the value as the node uses it, or raise a ConfigurationError."""
        try:
            converted = self.kind.convert(value)
        except (TypeError, ValueError):
            raise ConfigurationError(f'is {value!r}, expected {self.kind.expected}') from None
        if self.kind in (_NUMBER, _NUMBERS, _VECTOR):
            numbers = converted if isinstance(converted, tuple) else (converted,)
            if not all(self.minimum <= number <= self.maximum for number in numbers):
                raise ConfigurationError(
                    f'is {value}, expected {self.minimum:g} to {self.maximum:g}'
                )
        return converted

    def descriptor(self) -> ParameterDescriptor:
        # Dynamic typing, because rclpy would refuse 500 for 500.0; check() makes up for it.
        descriptor = ParameterDescriptor(
            description=self.description,
            additional_constraints=f'expected {self.kind.expected}; '
            + ('counts at once' if self.is_live else 'read when the node is configured'),
            dynamic_typing=True,
        )
        if self.kind is _NUMBER:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.minimum, to_value=self.maximum)
            ]
        return descriptor


_OF_URDF = -1.0
_SETTINGS = Settings()
PARAMETERS = {
    'robot_description': Parameter(
        _TEXT,
        '',
        'The URDF, as XML text. Empty: from robot_description_file, else from the topic',
        is_live=False,
    ),
    'robot_description_file': Parameter(_TEXT, '', 'Path of a URDF file', is_live=False),
    'joints': Parameter(
        _NAMES,
        [''],
        'The joints to command, in the order of ~/commands and ~/desired_accelerations. '
        'Empty: every movable joint, in the order of the URDF. All joints count in the dynamics',
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
        'inverse_dynamics: the accelerations of the reference. computed_torque: those, and back '
        'to its positions and velocities. gravity_compensation: hold the arm, whatever it says',
    ),
    'gravity': Parameter(
        _VECTOR,
        list(STANDARD_GRAVITY),
        'Free-fall acceleration in the frame of the root link [m/s^2]',
        -100.0,
        100.0,
    ),
    'include_gravity': Parameter(
        _FLAG, True, 'False where the driver compensates gravity itself: UR, Franka, KUKA FRI'
    ),
    'include_friction': Parameter(_FLAG, False, 'Overcome friction: damping and coulomb'),
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
        'Inertia of rotors and gears as felt at the commanded joints [kg m^2, kg]',
        0.0,
    ),
    'kp': Parameter(
        _NUMBERS, _SETTINGS.kp, 'computed_torque: acceleration for a distance [1/s^2]', 0.0
    ),
    'kd': Parameter(
        _NUMBERS,
        _SETTINGS.kd,
        'computed_torque: acceleration for a difference of velocities [1/s]',
        0.0,
    ),
    'max_position_jump': Parameter(
        _NUMBER,
        _SETTINGS.max_position_jump,
        'computed_torque: how far a reference may start away, or jump [rad, m]; 0: anywhere',
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
        _NUMBERS, 0.0, 'How fast efforts may change [N m/s, N/s]; 0: as fast as they like', 0.0
    ),
    'state_timeout': Parameter(
        _NUMBER,
        _SETTINGS.state_timeout,
        'A joint state older than this is lost [s]',
        0.005,
        60.0,
    ),
    'reference_timeout': Parameter(
        _NUMBER,
        _SETTINGS.reference_timeout,
        'A reference older than this counts no more: accelerations are zero [s]; 0: it holds '
        'until the next',
        0.0,
        3600.0,
    ),
    'on_stale_state': Parameter(
        _choice(StalePolicy),
        _SETTINGS.on_stale_state.value,
        'What becomes of the efforts when the joint state is lost: zero (along the stop ramp), '
        'or hold (the last ones)',
    ),
    'start_ramp': Parameter(
        _NUMBER, _SETTINGS.start_ramp, 'Time for the efforts to rise from zero [s]', 0.0, 60.0
    ),
    'stop_ramp': Parameter(
        _NUMBER, _SETTINGS.stop_ramp, 'Time for the efforts to fall to zero [s]', 0.0, 60.0
    ),
    'autostart': Parameter(
        _FLAG,
        True,
        'Configure and activate as soon as there is a robot description, with no one asking; once',
        is_live=False,
    ),
}


@dataclass(frozen=True)
class Configuration:
    """All parameters, checked."""

    robot_description: str
    robot_description_file: str
    joints: tuple[str, ...]
    update_rate: float
    gravity: tuple[float, float, float]
    include_gravity: bool
    include_friction: bool
    damping: PerJoint
    coulomb: PerJoint
    coulomb_width: float
    armature: PerJoint
    autostart: bool
    settings: Settings


def declare_parameters(node: Node) -> None:
    """Declare every parameter, with what the command line and files say of it."""
    for name, parameter in PARAMETERS.items():
        try:
            node.declare_parameter(name, parameter.default, parameter.descriptor())
        except Exception as error:
            raise ConfigurationError(f"parameter '{name}': {error}") from None


def read_configuration(node: Node) -> Configuration:
    """
    Read all parameters.

    Raises
    ------
    ConfigurationError
        Naming every parameter that cannot be used.

    """
    return checked_configuration({name: node.get_parameter(name).value for name in PARAMETERS})


def checked_configuration(values: dict[str, Any]) -> Configuration:
    """Check all values as a whole, and tell all problems at once."""
    checked: dict[str, Any] = {}
    problems = []
    for name, parameter in PARAMETERS.items():
        try:
            checked[name] = parameter.check(values[name])
        except ConfigurationError as error:
            problems.append(f"parameter '{name}' {error}")
    if checked.get('robot_description') and checked.get('robot_description_file'):
        problems.append('parameters robot_description and robot_description_file are both set')
    if 0.0 < checked.get('update_rate', 0.0) < 1.0:
        problems.append(
            f"parameter 'update_rate' is {checked['update_rate']:g}, expected 0 or at least 1"
        )
    if problems:
        raise ConfigurationError('; '.join(problems))
    for name in ('effort_limits', 'effort_rate_limits'):
        checked[name] = _unlimited_where_zero(checked[name])
    settings = Settings(**{name: checked.pop(name) for name in vars(_SETTINGS)})
    return Configuration(**checked, settings=settings)


def _unlimited_where_zero(numbers: PerJoint) -> PerJoint:
    if isinstance(numbers, tuple):
        return tuple(number or math.inf for number in numbers)
    return numbers or math.inf


def unknown_parameters(overrides: Iterable[str]) -> list[str]:
    """Name what was set, but is no parameter of this node: a slip of the pen, most likely."""
    known = {*PARAMETERS, 'use_sim_time', 'start_type_description_service'}
    return [name for name in overrides if name not in known and 'qos_overrides' not in name]
