"""
Prints the commands of the node, with the times at which the commands arrived on its machine.

A record on standard output is a steady time [s] and the efforts [N m or N] of one command. All
numbers have 8 bytes.

"""

from __future__ import annotations

from array import array
import os
import time

import rclpy
from std_msgs.msg import Float64MultiArray

PERIOD = 0.005  # [s]; between two polls


def main() -> None:
    """Print commands until the process ends."""
    rclpy.init(args=[])
    node = rclpy.create_node('monitor')
    commands = node.create_subscription(
        Float64MultiArray, 'inverse_dynamics/commands', print, 1000
    )
    while rclpy.ok():  # until SIGTERM
        time.sleep(PERIOD)
        offset = time.monotonic() - time.time()
        with commands.handle:
            while taken := commands.handle.take_message(Float64MultiArray, False):
                message, info = taken
                arrived = offset + info['received_timestamp'] * 1e-9
                os.write(1, array('d', [arrived, *message.data]).tobytes())
    node.destroy_node()


if __name__ == '__main__':
    main()
