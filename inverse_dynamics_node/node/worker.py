"""A process that does long work for the node while the control loop runs."""

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

_PR_SET_PDEATHSIG = 1  # prctl(2)


class Worker:
    """
    Calls functions in a child process, one after the other.

    A thread would keep the lock of the interpreter for milliseconds, while it reads a message or
    an XML file. Beside busy processes that takes even longer, because the scheduler interrupts a
    thread of normal priority while it keeps the lock, and the control loop waits.

    Parameters
    ----------
    has_process : bool
        Whether to create the child, as a copy of this process. Create it before the node, so that
        the copy has no entities of ROS, and after the imports, so that both share the memory of
        the libraries. Without it, and after its end, a thread does the work. Create `Scheduling`
        before: the threads of the executor hold the lock of the interpreter, too.

    """

    def __init__(self, has_process: bool = False) -> None:
        self.problem = ''
        """Why there is no process although one was requested; empty if there is one."""
        self._executor: Executor = ThreadPoolExecutor(1, 'worker')
        if has_process:
            try:
                fork = multiprocessing.get_context('fork')
                pool = ProcessPoolExecutor(1, fork, _prepare, (os.getpid(),))
                pool.submit(int)  # creates the process
                self._executor = pool
            except OSError as error:  # the limit of processes, or of memory
                self.problem = f'no process for long work ({error}): a thread delays the commands'

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """
        Call a function of a module later, with arguments that are pickled now.

        The future is completed by another thread: ask it regularly whether it is done.

        """
        request = pickle.dumps((function, arguments))
        try:
            return self._executor.submit(_call, request)
        except BrokenExecutor:  # the process has ended, from a lack of memory for example
            self._executor = ThreadPoolExecutor(1, 'worker')
            return self._executor.submit(_call, request)


def prepare_to_load() -> None:
    """Import the modules that the first robot description needs; the child shares them."""
    with contextlib.suppress(ImportError):  # reported when a description is loaded
        import scipy.interpolate  # noqa: F401
        import yourdfpy  # noqa: F401


def _prepare(parent: int) -> None:
    """Let a new process end with its parent only, and run at normal priority."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # of the terminal or of a service manager
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
    except Exception:  # those of libraries may not survive the way to another process
        raise InverseDynamicsError(traceback.format_exc()) from None
