"""
A storm of messages to all subscriptions of the node, most of them useless.

As a program, it publishes until it has sent a number of messages or its time has elapsed:

    python test/storm.py --messages 100000 --seconds 20 --seed 1 --namespace inverse_dynamics
"""

import argparse
import os
import signal
import time

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

from geometry_msgs.msg import (
    Inertia,
    InertiaStamped,
    Vector3,
    Vector3Stamped,
    Wrench,
    WrenchStamped,
)
import numpy as np
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray, Header, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

LATCHED = QoSProfile(
    depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL
)  # compatible with all subscriptions
STOCK = 50  # messages of each topic, one of which is replaced after every ROUNDS
ROUNDS = 100  # of one message to each topic
BAD_NUMBERS = [np.nan, np.inf, -np.inf, 1e300, -1e300, 5e-324, 0.0]
TEXTS = ['', 'link_1', 'link_6', 'nowhere', 'x' * 10000, 'line\nfeed', '\u00fc\u4e2d\U0001f916']


class Weather:
    """
    Makes messages, most of them useless, some of them valid.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of random numbers.
    joints : sequence of str
        Joint names of the robot.

    """

    def __init__(self, rng, joints):
        self.rng = rng
        self.joints = list(joints)

    def number(self):
        good = self.rng.random() < 0.7
        return float(self.rng.normal()) if good else float(self.rng.choice(BAD_NUMBERS))

    def numbers(self):
        count = len(self.joints) if self.rng.random() < 0.7 else int(self.rng.integers(0, 20))
        return [self.number() for _ in range(count)]

    def text(self):
        return str(self.rng.choice(TEXTS))

    def names(self):
        kind = self.rng.integers(0, 4)
        if kind == 0:
            return list(self.joints)
        if kind == 1:
            return self.joints[: int(self.rng.integers(0, len(self.joints)))]
        if kind == 2:
            return self.joints * 2
        return [self.text() for _ in range(int(self.rng.integers(0, 5)))]

    def vector(self):
        return Vector3(x=self.number(), y=self.number(), z=self.number())

    def header(self):
        return Header(frame_id=self.text())

    def trajectory(self):
        points = [
            JointTrajectoryPoint(
                positions=self.numbers(),
                velocities=self.numbers(),
                accelerations=self.numbers(),
                effort=self.numbers(),
            )
            for _ in range(int(self.rng.integers(0, 4)))
        ]
        return JointTrajectory(header=self.header(), joint_names=self.names(), points=points)

    def joint_state(self):
        return JointState(
            header=self.header(),
            name=[f'other {name}' for name in self.names()],  # the arm has its own publisher
            position=self.numbers(),
            velocity=self.numbers(),
            effort=self.numbers(),
        )

    def inertia(self):
        body = {key: self.number() for key in ('m', 'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')}
        return InertiaStamped(header=self.header(), inertia=Inertia(com=self.vector(), **body))

    def wrench(self):
        return WrenchStamped(
            header=self.header(), wrench=Wrench(force=self.vector(), torque=self.vector())
        )

    def gravity(self):
        return Vector3Stamped(header=self.header(), vector=self.vector())

    def imu(self):
        return Imu(
            header=self.header(),
            linear_acceleration=self.vector(),
            angular_velocity=self.vector(),
        )

    def topics(self, node):
        """Return type, name and source of the messages of every subscription of the node."""
        return [
            (JointState, 'joint_states', self.joint_state),
            (String, 'robot_description', lambda: String(data=self.text())),
            (
                Float64MultiArray,
                f'{node}/desired_accelerations',
                lambda: Float64MultiArray(data=self.numbers()),
            ),
            (JointTrajectory, f'{node}/reference', self.trajectory),
            (JointTrajectory, f'{node}/joint_trajectory_in', self.trajectory),
            (InertiaStamped, f'{node}/payload', self.inertia),
            (WrenchStamped, f'{node}/external_wrench', self.wrench),
            (Vector3Stamped, f'{node}/gravity', self.gravity),
            (Imu, 'imu', self.imu),
        ]


def storm(messages, seconds, seed, name, joints, is_over=lambda: False):
    """Publish; return how many messages were sent, and how long it took [s]."""
    rng = np.random.default_rng(seed)
    weather = Weather(rng, joints)
    node = rclpy.create_node(f'storm_{seed}')
    sources = []
    for kind, topic, make in weather.topics(name):
        stock = [serialize_message(make()) for _ in range(STOCK)]
        # Bytes that are not a message of this type.
        stock.append(b'\x00\x01\x00\x00' + rng.bytes(40))
        sources.append((node.create_publisher(kind, topic, LATCHED), stock, make))
    deadline = time.monotonic() + seconds
    while not all(publisher.get_subscription_count() for publisher, *_ in sources):
        if time.monotonic() > deadline or is_over():
            break
        time.sleep(0.02)
    print('all subscriptions are found', flush=True)
    sent, began = 0, time.monotonic()
    try:
        while sent < messages and time.monotonic() < deadline and not is_over():
            for row in rng.integers(STOCK + 1, size=(ROUNDS, len(sources))).tolist():
                for (publisher, stock, _), k in zip(sources, row, strict=True):
                    publisher.publish(stock[k])
            sent += ROUNDS * len(sources)
            for _, stock, make in sources:
                stock[int(rng.integers(STOCK))] = serialize_message(make())
    finally:
        node.destroy_node()
    return sent, time.monotonic() - began


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--messages', type=int, default=100000)
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--node', default='inverse_dynamics')
    parser.add_argument('--joints', nargs='+', default=[f'joint_{k}' for k in range(1, 7)])
    options = parser.parse_args()
    # SIGTERM ends it cleanly: a process that is killed leaves its shared memory behind. If the
    # handler raised SystemExit, the exception was lost in one of three tests.
    signals = []
    signal.signal(signal.SIGTERM, lambda number, _: signals.append(number))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    sent, took = storm(
        options.messages,
        options.seconds,
        options.seed,
        options.node,
        options.joints,
        lambda: bool(signals),
    )
    print(f'sent {sent} in {took:.3f} s', flush=True)
    rclpy.shutdown()


if __name__ == '__main__':
    main()
