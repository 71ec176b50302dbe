"""Calls functions in a process beside the control loop, which they would delay."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
import ctypes
import multiprocessing
import os
import pickle
import signal
import traceback
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode

from ..errors import InverseDynamicsError, TrajectoryError

Refuse = Callable[[object], None]
"""Gets the reason why a request is not carried out."""
_PERIOD = 0.005  # [s]; between checks for results
_PR_SET_PDEATHSIG = 1  # prctl(2)
_ENDED = (
    'the process that reads trajectories has ended, for example for lack of memory; restart the '
    'node to use trajectories'
)


class Worker:
    """
    Calls functions one at a time in a child process.

    A thread that reads a long message would hold the global interpreter lock for
    milliseconds, and so delay the control loop. On a busy machine, the scheduler may also
    interrupt the thread while it holds the lock.

    The child process is a copy of this process. Create the worker after the imports, so that the
    processes share the memory of the libraries. Create the worker before the node, so that the
    copy contains no ROS entities. Create `Scheduling` before the worker, so that the threads
    that the worker starts in this process get the priority of the loop.
    """

    def __init__(self) -> None:
        self.problem = ''
        """Why the child process could not be created, or an empty string."""
        try:
            fork = multiprocessing.get_context('fork')
            self._pool = ProcessPoolExecutor(1, fork, _prepare, (os.getpid(),))
            self._pool.submit(int)  # creates the process
        except OSError as error:  # a limit on processes or on memory
            self.problem = f'cannot create the process that reads trajectories ({error})'

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """
        Schedule a call of a module-level function, and pickle the arguments now.

        Callers must poll the future, because its callbacks run in another thread. Raise a
        TrajectoryError if the process could not be created or has ended.
        """
        if self.problem:
            raise TrajectoryError(self.problem)
        try:
            return self._pool.submit(_call, pickle.dumps((function, arguments)))
        except BrokenExecutor as error:
            raise TrajectoryError(_ENDED) from error


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


class WorkQueue:
    """Passes functions to a worker, and their results on, in the same order."""

    def __init__(self, node: LifecycleNode, worker: Worker) -> None:
        self._worker = worker
        self._waiting: deque[tuple[Future[Any], Callable[[Any], None], Refuse]] = deque()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_PERIOD, self.poll, clock=steady)
        self._timer.cancel()

    def __len__(self) -> int:
        """Return how many results have not been passed on yet."""
        return len(self._waiting)

    def submit(
        self,
        finish: Callable[[Any], None],
        refuse: Refuse,
        function: Callable[..., Any],
        *arguments: Any,
    ) -> None:
        """
        Schedule a call of a module-level function, and pickle the arguments now.

        `finish` gets the result. `refuse` gets an error of the function, or a
        InverseDynamicsError of `finish`. Raise a TrajectoryError if the worker has no process.
        """
        future = self._worker.submit(function, *arguments)
        self._waiting.append((future, finish, refuse))
        self._timer.reset()

    def poll(self) -> None:
        """Pass on the next result if there is one."""
        if not self._waiting:
            self._timer.cancel()
        elif self._waiting[0][0].done():
            future, finish, refuse = self._waiting.popleft()
            try:
                result = future.result()
            except BrokenExecutor:
                refuse(_ENDED)
                return
            except Exception as error:  # any error in the other process
                refuse(error)
                return
            try:
                finish(result)
            except InverseDynamicsError as error:
                refuse(error)
