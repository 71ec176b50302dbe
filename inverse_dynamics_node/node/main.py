"""The process: start the node, spin it, and let it leave the robot in peace."""

from __future__ import annotations

from collections.abc import Sequence
import signal
import sys
from types import FrameType
import warnings

try:
    import rclpy
except ImportError as error:
    sys.exit(
        f'inverse_dynamics_node: {error}: source a ROS 2 installation '
        "(. /opt/ros/jazzy/setup.sh), or pip install 'inverse_dynamics_node[ros]'"
    )
from rclpy.signals import SignalHandlerOptions

from ..errors import InverseDynamicsError
from .node import InverseDynamicsNode

try:
    from rclpy.experimental.events_executor import EventsExecutor as Executor
except ImportError:  # rclpy before 7.1.4
    from rclpy.executors import SingleThreadedExecutor as Executor


class _Stop:
    """
    Counts SIGINT and SIGTERM.

    rclpy's own handler shuts communication down before a last command could be sent.

    """

    def __init__(self) -> None:
        self.count = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.count += 1


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit code."""
    warnings.showwarning = _warn
    stop = _Stop()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        print(f'inverse_dynamics_node: {error}', file=sys.stderr)
        return 1
    try:
        return _run(stop)
    finally:
        rclpy.try_shutdown()


def _run(stop: _Stop) -> int:
    try:
        node = InverseDynamicsNode()
    except InverseDynamicsError as error:
        rclpy.logging.get_logger('inverse_dynamics').fatal(str(error))
        return 1
    executor = Executor()
    executor.add_node(node)
    try:
        if not node.autostart():
            return 1
        while not stop.count and not node.is_finalized:
            # Its spin() never returns in builds against an old C library; with a time-out it does.
            executor.spin_once(timeout_sec=0.1)
    finally:
        node.shut_down(lambda: stop.count > 1)
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()
    return 0


def _warn(message: Warning | str, *_: object, **__: object) -> None:
    print(f'inverse_dynamics_node: warning: {message}', file=sys.stderr)


if __name__ == '__main__':
    sys.exit(main())
