"""Recording topics into bags that ROS 2 tools read."""

import struct
import time

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mujoco')
pytest.importorskip('rosbags')

from inverse_dynamics_node.simulation.recorder import Recorder, stamp_of
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

PATIENCE = 90.0  # [s]; a demo that can do nothing gives up by itself before this


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_recorder_keeps_messages_at_their_own_times(domain_id, tmp_path, storage):
    context = Context()
    context.init(args=[], domain_id=domain_id)
    node = Node('side', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    recorder = Recorder(node, {'joint_states': JointState, 'commands': Float64MultiArray})
    states = node.create_publisher(JointState, 'joint_states', 10)
    commands = node.create_publisher(Float64MultiArray, 'commands', 10)
    heard = []
    node.create_subscription(Float64MultiArray, 'commands', heard.append, 10)

    def wait_until(is_true):
        deadline = time.monotonic() + PATIENCE
        while not is_true():
            assert time.monotonic() < deadline
            executor.spin_once(timeout_sec=0.02)

    wait_until(lambda: commands.get_subscription_count() == 2)
    wait_until(lambda: states.get_subscription_count() == 1)
    for i in range(3):
        state = JointState(name=['a'], position=[0.5 * i])
        state.header.stamp.sec, state.header.stamp.nanosec = 100 + i, 7
        states.publish(state)
        wait_until(lambda i=i: recorder.latest == (100 + i) * 10**9 + 7)
        commands.publish(Float64MultiArray(data=[float(i)]))
        wait_until(lambda i=i: len(heard) == i + 1)
    wait_until(lambda: recorder.count == 6)
    assert recorder.write(tmp_path / 'bag', storage) == 6
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
    for topic, values in (
        ('/joint_states', [message.position[0] for t, _, message in rows if t == '/joint_states']),
        ('/commands', [message.data[0] for t, _, message in rows if t == '/commands']),
    ):
        assert [stamp for t, stamp, _ in rows if t == topic] == stamps
        assert values == ([0.0, 0.5, 1.0] if topic == '/joint_states' else [0.0, 1.0, 2.0])


def test_stamp_is_read_in_either_byte_order():
    for order, flag in (('<', 1), ('>', 0)):
        data = bytes([0, flag, 0, 0]) + struct.pack(f'{order}iI', 12, 34)
        assert stamp_of(data) == 12_000_000_034
