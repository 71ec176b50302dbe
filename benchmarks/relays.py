"""
The baseline for the node: processes that forward positions as commands and compute nothing.

`python -m benchmarks.relays usual [RATE] --ros-args ...` is a straightforward ROS node. `lean`
instead of `usual` handles messages like the inverse dynamics node. Without RATE, the relay sends a
command for every joint state.
"""

from __future__ import annotations

import signal
import sys
from typing import Any

from inverse_dynamics_node.ros.cdr import JointStateReader, serialize_numbers
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from .wire import EVERY_ONE, NEWEST


class UsualRelay:
    """A relay with typed messages that creates a new message for each command."""

    def __init__(self, node: Any, rate: float) -> None:
        self._latest: JointState | None = None
        self._commands = node.create_publisher(Float64MultiArray, '~/commands', EVERY_ONE)
        if rate:
            node.create_subscription(JointState, 'joint_states', self._keep, NEWEST)
            node.create_timer(1.0 / rate, self._on_timer)
        else:
            node.create_subscription(JointState, 'joint_states', self._publish, NEWEST)

    def _keep(self, message: JointState) -> None:
        self._latest = message

    def _on_timer(self) -> None:
        if self._latest is not None:
            self._publish(self._latest)

    def _publish(self, message: JointState) -> None:
        self._commands.publish(Float64MultiArray(data=list(message.position)))


class LeanRelay:
    """A relay that reads and writes messages like the inverse dynamics node."""

    def __init__(self, node: Any) -> None:
        self._reader = JointStateReader()
        self._commands = node.create_lifecycle_publisher(
            Float64MultiArray, '~/commands', EVERY_ONE
        )
        node.create_subscription(JointState, 'joint_states', self._on_state, NEWEST, raw=True)
        node.trigger_configure()
        node.trigger_activate()

    def _on_state(self, data: bytes) -> None:
        self._commands.publish(serialize_numbers(self._reader.read(data).positions))


def main() -> None:
    """Run the relay until a signal arrives."""
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: stopped.append(number))
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    kind, *rate = remove_ros_args(sys.argv)[1:]
    if kind == 'lean':
        executor: Any = EventsExecutor()
        node: Any = LifecycleNode('relay')
        relay: Any = LeanRelay(node)
    else:
        executor = SingleThreadedExecutor()
        node = rclpy.create_node('relay')
        relay = UsualRelay(node, float(rate[0]) if rate else 0.0)
    executor.add_node(node)
    while not stopped:
        executor.spin_until_future_complete(Future(), timeout_sec=0.1)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()
    del relay


if __name__ == '__main__':
    main()
