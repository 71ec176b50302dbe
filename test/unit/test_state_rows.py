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


def rows_of(*states):
    rows = StateRows()
    for each in states:
        rows.note(each)
    return rows


ARM = ['shoulder', 'elbow']


def test_rows_are_read_back(tmp_path):
    states = [
        state(ARM, 1_800_000_000 + k, [0.1 * k, 0.2], [k / 3.0, 0.4], [0.5, -k / 7.0])
        for k in range(3)
    ]
    rows = rows_of(*states)
    with (tmp_path / 'run.csv').open('w', newline='') as file:
        csv.writer(file).writerows([rows.header(), *(rows.row(each, 0.0) for each in states)])
    recording, notes = read_measured_states(tmp_path / 'run.csv', ['elbow', 'shoulder'])
    assert notes == ()
    np.testing.assert_allclose(recording.times, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(recording.positions, [[0.2, 0.1 * k] for k in range(3)])
    np.testing.assert_array_equal(recording.velocities, [[0.4, k / 3.0] for k in range(3)])
    np.testing.assert_array_equal(recording.efforts, [[-k / 7.0, 0.5] for k in range(3)])


def test_several_publishers_fill_the_cells_of_their_joints():
    arm, gripper = state(ARM, 5, [0.1, 0.2], (), [1.0, 2.0]), state(['finger'], 6, [0.01])
    rows = rows_of(gripper, arm)
    assert rows.joints == {'finger': False, 'shoulder': True, 'elbow': True}
    assert rows.header()[:5] == [
        'time',
        'finger.position',
        'finger.velocity',
        'finger.effort',
        'shoulder.position',
    ]
    assert rows.row(arm, 0.0) == ['5.250000000', None, None, None, 0.1, None, 1.0, 0.2, None, 2.0]
    assert rows.row(gripper, 0.0) == ['6.250000000', 0.01, *[None] * 8]


def test_a_joint_whose_values_are_nan_has_empty_cells():
    nan = np.nan
    states = [state(ARM, 5 + k, [0.1 * k, nan], [0.3, nan], [1.0, nan]) for k in range(3)]
    rows = rows_of(*states)
    assert rows.row(states[0], 0.0) == ['5.250000000', 0.0, 0.3, 1.0, None, None, None]


def test_a_state_without_a_stamp_has_the_time_of_its_arrival():
    unstamped = state(ARM, 0, [0.1, 0.2])
    assert rows_of(unstamped).row(unstamped, 1234.5)[0] == '1234.500000000'


def test_other_joints_and_other_messages_are_no_rows():
    rows = rows_of(state(ARM, 5, [0.1, 0.2]), b'nothing')
    assert rows.row(state(['later'], 6, [0.3]), 0.0) is None
    assert rows.row(b'nothing', 0.0) is None


@pytest.mark.parametrize('effort', [(), (1.0,), (np.nan, np.nan)])
def test_missing_efforts_are_noted(effort):
    rows = rows_of(state(ARM, 5, [0.1, 0.2], [0.3, 0.4], effort))
    assert not any(rows.joints.values())
    filled = rows_of(state(ARM, 5, [0.1, 0.2], [0.3, 0.4], (0.0, np.nan)))
    assert filled.joints == {'shoulder': True, 'elbow': False}
