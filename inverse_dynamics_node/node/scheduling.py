"""Sets real-time priority for the control loop and related threads, and locks memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
import ctypes
import functools
import os
from pathlib import Path
import platform
import resource
import threading
import time

from ..control.status import Level, SchedulingStatus

_MAX_CPU = 0.9  # above this fraction of one CPU, the threads get normal priority
_CALM_CPU = 0.5  # below this fraction of one CPU, the threads get real-time priority again
_WINDOW, _CALM_WINDOW = 2.0, 10.0  # [s]; times over which the two fractions are measured
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # mlockall(2), <asm-generic/mman.h>

_HINT = (
    'to permit real-time priority and locked memory, add "@realtime - rtprio 99" and "@realtime - '
    'memlock unlimited" to /etc/security/limits.conf, join the group realtime and log in again, '
    'or start the container with --cap-add=SYS_NICE --ulimit rtprio=99 --ulimit memlock=-1; see '
    'doc/realtime.md'
)


@functools.cache
def available_cpus() -> frozenset[int]:
    """Return the CPUs that the process could use at the first call of this function."""
    return frozenset(os.sched_getaffinity(0))


def has_realtime_kernel() -> bool:
    """Return whether the kernel is built with PREEMPT_RT."""
    file = Path('/sys/kernel/realtime')
    is_marked = file.exists() and file.read_text().strip() == '1'
    return is_marked or 'PREEMPT_RT' in platform.version().split()


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
        self._priority = 0
        self._watchdog = 0
        self._is_realtime = self._is_limited = False
        self._problem = 'normal priority: the parameter thread_priority has not been applied'
        self._memory = 'not locked'
        self._start_window()

    def apply(
        self, priority: int, cpus: Sequence[int], should_lock_memory: bool, watchdog: int
    ) -> tuple[bool, str]:
        """
        Set the priority and the CPUs of the threads, and lock the memory.

        `priority` is the SCHED_FIFO priority of the loop, from 1 to 99. If `cpus` is empty, every
        CPU may be used. `watchdog` is the native id of the watchdog thread. The watchdog gets a
        higher priority than the loop (at most 99), because a busy loop might never sleep. Return
        whether everything was permitted, and one line for the log.
        """
        problems, done = [], []
        self._priority, self._watchdog, self._problem = priority, watchdog, ''
        try:
            self._set_priority(priority)
            done.append(f'SCHED_FIFO priority {priority} for the control loop and the middleware')
        except PermissionError:
            if _policy(self._loop) == 'SCHED_OTHER':
                limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
                reason = f'not permitted (rtprio limit {limit})'
                self._problem = f'normal priority: SCHED_FIFO {priority} is {reason}'
                problems.append(self._problem)
            else:  # started by chrt
                done.append('real-time priority set by the program that started this process')
        if cpus:
            for tid in self._threads():
                os.sched_setaffinity(tid, cpus)
            done.append(f'on CPU {", ".join(map(str, cpus))}')
        if should_lock_memory:
            try:
                self._memory = lock_memory()
                done.append(self._memory)
            except OSError as error:
                self._memory = str(error.strerror)
                problems.append(self._memory)
        self._start_window()
        return not problems, '; '.join([*done, *problems, *([_HINT] if problems else [])])

    def _threads(self) -> list[int]:
        """Return the ids of the threads that get real-time priority."""
        return [tid for tid in _thread_ids() if tid not in self._others]

    def _set_priority(self, priority: int) -> None:
        """Set the SCHED_FIFO priority of the threads; 0 means normal priority."""
        for tid in self._threads():
            with contextlib.suppress(ProcessLookupError):  # the thread has just ended
                is_watchdog = priority and tid == self._watchdog
                _schedule(tid, min(priority + 1, 99) if is_watchdog else priority)
        self._is_realtime = priority > 0

    @contextlib.contextmanager
    def normal_priority(self) -> Iterator[None]:
        """Give the loop thread normal priority during a long task, such as compilation."""
        before = set(_thread_ids())
        if self._is_realtime:
            _schedule(self._loop, 0)
        try:
            yield
        finally:
            self._others |= set(_thread_ids()) - before
            if self._is_realtime:
                _schedule(self._loop, self._priority)
            self._start_window()

    def limit_time(self) -> str:
        """
        Give the threads normal priority while the process needs almost all of a CPU.

        Call this method regularly. Return a log text if the priority has changed, otherwise an
        empty string. If a real-time loop never sleeps, the kernel leaves only 5 % of the CPU to
        other programs.
        """
        duration = time.monotonic() - self._began
        if duration < (_WINDOW if self._is_realtime else _CALM_WINDOW):
            return ''
        fraction = (time.process_time() - self._cpu_time) / duration
        self._start_window()
        if self._is_realtime and fraction > _MAX_CPU:
            self._set_priority(0)
            self._is_limited = True
            self._problem = (
                f'normal priority: the process needed {100 * fraction:.0f} % of a CPU, expected '
                f'at most {100 * _MAX_CPU:.0f} %'
            )
            return f'{self._problem}; reduce the rates of incoming messages'
        if self._is_limited and fraction < _CALM_CPU:
            self._set_priority(self._priority)
            self._is_limited, self._problem = False, ''
            return 'SCHED_FIFO again: the process needs less CPU time'
        return ''

    def _start_window(self) -> None:
        self._began, self._cpu_time = time.monotonic(), time.process_time()

    def status(self) -> SchedulingStatus:
        """Return the scheduling of the loop as reported by the kernel."""
        return SchedulingStatus(
            level=Level.WARN if self._problem else Level.OK,
            message=self._problem or 'real-time priority',
            policy=_policy(self._loop),
            priority=os.sched_getparam(self._loop).sched_priority,
            cpus=tuple(sorted(os.sched_getaffinity(self._loop))),
            threads=len(self._threads()),
            memory=self._memory,
        )


def lock_memory() -> str:
    """Lock each memory page at its first use; return a log text, or raise an OSError."""
    libc = ctypes.CDLL(None, use_errno=True)
    _, limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (limit, limit))
    # Under a limit, locking later allocations could end the process.
    is_limited = limit != resource.RLIM_INFINITY
    if libc.mlockall(_MCL_CURRENT | _MCL_ONFAULT | (0 if is_limited else _MCL_FUTURE)):
        number = ctypes.get_errno()
        bound = f' (memlock limit {limit >> 10} kB)' if is_limited else ''
        raise OSError(number, f'memory cannot be locked: {os.strerror(number)}{bound}')
    return 'only the memory in use at the start is locked' if is_limited else 'memory is locked'


def _thread_ids() -> list[int]:
    return [int(name) for name in os.listdir('/proc/self/task')]


def _schedule(tid: int, priority: int) -> None:
    policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
    os.sched_setscheduler(tid, policy, os.sched_param(priority))


def _policy(tid: int) -> str:
    policy = os.sched_getscheduler(tid) & ~os.SCHED_RESET_ON_FORK
    return {os.SCHED_FIFO: 'SCHED_FIFO', os.SCHED_RR: 'SCHED_RR'}.get(policy, 'SCHED_OTHER')
