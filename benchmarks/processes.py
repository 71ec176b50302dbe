"""Processes of a measurement: priorities, start, end, memory, and other load on the CPUs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
import ctypes
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
from types import FrameType
from typing import Any

PRIORITY = 50
"""Real-time priority of contenders, equal to the node's default."""
_ROBOT_PRIORITY = 60
_BUSY = 'while True: pass'
_PATIENCE = 30.0  # [s]; longest time from SIGTERM to the end of a process
_PR_CAPBSET_DROP, _CAP_SYS_NICE = 24, 23


def raise_robot_side() -> bool:
    """
    Give this process a higher priority than all contenders; return whether that is permitted.

    This process simulates the driver of the robot. Drivers that send 1000 joint states per second
    also have real-time priority, and delays of this process must not count as delays of the
    contenders. Call this function before any thread is started.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_ROBOT_PRIORITY))
    except (AttributeError, PermissionError):
        return False
    return True


def normal() -> None:
    """Start a process at normal priority, with permission to raise it."""
    if hasattr(os, 'sched_setscheduler'):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def realtime() -> None:
    """Start a process at real-time priority, as ``chrt -f 50`` does."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def forbidden() -> None:
    """Start a process at normal priority, without permission to raise it."""
    normal()
    ctypes.CDLL(None).prctl(_PR_CAPBSET_DROP, _CAP_SYS_NICE, 0, 0, 0)
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))


def heed_signals() -> None:
    """Let SIGTERM and SIGHUP end this program like Ctrl-C, so that ``finally`` blocks run."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupt)


def start(
    module: Sequence[str], prepare: Callable[[], None] = normal, **options: Any
) -> subprocess.Popen[str]:
    """
    Start a Python module with its arguments, by default at normal priority.

    Ctrl-C does not reach the new process. This program must end it.
    """
    return subprocess.Popen(
        [sys.executable, '-m', *module],
        preexec_fn=prepare,
        start_new_session=True,
        text=True,
        **options,
    )


def end(processes: Sequence[subprocess.Popen[Any]]) -> None:
    """End processes, first with SIGTERM, so that the processes remove their shared memory."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # a second Ctrl-C would leave processes behind
    for process in processes:
        process.terminate()
    for process in processes:
        try:
            process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def waiting_times(pid: int) -> dict[str, float]:
    """Return how long each thread of a process has waited for a CPU [s], by thread number."""
    found = {}
    for path in Path(f'/proc/{pid}/task').iterdir():
        with contextlib.suppress(OSError):  # the thread has ended
            found[path.name] = 1e-9 * int((path / 'schedstat').read_text().split()[1])
    return found


def children(pid: int) -> list[int]:
    """Return the processes that a process has started."""
    found = []
    for path in Path(f'/proc/{pid}/task').iterdir():
        with contextlib.suppress(OSError):  # the thread has ended
            found += [int(each) for each in (path / 'children').read_text().split()]
    return found


def resident(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 2**20


class BusyProcesses:
    """Processes at normal priority that keep the CPUs busy; they are stopped until needed."""

    def __init__(self, count: int) -> None:
        command = [sys.executable, '-c', _BUSY]
        self._processes = [subprocess.Popen(command, preexec_fn=normal) for _ in range(count)]
        self._signal(signal.SIGSTOP)

    @contextlib.contextmanager
    def running(self, is_wanted: bool = True) -> Iterator[None]:
        """Let the busy processes run during the context."""
        if not is_wanted:
            yield
            return
        self._signal(signal.SIGCONT)
        try:
            yield
        finally:
            self._signal(signal.SIGSTOP)

    def close(self) -> None:
        """End the busy processes."""
        for process in self._processes:
            process.kill()
            process.wait()

    def _signal(self, number: int) -> None:
        for process in self._processes:
            process.send_signal(number)
