"""Makes standard output and standard error non-blocking, and replaces them if they are closed."""

from __future__ import annotations

import contextlib
import io
import os
import stat
import sys
from typing import Any


def unblock_output() -> None:
    """
    Make standard output and standard error safe to write to from the control loop.

    Without a reader, text is dropped and the writer continues. rclpy's logger writes while it
    holds Python's global lock, so that a write that blocks would stop all threads, and no thread
    could take over the writing.

    """
    for number, name in ((1, 'stdout'), (2, 'stderr')):
        try:
            _unblock(number)
        except OSError:  # closed: otherwise the next socket gets this number, and the log with it
            _open_as(os.devnull, number, os.O_WRONLY)
        output: Any = _LossyOutput(number, 'w', closefd=False)
        setattr(sys, name, io.TextIOWrapper(output, errors='backslashreplace', write_through=True))


def report_failure(message: str) -> None:
    """Write a message to standard error."""
    sys.stderr.write(f'inverse_dynamics_node: {message}\n')


def _unblock(number: int) -> None:
    """Open the same pipe or terminal again, non-blocking: other processes may use the first."""
    mode = os.fstat(number).st_mode
    if stat.S_ISSOCK(mode):  # cannot be opened again
        os.set_blocking(number, False)
    elif stat.S_ISFIFO(mode) or stat.S_ISCHR(mode):
        flags = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY
        with contextlib.suppress(OSError):  # a terminal of another user, a pipe without a reader
            _open_as(f'/proc/self/fd/{number}', number, flags)


def _open_as(path: str, number: int, flags: int) -> None:
    new = os.open(path, flags)
    if new != number:
        os.dup2(new, number)
        os.close(new)


class _LossyOutput(io.FileIO):
    """A file that drops the text that cannot be written at once."""

    def write(self, data: Any) -> int:
        with contextlib.suppress(OSError):
            super().write(data)
        return len(data)
