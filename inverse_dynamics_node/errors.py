"""One family of errors: what is wrong, where, what was expected, and the value found."""

from __future__ import annotations

from collections.abc import Iterable
import difflib

_LONGEST_LINE = 1000  # characters
_MOST_LINES = 1000


class InverseDynamicsError(Exception):
    """Root of every error this package raises on purpose."""


class UrdfError(InverseDynamicsError):
    """
    A robot description that cannot be used.

    Attributes
    ----------
    source : str
        The file, or ``'URDF'`` where the description came as text.
    problems : tuple of str
        Everything that is wrong with it, in file order; never empty.

    """

    def __init__(self, problems: Iterable[str], source: str = 'URDF') -> None:
        self.problems = tuple(problems)
        self.source = source
        super().__init__(source, self.problems)

    def __str__(self) -> str:
        if len(self.problems) == 1:
            return f'{self.source}: {self.problems[0]}'
        listed = '\n'.join(f'  - {problem}' for problem in self.problems)
        return f'{self.source}: {len(self.problems)} problems\n{listed}'


class JointStateError(InverseDynamicsError):
    """A joint vector of the wrong size, or with a value that is not finite."""


class ConfigurationError(InverseDynamicsError):
    """A setting that cannot be used with this robot, or at all; one line for each problem."""

    def __str__(self) -> str:
        return '\n'.join(map(str, self.args))


class TrajectoryError(InverseDynamicsError):
    """A trajectory that cannot be followed, or not by this robot."""


class RecordingError(InverseDynamicsError):
    """A recorded run that cannot be read, or not be held against this robot."""


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """
    Suggest the closest of several names.

    Returns
    -------
    hint : str
        To be appended to a message; empty if no name is close.

    """
    closest = difflib.get_close_matches(name, names, 1)
    return f"; did you mean '{closest[0]}'?" if closest else ''


def shortened(text: str, most: int = 60) -> str:
    """
    Make text from outside fit for a message.

    Parameters
    ----------
    text : str
        A name from a message, a parameter or a file, of any length.
    most : int
        Characters to keep.

    Returns
    -------
    shortened : str
        Printable; with the full length at its end if it was cut.

    """
    start = text[:most]
    if not start.isprintable():
        start = ''.join(
            x if x.isprintable() else x.encode('unicode_escape').decode() for x in start
        )
    return start if len(text) <= most else f'{start}... ({len(text)} characters)'


def shortened_lines(text: str) -> str:
    """Bound the length of a whole message: each of its lines, and their number."""
    lines = text[: _MOST_LINES * _LONGEST_LINE].split('\n', _MOST_LINES)
    return '\n'.join(shortened(line, _LONGEST_LINE) for line in lines)
