"""A process that runs long tasks for the node while the control loop runs."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
import contextlib
import ctypes
import multiprocessing
import os
import pickle
import signal
import traceback
from typing import Any

from ..errors import InverseDynamicsError

with contextlib.suppress(ImportError):  # reported when a trajectory is filled
    # Imported here, because the import would take tenths of a second in the child process.
    import scipy.interpolate  # noqa: F401

_PR_SET_PDEATHSIG = 1  # prctl(2)


class Worker:
    """
    Calls functions one at a time in a child process.

    A thread that reads a long message would hold the global interpreter lock for
    milliseconds, and so delay the control loop. On a busy machine, the scheduler may also
    interrupt the thread while it holds the lock.

    The child process is a copy of this process. Create the worker after the imports, so that the
    processes share the memory of the libraries. Create the worker before the node, so that the
    copy contains no ROS entities. Create `Scheduling` before the worker, so that the threads
    that the worker starts in this process get the priority of the loop. If `has_process` is
    false or the child process has ended, a thread calls the functions.
    """

    def __init__(self, has_process: bool = False) -> None:
        self.problem = ''
        """Why the child process could not be created, or an empty string."""
        self._executor: Executor = ThreadPoolExecutor(1, 'worker')
        if has_process:
            try:
                fork = multiprocessing.get_context('fork')
                pool = ProcessPoolExecutor(1, fork, _prepare, (os.getpid(),))
                pool.submit(int)  # creates the process
                self._executor = pool
            except OSError as error:  # a limit on processes or on memory
                self.problem = (
                    f'cannot create a process for long tasks ({error}): a thread runs the tasks '
                    'instead, and delays commands'
                )

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """
        Schedule a call of a module-level function, and pickle the arguments now.

        Callers must poll the future, because its callbacks run in another thread.
        """
        request = pickle.dumps((function, arguments))
        try:
            return self._executor.submit(_call, request)
        except BrokenExecutor:  # the process has ended, for example for lack of memory
            self._executor = ThreadPoolExecutor(1, 'worker')
            return self._executor.submit(_call, request)


def _prepare(parent: int) -> None:
    """Make the child process ignore signals, end with its parent, and run at normal priority."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # sent by a terminal or a service manager
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # the parent may run under chrt


def _call(request: bytes) -> Any:
    function, arguments = pickle.loads(request)
    try:
        return function(*arguments)
    except InverseDynamicsError:
        raise
    except Exception:  # an error of a library cannot always be pickled
        raise InverseDynamicsError(traceback.format_exc()) from None
