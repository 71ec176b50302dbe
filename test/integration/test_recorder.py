"""Recording topics into bags that ROS 2 tools read."""

import struct
import time

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mujoco')
pytest.importorskip('rosbags')

from inverse_dynamics_node.ros.cdr import stamp_of
from inverse_dynamics_node.ros.qos import LATCHED
from inverse_dynamics_node.simulation.demo.recorder import Recorder
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

PATIENCE = 120.0  # [s]


class CountedRecorder(Recorder):
    @property
    def count(self):
        """Number of messages recorded so far."""
        return sum(map(len, self._messages.values()))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_recorder_keeps_messages_at_their_own_times(domain_id, tmp_path, storage):
    context = Context()
    context.init(args=[], domain_id=domain_id)
    node = Node('side', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    topics = {'joint_states': JointState, 'commands': Float64MultiArray}
    recorder = CountedRecorder(node, topics, latched=('commands',))
    states = node.create_publisher(JointState, 'joint_states', 10)
    commands = node.create_publisher(Float64MultiArray, 'commands', LATCHED)
    received = []
    node.create_subscription(Float64MultiArray, 'commands', received.append, 10)

    def wait_until(is_true):
        deadline = time.monotonic() + PATIENCE
        while not is_true():
            assert time.monotonic() < deadline
            executor.spin_once(timeout_sec=0.02)

    wait_until(lambda: commands.get_subscription_count() == 2)
    wait_until(lambda: states.get_subscription_count() == 1)
    early = JointState(name=['too early'])
    early.header.stamp.sec = 50
    states.publish(early)
    wait_until(lambda: recorder.latest)
    commands.publish(Float64MultiArray(data=[8.0]))
    wait_until(lambda: recorder.count == 2)
    recorder.begin()
    assert recorder.count == 1  # the latched command
    wait_until(lambda: len(received) == 1)
    received.clear()
    for i in range(3):
        state = JointState(name=['a'], position=[0.5 * i])
        state.header.stamp.sec, state.header.stamp.nanosec = 100 + i, 7
        states.publish(state)
        wait_until(lambda i=i: recorder.latest == (100 + i) * 10**9 + 7)
        commands.publish(Float64MultiArray(data=[float(i)]))
        wait_until(lambda i=i: len(received) == i + 1)
    wait_until(lambda: recorder.count == 7)
    assert recorder.write(tmp_path / 'bag', storage) == 7
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()
    typestore = get_typestore(Stores.ROS2_JAZZY)
    with Reader(tmp_path / 'bag') as reader:
        rows = [
            (connection.topic, stamp, typestore.deserialize_cdr(data, connection.msgtype))
            for connection, stamp, data in reader.messages()
        ]
    stamps = [(100 + i) * 10**9 + 7 for i in range(3)]
    for topic, expected in (
        ('/joint_states', [(stamp, 0.5 * i) for i, stamp in enumerate(stamps)]),
        ('/commands', [(50 * 10**9, 8.0), *((stamp, 1.0 * i) for i, stamp in enumerate(stamps))]),
    ):
        values = [
            (stamp, message.position[0] if t == '/joint_states' else message.data[0])
            for t, stamp, message in rows
            if t == topic
        ]
        assert values == expected


def test_stamp_is_read_in_either_byte_order():
    for order, flag in (('<', 1), ('>', 0)):
        data = bytes([0, flag, 0, 0]) + struct.pack(f'{order}iI', 12, 34)
        assert stamp_of(data) == 12_000_000_034
