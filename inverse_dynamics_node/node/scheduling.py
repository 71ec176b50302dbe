"""Real-time priority of the control loop, and of the threads that it waits for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
import contextlib
from dataclasses import replace
import functools
import os
from pathlib import Path
import platform
import threading
import time

from ..control.status import Level, SchedulingStatus
from .memory_lock import lock_memory, MemoryLockError

_TASKS = Path('/proc/self/task')
_WINDOW = 2.0  # [s]; CPU time is measured over this time
# The kernel stops real-time threads at 0.95 of a CPU (sched_rt_runtime_us), for 50 ms at a time.
_MAX_CPU = 0.9  # above this fraction of one CPU, the threads get normal priority,
_CALM_CPU = 0.5  # until they need less than this
_CALM_TIME = 10.0  # [s]; for this long

_HINT = (
    'to permit it, add "@realtime - rtprio 99" and "@realtime - memlock unlimited" to '
    '/etc/security/limits.conf, join the group realtime and log in again, or start the container '
    'with --cap-add=SYS_NICE --ulimit rtprio=99 --ulimit memlock=-1; see doc/realtime.md'
)


@functools.cache
def available_cpus() -> frozenset[int]:
    """Return the numbers of the CPUs that the process could use when it was started."""
    if hasattr(os, 'sched_getaffinity'):
        return frozenset(os.sched_getaffinity(0))
    return frozenset(range(os.cpu_count() or 1))


class Scheduling:
    """
    Lets the control loop and the middleware run before other programs.

    Must be created by the thread of the control loop, right before the node: the threads that
    exist by then, those of libraries for numbers and of the log, keep their normal priority. All
    threads of the middleware get the priority, because each may hold a lock that the loop waits
    for. Threads and processes that are started later have normal priority (SCHED_RESET_ON_FORK).

    """

    def __init__(self) -> None:
        self._loop = threading.get_native_id()
        self._others = set(_thread_ids()) - {self._loop}
        self._threads: dict[int, int] = {}  # priorities of the real-time threads, by id
        self._cpus: Sequence[int] = ()
        self._is_realtime = False
        self._is_configuring = False
        self._is_limited = False
        self._problem = 'normal priority: the parameter thread_priority has not been applied'
        self._memory = 'not locked'
        self._reports: list[str] = []
        self._began, self._cpu_time = 0.0, 0.0
        self._calm_since = 0.0

    def apply(
        self, priority: int, cpus: Sequence[int], should_lock_memory: bool, guard: int
    ) -> tuple[bool, str]:
        """
        Set the priority and the CPUs of the threads, and lock the memory.

        Parameters
        ----------
        priority : int
            Priority of SCHED_FIFO, from 1 to 99.
        cpus : sequence of int
            The CPUs to run on; empty for all.
        should_lock_memory : bool
            Whether to lock the memory.
        guard : int
            Native id of the thread that calls `limit_time`. It gets a higher priority than the
            loop, so that it runs while the loop does not sleep.

        Returns
        -------
        is_well : bool
            Whether all of it was permitted.
        text : str
            One line for the log.

        """
        self._threads = {self._loop: priority, guard: min(priority + 1, 99)}
        self._threads.update(dict.fromkeys(self._new_threads(), priority))
        self._cpus = cpus
        problems, done = [], []
        try:
            self._set_realtime()
            self._problem = ''
            done.append(f'SCHED_FIFO priority {priority} for the control loop and the middleware')
        except OSError as error:
            self._problem = f'normal priority: SCHED_FIFO {priority} is {_reason(error)}'
            if _policy(self._loop) == 'SCHED_OTHER':
                problems.append(self._problem)
            else:  # started by chrt
                self._problem = ''
                done.append('real-time priority of the program that started this process')
        if cpus:
            self._pin(self._threads)
            done.append(f'on CPU {", ".join(map(str, cpus))}')
        if should_lock_memory:
            try:
                self._memory = lock_memory()
                done.append(self._memory)
            except MemoryLockError as error:
                self._memory = str(error)
                problems.append(self._memory)
        self._start_window()
        if problems and hasattr(os, 'sched_setscheduler'):
            problems.append(_HINT)
        return not problems, '; '.join([*done, *problems])

    def _new_threads(self) -> list[int]:
        """Return the threads that the middleware and the executor of rclpy have started."""
        python = {thread.native_id for thread in threading.enumerate()}
        known = self._others | python | set(self._threads)
        return sorted(set(_thread_ids()) - known)

    def _adopt_new_threads(self) -> None:
        for tid in self._new_threads():
            self._threads[tid] = self._threads[self._loop]
            with contextlib.suppress(ProcessLookupError):
                if self._is_realtime:
                    _schedule(tid, self._threads[tid])
                if self._cpus:
                    self._pin([tid])

    def _set_realtime(self) -> None:
        if not hasattr(os, 'sched_setscheduler'):
            raise OSError(f'not available on {platform.system()}')
        for tid, priority in self._threads.items():
            with contextlib.suppress(ProcessLookupError):
                _schedule(tid, priority)
        self._is_realtime = True

    def _set_normal(self) -> None:
        self._is_realtime = False
        for tid in self._threads:
            with contextlib.suppress(ProcessLookupError):
                _schedule(tid, 0)

    def _pin(self, tids: Iterable[int]) -> None:
        for tid in tids:
            with contextlib.suppress(ProcessLookupError):
                os.sched_setaffinity(tid, self._cpus)

    @contextlib.contextmanager
    def normal_priority(self) -> Iterator[None]:
        """Run work of the loop's thread that takes long, such as compiling, at normal priority."""
        self._is_configuring = True
        was_realtime = self._is_realtime
        if was_realtime:
            _schedule(self._loop, 0)
        before = set(_thread_ids())
        try:
            yield
        finally:
            self._others |= set(_thread_ids()) - before
            if was_realtime and self._is_realtime:
                _schedule(self._loop, self._threads[self._loop])
            self._start_window()
            self._is_configuring = False

    def limit_time(self) -> None:
        """
        Give the threads normal priority while they need almost all of a CPU.

        Called by the guard again and again. At real-time priority, a loop that never sleeps would
        leave no time to other programs, not even to the terminal that could stop it.

        """
        now = time.monotonic()
        if self._is_configuring or now < self._began + _WINDOW or not self._threads:
            return
        self._adopt_new_threads()
        before, began = self._cpu_time, self._began
        self._start_window()
        fraction = (self._cpu_time - before) / (now - began)
        if self._is_realtime and fraction > _MAX_CPU:
            self._set_normal()
            self._is_limited, self._calm_since = True, now
            self._problem = (
                f'normal priority: the loop and the middleware needed {100 * fraction:.0f} % of a '
                f'CPU, expected at most {100 * _MAX_CPU:.0f} %'
            )
            self._reports.append(f'{self._problem}; reduce the rates of the topics')
        elif self._is_limited:
            if fraction > _CALM_CPU:
                self._calm_since = now
            elif now > self._calm_since + _CALM_TIME:
                self._is_limited = False
                self._restore()

    def _restore(self) -> None:
        try:
            self._set_realtime()
        except OSError as error:
            self._problem = f'normal priority: SCHED_FIFO is {_reason(error)}'
            return
        self._problem = ''
        self._reports.append('SCHED_FIFO again: the loop and the middleware need less CPU time')

    def _start_window(self) -> None:
        self._began = time.monotonic()
        self._cpu_time = sum(map(_cpu_time, self._threads))

    def new_reports(self) -> list[str]:
        """Return and forget the lines that `limit_time` has for the log."""
        reports, self._reports = self._reports, []
        return reports

    def status(self) -> SchedulingStatus:
        """Return policy and priority of the loop as the kernel reports them."""
        status = SchedulingStatus(message='real-time priority', memory=self._memory)
        if self._problem:
            status = replace(status, level=Level.WARN, message=self._problem)
        if not hasattr(os, 'sched_getscheduler'):
            return status
        return replace(
            status,
            policy=_policy(self._loop),
            priority=os.sched_getparam(self._loop).sched_priority,
            cpus=tuple(sorted(os.sched_getaffinity(self._loop))),
            threads=len(self._threads),
        )


def _thread_ids() -> list[int]:
    return [int(task.name) for task in _TASKS.iterdir()] if _TASKS.exists() else []


def _schedule(tid: int, priority: int) -> None:
    """Set the priority of SCHED_FIFO; 0 for normal priority."""
    # Without the flag, processes started by these threads would inherit the priority. Once it is
    # set, an unprivileged process cannot clear it.
    policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
    os.sched_setscheduler(tid, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _policy(tid: int) -> str:
    if not hasattr(os, 'sched_getscheduler'):
        return 'SCHED_OTHER'
    policy = os.sched_getscheduler(tid) & ~os.SCHED_RESET_ON_FORK
    return {os.SCHED_FIFO: 'SCHED_FIFO', os.SCHED_RR: 'SCHED_RR'}.get(policy, 'SCHED_OTHER')


def _cpu_time(tid: int) -> float:
    """Return the CPU time of a thread [s]; 0 after its end."""
    try:
        return time.clock_gettime((~tid << 3) | 6)  # pthread_getcpuclockid(3) without a pthread
    except OSError:
        return 0.0


def _reason(error: OSError) -> str:
    if not isinstance(error, PermissionError):
        return str(error)
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return f'not permitted (rtprio limit {limit})'
