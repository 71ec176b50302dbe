"""Gives the control loop and the threads of the middleware real-time priority."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import os
import resource
import threading
from typing import NamedTuple

from .parameters import PRIORITY

_HINT = (
    'to permit real-time priority, add "@realtime - rtprio 99" to /etc/security/limits.conf, join '
    'the group realtime and log in again, or start the container with --cap-add=SYS_NICE --ulimit '
    'rtprio=99; see doc/realtime.md'
)


class Scheduled(NamedTuple):
    """The scheduling of the control loop, as reported by the kernel."""

    policy: str
    priority: int
    problem: str
    """Why the loop has no real-time priority; '' if it has."""
    is_requested: bool
    """Whether the user has asked for real-time priority."""


class Scheduling:
    """
    Gives the control loop and the middleware precedence over other programs.

    Create this object in the thread of the control loop, before the worker and the node. Threads
    that already exist, such as those of numerical libraries and the log, keep normal priority.
    Threads of the middleware get real-time priority, because the loop may wait for their locks. A
    new thread inherits the priority of its parent thread.
    """

    def __init__(self) -> None:
        self._loop = threading.get_native_id()
        self._others = set(_thread_ids()) - {self._loop}
        self._priority, self._is_requested = 0, False
        self._problem = 'normal priority: the parameter thread_priority has not been applied'

    def apply(self, requested: int, watchdog: int) -> tuple[bool, str]:
        """
        Set the SCHED_FIFO priority of the threads, from 1 to 99; 0 means the usual one.

        `watchdog` is the native id of the watchdog thread. The watchdog gets a higher priority
        than the loop (at most 99), because a busy loop might never sleep. Return whether the
        scheduling is as requested, and one line for the log.
        """
        priority, self._is_requested = requested or PRIORITY, bool(requested)
        try:
            for tid in set(_thread_ids()) - self._others:
                with contextlib.suppress(ProcessLookupError):  # the thread has just ended
                    _schedule(tid, min(priority + 1, 99) if tid == watchdog else priority)
        except PermissionError:
            if _policy(self._loop) != 'SCHED_OTHER':  # started by chrt
                self._problem = ''
                return True, 'real-time priority set by the program that started this process'
            limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
            reason = f'not permitted (rtprio limit {limit})'
            self._problem = f'normal priority: SCHED_FIFO {priority} is {reason}'
            return not requested, f'{self._problem}; {_HINT}'
        self._priority, self._problem = priority, ''
        return True, f'SCHED_FIFO priority {priority} for the control loop and the middleware'

    @contextlib.contextmanager
    def normal_priority(self) -> Iterator[None]:
        """Give the loop thread normal priority during a long task, such as compilation."""
        if self._priority:
            _schedule(self._loop, 0)
        try:
            yield
        finally:
            if self._priority:
                _schedule(self._loop, self._priority)

    def look(self) -> Scheduled:
        """Return the scheduling of the loop."""
        priority = os.sched_getparam(self._loop).sched_priority
        return Scheduled(_policy(self._loop), priority, self._problem, self._is_requested)


def _thread_ids() -> list[int]:
    return [int(name) for name in os.listdir('/proc/self/task')]


def _schedule(tid: int, priority: int) -> None:
    policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
    os.sched_setscheduler(tid, policy, os.sched_param(priority))


def _policy(tid: int) -> str:
    policy = os.sched_getscheduler(tid) & ~os.SCHED_RESET_ON_FORK
    return {os.SCHED_FIFO: 'SCHED_FIFO', os.SCHED_RR: 'SCHED_RR'}.get(policy, 'SCHED_OTHER')
