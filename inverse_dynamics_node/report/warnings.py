"""Warnings as text, grouped by their hints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ..robot.limit_checks import effort_limit_warnings
from ..robot.model import ModelWarning, RobotModel
from .tables import Line, Style, WIDTH, wrapped


def warnings_about(robot: RobotModel) -> tuple[ModelWarning, ...]:
    """Return all warnings about a robot description: of the loader, and about effort limits."""
    return (*robot.warnings, *effort_limit_warnings(robot))


def warnings_as_text(warnings: Sequence[ModelWarning], width: int = WIDTH) -> str:
    """Format warnings as plain text, those with the same hint together."""
    return '\n'.join(line.text for line in warning_lines(warnings, width))


def warning_lines(warnings: Sequence[ModelWarning], width: int = WIDTH) -> list[Line]:
    """Format warnings, those with the same hint together."""
    if not warnings:
        return [Line('No warnings.', Style.NO_WARNINGS)]
    plural = 's' if len(warnings) > 1 else ''
    lines = [Line(f'{len(warnings)} warning{plural}', Style.WARNINGS)]
    for hint, group in _by_hint(warnings).items():
        for warning in group:
            lines += [Line(x, Style.WARNING) for x in wrapped(str(warning), width, '  ', '    ')]
        lines += [Line(x, Style.HINT) for x in wrapped(hint, width, '    -> ', '       ')]
    return lines


def _by_hint(warnings: Iterable[ModelWarning]) -> dict[str, list[ModelWarning]]:
    groups: dict[str, list[ModelWarning]] = {}
    for warning in warnings:
        groups.setdefault(warning.hint, []).append(warning)
    return groups
