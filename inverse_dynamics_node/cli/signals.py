"""Handles the signals that end a command."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import signal


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
