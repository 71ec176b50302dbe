"""A process that does long work for the node while the control loop runs."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
import contextlib
import os
import pickle
import signal
import tempfile
import traceback
from typing import Any

from ..errors import InverseDynamicsError

_SIZE = 8  # [bytes]; of the length of a request or an answer


class Background:
    """
    Calls functions in a child process, one after the other.

    A thread would keep the lock of the interpreter for milliseconds, while it reads a message or
    an XML file. Beside busy processes that takes even longer, because the scheduler interrupts a
    thread of normal priority while it keeps the lock, and the control loop waits. Neither side
    waits for the other one here: `poll` takes the results.

    Parameters
    ----------
    has_process : bool
        Whether to create the child, as a copy of this process. Create it before the node, so that
        the copy has no entities of ROS, and after the imports, so that both share the memory of
        the libraries. Without it, and after its end, a thread does the work.

    """

    def __init__(self, has_process: bool = False) -> None:
        self._waiting: deque[tuple[Future[Any], bytes]] = deque()
        self._current: Future[Any] | None = None
        self._thread: ThreadPoolExecutor | None = None
        self._child = 0
        self.problem = ''
        """Why there is no process although one was requested; empty if there is one."""
        self._on_busy: Callable[[], None] = lambda: None
        self._on_idle: Callable[[], None] = lambda: None
        if has_process:
            self._fork()

    def _fork(self) -> None:
        request_file, answer_file = files = _memory_file(), _memory_file()
        request_reader, request_writer = requests = os.pipe()
        answer_reader, answer_writer = answers = os.pipe()
        try:
            self._child = os.fork()
        except OSError as error:  # the limit of processes, or of memory
            for number in (*files, *requests, *answers):
                os.close(number)
            self.problem = f'no process for long work ({error}): a thread delays the commands'
            return
        if self._child == 0:
            try:
                _close_others(request_file, answer_file, request_reader, answer_writer)
                _serve(request_file, request_reader, answer_file, answer_writer)
            finally:
                os._exit(0)
        os.close(request_reader)
        os.close(answer_writer)
        os.set_blocking(answer_reader, False)
        self._request_file, self._request_writer = request_file, request_writer
        self._answer_file, self._answer_reader = answer_file, answer_reader

    def call_while_busy(self, on_busy: Callable[[], None], on_idle: Callable[[], None]) -> None:
        """Set functions that start and stop the calls of `poll`, which are stopped now."""
        self._on_busy, self._on_idle = on_busy, on_idle
        on_idle()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """
        Call a function later.

        Parameters
        ----------
        function : callable
            A function of a module.
        *arguments
            Its arguments, which are pickled now.

        Returns
        -------
        future : Future
            Its result, or its error as an `InverseDynamicsError`, after a call of `poll`.

        """
        future: Future[Any] = Future()
        # Those that were cancelled may be long.
        self._waiting = deque(call for call in self._waiting if not call[0].cancelled())
        self._waiting.append((future, pickle.dumps((function, arguments))))
        self._start_next()
        self._on_busy()
        return future

    def _start_next(self) -> None:
        while self._current is None and self._waiting:
            future, request = self._waiting.popleft()
            if future.set_running_or_notify_cancel():
                self._current = future
                self._send(request)

    def _send(self, request: bytes) -> None:
        if not self._child:
            if self._thread is None:
                self._thread = ThreadPoolExecutor(1, 'background')
            self._answer = self._thread.submit(_answer, request)
            return
        try:
            os.pwrite(self._request_file, request, 0)
            os.write(self._request_writer, len(request).to_bytes(_SIZE, 'little'))
        except OSError:
            self._replace_child(request)

    def _receive(self) -> bytes | None:
        """Return the answer to the current request, or None."""
        if not self._child:
            return self._answer.result() if self._answer.done() else None
        try:
            size = os.read(self._answer_reader, _SIZE)
        except BlockingIOError:
            return None
        if not size:
            self._replace_child(pickle.dumps((_report_end, ())))
            return None
        return os.pread(self._answer_file, int.from_bytes(size, 'little'), 0)

    def _replace_child(self, request: bytes) -> None:
        """Continue with a thread after the child has ended, from a lack of memory for example."""
        with contextlib.suppress(ChildProcessError):
            os.waitpid(self._child, 0)
        self._child = 0
        self._send(request)

    def poll(self) -> None:
        """Take a result if there is one, and start the next call."""
        if self._current is None:
            self._on_idle()
            return
        data = self._receive()
        if data is None:
            return
        is_well, result = pickle.loads(data)
        future, self._current = self._current, None
        self._start_next()
        if is_well:
            future.set_result(result)
        else:
            future.set_exception(InverseDynamicsError(result))

    def close(self) -> None:
        """End the child; pending calls have no result."""
        if self._child:
            os.close(self._request_writer)
            os.kill(self._child, signal.SIGKILL)  # it may be busy
            os.waitpid(self._child, 0)
            self._child = 0


def prepare_to_load() -> None:
    """Import the modules that the first robot description needs; the child shares them."""
    with contextlib.suppress(ImportError):  # reported when a description is loaded
        import scipy.interpolate  # noqa: F401
        import yourdfpy  # noqa: F401


def _memory_file() -> int:
    if hasattr(os, 'memfd_create'):
        return os.memfd_create('inverse_dynamics_background')
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _close_others(*kept: int) -> None:
    """Close the files of the parent: another process may wait for the end of a pipe."""
    highest = max(kept)
    for number in range(3, highest):
        if number not in kept:
            with contextlib.suppress(OSError):
                os.close(number)
    os.closerange(highest + 1, 4096)


def _report_end() -> None:
    raise InverseDynamicsError('the process for long work has ended; try again')


def _serve(request_file: int, requests: int, answer_file: int, answers: int) -> None:
    """Call functions until the parent ends."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # of the terminal or of a service manager
    if hasattr(os, 'sched_setscheduler'):  # the parent may have been started by chrt
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    while size := os.read(requests, _SIZE):
        data = os.pread(request_file, int.from_bytes(size, 'little'), 0)
        result = _answer(data)
        os.pwrite(answer_file, result, 0)
        os.write(answers, len(result).to_bytes(_SIZE, 'little'))


def _answer(data: bytes) -> bytes:
    try:
        function, arguments = pickle.loads(data)
        return pickle.dumps((True, function(*arguments)))
    except InverseDynamicsError as error:
        return pickle.dumps((False, str(error)))
    except Exception:
        return pickle.dumps((False, traceback.format_exc()))
