"""The command `effort`, and the files it reads and writes."""

import csv
from pathlib import Path
import re

from inverse_dynamics_node.analysis.trajectory_files import read_trajectory
from inverse_dynamics_node.cli.main import main
from inverse_dynamics_node.dynamics.inverse_dynamics import InverseDynamics
from inverse_dynamics_node.errors import TrajectoryError
from inverse_dynamics_node.robot.urdf import load_urdf
import numpy as np
import pytest
from robot_files import STANFORD

yaml = pytest.importorskip('yaml')

JOINTS = tuple(f'joint_{i}' for i in range(1, 7))
LISTS = """\
joint_names: [joint_2, joint_3]
times: [0.0, 0.5, 1]
positions: [[-1.0, 0.4], [-1.5, 0.9], [-1.0, 0.4]]
"""
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


def read(path, topic=None):
    return read_trajectory(path, JOINTS, topic)


# ---- The command ---------------------------------------------------------------------------


def test_reports_peaks_and_writes_table_and_picture(tmp_path, write, capsys, size_of):
    assert main(['effort', str(STANFORD), str(write(LISTS))]) == 0
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


def test_written_files_give_the_same_report(tmp_path, write, capsys):
    options = ['--no-picture', '--force', '--payload', '1.5,0,0,0.1']
    peaks = []
    for path, *more in (
        (write(LISTS), '--trajectory-out', 'out.yaml'),
        ('out.yaml',),
        ('out_efforts.csv',),
    ):
        assert main(['effort', str(STANFORD), str(path), *options, *more]) == 0
        peaks.append(capsys.readouterr().out.split('Peaks')[1].split('written')[0])
    assert peaks[0] == peaks[1] == peaks[2]


def test_trajectory_out_is_a_message(tmp_path, write):
    arguments = [
        str(STANFORD),
        str(write(ECHO)),
        '--no-picture',
        '--force',
        '--trajectory-out',
        'out.yaml',
    ]
    assert main(['effort', *arguments]) == 0
    message = yaml.safe_load((tmp_path / 'out.yaml').read_text())
    assert message['joint_names'] == ['joint_2', 'joint_3']
    assert [set(point) for point in message['points']] == [
        {'positions', 'velocities', 'accelerations', 'effort', 'time_from_start'}
    ] * 2
    assert message['points'][1]['time_from_start'] == {'sec': 1, 'nanosec': 500000000}
    dynamics = InverseDynamics(load_urdf(STANFORD))
    q, qd, qdd = np.zeros((3, 6))
    point = message['points'][1]
    q[[0, 1, 2]] = [0.0, *point['positions']]
    qdd[1:3] = point['accelerations']
    assert point['effort'] == pytest.approx(dynamics.efforts(q, qd, qdd)[1:3], rel=1e-6)


def test_trajectory_out_fills_a_message_of_ros(tmp_path, write):
    pytest.importorskip('trajectory_msgs')
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    arguments = [
        str(STANFORD),
        str(write(ECHO)),
        '--no-picture',
        '--force',
        '--trajectory-out',
        'out.yaml',
    ]
    assert main(['effort', *arguments]) == 0
    fields = yaml.safe_load((tmp_path / 'out.yaml').read_text())
    points = fields.pop('points')
    for point in points:
        point['time_from_start'] = Duration(**point['time_from_start'])
    # The constructor checks the types of all fields.
    message = JointTrajectory(points=[JointTrajectoryPoint(**each) for each in points], **fields)
    assert len(message.points[1].effort) == 2


def test_strict_fails_beyond_a_limit(write, capsys):
    path = str(write(LISTS.replace('0.5, 1]', '0.05, 0.1]')))
    arguments = ['effort', str(STANFORD), path, '--no-picture', '--force']
    assert main(arguments) == 0
    output = capsys.readouterr().out
    assert 'beyond: effort, speed' in output
    assert '\n\nThe motion exceeds limits: up to ' in output
    assert main([*arguments, '--strict']) == 3
    slow = str(write(LISTS.replace('0.5, 1]', '5, 10]')))
    assert main(['effort', str(STANFORD), slow, '--no-picture', '--force', '--strict']) == 0
    last = capsys.readouterr().out.split('\n\n')[-1]
    assert ' '.join(last.split()) == (
        'The motion stays within the known limits: up to 32% of the effort limit of joint_2, '
        'up to 15% of the speed limit of joint_3.'
    )


