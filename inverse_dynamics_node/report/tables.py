"""
Formats tables, warnings, numbers and units as text.

A table contains only strings. Logs and services show tables as plain text. A terminal shows the
same lines in colours.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
import textwrap
from typing import NamedTuple, TYPE_CHECKING

import numpy as np

from ..errors import escaped, significant
from ..robot.limit_checks import effort_limit_warnings
from ..robot.model import Floats, ModelWarning, RobotModel

if TYPE_CHECKING:
    from ..analysis.recordings.signals import Motion

WIDTH = 100
"""Largest width of a report, in characters."""
SHORTEST_NAME = 12
"""Smallest number of characters of a shortened name."""
_GAP = '  '


class Table(NamedTuple):
    """A title, rows and notes."""

    title: str
    columns: tuple[str, ...] = ()
    """
    Titles of the columns.

    The first column contains names, which may be shortened. An empty column is left out.
    """
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()
    words: frozenset[int] = frozenset()
    """Indices of columns after the first that contain words and are aligned to the left."""
    marked: frozenset[int] = frozenset()
    """Indices of the rows that need attention, such as a joint beyond a limit."""


class Line(NamedTuple):
    """One line of text, and its terminal style in the notation of the `rich` library."""

    text: str
    style: str = ''


def as_text(table: Table, whole_names: bool = False) -> str:
    """Format a table as plain text without a final newline."""
    return '\n'.join(line.text for line in table_lines(table, WIDTH, whole_names))


def table_lines(table: Table, width: int = WIDTH, whole_names: bool = False) -> list[Line]:
    """
    Format a table in lines of at most `width` characters.

    With `whole_names`, names are not shortened, so that programs can read the names. Lines can
    then be longer than `width`.
    """
    lines = [Line(escaped(table.title), 'bold')]
    if table.rows:
        columns, *rows = _aligned(table, math.inf if whole_names else width - 2)
        lines.append(Line(columns, 'cyan'))
        lines += [Line(row, 'bold red' if k in table.marked else '') for k, row in enumerate(rows)]
    for note in table.notes:
        lines += [Line(line, 'dim') for line in wrapped(note, width - 2)]
    return [lines[0], *(Line(f'  {text}'.rstrip(), style) for text, style in lines[1:])]


def wrapped(text: str, width: int, first: str = '', rest: str = '') -> list[str]:
    """Wrap a paragraph between words, but not at hyphens."""
    return textwrap.wrap(
        text,
        width,
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _aligned(table: Table, width: float) -> list[str]:
    """Return a line of column titles, and one line for each row."""
    cells = [tuple(map(escaped, row)) for row in (table.columns, *table.rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    spare = width - sum(widths[1:]) - len(_GAP) * np.count_nonzero(widths[1:])
    widths[0] = int(min(widths[0], max(SHORTEST_NAME, spare)))
    names = [shortened(cells[0][0], widths[0])]
    names += all_shortened([row[0] for row in cells[1:]], widths[0])
    return [
        _GAP.join(
            [name.ljust(widths[0])]
            + [
                shortened(cell, size).ljust(size) if k in table.words else cell.rjust(size)
                for k, (cell, size) in enumerate(zip(row[1:], widths[1:], strict=True), 1)
                if size
            ]
        )
        for name, row in zip(names, cells, strict=True)
    ]


# ---- Warnings ------------------------------------------------------------------------------


def warnings_about(robot: RobotModel) -> tuple[ModelWarning, ...]:
    """Return the warnings from loading a robot, and warnings about its effort limits."""
    return (*robot.warnings, *effort_limit_warnings(robot))


def warnings_as_text(warnings: Sequence[ModelWarning]) -> str:
    """Format warnings as plain text, grouped by their hints."""
    return '\n'.join(line.text for line in warning_lines(warnings))


def warning_lines(warnings: Sequence[ModelWarning], width: int = WIDTH) -> list[Line]:
    """Format warnings as lines, grouped by their hints."""
    if not warnings:
        return [Line('No warnings.')]
    lines = [Line(counted(len(warnings), 'warning'), 'bold yellow')]
    groups: dict[str, list[ModelWarning]] = {}
    for warning in warnings:
        groups.setdefault(warning.hint, []).append(warning)
    for hint, group in groups.items():
        for warning in group:
            lines += map(Line, wrapped(str(warning), width, '  ', '    '))
        lines += [Line(x, 'cyan') for x in wrapped(hint, width, '    -> ', '       ')]
    return lines


# ---- Names ---------------------------------------------------------------------------------


def all_shortened(names: Sequence[str], size: int) -> list[str]:
    """Shorten names so that different names remain different."""
    short = [shortened(name, size) for name in names]
    if len(set(short)) == len(set(names)):
        return short
    head = _common_prefix(names)
    tail = _common_prefix([name[head:][::-1] for name in names])
    # Keep the part in which the names differ.
    parts = [name[head : len(name) - tail] for name in names]
    short = [f'…{shortened(part, size - 1)}' if head else shortened(part, size) for part in parts]
    for first in (size // 3, size // 4, 2 * size // 3, 1):
        if len(set(short)) == len(set(names)):
            break
        # Names may differ at both ends, so keep more of one end.
        rest = size - 1 - first
        short = [n if len(n) <= size else f'{n[:first]}…{n[len(n) - rest :]}' for n in names]
    return short


def shortened(text: str, size: int) -> str:
    """Replace the middle of a long text with "…", because names differ at the start or end."""
    if len(text) <= size:
        return text
    stem = text.removesuffix('_joint')
    if stem != text and size >= SHORTEST_NAME:  # the suffix carries no information
        return f'{shortened(stem, size - 1)}…'
    head = (size - 1) // 2
    return f'{text[:head]}…{text[len(text) - (size - 1 - head) :]}'


def _common_prefix(names: Sequence[str]) -> int:
    """Return the length of the common prefix of the names."""
    letters = list(zip(*names, strict=False))
    return next((i for i, each in enumerate(letters) if len(set(each)) > 1), len(letters))


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
    return f'{abs(effort) / limit:.0%}' if math.isfinite(limit) else '-'


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
    if motion.lags:
        late = ', '.join(f'{name} {1e3 * value:.0f} ms' for name, value in motion.lags.items())
        notes.append(
            f'recorded velocities lag behind the positions ({late}); velocities were derived from '
            'the positions instead'
        )
    if math.isfinite(motion.cut_off):
        notes.append(
            f'above about {motion.cut_off:.0f} Hz, the efforts contain neither signal nor noise: '
            'either a low-pass filter acted before the recording, or the efforts were computed '
            'without noise. A filter distorts the friction at reversals; record unfiltered '
            'efforts from the driver'
        )
    return notes
