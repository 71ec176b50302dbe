"""
Prints results in colours on a terminal, and as plain text elsewhere.

Unprintable characters are escaped, so that names from files and messages cannot control the
terminal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import os
import sys
from typing import Any

from ..errors import escaped
from ..report.tables import (
    Line,
    Table,
    table_lines,
    warning_lines,
    WIDTH,
    wrapped,
)
from ..robot.model import ModelWarning


def show(*tables: Table) -> None:
    """Print each table, followed by an empty line."""
    terminal = _terminal()
    for table in tables:
        if terminal is None:
            lines = table_lines(table, whole_names=not sys.stdout.isatty())
        else:
            lines = table_lines(table, terminal.width)
        _print(lines, terminal)


def show_warnings(warnings: Sequence[ModelWarning]) -> None:
    """Print the warnings with their hints, and an empty line."""
    if warnings:
        terminal = _terminal()
        width = WIDTH if terminal is None else min(WIDTH, terminal.width)
        _print(warning_lines(warnings, width), terminal)


def say(text: str) -> None:
    """Print one paragraph."""
    print('\n'.join(wrapped(text, WIDTH)))


@contextmanager
def waiting(label: str) -> Iterator[None]:
    """Show a spinner on a terminal while the `with` block runs."""
    terminal = _terminal(stderr=True)
    if terminal is None:
        yield
        return
    from rich.text import Text

    with terminal.status(Text(label)):
        yield


@contextmanager
def progress(label: str) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on a terminal; yield a function that sets the completed fraction."""
    terminal = _terminal(stderr=True)
    if terminal is None:
        yield lambda fraction: None
        return
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=terminal, transient=True) as bar:
        task = bar.add_task(escape(label), total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)


class EscapedOutput:
    """A text stream that escapes all unprintable characters except line ends."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write text; return its length."""
        self.stream.write(escaped_lines(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write lines, without adding line ends."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def escaped_lines(text: str) -> str:
    """Escape the unprintable characters of a text, except its line ends."""
    return '\n'.join(map(escaped, text.split('\n')))


@contextmanager
def escaped_output() -> Iterator[None]:
    """Escape the text that the `with` block writes to standard output and standard error."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (stream and EscapedOutput(stream) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def colour_console(stderr: bool = False, environment: Mapping[str, str] = os.environ) -> Any:
    """Return a `rich.console.Console` that prints in colour and escapes unprintable characters."""
    from rich.console import Console
    from rich.segment import Segment

    class EscapingConsole(Console):
        def render(self, *arguments: Any, **options: Any) -> Iterator[Segment]:
            for part in super().render(*arguments, **options):
                if part.control:
                    yield part
                else:
                    yield Segment(escaped_lines(part.text), part.style)

    stream: Any = sys.stderr if stderr else sys.stdout
    if isinstance(stream, EscapedOutput):
        stream = stream.stream
    return EscapingConsole(file=stream, highlight=False, _environ=environment)


def _terminal(stderr: bool = False) -> Any:
    """Return a colour console, or None if there is no terminal or rich is not installed."""
    if not (sys.stderr if stderr else sys.stdout).isatty():
        return None
    try:
        return colour_console(stderr)
    except ModuleNotFoundError:
        return None


def _print(lines: Iterable[Line], terminal: Any) -> None:
    """Print lines and an empty line; a terminal shows the styles and wraps long lines."""
    for text, style in lines:
        if terminal is None:
            print(text)
        else:
            from rich.text import Text

            terminal.print(Text(text, style), soft_wrap=True)
    print()
