"""What a command prints: tables with colours on a terminal, plain text anywhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import sys
from typing import Any

from ..report.advice import Concern
from ..report.report import (
    as_text,
    concerns_as_text,
    Table,
    WIDTH,
    wrapped,
)

_MARKS = ('beyond', 'outside')
"""Words that make a row red."""


def show(*tables: Table) -> None:
    """Print tables, with an empty line after each."""
    terminal = _terminal()
    for table in tables:
        if terminal is None:
            print(as_text(table, whole_names=not sys.stdout.isatty()), end='\n\n')
        else:
            _print_in_colour(terminal, table)


def show_concerns(concerns: Sequence[Concern]) -> None:
    """Print what looks wrong, and what to do about it."""
    terminal = _terminal()
    if terminal is None:
        print(concerns_as_text(concerns))
        return
    from rich.text import Text

    head, *lines = concerns_as_text(concerns, min(WIDTH, terminal.width)).splitlines()
    terminal.print(Text(head, style='bold yellow' if concerns else 'bold green'))
    is_advice = False
    for line in lines:
        is_advice = line.startswith('    ->') or (is_advice and line.startswith('       '))
        terminal.print(Text(line, style='cyan' if is_advice else ''))


def say(text: str) -> None:
    """Print one paragraph."""
    print('\n'.join(wrapped(text, WIDTH)))


@contextmanager
def waiting(label: str) -> Iterator[None]:
    """Show that something is going on, where somebody looks on."""
    terminal = _terminal(stderr=True)
    if terminal is None:
        yield
        return
    with terminal.status(label):
        yield


@contextmanager
def progress(label: str) -> Iterator[Callable[[float], None]]:
    """Show how far something is, where somebody looks on; what it yields takes the share done."""
    terminal = _terminal(stderr=True)
    if terminal is None:
        yield lambda share: None
        return
    from rich.progress import Progress

    with Progress(console=terminal, transient=True) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda share: bar.update(task, completed=share)


def _terminal(stderr: bool = False) -> Any:
    """Return a rich console on a terminal; None for a pipe, a file, or where rich is not here."""
    if not (sys.stderr if stderr else sys.stdout).isatty():
        return None
    try:
        from rich.console import Console
    except ModuleNotFoundError:
        return None
    return Console(stderr=stderr, highlight=False)  # minds NO_COLOR by itself


def _print_in_colour(terminal: Any, table: Table) -> None:
    """Print the lines of the plain table, in the terminal's width; too long ones wrap."""
    from rich.text import Text

    lines = as_text(table, terminal.width).splitlines()
    rows = 1 + len(table.rows) if table.rows else 0
    for k, line in enumerate(lines):
        if k == 0:
            style = 'bold'
        elif k > rows:
            style = 'dim'
        elif k == 1:
            style = 'cyan'
        else:
            style = 'bold red' if any(mark in line for mark in _MARKS) else ''
        terminal.print(Text(line, style=style), soft_wrap=True)
    terminal.print()