def test_warns_about_positions_in_degrees(write, capsys):
    degrees = LISTS.replace('[-1.0, 0.4], [-1.5', '[-57.3, 0.4], [-70').replace('[-1.0', '[-57.3')
    assert main(['effort', str(STANFORD), str(write(degrees)), '--no-picture', '--force']) == 0
    output = capsys.readouterr().out
    words = ' '.join(output.split())
    assert 'joint_2 outside the position limits.' in words
    assert re.search(r'joint_2 is at -7\d(\.\d+)? rad, outside its limits .*degrees\?\)', words)
    assert re.search(r'joint_2: the (effort|speed) is [\d.]+ times its limit', words)
    assert main(['effort', str(STANFORD), str(write(LISTS)), '--no-picture', '--force']) == 0
    assert 'warning' not in capsys.readouterr().out


def test_the_link_of_the_payload_is_named(write, capsys):
    arguments = [
        'effort',
        str(STANFORD),
        str(write(LISTS)),
        '--no-picture',
        '--force',
        '--payload',
        '2',
    ]
    for options, link in (([], 'tool0'), (['--link', 'link_3'], 'link_3')):
        assert main([*arguments, *options]) == 0
        assert f"payload 2 kg on link '{link}'; " in capsys.readouterr().out


def test_payload_friction_and_positions_change_the_result(tmp_path, write, capsys):
    urdf = tmp_path / 'rubbing.urdf'
    text = STANFORD.read_text()
    urdf.write_text(text.replace('<limit', '<dynamics damping="5"/><limit'))
    tables = []
    for options in ([], ['--friction'], ['--payload', '3'], ['--at', 'joint_5=1.5']):
        assert (
            main(['effort', str(urdf), str(write(LISTS)), '--no-picture', '--force', *options])
            == 0
        )
        tables.append(capsys.readouterr().out.split('Peaks')[1])
    assert len(set(tables)) == 4


@pytest.mark.parametrize('count', [1, pytest.param(30, marks=pytest.mark.long)])
def test_draws_any_number_of_joints(tmp_path, write, size_of, count):
    links = ''.join(
        f'<link name="l{i}"><inertial><mass value="1"/><origin xyz="0.1 0 0"/><inertia ixx="0.1" '
        'ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>'
        for i in range(count + 1)
    )
    joints = ''.join(
        f'<joint name="j{i}" type="continuous"><parent link="l{i}"/><child link="l{i + 1}"/>'
        '<axis xyz="0 1 0"/></joint>'
        for i in range(count)
    )
    urdf = write(f'<robot name="snake">{links}{joints}</robot>', 'snake.urdf')
    rows = [[0.0] * count, [0.3] * count]
    names = [f'j{i}' for i in range(count)]
    text = yaml.safe_dump({'joint_names': names, 'times': [0.0, 1.0], 'positions': rows})
    assert main(['effort', str(urdf), str(write(text)), '--picture', 'p.png']) == 0
    width, height = size_of(tmp_path / 'p.png')
    assert width == 900
    assert 300 <= height <= 2200


@pytest.mark.parametrize(
    'options',
    [['--payload', 'heavy'], ['--payload', '1,2'], ['--rate', '-1'], ['--at', 'joint_1']],
)
def test_arguments_are_checked(write, options):
    with pytest.raises(SystemExit) as exit_:
        main(['effort', str(STANFORD), str(write(LISTS)), *options])
    assert exit_.value.code == 2


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        (['--link', 'tool9', '--payload', '1'], "link 'tool9' does not exist"),
        (['--payload', '-1'], 'mass is -1'),
        (['--at', 'joint_9=1'], "joint 'joint_9' does not exist"),
    ],
)
def test_arguments_that_do_not_fit_the_robot_are_reported(write, capsys, options, words):
    assert main(['effort', str(STANFORD), str(write(LISTS)), *options]) == 1
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


def test_reads_goals_and_answers_that_hold_a_trajectory(write):
    inner = ECHO.replace('---\n', '').replace('\n', '\n    ')
    assert len(read(write(f'goal:\n  trajectory:\n    {inner}')).trajectory.times) == 2
    assert len(read(write(f'joint_trajectory:\n    {inner}')).trajectory.times) == 2


