"""Formats tables, warnings, numbers and units as text without unprintable characters."""

from __future__ import annotations

from collections.abc import Sequence
import math
import textwrap
from typing import TYPE_CHECKING

import numpy as np

from ..errors import escaped, significant
from ..robot.limit_checks import effort_limit_warnings
from ..robot.model import Floats, ModelWarning, RobotModel

if TYPE_CHECKING:
    from ..analysis.recordings.signals import Motion

WIDTH = 100
"""Largest width of a paragraph, in characters."""


def table(
    title: str,
    columns: Sequence[str] = (),
    rows: Sequence[Sequence[str]] = (),
    notes: Sequence[str] = (),
    words: Sequence[int] = (),
) -> str:
    """
    Format a title, aligned rows and wrapped notes, without a final newline.

    The first column and the columns with the indices `words` are aligned to the left, and the
    others to the right. An empty column is left out.
    """
    lines = [escaped(title)]
    if rows:
        cells = [[escaped(cell) for cell in row] for row in (columns, *rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        for row in cells:
            parts = [
                cell.ljust(width) if k == 0 or k in words else cell.rjust(width)
                for k, (cell, width) in enumerate(zip(row, widths, strict=True))
                if width
            ]
            lines.append(f'  {"  ".join(parts)}'.rstrip())
    for note in notes:
        lines += wrapped(note, first='  ', rest='  ')
    return '\n'.join(lines)


def wrapped(text: str, width: int = WIDTH, first: str = '', rest: str = '') -> list[str]:
    """Wrap a paragraph between words, but not at hyphens; escape unprintable characters."""
    return textwrap.wrap(
        escaped(' '.join(text.split())),
        width,
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )


# ---- Warnings ------------------------------------------------------------------------------


def warnings_about(robot: RobotModel) -> tuple[ModelWarning, ...]:
    """Return the warnings from loading a robot, and warnings about its effort limits."""
    return (*robot.warnings, *effort_limit_warnings(robot))


def warnings_as_text(warnings: Sequence[ModelWarning]) -> str:
    """Format warnings, grouped by their hints."""
    if not warnings:
        return 'No warnings.'
    lines = [counted(len(warnings), 'warning')]
    groups: dict[str, list[ModelWarning]] = {}
    for warning in warnings:
        groups.setdefault(warning.hint, []).append(warning)
    for hint, group in groups.items():
        for warning in group:
            lines += wrapped(str(warning), first='  ', rest='    ')
        lines += wrapped(hint, first='    -> ', rest='       ')
    return '\n'.join(lines)


# ---- Numbers and units ---------------------------------------------------------------------


def effort_unit(robot: RobotModel, joint: int) -> str:
    """Return the unit of an effort, padded to three characters."""
    return 'N  ' if robot.is_prismatic_joint[joint] else 'N m'


def counted(count: int, noun: str) -> str:
    """Write a number and a noun, which is in the plural unless the number is 1."""
    return f'{count} {noun}' if count == 1 else f'{count} {noun}s'


def or_dash(value: float, how: str) -> str:
    """Write a number in the format `how`, or a dash for a number that is not finite."""
    return format(value, how) if math.isfinite(value) else '-'


def number(value: float) -> str:
    """Write a limit, or a dash for an infinite limit."""
    if not math.isfinite(value):
        return '-'
    return f'{value:.0f}' if 1e4 <= abs(value) < 1e7 else f'{value:.4g}'


def fraction(effort: float, limit: float) -> str:
    """Write an effort as a percentage of its limit, or a dash if the limit is infinite."""
    return percent(abs(effort) / limit) if math.isfinite(limit) else '-'


def percent(ratio: float) -> str:
    """Write a ratio as a percentage, with a decimal if it is almost 1."""
    return f'{ratio:.1%}' if 0.0 < abs(ratio - 1.0) < 0.005 else f'{ratio:.0%}'


def decimals(values: Floats) -> int:
    """Return how many decimals, from 1 to 6, show four digits of the largest value."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if not 0.0 < largest < math.inf:
        return 1
    return min(6, max(1, 3 - math.floor(math.log10(largest))))


def with_error(value: float, error: float) -> str:
    """Write a value and its standard error, with as many digits as the error justifies."""
    if not error > 0.0 or not math.isfinite(error):
        return significant(value, 4)
    places = min(6, max(0, 1 - math.floor(math.log10(error))))
    return f'{value:.{places}f} ± {error:.{places}f}'


def motion_notes(motion: Motion) -> list[str]:
    """Return notes about ignored, repaired and doubtful data, without full stops."""
    notes = list(motion.notes)
    if math.isfinite(motion.cut_off):
        notes.append(
            f'above about {motion.cut_off:.0f} Hz, the efforts contain neither signal nor noise: '
            'either a low-pass filter acted before the recording, or the efforts were computed '
            'without noise. A filter distorts the friction at reversals; record unfiltered '
            'efforts from the driver'
        )
    return notes
