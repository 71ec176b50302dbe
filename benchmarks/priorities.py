"""Priorities of the measured processes, and other processes that keep all CPUs busy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import ctypes
import os
import resource
import signal
import subprocess
import sys

PRIORITY = 50
"""Real-time priority of contenders, equal to the node's default."""
_ROBOT_PRIORITY = 60
_BUSY = 'while True: pass'
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


class BusyProcesses:
    """Processes at normal priority that keep the CPUs busy; they are stopped until needed."""

    def __init__(self, count: int) -> None:
        self._processes = [_start([sys.executable, '-c', _BUSY], normal) for _ in range(count)]
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


def _start(command: list[str], prepare: Callable[[], None]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, preexec_fn=prepare)