def test_reads_the_first_of_several_trajectories(write):
    assert read(write(ECHO + ECHO)).notes == ('only the first of 2 trajectories is used',)


def test_derivatives_of_some_points_only_are_not_used(write):
    trajectory, notes = read(write(ECHO.replace('  - 0.0\n  - 0.0\n', '    []\n', 1)))
    assert trajectory.velocities is None
    assert notes == ('velocities are not used, because only 1 of 2 points have them',)


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('a: [1', 'not valid YAML: while parsing'),
        ('hello', 'no trajectory, expected joint_names and points'),
        ('', 'no trajectory'),
        (ECHO.replace('  - 0.4\n', "  - '...'\n"), '--full-length'),
        (ECHO.replace('  - 0.4\n', ''), 'positions of point 0: expected 2 numbers, got 1'),
        (ECHO.replace('-1.5', 'up'), 'positions of point 1: could not convert'),
        (ECHO.replace('sec: 1', 'sec: one'), 'time_from_start of point 1'),
        (ECHO.replace('points:', "points: '...'\nothers:"), '--full-length'),
        (LISTS.replace('times', 'when'), 'no list of times'),
        (LISTS.replace(', [-1.0, 0.4]]', ']'), 'positions: expected 3 lists'),
        (LISTS.replace('[joint_2, joint_3]', 'joint_2'), 'expected a list of names'),
    ],
)  # fmt: skip
def test_invalid_yaml_is_rejected(write, text, words):
    path = write(text)
    with pytest.raises(TrajectoryError, match=words) as error:
        read(path)
    assert str(path) in str(error.value)


# ---- CSV -----------------------------------------------------------------------------------


def test_reads_csv_by_its_header(write):
    text = (
        'time, joint_3,joint_1,joint_3.velocity,joint_1.velocity,note\n0,1,2,3,4,5\n1,2,3,4,5,6\n'
    )
    trajectory, notes = read(write(text, 'a.csv'))
    assert trajectory.joint_names == ('joint_3', 'joint_1')
    assert trajectory.positions.tolist() == [[1.0, 2.0], [2.0, 3.0]]
    assert trajectory.velocities.tolist() == [[3.0, 4.0], [4.0, 5.0]]
    assert trajectory.accelerations is None
    assert notes == ('columns not used: note',)


def test_reads_columns_with_the_suffix_position(write):
    trajectory, notes = read(write('time,joint_1.position,joint_1.effort\n0,1,2\n', 'a.csv'))
    assert trajectory.positions.tolist() == [[1.0]]
    assert notes == ('columns not used: joint_1.effort',)


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('', 'no rows'),
        (
            't,joint_1\n0,1\n',
            "no column 'time'; the columns are t, joint_1; expected 'time' .s. and, for each "
            "joint, '<joint>' or '<joint>.position', '<joint>.velocity', '<joint>.acceleration'; "
            'the joints are joint_1, ',
        ),
        ('time;joint_1\n0;1\n', "separated by ';', expected ','; the columns are time, joint_1;"),
        ('time\tjoint_1\n0\t1\n', "separated by tabs, expected ','; the columns are time, "),
        (
            'time,elbow\n0,1\n',
            'no column contains positions of a joint of this robot; the columns are time, elbow',
        ),
        ('time,joint_1,joint_2.velocity\n0,1,2\n', "joint 'joint_2' has no position column"),
        ('time,joint_1,joint_1\n0,1,2\n', "two columns contain the position of joint 'joint_1'"),
        ('time,joint_1\n0,1\n1\n', 'line 3 has 1 values, but the header has 2 columns'),
        ('time,joint_1\n0,one\n', "line 2, column 'joint_1': 'one' is not a number"),
    ],
)
def test_invalid_csv_is_rejected(write, text, words):
    with pytest.raises(TrajectoryError, match=words):
        read(write(text, 'a.csv'))


def test_empty_or_backward_trajectories_are_rejected(write, capsys):
    assert main(['effort', str(STANFORD), str(write('time,joint_1\n', 'a.csv'))]) == 1
    assert 'no points' in capsys.readouterr().err
    text = 'time,joint_1\n1,0\n0,0\n'
    assert main(['effort', str(STANFORD), str(write(text, 'a.csv'))]) == 1
    assert 'expected a time' in capsys.readouterr().err


