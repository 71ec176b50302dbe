"""Makes standard output and standard error non-blocking, and replaces them if they are closed."""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import stat
import sys
import syslog
from typing import Any

_PIPE_SIZE = 1 << 20  # [bytes]; room for messages while the reader is busy


def prepare_console() -> None:
    """
    Make standard output and standard error safe to write to from the control loop.

    Without a reader, text is dropped and the writer continues. rclpy's logger writes while it
    holds Python's global lock, so that a write that blocks would stop all threads, and no thread
    could take over the writing.

    """
    for number, name in ((1, 'stdout'), (2, 'stderr')):
        if not _is_open(number):
            # Otherwise the next file or socket gets this number, and the log is written into it.
            _open_as(os.devnull, number, os.O_WRONLY)
        else:
            _unblock(number)
        setattr(sys, name, _text_output(number))


def report_failure(message: str) -> None:
    """Write a message to standard error, or to the system log if there is no standard error."""
    text = f'inverse_dynamics_node: {message}'
    if sys.__stderr__ is None:  # closed at the start
        syslog.openlog('inverse_dynamics_node', syslog.LOG_PID)
        syslog.syslog(syslog.LOG_ERR, text)
    with contextlib.suppress(OSError):
        os.write(2, f'{text}\n'.encode(errors='backslashreplace'))


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True


def _unblock(number: int) -> None:
    """Open the same pipe or terminal again, non-blocking: other processes may use the first."""
    mode = os.fstat(number).st_mode
    if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode):
        try:
            _open_as(f'/proc/self/fd/{number}', number, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
        except OSError:  # a terminal of another user, or a pipe without a reader
            return
        if stat.S_ISFIFO(mode):
            with contextlib.suppress(OSError):
                fcntl.fcntl(number, fcntl.F_SETPIPE_SZ, _PIPE_SIZE)
    elif stat.S_ISSOCK(mode):  # cannot be opened again
        os.set_blocking(number, False)


def _open_as(path: str, number: int, flags: int) -> None:
    new = os.open(path, flags)
    if new != number:
        os.dup2(new, number)
        os.close(new)


class _LossyOutput(io.RawIOBase):
    """A file that drops the text that cannot be written at once."""

    def __init__(self, number: int) -> None:
        self._number = number

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._number

    def write(self, data: Any) -> int:
        with contextlib.suppress(OSError):
            os.write(self._number, data)
        return len(data)


def _text_output(number: int) -> io.TextIOWrapper:
    return io.TextIOWrapper(
        _LossyOutput(number),  # type: ignore[arg-type]
        errors='backslashreplace',
        write_through=True,
    )
