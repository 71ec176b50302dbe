"""The command `effort`, and the files it reads and writes."""

import csv
from dataclasses import replace
import json
from pathlib import Path
import re
import textwrap

from inverse_dynamics_node.analysis import trajectory_files
from inverse_dynamics_node.analysis.recordings.measured_states import read_measured_states
from inverse_dynamics_node.analysis.trajectory_files import FORMATS, read_trajectory
from inverse_dynamics_node.cli.main import main
from inverse_dynamics_node.dynamics.inverse_dynamics import InverseDynamics
from inverse_dynamics_node.errors import TrajectoryError
from inverse_dynamics_node.robot.urdf import load_urdf
import numpy as np
import pytest
from robot_files import STANFORD
from simulated_runs import typestore, write_messages

pytest.importorskip('rosbags')

JOINTS = tuple(f'joint_{i}' for i in range(1, 7))
MOVE = """\
joint_names: [joint_2, joint_3]
points:
- {positions: [-1.0, 0.4], time_from_start: 0}
- {positions: [-1.5, 0.9], time_from_start: 0.5}
- {positions: [-1.0, 0.4], time_from_start: 1}
"""
BOMB = 'a0: &a0 [x, x]\n' + ''.join(
    f'a{i}: &a{i} [{", ".join([f"*a{i - 1}"] * 9)}]\n' for i in range(1, 12)
)
# As `ros2 topic echo --full-length` prints it.
ECHO = """\
header:
  stamp:
    sec: 0
    nanosec: 0
  frame_id: ''
joint_names:
- joint_2
- joint_3
points:
- positions:
  - -1.0
  - 0.4
  velocities:
  - 0.0
  - 0.0
  accelerations: []
  effort: []
  time_from_start:
    sec: 0
    nanosec: 0
- positions:
  - -1.5
  - 0.9
  velocities:
  - 0.0
  - 0.0
  accelerations: []
  effort: []
  time_from_start:
    sec: 1
    nanosec: 500000000
---
"""


@pytest.fixture
def write(tmp_path):
    def write(text, name='move.yaml'):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def read(path):
    return read_trajectory(path, JOINTS)


def code_of(*words):
    """Run a command; return its exit code."""
    try:
        return main([str(word) for word in words])
    except SystemExit as end:  # of argparse
        return end.code


def effort(*arguments):
    return main(['effort', str(STANFORD), *map(str, arguments), '--no-picture', '--force'])


# ---- The command ---------------------------------------------------------------------------