# ---- Recordings ----------------------------------------------------------------------------


class Recording:
    """Writes messages as `ros2 bag record` does, by the library that reads them."""

    def __init__(self, path, plugin):
        from rosbags.rosbag2 import Writer
        from rosbags.typesys import get_typestore, Stores

        self.store = get_typestore(Stores.ROS2_JAZZY)
        self.types = self.store.types
        self.writer = Writer(path, version=9, storage_plugin=plugin)
        self.connections = {}

    def write(self, topic, message, time):
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        data = self.store.serialize_cdr(message, kind)
        self.writer.write(self.connections[topic], int(1e9 * time), data)

    def stamp(self, time):
        stamp = self.types['builtin_interfaces/msg/Time'](int(time), round(time % 1.0 * 1e9))
        return self.types['std_msgs/msg/Header'](stamp=stamp, frame_id='')

    def state(self, time, positions):
        empty = np.zeros(0)
        return self.types['sensor_msgs/msg/JointState'](
            self.stamp(time), list(positions), np.array([*positions.values()]), empty, empty
        )

    def trajectory(self, times, positions):
        duration = self.types['builtin_interfaces/msg/Duration']
        empty = np.zeros(0)
        points = [
            self.types['trajectory_msgs/msg/JointTrajectoryPoint'](
                np.array(row), empty, empty, empty, duration(int(t), round(t % 1.0 * 1e9))
            )
            for t, row in zip(times, positions, strict=True)
        ]
        return self.types['trajectory_msgs/msg/JointTrajectory'](
            self.stamp(0.0), ['joint_2', 'joint_3'], points
        )


@pytest.fixture(params=['MCAP', 'SQLITE3'])
def record(request, tmp_path):
    from rosbags.rosbag2 import StoragePlugin

    def record(messages):
        recording = Recording(tmp_path / 'bag', StoragePlugin[request.param])
        with recording.writer:
            messages(recording)
        return tmp_path / 'bag'

    return record


