"""
The boundary to the terminal: names in files and messages cannot control it.

Everything that a command prints passes here, in colours or not. Characters that are not printable,
such as those that begin an escape sequence or change the direction of the text, are escaped.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import os
import sys
from typing import Any

from ..errors import escaped


class EscapedOutput:
    """
    A stream that escapes all characters that are not printable, except for line ends.

    Parameters
    ----------
    stream : text stream
        Standard output or standard error.

    """

    def __init__(self, stream: Any) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write text; return its length."""
        self.stream.write(escaped_lines(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write lines, which have line ends."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def escaped_lines(text: str) -> str:
    """Escape text of several lines."""
    return '\n'.join(map(escaped, text.split('\n')))


@contextmanager
def escaped_output() -> Iterator[None]:
    """Escape what is written to standard output and standard error within the body."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (stream and EscapedOutput(stream) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def colour_console(stderr: bool = False, environment: Mapping[str, str] = os.environ) -> Any:
    """Return a rich console that writes its own escape sequences, but none of the text."""
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
