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
"""Of a contender with real-time priority; the node's default."""
_ROBOT_PRIORITY = 60
_BUSY = 'while True: pass'
_PR_CAPBSET_DROP, _CAP_SYS_NICE = 24, 23


def raise_robot_side() -> bool:
    """
    Give this process, the robot's side, a higher priority than all contenders.

    Call it before any thread is started. Drivers of robots that send 1000 states a second have
    real-time priority too, and the delays of this process are not those of the contenders.

    Returns
    -------
    is_permitted : bool
        Whether real-time priority is permitted.

    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_ROBOT_PRIORITY))
    except (AttributeError, PermissionError):
        return False
    return True


def normal() -> None:
    """Let a process that is about to start keep its permissions, but begin at normal priority."""
    if hasattr(os, 'sched_setscheduler'):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def realtime() -> None:
    """Start a process at real-time priority, as ``chrt -f 50`` does."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def forbidden() -> None:
    """Start a process at normal priority, and without permission to raise it."""
    normal()
    ctypes.CDLL(None).prctl(_PR_CAPBSET_DROP, _CAP_SYS_NICE, 0, 0, 0)
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))


class BusyProcesses:
    """Processes at normal priority that never sleep, stopped until they are needed."""

    def __init__(self, count: int) -> None:
        self._processes = [_start([sys.executable, '-c', _BUSY], normal) for _ in range(count)]
        self._signal(signal.SIGSTOP)

    @contextlib.contextmanager
    def running(self, is_wanted: bool = True) -> Iterator[None]:
        """Let them run."""
        if not is_wanted:
            yield
            return
        self._signal(signal.SIGCONT)
        try:
            yield
        finally:
            self._signal(signal.SIGSTOP)

    def close(self) -> None:
        """End them."""
        for process in self._processes:
            process.kill()
            process.wait()

    def _signal(self, number: int) -> None:
        for process in self._processes:
            process.send_signal(number)


def _start(command: list[str], prepare: Callable[[], None]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, preexec_fn=prepare)
