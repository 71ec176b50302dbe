"""A warning about a robot, as a value."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelWarning:
    """
    Something that looks wrong although the robot can be used.

    ``str(warning)`` is one line with the line number, the subject and the text.

    """

    text: str
    """The condition and the value that was found."""
    hint: str
    """How to correct it, or when it is harmless."""
    subject: str = ''
    """The part of the robot, such as ``link 'hand' inertial``; empty for the whole robot."""
    line: int | None = None
    """Line of the robot description; None if no single line is the cause."""

    def __str__(self) -> str:
        line = '' if self.line is None else f'line {self.line}'
        return ': '.join(part for part in (line, self.subject, self.text) if part)
