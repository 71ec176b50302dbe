"""Serialized joint states are read as deserialized, and only JointStateError is raised."""

import contextlib
import math
import struct

from hypothesis import example, given
from hypothesis import strategies as st
from inverse_dynamics_node.errors import JointStateError
import numpy as np
import pytest

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time
from inverse_dynamics_node.ros.cdr import JointStateReader, serialize_numbers
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header

texts = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=9)
numbers = st.lists(st.floats(), max_size=9)
messages = st.builds(
    JointState,
    header=st.builds(
        Header,
        stamp=st.builds(
            Time,
            sec=st.integers(-(2**31), 2**31 - 1),
            nanosec=st.integers(0, 2**32 - 1),
        ),
        frame_id=texts,
    ),
    name=st.lists(texts, max_size=9),
    position=numbers,
    velocity=numbers,
    effort=numbers,
)
ARM = JointState(
    name=['shoulder', 'elbow'], position=[0.1, 0.2], velocity=[0.3, 0.4], effort=[0.5, 0.6]
)


def assert_reads(reader, data):
    """Assert that the arrays equal those of the deserialized message, bit for bit."""
    message = deserialize_message(data, JointState)
    arrays = reader.read(data)
    assert arrays.joints == tuple(message.name)
    for ours, theirs in zip(
        arrays[1:], (message.position, message.velocity, message.effort), strict=True
    ):
        assert ours.dtype == np.float64
        assert ours.tobytes() == theirs.tobytes()


def numbered(message, first):
    """Return a later message: other numbers, another stamp."""
    later = deserialize_message(serialize_message(message), JointState)
    later.header.stamp = Time(sec=int(first), nanosec=3)
    for values in (later.position, later.velocity, later.effort):
        for k in range(len(values)):
            values[k] = first + k
    return later


@given(messages)
@example(ARM)
@example(JointState())
def test_the_first_and_the_next_message_are_read_as_deserialized(message):
    reader = JointStateReader()
    assert_reads(reader, serialize_message(message))
    assert_reads(reader, serialize_message(numbered(message, 7.0)))
    assert len(reader._layouts) == 1


@given(st.lists(messages, max_size=30))
def test_messages_of_many_publishers_are_read(messages):
    reader = JointStateReader()
    for k in range(3):
        for message in messages:
            assert_reads(reader, serialize_message(numbered(message, 100.0 * k)))
    assert len(reader._layouts) <= 16


@given(st.binary(max_size=400))
def test_garbage_raises_a_joint_state_error(data):
    reader = JointStateReader()
    reader.read(serialize_message(ARM))
    for garbage in (data, b'\x00\x01\x00\x00' + data):
        with contextlib.suppress(JointStateError):
            reader.read(garbage)


@given(messages, st.data())
def test_damaged_bytes_are_read_as_deserialized_or_raise_a_joint_state_error(message, data):
    good = serialize_message(message)
    reader = JointStateReader()
    reader.read(good)
    cut = data.draw(st.integers(0, len(good)), 'cut')
    at = data.draw(st.integers(0, len(good) - 1), 'at')
    byte = data.draw(st.binary(min_size=1, max_size=1), 'byte')
    tail = data.draw(st.binary(max_size=9), 'tail')
    for bad in (good[:cut], good[:at] + byte + good[at + 1 :], good + tail):
        try:
            assert_reads(reader, bad)
        except JointStateError:
            pass
        except RuntimeError:  # of the middleware
            with pytest.raises(JointStateError):
                reader.read(bad)


def test_padding_may_have_any_value():
    data = serialize_message(ARM)
    reader = JointStateReader()
    reader.read(data)
    padding = data.index(b'elbow\0') + 6
    assert_reads(reader, data[:padding] + b'\xaa\x55' + data[padding + 2 :])
    assert len(reader._layouts) == 1


def test_big_endian_is_read_too():
    def text(content):
        content += b'\0'
        return struct.pack('>I', len(content)) + content + bytes(-len(content) % 4)

    # After the header: stamp, frame, names, padding, one position, no velocity, no effort.
    data = b'\x00\x00\x00\x00' + struct.pack('>iI', 1, 2) + text(b'') + struct.pack('>I', 1)
    data += text(b'elbow') + struct.pack('>I', 1)
    data += bytes(-(len(data) - 4) % 8) + struct.pack('>dII', 0.25, 0, 0)
    reader = JointStateReader()
    for _ in range(2):
        assert reader.read(data).joints == ('elbow',)
        assert reader.read(data).positions.tolist() == [0.25]
    assert reader._layouts == []


def test_fifty_thousand_names_are_read():
    message = JointState(name=[f'joint_{k}' for k in range(50_000)], position=[0.5] * 50_000)
    reader = JointStateReader()
    for _ in range(2):
        assert_reads(reader, serialize_message(message))
    assert len(reader._layouts) == 1


def test_arrays_cannot_be_written_to():
    reader = JointStateReader()
    for _ in range(2):
        arrays = reader.read(serialize_message(ARM))
    with pytest.raises(ValueError, match='read-only'):
        arrays.positions[0] = math.nan


@given(st.lists(st.floats(allow_nan=False), max_size=9))
def test_serialized_commands_are_deserialized_to_the_same_numbers(efforts):
    message = deserialize_message(serialize_numbers(np.array(efforts)), Float64MultiArray)
    assert message == Float64MultiArray(data=efforts)
