"""The first point of a serialized trajectory is read as if it were deserialized."""

import contextlib
import struct
import time

from hypothesis import example, given
from hypothesis import strategies as st
from inverse_dynamics_node.errors import JointStateError
import pytest

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Duration, Time
from inverse_dynamics_node.node.first_point import read_first_point
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

texts = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=9)
numbers = st.lists(st.floats(allow_nan=False), max_size=4)
points = st.builds(
    JointTrajectoryPoint,
    positions=numbers,
    velocities=numbers,
    accelerations=numbers,
    effort=numbers,
    time_from_start=st.builds(Duration, sec=st.integers(-9, 9), nanosec=st.integers(0, 99)),
)
messages = st.builds(
    JointTrajectory,
    header=st.builds(Header, stamp=st.builds(Time, sec=st.integers(0, 9)), frame_id=texts),
    joint_names=st.lists(texts, max_size=5),
    points=st.lists(points, max_size=4),
)
POINT = JointTrajectoryPoint(positions=[0.1, 0.2], time_from_start=Duration(sec=3))


def assert_reads(data):
    message = deserialize_message(data, JointTrajectory)
    message.points = message.points[:1]
    assert read_first_point(data) == message


@given(messages)
@example(JointTrajectory())
@example(JointTrajectory(joint_names=['a', 'bcd'], points=[POINT, POINT]))
def test_the_first_point_is_read_as_deserialized(message):
    assert_reads(serialize_message(message))


@given(st.binary(max_size=300), messages, st.data())
def test_garbage_is_read_or_raises_a_joint_state_error(garbage, message, data):
    good = serialize_message(message)
    cut = data.draw(st.integers(0, len(good)))
    for bad in (garbage, b'\0\1\0\0' + garbage, good[:cut], good[:cut] + garbage):
        with contextlib.suppress(JointStateError):
            read_first_point(bad)


def test_big_endian_is_read_too():
    # After the header: stamp, frame, no names, two points with one position each.
    data = b'\0\0\0\0' + struct.pack('>iII4xII', 1, 2, 1, 0, 2)
    for position in (0.25, 0.5):
        data += struct.pack('>I', 1) + bytes(-(len(data)) % 8)
        data += struct.pack('>dIIIiI', position, 0, 0, 0, 1, 2)
    assert_reads(data)
    assert list(read_first_point(data).points[0].positions) == [0.25]


def test_later_points_are_not_read():
    message = JointTrajectory(joint_names=['a', 'b'], points=[POINT] * 5000)
    data = serialize_message(message)
    times = []
    for read in (read_first_point, lambda whole: deserialize_message(whole, JointTrajectory)):
        start = time.perf_counter()
        read(data)
        times.append(time.perf_counter() - start)
    assert 5.0 * times[0] < times[1]  # 1000 times, on a quiet machine
