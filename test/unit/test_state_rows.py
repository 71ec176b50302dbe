"""Joint states become rows of a CSV file, which is read back as the same recording."""

import csv

from inverse_dynamics_node.analysis.recordings.measured_states import read_measured_states
import numpy as np
import pytest

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time
from inverse_dynamics_node.ros.recorder import StateRows
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header


def state(names, stamp, position=(), velocity=(), effort=()):
    """Return a serialized joint state."""
    message = JointState(
        header=Header(stamp=Time(sec=stamp, nanosec=250_000_000 if stamp else 0)),
        name=names,
        position=position,
        velocity=velocity,
        effort=effort,
    )
    return serialize_message(message)


ARM = ['shoulder', 'elbow']


def test_rows_are_read_back(tmp_path):
    states = [
        state(ARM, 1_800_000_000 + k, [0.1 * k, 0.2], [k / 3.0, 0.4], [0.5, -k / 7.0])
        for k in range(3)
    ]
    rows = StateRows(['elbow', 'finger', 'shoulder'])
    with (tmp_path / 'run.csv').open('w', newline='') as file:
        csv.writer(file).writerows([rows.header, *(rows.row(each, 0.0) for each in states)])
    recording, _ = read_measured_states(tmp_path / 'run.csv', ARM)
    np.testing.assert_allclose(recording.times, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(recording.positions, [[0.1 * k, 0.2] for k in range(3)])
    np.testing.assert_array_equal(recording.velocities, [[k / 3.0, 0.4] for k in range(3)])
    np.testing.assert_array_equal(recording.efforts, [[0.5, -k / 7.0] for k in range(3)])


@pytest.mark.parametrize(
    ('message', 'expected'),
    [
        (state(ARM, 5, [0.1, 0.2], (), [1.0, 2.0]), [0.1, None, 1.0, 0.2, None, 2.0]),
        (state(['finger', 'elbow'], 5, [0.01, 0.2]), [None, None, None, 0.2, None, None]),
        (state(ARM, 5, [0.1, np.nan], [0.3, np.nan]), [0.1, 0.3, None, None, None, None]),
        (state(ARM, 5, [0.1, 0.2], effort=[1.0]), [0.1, None, None, 0.2, None, None]),
    ],
    ids=['all joints', 'some joints', 'NaN', 'too few efforts'],
)
def test_cells_without_a_value_are_empty(message, expected):
    assert StateRows(ARM).row(message, 0.0) == ['5.250000000', *expected]


def test_a_state_without_a_stamp_has_the_time_of_its_arrival():
    assert StateRows(ARM).row(state(ARM, 0, [0.1, 0.2]), 1234.5)[0] == '1234.500000000'


@pytest.mark.parametrize(
    'message', [state(['finger'], 6, [0.3]), b'nothing'], ids=['other joint', 'no message']
)
def test_other_joints_and_other_messages_are_no_rows(message):
    assert StateRows(ARM).row(message, 0.0) is None
