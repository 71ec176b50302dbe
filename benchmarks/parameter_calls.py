"""A client that sets a parameter many times."""

from __future__ import annotations

from collections import deque
import signal
import sys

from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

AT_ONCE = 5  # largest number of unanswered requests
PATIENCE = 20  # [s]; time limit for all calls, including the start of this process


def main() -> None:
    """Set the parameter as many times as the command line asks for."""
    signal.alarm(PATIENCE)
    rclpy.init(args=[])
    node = rclpy.create_node('caller')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    client = node.create_client(SetParameters, '/contender/set_parameters')
    client.wait_for_service()
    waiting: deque[rclpy.Future] = deque()
    for k in range(int(sys.argv[1])):
        value = Parameter('kp', value=100.0 + k % 2).to_parameter_msg()
        waiting.append(client.call_async(SetParameters.Request(parameters=[value])))
        while len(waiting) >= AT_ONCE:
            _wait(executor, waiting[0])
            assert waiting.popleft().result().results[0].successful
    for future in waiting:
        _wait(executor, future)


def _wait(executor: SingleThreadedExecutor, future: rclpy.Future) -> None:
    # spin_until_future_complete() of rclpy 7.1 becomes slower with every call.
    while not future.done():
        executor.spin_once()


if __name__ == '__main__':
    main()
