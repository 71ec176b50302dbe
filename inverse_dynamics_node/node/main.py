"""Starts and spins the node, and ramps the efforts down at the end."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
import io
import math
import os
import signal
import stat
import sys
import time
import traceback
from types import FrameType
from typing import Any
import warnings

# rclpy and numpy are imported after the signal handlers have been installed, because the import
# takes almost a second. A signal during the import must also end the process cleanly.

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_ONE_SIGNAL = 1.0  # [s]; signals within this time are one


class _Stop:
    """
    Counts the signals SIGINT, SIGTERM and SIGHUP.

    The handler of rclpy would end the communication before the node could send its last command.
    A signal in the second after the first does not count: ``ros2 launch`` without a terminal
    passes a signal on that the node has received too.
    """

    def __init__(self) -> None:
        self.count = 0
        self._counts_from = -math.inf  # steady time [s]
        # Under nohup, SIGHUP is ignored and must stay ignored.
        self._numbers = [
            number
            for number in _SIGNALS
            if number is not signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
        ]
        self.catch()

    def catch(self) -> None:
        for number in self._numbers:
            signal.signal(number, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if not self.count:
            self._counts_from = now + _ONE_SIGNAL
        elif now < self._counts_from:
            return
        self.count += 1


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until a signal or a shutdown transition; return the exit code."""
    stop = _Stop()
    _unblock_output()
    try:
        return _main(list(sys.argv if args is None else args), stop)
    except Exception:
        return _fail(f'stopped by an error\n{traceback.format_exc()}')
    finally:
        for number in _SIGNALS:  # a signal can no longer change the result
            signal.signal(number, signal.SIG_IGN)


def run() -> None:
    """Run `main`, then end the process at once: the cleanup of Python would take a second."""
    code = main()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


def _main(args: list[str], stop: _Stop) -> int:
    warnings.showwarning = _show_warning
    if '--help' in args or '-h' in args:  # works without ROS, as --version does
        from .help import help_text

        print(help_text())
        return 0
    if '--version' in args:
        from ..ros import version

        print(f'inverse_dynamics_node {version()}')
        return 0
    return _start(args, stop)


def _start(args: list[str], stop: _Stop) -> int:
    try:
        import rclpy

        from ..ros.middleware import security_hints, start_ros
        from ..ros.private import is_unknown_arguments
    except ModuleNotFoundError as error:
        return _fail(
            f'{error}; source a ROS 2 installation (. /opt/ros/jazzy/setup.sh), or run '
            "pip install '.[ros]' in a copy of the repository"
        )
    from rclpy.utilities import remove_ros_args

    try:
        start_ros(args)
    except UnicodeEncodeError as error:
        return _fail(f'argument {error.object!r} is not UTF-8')
    except Exception as error:
        if is_unknown_arguments(error):
            return _fail_with_usage(f'unrecognized ROS arguments: {str(error).strip("[]")}')
        return _fail('\n'.join([str(error), *security_hints(error)]))
    try:
        stray = remove_ros_args(args)[1:]
        if stray:
            return _fail_with_usage(f'unrecognized arguments: {" ".join(stray)}')
        return _run(stop)
    finally:
        rclpy.try_shutdown()


def _run(stop: _Stop) -> int:
    from rclpy.experimental.events_executor import EventsExecutor
    import rclpy.logging

    from ..ros.middleware import security_hints
    from .node import InverseDynamicsNode
    from .runner import Watchdog
    from .scheduling import Scheduling
    from .worker import Worker

    scheduling = Scheduling()
    worker = Worker()
    if worker.problem:
        _report(f'warning: {worker.problem}')
    try:
        node = InverseDynamicsNode(lambda: stop.count, scheduling, worker)
    except Exception as error:
        for problem in [*(str(error) or repr(error)).splitlines(), *security_hints(error)]:
            rclpy.logging.get_logger('inverse_dynamics').fatal(problem)
        return 1
    stop.catch()
    executor = EventsExecutor()
    executor.add_node(node)
    watchdog = Watchdog()
    try:
        logger = node.get_logger()
        is_fine, text = scheduling.apply(node.configuration.thread_priority, watchdog.native_id)
        if is_fine:
            logger.info(text)
        else:
            logger.warning(text)
        if not stop.count and not node.autostart():
            return 1
        while not stop.count and not node.may_leave:
            watchdog.spin(executor)
            if watchdog.is_congested:
                node.catch_up()
    finally:
        node.shut_down()
        watchdog.close()
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()
    return 0


def _fail(message: str, code: int = 1) -> int:
    _report(message)
    return code


def _fail_with_usage(message: str) -> int:
    from .help import USAGE

    return _fail(f'{message}\n{USAGE}', code=2)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    _report(f'warning: {message}')


def _unblock_output() -> None:
    """
    Let stdout and stderr drop unread output; a blocked write would stop the control loop.

    A separate thread for the output would not help: the logger of rclpy writes while it holds the
    global interpreter lock. A pipe or terminal stays blocking for other processes.
    """
    for number, name in ((1, 'stdout'), (2, 'stderr')):
        try:
            mode = os.fstat(number).st_mode
            if stat.S_ISSOCK(mode):  # a socket cannot be opened again
                os.set_blocking(number, False)
            elif stat.S_ISFIFO(mode) or stat.S_ISCHR(mode):
                with contextlib.suppress(OSError):  # terminal of another user, or without a reader
                    _open_as(f'/proc/self/fd/{number}', number, os.O_NONBLOCK | os.O_NOCTTY)
        except OSError:
            # The output is closed. Otherwise a new socket would get this number and the log.
            _open_as(os.devnull, number)
        output: Any = _LossyOutput(number, 'w', closefd=False)
        setattr(sys, name, io.TextIOWrapper(output, errors='backslashreplace', write_through=True))


def _open_as(path: str, number: int, flags: int = 0) -> None:
    new = os.open(path, os.O_WRONLY | flags)
    if new != number:
        os.dup2(new, number)
        os.close(new)


class _LossyOutput(io.FileIO):
    """A file that drops text instead of blocking."""

    def write(self, data: Any) -> int:
        with contextlib.suppress(OSError):
            super().write(data)
        return len(data)


def _report(message: str) -> None:
    sys.stderr.write(f'inverse_dynamics_node: {message}\n')


if __name__ == '__main__':
    run()
