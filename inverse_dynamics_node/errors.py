"""Exceptions of the package, and functions that format their messages."""

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
        One or more problems, in the order in which they appear in the file.

    """

    def __init__(self, problems: Iterable[str], source: str = 'URDF') -> None:
        self.problems = tuple(problems)
        self.source = shortened(source, 250)
        super().__init__(source, self.problems)

    def __str__(self) -> str:
        if len(self.problems) == 1:
            return f'{self.source}: {escaped(self.problems[0])}'
        listed = '\n'.join(f'  - {escaped(problem)}' for problem in self.problems)
        return f'{self.source}: {len(self.problems)} problems\n{listed}'


class JointStateError(InverseDynamicsError):
    """A joint vector has the wrong size or a value that is not finite."""


class ConfigurationError(InverseDynamicsError):
    """A setting is invalid or does not fit the robot; ``args`` lists the problems."""

    def __str__(self) -> str:
        return '\n'.join(map(str, self.args))


class TrajectoryError(InverseDynamicsError):
    """A trajectory is invalid or does not fit the robot."""


class RecordingError(InverseDynamicsError):
    """A recording cannot be read or does not fit the robot."""


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return a hint such as ``; did you mean 'link1'?``, or '' if no name is similar."""
    closest = difflib.get_close_matches(name, names, 1)
    return f"; did you mean '{closest[0]}'?" if closest else ''


def unknown_name(kind: str, name: str, names: Collection[str]) -> str:
    """Return a message such as ``link 'x' does not exist; links are a, b``."""
    # A shortened list may not contain the name that the user meant.
    hint = did_you_mean(name, names) if len(names) > _MOST_LISTED else ''
    return f"{kind} '{shortened(name)}' does not exist; {kind}s are {listed(names)}{hint}"


def listed(names: Collection[str], most: int = _MOST_LISTED) -> str:
    """Join the first ``most`` names with commas; if there are more, append the total number."""
    shown = ', '.join(shortened(name) for name in islice(names, most))
    return f'{shown}, ... ({len(names)} in all)' if len(names) > most else shown


def significant(value: float, digits: int = 3) -> str:
    """Format a number with ``digits`` significant digits, but keep the whole integer part."""
    text = f'{value:.{digits}g}'
    return f'{value:.0f}' if 'e+' in text else text


def plain(value: Any) -> Any:
    """Convert an array to a list for printing; return other values unchanged."""
    return value.tolist() if hasattr(value, 'tolist') else value


def shortened(text: str, most: int = 60) -> str:
    """Escape control characters, and cut the text after ``most`` characters."""
    start = escaped(text[:most])
    return start if len(text) <= most else f'{start}... ({len(text)} characters)'


def escaped(text: str) -> str:
    r"""Replace non-printable characters, including line ends, with escapes such as ``\x1b``."""
    if text.isprintable():
        return text
    return ''.join(x if x.isprintable() else x.encode('unicode_escape').decode() for x in text)


def shortened_lines(text: str) -> str:
    """Limit the number of lines in a message, and the length of each line."""
    lines = text[: _MOST_LINES * _LONGEST_LINE].split('\n', _MOST_LINES)
    return '\n'.join(shortened(line, _LONGEST_LINE) for line in lines)