def test_reads_a_recorded_trajectory(record, capsys):
    def messages(recording):
        recording.write('/joint_states', recording.state(1.0, {'joint_1': 0.0}), 1.0)
        for start in (-1.0, -1.4):
            moving = recording.trajectory([0.0, 1.5], [[start, 0.4], [-1.5, 0.9]])
            recording.write('/controller/joint_trajectory', moving, 2.0 - start)

    bag = record(messages)
    trajectory, notes = read(bag)
    assert trajectory.times.tolist() == [0.0, 1.5]
    assert trajectory.positions.tolist() == [[-1.0, 0.4], [-1.5, 0.9]]
    assert notes == ('topic /controller/joint_trajectory: trajectory 1 of 2',)
    (file,) = [path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3')]
    assert np.array_equal(read(file).trajectory.positions, trajectory.positions)
    assert main(['effort', str(STANFORD), str(bag), '--no-picture', '--force']) == 0
    assert Path('bag_efforts.csv').exists()


def test_reads_recorded_joint_states(record):
    def messages(recording):
        for k in range(50):
            positions = {'wheel': 9.0, 'joint_3': 0.01 * k, 'joint_2': -0.02 * k}
            recording.write('/joint_states', recording.state(5.0 + 0.1 * k, positions), 7.0 + k)
            if k % 5 == 0:
                gripper = recording.state(5.0 + 0.1 * k, {'joint_6': 0.0})
                recording.write('/joint_states', gripper, 7.1 + k)
        recording.write('/joint_states', recording.state(5.0, positions), 60.0)

    trajectory, notes = read(record(messages))
    assert trajectory.joint_names == ('joint_3', 'joint_2')
    assert trajectory.times == pytest.approx(0.1 * np.arange(50))
    assert trajectory.positions[:, 1] == pytest.approx(-0.02 * np.arange(50))
    assert trajectory.velocities is None
    assert notes == (
        'topic /joint_states',
        '50 joint states',
        'ignored 1 joint states that are not later than the previous state',
        'ignored joints that the robot does not have: wheel',
        'ignored joint states with other joint names: joint_6',
    )


def test_measured_states_may_be_smoothed(record, rng, capsys):
    def messages(recording):
        for k in range(500):
            angle = np.sin(0.02 * k) + rng.normal(0.0, 1e-4)
            recording.write('/joint_states', recording.state(0.01 * k, {'joint_1': angle}), k)

    peaks = []
    bag = record(messages)
    for options in ([], ['--smooth', '5']):
        assert main(['effort', str(STANFORD), str(bag), '--no-picture', '--force', *options]) == 0
        output = capsys.readouterr().out
        peaks.append(abs(float(re.search(r'joint_1 +(\S+) N m', output)[1])))
    assert 'smoothed at 5 Hz' in output
    assert peaks[1] < 0.7 * peaks[0]


def test_several_topics_without_the_default_one_are_an_error(record):
    def messages(recording):
        for name in ('left', 'right'):
            recording.write(f'/{name}/joint_states', recording.state(1.0, {'joint_1': 0.0}), 1.0)

    bag = record(messages)
    with pytest.raises(TrajectoryError, match='choose one with --topic'):
        read(bag)
    assert len(read(bag, '/left/joint_states').trajectory.times) == 1
    with pytest.raises(TrajectoryError, match=r"'/up'; topics: /left/joint_states"):
        read(bag, '/up')


def test_joint_states_is_the_default_of_several_topics(record):
    def messages(recording):
        for k, name in enumerate(('/joint_states', '/node/joint_efforts')):
            recording.write(name, recording.state(1.0, {'joint_1': float(k)}), 1.0)

    assert read(record(messages)).trajectory.positions.tolist() == [[0.0]]


def stream_references(recording):
    """Record references with one point and joint states, as in a run of the demo."""
    for k in range(5):
        point = recording.trajectory([0.0], [[-0.01 * k, 0.4]])
        recording.write('/node/reference', point, 1.0 + 0.1 * k)
        positions = {'joint_2': -0.01 * k, 'joint_3': 0.4}
        recording.write('/joint_states', recording.state(1.0 + 0.1 * k, positions), 1.0 + 0.1 * k)


def test_joint_states_are_preferred_to_single_points(record, capsys):
    bag = record(stream_references)
    trajectory, notes = read(bag)
    assert len(trajectory.times) == 5
    assert notes[0] == 'topic /joint_states'
    assert notes[-1].endswith('have a single point are not used: /node/reference')
    command = [
        'effort',
        str(STANFORD),
        str(bag),
        '--no-picture',
        '--force',
        '--topic',
        '/node/reference',
    ]
    assert main(command) == 0
    output = capsys.readouterr().out
    assert '  1 point in 0 s, 2 joints\n' in output
    assert 'topic /node/reference: trajectory 1 of 5' in output
    assert 'a single point; --topic can select other topics: /joint_states' in output


def test_reads_the_longest_trajectory_and_lists_the_others(record):
    def messages(recording):
        stream_references(recording)
        for k, count in enumerate((2, 4, 3)):
            rows = [[-1.0 - 0.1 * i, 0.4] for i in range(count)]
            moving = recording.trajectory([float(i) for i in range(count)], rows)
            recording.write('/controller/joint_trajectory', moving, 2.0 + k)

    trajectory, notes = read(record(messages))
    assert len(trajectory.times) == 4
    assert notes == (
        'topic /controller/joint_trajectory: trajectory 2 of 3',
        'other topics: /node/reference (1 point); choose one with --topic',
    )


def test_recordings_without_a_trajectory_are_rejected(record):
    def messages(recording):
        recording.write('/joint_states', recording.state(1.0, {'wheel': 0.0}), 1.0)

    with pytest.raises(TrajectoryError, match='contain no joint of this robot, only wheel'):
        read(record(messages))


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


def test_the_example_of_the_help_can_be_read(write, capsys):
    with pytest.raises(SystemExit):
        main(['effort', '--help'])
    text = capsys.readouterr().out.split('Or plain lists:\n')[1].split('  .csv')[0]
    lines = [line.split('    optional')[0].strip() for line in text.splitlines()]
    lists = '\n'.join(lines).replace('[a, b]', '[joint_1, joint_4]')
    assert len(read(write(lists)).trajectory.times) == 2
