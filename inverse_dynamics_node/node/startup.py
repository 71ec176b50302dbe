"""Reports causes of a start that hangs or fails."""

from __future__ import annotations

import os
from pathlib import Path
import resource
import select
import signal
from types import TracebackType

from .console import report_failure

_PATIENCE = 10.0  # [s]
_ADDRESS_SPACE = 1500 << 20  # [bytes]; rclpy, numpy and numba on two cores need 1.2 GB
_SHARED_MEMORY = Path('/dev/shm')


class StartupWatch:
    """
    Explains a start that takes longer than ten seconds, from a separate process.

    Creating a ROS node holds Python's global lock: while it hangs, no thread of the same process
    runs, and no signal is handled. Use this as a context manager around the creation, before any
    thread is started.

    """

    def __init__(self, patience: float = _PATIENCE, directory: Path = _SHARED_MEMORY) -> None:
        reader, self._writer = os.pipe()
        self._child = os.fork()
        if self._child == 0:
            try:
                os.close(self._writer)
                _watch(reader, patience, directory)
            finally:
                os._exit(0)
        os.close(reader)

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


def _watch(reader: int, patience: float, directory: Path) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # this process ends with its parent
    is_finished, _, _ = select.select([reader], [], [], patience)
    if is_finished:
        return
    files = empty_port_files(directory)
    report_failure(f'the start takes longer than {patience:g} s')
    for path in files:
        report_failure(
            f'{path} is empty, which makes every ROS process that opens it hang. A process that '
            'was stopped while it created the file left it behind. Stop all ROS processes that '
            f'hang (SIGKILL), then delete the file: rm {path}'
        )
    os.read(reader, 1)  # returns when the parent finishes or ends
