"""
Publish the joint states of a robot at rest, and print the efforts that hold it.

Usage: python examples/hold_still.py my_arm.urdf

This program replaces the robot for a node that was started with the same URDF. All joints are at
zero, or at the position limit closest to zero.

"""

from collections import deque
import sys

from inverse_dynamics_node import load_urdf
import numpy as np
import rclpy
from sensor_msgs.msg import JointState

robot = load_urdf(sys.argv[1])
state = JointState(
    name=robot.joint_names,
    position=np.clip(0.0, robot.lower, robot.upper).tolist(),
    velocity=[0.0] * len(robot.joint_names),
)

rclpy.init()
node = rclpy.create_node('hold_still')
publisher = node.create_publisher(JointState, 'joint_states', 10)
received = deque(maxlen=100)
node.create_subscription(
    JointState, 'inverse_dynamics/joint_efforts', lambda message: received.append(message), 10
)


def publish():
    """Publish the state with the current time."""
    state.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(state)


node.create_timer(0.01, publish)
# The node ramps up the efforts from zero: wait until the efforts are constant for a second. After
# a pause of this process, the efforts are zero for less than a second.
while len(received) < 100 or received[0].effort != received[-1].effort:
    rclpy.spin_once(node)
for name, effort in zip(received[-1].name, received[-1].effort, strict=True):
    print(f'{name:20} {effort:10.3f}')

node.destroy_node()
rclpy.shutdown()
