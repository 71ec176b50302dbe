"""Prints results without unprintable characters, shows progress, and handles signals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import signal
import sys

from ..errors import escaped
from ..report.tables import wrapped


def show(*texts: str) -> None:
    """Print each text, followed by an empty line."""
    for text in texts:
        print(f'{text}\n')


def say(text: str) -> None:
    """Print one paragraph."""
    print('\n'.join(wrapped(text)))


@contextmanager
def progress(label: str) -> Iterator[Callable[[float], None]]:
    """Show the label on a terminal; yield a function that shows the completed fraction."""
    if not sys.stderr.isatty():
        yield lambda fraction: None
        return

    def report(fraction: float) -> None:
        print(f'\r{escaped(label)} {fraction:.0%} ', end='', file=sys.stderr, flush=True)

    print(escaped(label), end='', file=sys.stderr, flush=True)
    try:
        yield report
    finally:
        print('\r\x1b[K', end='', file=sys.stderr, flush=True)  # clears the line


@contextmanager
def handled_signals(handle: Callable[[int, object], object]) -> Iterator[None]:
    """Call `handle` for SIGINT, SIGTERM and SIGHUP in the ``with`` block."""
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def collected_signals() -> Iterator[list[int]]:
    """Collect SIGINT, SIGTERM and SIGHUP in a list, so that the ``with`` block can end cleanly."""
    received: list[int] = []
    with handled_signals(lambda number, _: received.append(number)):
        yield received
