"""
Describes the type, default, unit and range of a parameter, and checks its values.

This module does not import ROS, so that ``--help`` works without ROS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
import math
from typing import Any

from ..control.settings import PerJoint
from ..errors import ConfigurationError, plain

UNBOUNDED = 1e9
"""Largest permitted magnitude of a number, unless its parameter declares another limit."""


@dataclass(frozen=True)
class Kind:
    """A type of parameter."""

    expected: str
    """Description of the accepted values, for error messages."""
    convert: Callable[[Any], Any]
    """Converts a value for the `Configuration`, or raises a TypeError or a ValueError."""
    choices: tuple[str, ...] = ()
    is_numeric: bool = False


def _only(kind: type) -> Callable[[Any], Any]:
    """Return a function that accepts values of exactly this type."""

    def convert(value: Any) -> Any:
        if type(value) is not kind:  # a bool is also an instance of int
            raise TypeError
        return value

    return convert


_text = _only(str)


def _number(value: Any) -> float:
    """Return a finite float. Integers are accepted, because users type 500 instead of 500.0."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TypeError
    return float(value)


def _vector(value: Any) -> tuple[float, ...]:
    if isinstance(value, str) or len(value) != 3:
        raise ValueError
    return tuple(_number(x) for x in value)


def _numbers(value: Any) -> PerJoint:
    if isinstance(value, int | float):
        return _number(value)
    if isinstance(value, str) or not len(value):
        raise TypeError
    return tuple(_number(x) for x in value)


def _names(value: Any) -> tuple[str, ...]:
    """Return the names that are not empty; `value` is None if rclpy got an empty list."""
    if isinstance(value, str):
        raise TypeError
    return tuple(_text(name) for name in value or () if name)


NUMBER = Kind('a finite number', _number, is_numeric=True)
INTEGER = Kind('an integer', _only(int), is_numeric=True)
_NUMBERS = Kind(
    'a finite number, or a list with one number for each commanded joint',
    _numbers,
    is_numeric=True,
)
_KINDS = {
    str: Kind('text', _text),
    bool: Kind('true or false', _only(bool)),
    float: NUMBER,
    int: INTEGER,
    tuple[float, float, float]: Kind(
        'three finite numbers, all with a decimal point or all without', _vector, is_numeric=True
    ),
    PerJoint: _NUMBERS,
    tuple[str, ...]: Kind('a list of names', _names),
}


def kind_of(annotation: Any) -> Kind:
    """Return the `Kind` for the type annotation of a field of `Configuration`."""
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        choices = tuple(choice.value for choice in annotation)
        return Kind(f'one of {", ".join(choices)}', annotation, choices)
    return _KINDS[annotation]


@dataclass(frozen=True)
class Parameter:
    """Declaration of one parameter of the node."""

    kind: Kind
    default: Any
    """Default value, as written in a parameter file."""
    summary: str
    """One or two short Markdown sentences for tables, without the final full stop."""
    details: str = ''
    """Further Markdown sentences, without the final full stop."""
    unit: str = ''
    minimum: float = -UNBOUNDED
    maximum: float = UNBOUNDED
    special: float | None = None
    """A number below the minimum that has a meaning of its own."""
    is_live: bool = True
    """Whether a change applies without reconfiguring the node."""
    is_read_only: bool = False
    """Whether the value can be set only when the process starts."""
    is_unlimited_at_zero: bool = False
    """Whether the value 0 means that there is no limit."""
    default_note: str = ''
    """Description of a default that depends on the machine or the launch file."""

    @property
    def description(self) -> str:
        """Plain text of summary and details, with the unit after the first sentence."""
        first, stop, rest = self.summary.partition('. ')
        unit = f' [{self.unit}]' if self.unit else ''
        text = f'{first}{unit}{stop}{rest}' + (f'. {self.details}' if self.details else '')
        return text.replace('`', '')

    @property
    def range(self) -> tuple[float, float] | None:
        """Smallest and largest permitted number; None if there is no range."""
        if not self.kind.is_numeric or not math.isfinite(self.minimum):
            return None
        return self.minimum if self.special is None else self.special, self.maximum

    @property
    def range_text(self) -> str:
        """Text of the range or of the choices; may be empty."""
        if not self.range:
            return ', '.join(self.kind.choices)
        special = '' if self.special is None else f'{self.special:g} or '
        if self.maximum < UNBOUNDED:
            return f'{special}{self.minimum:g} to {self.maximum:g}'
        return f'{special}at least {self.minimum:g}' if self.minimum > -UNBOUNDED else ''

    @property
    def default_text(self) -> str:
        """`default_note`, or else the default as written in a parameter file."""
        if self.default_note:
            return self.default_note
        if isinstance(self.default, bool):
            return str(self.default).lower()
        return repr(self.default)

    @property
    def is_per_joint(self) -> bool:
        """Whether the value may be a list with one number for each commanded joint."""
        return self.kind is _NUMBERS

    @property
    def applies(self) -> str:
        """Text that says when a new value is used."""
        if self.is_read_only:
            return 'read when the process starts'
        return 'applies at once' if self.is_live else 'read when the node is configured'

    def check(self, value: Any) -> Any:
        """Convert a value for the `Configuration`, or raise a ConfigurationError."""
        try:
            converted = self.kind.convert(value)
        except (TypeError, ValueError):
            hint = _hint(value) if self.kind.is_numeric else ''
            raise ConfigurationError(
                f'is {plain(value)!r}, expected {self.kind.expected}{hint}'
            ) from None
        if self.kind.is_numeric:
            for number in converted if isinstance(converted, tuple) else (converted,):
                if number != self.special and not self.minimum <= number <= self.maximum:
                    expected = self.range_text or f'at least {self.minimum:g}'
                    if number > UNBOUNDED:
                        expected = f'at most {UNBOUNDED:g}'
                    raise ConfigurationError(f'is {plain(value)}, expected {expected}')
        return _unlimited_where_zero(converted) if self.is_unlimited_at_zero else converted


def _unlimited_where_zero(numbers: PerJoint) -> PerJoint:
    if isinstance(numbers, tuple):
        return tuple(number or math.inf for number in numbers)
    return numbers or math.inf


def _hint(value: Any) -> str:
    """Return a hint if the value is a string that looks like a number, otherwise ''."""
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        return ''
    return f'; YAML reads {value} as text, write {number}' if math.isfinite(number) else ''


def parameter(default: Any, summary: str, details: str = '', **properties: Any) -> Any:
    """Declare a dataclass field as a parameter; the arguments are fields of `Parameter`."""
    declaration = {'default': default, 'summary': summary, 'details': details, **properties}
    return field(metadata=declaration)
