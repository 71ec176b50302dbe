"""
Tables as lines of text.

A table contains strings only, so that every reader gets the same numbers: logs and services plain
text, a terminal the same lines in colours.
"""

from __future__ import annotations

from enum import auto, Enum
import math
import textwrap
from typing import NamedTuple

from ..errors import escaped
from .short_names import all_shortened, shortened, SHORTEST_NAME

WIDTH = 100
"""Largest width of a report, in characters."""
_GAP = '  '


class Table(NamedTuple):
    """Rows below a title, followed by notes; a table without rows consists of its notes."""

    title: str
    columns: tuple[str, ...] = ()
    """The first column contains names, which may be shortened."""
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()
    words: frozenset[int] = frozenset()
    """Columns other than the first that contain words and are aligned to the left."""
    marked: frozenset[int] = frozenset()
    """Rows that need attention, such as a joint beyond a limit."""


class Style(Enum):
    """The role of a line, from which a terminal chooses its colour."""

    TITLE = auto()
    COLUMNS = auto()
    ROW = auto()
    MARKED_ROW = auto()
    NOTE = auto()
    WARNINGS = auto()
    NO_WARNINGS = auto()
    WARNING = auto()
    HINT = auto()


class Line(NamedTuple):
    """One line of text and its role."""

    text: str
    style: Style


def as_text(table: Table, width: int = WIDTH, whole_names: bool = False) -> str:
    """
    Format a table as plain text.

    Parameters
    ----------
    table, width, whole_names
        As for `table_lines`.

    Returns
    -------
    text : str
        Several lines, without a line end after the last.

    """
    return '\n'.join(line.text for line in table_lines(table, width, whole_names))


def table_lines(table: Table, width: int = WIDTH, whole_names: bool = False) -> list[Line]:
    """
    Format a table.

    Parameters
    ----------
    table : Table
        The table to format.
    width : int
        Length of the longest line, in characters.
    whole_names : bool
        Let rows be longer instead of shortening names, for programs that read them.

    Returns
    -------
    lines : list of Line

    """
    lines = [Line(escaped(table.title), Style.TITLE)]
    if table.rows:
        columns, *rows = _aligned(table, math.inf if whole_names else width - 2)
        lines.append(Line(columns, Style.COLUMNS))
        for k, row in enumerate(rows):
            lines.append(Line(row, Style.MARKED_ROW if k in table.marked else Style.ROW))
    for note in table.notes:
        lines += [Line(line, Style.NOTE) for line in wrapped(note, width - 2)]
    return [lines[0], *(Line(f'  {text}'.rstrip(), style) for text, style in lines[1:])]


def wrapped(text: str, width: int, first: str = '', rest: str = '') -> list[str]:
    """Wrap a paragraph between words; names and numbers with hyphens are not divided."""
    return textwrap.wrap(
        text,
        width,
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _aligned(table: Table, width: float) -> list[str]:
    """Return the line of column titles and one line for each row."""
    cells = [tuple(map(escaped, row)) for row in (table.columns, *table.rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(table.columns))]
    spare = width - sum(widths[1:]) - len(_GAP) * (len(widths) - 1)
    widths[0] = int(min(widths[0], max(SHORTEST_NAME, spare)))
    names = [shortened(cells[0][0], widths[0])]
    names += all_shortened([row[0] for row in cells[1:]], widths[0])
    return [
        _GAP.join(
            [name.ljust(widths[0])]
            + [
                shortened(cell, size).ljust(size) if k in table.words else cell.rjust(size)
                for k, (cell, size) in enumerate(zip(row[1:], widths[1:], strict=True), 1)
            ]
        )
        for name, row in zip(names, cells, strict=True)
    ]
