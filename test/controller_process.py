"""
A controller as ros2_control has it: it subscribes to commands, and has the parameter `joints`.

The arguments are the name of the node, the delay before it answers requests [s], the topic of the
commands and the joints. With the delay 'never', it answers none.
"""

import sys
import time

import rclpy


def main():
    name, delay, topic, *joints = sys.argv[1:]
    rclpy.init(args=[])
    from std_msgs.msg import Float64MultiArray

    node = rclpy.create_node(name)
    node.declare_parameter('interface_name', 'effort')
    node.declare_parameter('joints', joints)
    node.create_subscription(Float64MultiArray, topic, lambda message: None, 10)
    began = time.monotonic()
    while delay == 'never' or time.monotonic() < began + float(delay):
        time.sleep(0.05)
    rclpy.spin(node)


if __name__ == '__main__':
    main()
