"""The node's parameters: one table, checked before any value is used."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from ..controller import Settings
from ..dynamics import STANDARD_GRAVITY
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


_TEXT = _Kind('a text', _text)
_FLAG = _Kind('true or false', _flag)
_NUMBER = _Kind('a finite number', _number)
_VECTOR = _Kind('three finite numbers, all with a decimal point or all without', _vector)
_NAMES = _Kind('a list of names', _names)


class Parameter(NamedTuple):
    """One parameter: what it may be, and what it is for."""

    kind: _Kind
    default: Any
    description: str
    minimum: float = -math.inf
    maximum: float = math.inf

    def check(self, value: Any) -> Any:
        """Return the value as the node uses it, or raise a ConfigurationError."""
        try:
            converted = self.kind.convert(value)
        except (TypeError, ValueError):
            raise ConfigurationError(f'is {value!r}, expected {self.kind.expected}') from None
        if self.kind is _NUMBER and not self.minimum <= converted <= self.maximum:
            raise ConfigurationError(
                f'is {converted:g}, expected {self.minimum:g} to {self.maximum:g}'
            )
        return converted

    def descriptor(self) -> ParameterDescriptor:
        # Dynamic typing, because rclpy would refuse 500 for 500.0; check() makes up for it.
        descriptor = ParameterDescriptor(
            description=self.description,
            additional_constraints=f'expected {self.kind.expected}',
            dynamic_typing=True,
        )
        if self.kind is _NUMBER:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.minimum, to_value=self.maximum)
            ]
        return descriptor


_SETTINGS = Settings()
PARAMETERS = {
    'robot_description': Parameter(
        _TEXT, '', 'The URDF, as XML text. Empty: from robot_description_file, else from the topic'
    ),
    'robot_description_file': Parameter(_TEXT, '', 'Path of a URDF file'),
    'joints': Parameter(
        _NAMES,
        [''],
        'The joints to command, in the order of ~/commands and ~/desired_accelerations. '
        'Empty: every movable joint, in the order of the URDF. All joints count in the dynamics',
    ),
    'update_rate': Parameter(
        _NUMBER, 0.0, 'Commands per second [Hz]; 0: one for every joint state', 0.0, 10_000.0
    ),
    'gravity': Parameter(
        _VECTOR,
        list(STANDARD_GRAVITY),
        'Free-fall acceleration in the frame of the root link [m/s^2]',
    ),
    'state_timeout': Parameter(
        _NUMBER,
        _SETTINGS.state_timeout,
        'A joint state older than this is lost: the efforts go to zero [s]',
        0.001,
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
    'use_urdf_effort_limits': Parameter(
        _FLAG,
        _SETTINGS.use_urdf_effort_limits,
        'Keep efforts within <limit effort> of the URDF',
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
        'Configure and activate as soon as there is a robot description, with no one asking',
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
    """Check all values as a whole; they are few, so all problems are told at once."""
    checked: dict[str, Any] = {}
    problems = []
    for name, parameter in PARAMETERS.items():
        try:
            checked[name] = parameter.check(values[name])
        except ConfigurationError as error:
            problems.append(f"parameter '{name}' {error}")
    if checked.get('robot_description') and checked.get('robot_description_file'):
        problems.append('parameters robot_description and robot_description_file are both set')
    if problems:
        raise ConfigurationError('; '.join(problems))
    settings = Settings(**{name: checked.pop(name) for name in vars(_SETTINGS)})
    return Configuration(**checked, settings=settings)


def unknown_parameters(overrides: Iterable[str]) -> list[str]:
    """Name what was set, but is no parameter of this node: a slip of the pen, most likely."""
    known = {*PARAMETERS, 'use_sim_time', 'start_type_description_service'}
    return [name for name in overrides if name not in known and 'qos_overrides' not in name]
