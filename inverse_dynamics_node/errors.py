"""The exceptions of the package, and the parts that their messages have in common."""

from __future__ import annotations

from collections.abc import Collection, Iterable
import difflib
from itertools import islice
from typing import Any

_LONGEST_LINE = 1000  # characters
_MOST_LINES = 1000
_MOST_LISTED = 12  # names


class InverseDynamicsError(Exception):
    """Base class of the exceptions of this package."""


class UrdfError(InverseDynamicsError):
    """
    A robot description cannot be used.

    Attributes
    ----------
    source : str
        Path of the file, or ``'URDF'`` if the description was passed as text.
    problems : tuple of str
        Every problem found, in file order; never empty.

    """

    def __init__(self, problems: Iterable[str], source: str = 'URDF') -> None:
        self.problems = tuple(problems)
        self.source = source
        super().__init__(source, self.problems)

    def __str__(self) -> str:
        if len(self.problems) == 1:
            return f'{self.source}: {escaped(self.problems[0])}'
        listed = '\n'.join(f'  - {escaped(problem)}' for problem in self.problems)
        return f'{self.source}: {len(self.problems)} problems\n{listed}'


class JointStateError(InverseDynamicsError):
    """A joint vector has the wrong size, or contains a value that is not finite."""


class ConfigurationError(InverseDynamicsError):
    """A setting is invalid, or does not fit the robot; one argument per problem."""

    def __str__(self) -> str:
        return '\n'.join(map(str, self.args))


class TrajectoryError(InverseDynamicsError):
    """A trajectory is invalid, or does not fit the robot."""


class RecordingError(InverseDynamicsError):
    """A recording cannot be read, or does not fit the robot."""


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """
    Suggest the valid name that is closest to an invalid one.

    Parameters
    ----------
    name : str
        The invalid name.
    names : iterable of str
        The valid names.

    Returns
    -------
    hint : str
        Text to append to a message; empty if no name is close.

    """
    closest = difflib.get_close_matches(name, names, 1)
    return f"; did you mean '{closest[0]}'?" if closest else ''


def unknown_name(kind: str, name: str, names: Collection[str]) -> str:
    """
    Report that a name does not exist, and list the names that do.

    Parameters
    ----------
    kind : str
        The kind of thing in the singular, such as ``'link'`` or ``'joint'``.
    name : str
        The name that does not exist.
    names : collection of str
        The valid names.

    Returns
    -------
    text : str
        Such as ``link 'x' does not exist; links are a, b``.

    """
    # A list that is cut short may lack the name that was meant.
    hint = did_you_mean(name, names) if len(names) > _MOST_LISTED else ''
    return f"{kind} '{shortened(name)}' does not exist; {kind}s are {listed(names)}{hint}"


def listed(names: Collection[str], most: int = _MOST_LISTED) -> str:
    """Join names by commas; of more than ``most`` names, only the first ones and their number."""
    shown = ', '.join(shortened(name) for name in islice(names, most))
    return f'{shown}, ... ({len(names)} in all)' if len(names) > most else shown


def significant(value: float, digits: int = 3) -> str:
    """Write a number with some significant digits, and all digits before the decimal point."""
    text = f'{value:.{digits}g}'
    return f'{value:.0f}' if 'e+' in text else text


def plain(value: Any) -> Any:
    """Return an array as a list, which is shown without its type; other values as they are."""
    return value.tolist() if hasattr(value, 'tolist') else value


def shortened(text: str, most: int = 60) -> str:
    """
    Shorten text from a message or a file, and escape control characters in it.

    Parameters
    ----------
    text : str
        Text of any length, such as the name of a joint.
    most : int
        Number of characters to keep.

    Returns
    -------
    shortened : str
        Printable text, which ends with the original length if it was cut.

    """
    start = escaped(text[:most])
    return start if len(text) <= most else f'{start}... ({len(text)} characters)'


def escaped(text: str) -> str:
    r"""Replace characters that are not printable, also line ends, such as by ``\x1b``."""
    if text.isprintable():
        return text
    return ''.join(x if x.isprintable() else x.encode('unicode_escape').decode() for x in text)


def shortened_lines(text: str) -> str:
    """Limit the number of lines of a message, and the length of each line."""
    lines = text[: _MOST_LINES * _LONGEST_LINE].split('\n', _MOST_LINES)
    return '\n'.join(shortened(line, _LONGEST_LINE) for line in lines)