def test_reports_peaks_and_writes_table_and_picture(tmp_path, write, capsys, size_of):
    assert main(['effort', str(STANFORD), str(write(MOVE))]) == 0
    output = capsys.readouterr().out
    assert '3 points in 1 s, 2 joints; evaluated at 201 states' in output
    assert 'velocities derived' in output
    assert 'Terms of the efforts' in output
    assert size_of(tmp_path / 'move_efforts.png')[0] == 900
    with (tmp_path / 'move_efforts.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 201
    dynamics = InverseDynamics(load_urdf(STANFORD))
    state = np.zeros((3, 6))
    for k, ending in enumerate(('', '.velocity', '.acceleration')):
        state[k, 1:3] = [float(rows[50][name + ending]) for name in ('joint_2', 'joint_3')]
    effort = float(rows[50]['joint_2.effort'])
    assert effort == pytest.approx(dynamics.efforts(*state)[1], rel=1e-6)


def test_a_written_table_gives_the_same_report(tmp_path, write, capsys):
    peaks = []
    for path in (write(MOVE), 'move_efforts.csv'):
        assert effort(path, '--payload', '1.5,0,0,0.1') == 0
        peaks.append(capsys.readouterr().out.split('Peaks')[1].split('written')[0])
    assert peaks[0] == peaks[1]


def test_reports_whether_limits_are_exceeded(write, capsys):
    assert effort(write(MOVE.replace(': 0.5', ': 0.05').replace(': 1}', ': 0.1}'))) == 0
    output = capsys.readouterr().out
    assert 'beyond: effort, speed' in output
    assert '\n\nThe motion exceeds limits: up to ' in output
    assert effort(write(MOVE.replace(': 0.5', ': 5').replace(': 1}', ': 10}'))) == 0
    last = capsys.readouterr().out.split('\n\n')[-1]
    assert ' '.join(last.split()) == (
        'The motion stays within the known limits: up to 32% of the effort limit of joint_2, '
        'up to 15% of the speed limit of joint_3.'
    )


def test_warns_about_positions_in_degrees(write, capsys):
    degrees = MOVE.replace('-1.0', '-57.3').replace('-1.5', '-70')
    assert effort(write(degrees)) == 0
    output = capsys.readouterr().out
    words = ' '.join(output.split())
    assert 'joint_2 outside the position limits.' in words
    assert re.search(r'joint_2 is at -7\d(\.\d+)? rad, outside its limits .*degrees\?\)', words)
    assert re.search(r'joint_2: the (effort|speed) is [\d.]+ times its limit', words)
    assert effort(write(MOVE)) == 0
    assert 'warning' not in capsys.readouterr().out


def test_payload_and_friction_change_the_result(tmp_path, write, capsys):
    urdf = tmp_path / 'rubbing.urdf'
    text = STANFORD.read_text()
    urdf.write_text(text.replace('<limit', '<dynamics damping="5"/><limit'))
    tables = []
    for options in ('', '--friction', '--payload 3', '--payload 3 --link link_3'):
        arguments = [str(urdf), str(write(MOVE)), '--no-picture', '--force', *options.split()]
        assert main(['effort', *arguments]) == 0
        tables.append(capsys.readouterr().out.split('Peaks')[1])
    assert len(set(tables)) == 4


def test_the_result_is_also_json(tmp_path, write, capsys):
    fast = MOVE.replace(': 0.5', ': 0.05').replace(': 1}', ': 0.1}')
    assert effort(write(fast), '--json', '--payload', '2') == 0
    result = json.loads(capsys.readouterr().out)
    assert result['verdict'].startswith('The motion exceeds limits: up to ')
    assert list(result['joints']) == ['joint_2', 'joint_3']
    joint = result['joints']['joint_2']
    assert joint['beyond'] == ['effort', 'speed']
    assert abs(joint['peak']) > joint['effort_limits'] == 100.0
    assert result['notes'][0] == "payload 2 kg on link 'tool0'; without friction"
    assert (tmp_path / 'move_efforts.csv').exists()


# fmt: off
OPTIONS = [
    ('--payload heavy', 2, "--payload: 'heavy' is neither MASS nor MASS,X,Y,Z"),
    ('--payload 1,2', 2, "--payload: '1,2' is neither MASS nor MASS,X,Y,Z"),
    ('--rate -1', 2, "--rate: '-1' is not a rate from 0 to 100000 Hz"),
    ('--link tool9 --payload 1', 1, "link 'tool9' does not exist"),
    ('--payload -1', 1, 'mass is -1'),
]
# fmt: on


@pytest.mark.parametrize(('options', 'code', 'words'), OPTIONS)
def test_arguments_are_checked(write, capsys, options, code, words):
    assert code_of('effort', STANFORD, write(MOVE), *options.split()) == code
    assert words in capsys.readouterr().err


# ---- YAML ----------------------------------------------------------------------------------


def test_reads_output_of_ros2_topic_echo(write):
    trajectory, notes = read(write(ECHO))
    assert trajectory.joint_names == ('joint_2', 'joint_3')
    assert trajectory.times.tolist() == [0.0, 1.5]
    assert trajectory.positions.tolist() == [[-1.0, 0.4], [-1.5, 0.9]]
    assert trajectory.velocities.tolist() == [[0.0, 0.0], [0.0, 0.0]]
    assert trajectory.accelerations is None
    assert notes == ()


def test_reads_the_first_of_several_trajectories(write):
    assert read(write(ECHO + ECHO)).notes == ('only the first of 2 trajectories is used',)


def test_derivatives_of_some_points_only_are_not_used(write):
    trajectory, notes = read(write(ECHO.replace('  - 0.0\n  - 0.0\n', '    []\n', 1)))
    assert trajectory.velocities is None
    assert notes == ('velocities are not used, because only 1 of 2 points have them',)


# fmt: off
YAML = [
    ('a: [1', 'not valid YAML: while parsing'),
    (MOVE.replace('points', 'steps'), 'no trajectory, expected joint_names and points'),
    ('hello', 'no trajectory, expected joint_names and points'),
    ('', 'no trajectory'),
    (ECHO.replace('  - 0.4\n', "  - '...'\n"), '--full-length'),
    (ECHO.replace('  - 0.4\n', ''), 'positions of point 0: expected 2 numbers, got 1'),
    (ECHO.replace('-1.5', 'up'), 'positions of point 1: could not convert'),
    (ECHO.replace('sec: 1', 'sec: one'), 'time_from_start of point 1'),
    (ECHO.replace('points:', "points: '...'\nothers:"), '--full-length'),
    (MOVE.replace('[joint_2, joint_3]', 'joint_2'), 'expected a list of names'),
    (MOVE.replace('joint_names', 'names'), 'joint_names is None, expected a list of names'),
    (MOVE.replace('-1.5, 0.9', '-1.5, [0.9]'), 'positions of point 1 contain a list'),
    (MOVE.replace(': 0.5', ': 2026-11-22'), "time_from_start of point 1 is '2026-11-22'"),
    (MOVE.replace(': 0.5', ': !!float x'), "time_from_start of point 1 is 'x'"),
    (MOVE.replace(': 0.5', ': !!python/object:os.system x'), "of point 1 is 'x'"),
    (MOVE.replace(': 0.5', ': {sec: [1]}'), 'time_from_start of point 1 is'),
    (BOMB + MOVE.replace(': 0.5', ': *a11'), r'time_from_start of point 1 is \[\['),
    (BOMB + 'joint_names: *a11\npoints: []', r'joint_names is \[\['),
    ('&a [*a]', 'not valid YAML: found unconstructable recursive node'),
    ('[' * 200_000, 'nesting depth'),
    ('joint_names: ' + '{a: ' * 50_000, 'nesting depth'),
    ('- ' * 50_000, 'nesting depth'),
    ('[' * 900 + ']' * 900, 'nested too deeply'),
]
# fmt: on


@pytest.mark.parametrize(('text', 'words'), YAML)
def test_invalid_yaml_is_rejected(write, text, words):
    path = write(text)
    with pytest.raises(TrajectoryError, match=words) as error:
        read(path)
    assert str(path) in str(error.value)
    assert len(str(error.value)) < 400
    assert '\n' not in str(error.value)


def test_a_huge_file_is_refused(write, monkeypatch):
    monkeypatch.setattr(trajectory_files, '_LARGEST', 100)
    with pytest.raises(TrajectoryError, match='has more than 100 characters'):
        read(write(MOVE))


def test_yaml_may_have_anchors_and_several_documents(write):
    text = """\
# comment
---
home: &home [-1.0, 4e-1]
---
joint_names: &names [joint_2, "joint_3"]
points:
- &a {positions: [-1, 4e-1], velocities: ~, accelerations: [], time_from_start: +.5}
- {positions: [-1.5, 0.9], time_from_start: {nanosec: 750000000}}
---
...
"""
    loaded = read(write(text)).trajectory
    assert loaded.joint_names == ('joint_2', 'joint_3')
    assert loaded.times.tolist() == [0.5, 0.75]
    assert loaded.positions.tolist() == [[-1, 0.4], [-1.5, 0.9]]
    assert loaded.velocities is loaded.accelerations is None


# ---- CSV -----------------------------------------------------------------------------------


def test_reads_csv_by_its_header(write):
    text = (
        'time, joint_3,joint_1.position,joint_3.velocity,joint_1.velocity,note\n'
        '0,1,2,3,4,5\n1,2,3,4,5,6\n'
    )
    trajectory, notes = read(write(text, 'a.csv'))
    assert trajectory.joint_names == ('joint_3', 'joint_1')
    assert trajectory.positions.tolist() == [[1.0, 2.0], [2.0, 3.0]]
    assert trajectory.velocities.tolist() == [[3.0, 4.0], [4.0, 5.0]]
    assert trajectory.accelerations is None
    assert notes == ('columns not used: note',)


PLOTJUGGLER = """\
__time,/imu/x,/joint_states/joint_3/effort,/joint_states/joint_3/position,/joint_states/joint_1/position
1700000000.5,,7,1,2
1700000000.6,0.1,,,
1700000001.5,,8,3,4
"""
ECHOED = """\
1700000000,500000000,,joint_3,joint_1,1.0,2.0,0.5,0.25,
1700000001,500000000,,joint_3,joint_1,3.0,4.0,0.5,0.25,
"""


@pytest.mark.parametrize(
    ('text', 'unused'),
    [
        (PLOTJUGGLER, '/imu/x'),
        (PLOTJUGGLER.replace('/joint_3/', '/robot/joint_3/'), '/imu/x'),
        (ECHOED, ''),
        (ECHOED.replace('0.5,0.25,\n', ',7.0,8.0\n'), ''),
    ],
)
def test_reads_exports_of_plotjuggler_and_of_ros2_topic_echo(write, text, unused):
    trajectory, notes = read(write(text, 'a.csv'))
    assert trajectory.joint_names == ('joint_3', 'joint_1')
    assert trajectory.positions.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert trajectory.times == pytest.approx([0.0, 1.0])
    assert (trajectory.velocities is not None) == (',0.5,0.25,' in text)
    assert 'first point, which was at 1700000000.500 s' in notes[-1]
    assert unused in notes[0]


@pytest.mark.parametrize('text', [PLOTJUGGLER, ECHOED.replace('0.5,0.25,\n', ',7.0,8.0\n')])
def test_exports_are_recordings_too(write, text):
    recording, _ = read_measured_states(write(text, 'a.csv'), ['joint_1', 'joint_3'])
    assert recording.times == pytest.approx([0.0, 1.0])
    assert recording.positions.tolist() == [[2.0, 1.0], [4.0, 3.0]]
    assert recording.efforts[:, 1].tolist() == ([7.0, 8.0] if text == PLOTJUGGLER else [7.0, 7.0])


# fmt: off
CSV = [
    ('', 'no rows'),
    ('t,joint_1\n0,1\n',
     "no column 'time'; the columns are t, joint_1; expected 'time' .s. and, for each "
     "joint, '<joint>' or '<joint>.position', '<joint>.velocity', '<joint>.acceleration'; "
     'the joints are joint_1, '),
    ('time;joint_1\n0;1\n', "separated by ';', expected ','; the columns are time, joint_1;"),
    ('time\tjoint_1\n0\t1\n', "separated by tabs, expected ','; the columns are time, "),
    ('time,elbow\n0,1\n',
     'no column contains positions of a joint of this robot; the columns are time, elbow'),
    ('time,joint_1,joint_2.velocity\n0,1,2\n', "joint 'joint_2' has no position column"),
    ('time,joint_1,joint_1\n0,1,2\n', "two columns contain the position of joint 'joint_1'"),
    ('time,joint_1,time\n0,1,0\n', "has 2 columns 'time', expected one"),
    ('time,joint_1\n0,1\n1\n', 'line 3 has 1 values, but the header has 2 columns'),
    ('time,joint_1\n0,one\n', "line 2, column 'joint_1': 'one' is not a number"),
    ('0,1\n', "line 1 is neither a header with the column 'time' nor a JointState of `ros2"),
    (ECHOED.replace('3.0,4.0', '3.0'), 'line 2 is neither a header with'),
    (ECHOED.replace('3.0,4.0', '3.0,...'), "line 2, column 'joint_1.position': '...' is"),
    (ECHOED.replace('joint_1,3.0', 'hand,3.0'), 'line 2 has other joints or values than the fir'),
    (ECHOED.replace('4.0,0.5,0.25', '4.0,'), 'line 2 has other joints or values'),
]
# fmt: on


@pytest.mark.parametrize(('text', 'words'), CSV)
def test_invalid_csv_is_rejected(write, text, words):
    with pytest.raises(TrajectoryError, match=words):
        read(write(text, 'a.csv'))


# fmt: off
MOTIONS = [
    ('time,joint_1\n', 'no points'),
    ('time,joint_1\n1,0\n0,0\n', 'expected a time'),
    ('time,joint_1,joint_2\n0,0,0\n1,,0\n', "positions of joint 'joint_1' are nan at point 1"),
    ('time,joint_1\n0,0\n1700000000,0\n', '3.4e+11 states are too many'),
    (f'time,joint_1\n0,0\n{"1" * 400},0\n', 'one of the times is inf'),
]
# fmt: on


@pytest.mark.parametrize(('text', 'words'), MOTIONS)
def test_impossible_motions_are_rejected(write, capsys, text, words):
    assert effort(write(text, 'a.csv')) == 1
    assert words in capsys.readouterr().err


# ---- Recordings ----------------------------------------------------------------------------


TYPES = typestore().types


def trajectory_message(times, positions):
    stamp = TYPES['builtin_interfaces/msg/Time'](0, 0)
    header = TYPES['std_msgs/msg/Header'](stamp=stamp, frame_id='')
    duration, empty = TYPES['builtin_interfaces/msg/Duration'], np.zeros(0)
    points = [
        TYPES['trajectory_msgs/msg/JointTrajectoryPoint'](
            np.array(row), empty, empty, empty, duration(int(t), round(t % 1.0 * 1e9))
        )
        for t, row in zip(times, positions, strict=True)
    ]
    return TYPES['trajectory_msgs/msg/JointTrajectory'](header, ['joint_2', 'joint_3'], points)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_reads_a_recorded_trajectory(tmp_path, storage, capsys):
    moving = trajectory_message([0.0, 1.5], [[-1.0, 0.4], [-1.5, 0.9]])
    messages = [('/stamps', moving.header, 1)]
    for k, points in enumerate((0, 1, 2, 1)):
        shorter = replace(moving, points=moving.points[:points])
        messages.append(('/controller/joint_trajectory', shorter, 2 + k))
    bag = tmp_path / 'bag'
    write_messages(bag, messages, storage)
    trajectory, notes = read(bag)
    assert trajectory.times.tolist() == [0.0, 1.5]
    assert trajectory.positions.tolist() == [[-1.0, 0.4], [-1.5, 0.9]]
    assert notes == (
        'topic /controller/joint_trajectory: the first with the most points among 3 trajectories',
    )
    (file,) = [path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3')]
    assert np.array_equal(read(file).trajectory.positions, trajectory.positions)
    assert effort(bag) == 0
    assert Path('bag_efforts.csv').exists()


def test_recordings_without_a_trajectory_are_rejected(tmp_path):
    write_messages(tmp_path / 'bag', [('/stamps', trajectory_message([], []).header, 1)])
    words = 'no JointTrajectory message with points; topics: /stamps'
    with pytest.raises(TrajectoryError, match=words):
        read(tmp_path / 'bag')


def test_invalid_recordings_are_rejected(tmp_path, capsys):
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'noise.mcap').write_bytes(b'noise')
    (tmp_path / 'noise.db3').write_bytes(b'noise')
    (tmp_path / 'noise.bin').write_bytes(b'\xff\xfe\x00')
    (tmp_path / 'noise.csv').write_bytes(b'\xff\xfe\x00')
    for name in ('empty', 'noise.mcap', 'noise.db3', 'noise.bin', 'noise.csv', 'nothing.mcap'):
        assert main(['effort', str(STANFORD), str(tmp_path / name)]) == 1, name
        error = capsys.readouterr().err
        assert name in error
        assert len(error.splitlines()) == 1


def test_the_example_of_the_help_can_be_read(write):
    text = FORMATS.split('prints it:\n')[1].split('              Points may')[0]
    text = textwrap.dedent(text).replace('[a, b]', '[joint_1, joint_4]')
    assert len(read(write(text)).trajectory.times) == 2
