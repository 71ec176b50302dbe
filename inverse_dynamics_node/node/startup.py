"""Reports causes of a start that hangs or fails, and ends it on a signal."""

from __future__ import annotations

import math
import os
from pathlib import Path
import resource
import select
import signal
import time
from types import TracebackType

from .console import report_failure

_PATIENCE = 10.0  # [s]
_ADDRESS_SPACE = 1500 << 20  # [bytes]; rclpy, numpy and numba on two cores need 1.2 GB
_SHARED_MEMORY = Path('/dev/shm')


class StartupWatch:
    """
    Explains a start that takes longer than ten seconds, from a separate process.

    Creating a ROS node and loading libraries hold Python's global lock: while they hang, no thread
    of the same process runs, and no signal is handled. The other process then ends this one ten
    seconds after a signal, or on a second one: nothing has been commanded yet. Use this as a
    context manager around the creation, in the main thread, before any thread is started.

    """

    def __init__(self, patience: float = _PATIENCE, directory: Path = _SHARED_MEMORY) -> None:
        reader, self._writer = os.pipe()
        parent = os.getpid()
        try:
            self._child = os.fork()
        except OSError:  # the limit of processes; the start continues without this help
            self._child = 0
            os.close(self._writer)
            os.close(reader)
            return
        if self._child == 0:
            try:
                os.close(self._writer)
                _watch(parent, reader, patience, directory)
            finally:
                os._exit(0)
        os.close(reader)
        os.set_blocking(self._writer, False)
        # The number of a signal arrives there at once, even if Python never handles the signal.
        signal.set_wakeup_fd(self._writer)

    def __enter__(self) -> StartupWatch:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.finish()

    def finish(self) -> None:
        """Stop watching; further calls do nothing."""
        if self._child:
            signal.set_wakeup_fd(-1)
            os.close(self._writer)
            os.waitpid(self._child, 0)
            self._child = 0


def empty_port_files(directory: Path = _SHARED_MEMORY) -> list[Path]:
    """Return the port files of Fast DDS in shared memory that were created but never filled."""
    return sorted(
        path
        for path in directory.glob('fastrtps_port*')
        if not path.name.endswith('_el') and path.stat().st_size == 0
    )


def warn_of_memory_limit() -> None:
    """Warn if the address space is limited to less than the libraries need to be loaded."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _ADDRESS_SPACE:
        report_failure(
            f'warning: the address space is limited to {limit >> 20} MB (ulimit -v), expected at '
            f'least {_ADDRESS_SPACE >> 20} MB; the process may fail to start, or hang'
        )


def _watch(parent: int, reader: int, patience: float, directory: Path) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # this process ends with its parent
    late, end = time.monotonic() + patience, math.inf
    while True:
        now = time.monotonic()
        if now >= end:
            if os.getppid() == parent:  # it may have just ended
                report_failure('the start does not respond to signals: it is killed')
                os.kill(parent, signal.SIGKILL)
            return
        if now >= late:
            _report_late(patience, directory)
            late = math.inf
        wait = min(late, end) - now
        if select.select([reader], [], [], wait if wait < math.inf else None)[0]:
            signals = os.read(reader, 2)
            if not signals:  # the parent has finished or ended
                return
            end = now if end < math.inf or len(signals) > 1 else now + patience


def _report_late(patience: float, directory: Path) -> None:
    report_failure(f'the start takes longer than {patience:g} s')
    for path in empty_port_files(directory):
        report_failure(
            f'{path} is empty, which makes every ROS process that opens it hang. A process that '
            'was stopped while it created the file left it behind. Stop all ROS processes that '
            f'hang (SIGKILL), then delete the file: rm {path}'
        )
