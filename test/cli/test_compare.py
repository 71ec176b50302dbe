"""The command `compare` on recordings of the simulated robot."""

import re

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.recordings.measured_states import read_measured_states
from inverse_dynamics_node.analysis.recordings.signals import Recording
from inverse_dynamics_node.cli.main import main
import numpy as np
import pytest
from robot_files import ROOT, STANFORD
from runs import run as made_up
from simulated_runs import (
    COULOMB,
    DAMPING,
    simulate,
    simulate_with_a_gripper,
    with_friction,
    write_bag,
    write_csv,
)
import yaml

pytest.importorskip('mujoco')

JOINTS = load_urdf(STANFORD).joint_names


@pytest.fixture(scope='session')
def recorded():
    """Return 20 s of the simulated robot at 500 Hz."""
    return simulate(STANFORD, with_friction(STANFORD, DAMPING, COULOMB))


def compare(*arguments):
    return main(['compare', str(STANFORD), *map(str, arguments)])


# ---- Its findings --------------------------------------------------------------------------


@pytest.mark.parametrize('storage', ['mcap', pytest.param('sqlite3', marks=pytest.mark.long)])
def test_finds_the_friction_of_the_simulated_robot(recorded, storage, here, capsys, size_of):
    write_bag(here / 'run', recorded, storage)
    assert compare('run', '--parameters', 'friction.yaml', '--strict') == 0
    output = capsys.readouterr().out
    assert output.startswith('The model explains ')
    corrected = re.search(
        r'With fitted friction, the model explains >?([\d.]+)%', ' '.join(output.split())
    )
    assert float(corrected[1]) > 99.0
    parameters = yaml.safe_load((here / 'friction.yaml').read_text())['/**']['ros__parameters']
    assert parameters['joints'] == list(JOINTS)
    assert parameters['damping'] == pytest.approx(DAMPING, rel=0.1)
    assert parameters['coulomb'] == pytest.approx(COULOMB, rel=0.1)
    width, height = size_of(here / 'run_compare.png')
    assert 800 <= width <= 1000
    assert 600 <= height <= 1000


def test_finds_a_payload_and_nothing_once_it_is_passed(here, capsys):
    write_bag(here / 'run', simulate_with_a_gripper())
    assert compare('run', '--no-picture') == 0
    output = capsys.readouterr().out
    assert output.startswith("Link 'tool0' carries 1.20 kg that the model does not have. ")
    assert '1 warning\n' in output
    again = ' '.join(output.split()).split('To continue the diagnosis, use ')[1].split()[:4]
    assert again[:3] == ['--link', 'tool0', '--payload']
    assert [float(x) for x in again[3].split(',')] == pytest.approx([1.2, 0, 0.03, 0.06], abs=0.01)
    assert compare('run', '--no-picture', '--strict', *again) == 0
    assert 'warning' not in capsys.readouterr().out


def test_finds_compensated_gravity_and_nothing_with_zero_gravity(here, capsys):
    dynamics, recording = made_up('seven_dof', rate=200.0, friction=(1.0, 1.0))
    lacking = recording.efforts - dynamics.gravity_efforts(recording.positions)
    write_csv(here / 'run.csv', recording._replace(efforts=lacking))
    arguments = [
        'compare',
        str(ROOT / 'test' / 'robots' / 'seven_dof.urdf'),
        'run.csv',
        '--strict',
        '--no-picture',
    ]
    assert main(arguments) == 3
    assert 'lack gravity' in capsys.readouterr().out
    assert main([*arguments, '--gravity', '0', '0', '0']) == 0


def test_parameters_of_the_node_say_what_the_recorded_efforts_contain(here, capsys):
    dynamics, recording = made_up('seven_dof', rate=200.0, friction=(1.0, 1.0))
    gravity = dynamics.gravity_efforts(recording.positions)
    scale = [-1.0, 0.02, 1.0, 1.0, 1.0, 1.0, 30.0]
    recording = recording._replace(efforts=(recording.efforts - gravity) / scale)
    write_csv(here / 'run.csv', recording)
    urdf = ROOT / 'test' / 'robots' / 'seven_dof.urdf'
    given = ['--node-parameters', 'node.yaml', '--strict', '--no-picture']

    def compared(**parameters):
        parameters['joints'] = list(recording.joint_names)
        sections = {'/**': {'ros__parameters': parameters}, 'other': 1}
        (here / 'node.yaml').write_text(yaml.safe_dump(sections))
        code = main(['compare', str(urdf), 'run.csv', *given])
        return code, ' '.join(capsys.readouterr().out.split())

    code, output = compared(include_gravity=False, measured_effort_scale=scale)
    assert code == 0, output
    assert compared(measured_gravity='excluded', measured_effort_scale=scale)[0] == 0
    code, output = compared(
        include_gravity=False, measured_gravity='included', measured_effort_scale=scale
    )
    assert code == 3
    assert 'lack gravity, although measured_gravity is set to included' in output
    assert compared(include_gravity=False)[0] == 3


@pytest.mark.parametrize(
    ('text', 'problem'),
    [
        ('', 'has no ros__parameters'),
        ('[1', 'node.yaml'),
        (
            'a: {ros__parameters: {measured_gravity: yes}}',
            'measured_gravity is True, expected one of',
        ),
        ('a: {ros__parameters: {include_gravity: 1}}', 'include_gravity is 1, expected true'),
        ('a: {ros__parameters: {measured_effort_scale: [1, 2]}}', 'has 2 numbers, expected one'),
        ('a: {ros__parameters: {measured_effort_scale: x}}', 'could not convert'),
    ],
)
def test_parameters_of_the_node_that_cannot_be_used_are_explained(here, capsys, text, problem):
    write_csv(here / 'run.csv', made_up('stanford', rate=200.0)[1])
    (here / 'node.yaml').write_text(text)
    assert compare('run.csv', '--node-parameters', 'node.yaml') != 0
    assert problem in capsys.readouterr().err


def test_friction_option_includes_the_friction_of_the_urdf(here, capsys):
    dynamics, recording = made_up('seven_dof', rate=200.0)
    dynamics.set_friction()
    efforts = (
        recording.efforts
        + dynamics.effort_terms(
            recording.positions, recording.velocities, np.zeros_like(recording.positions)
        ).friction
    )
    write_csv(here / 'run.csv', recording._replace(efforts=efforts))
    urdf = ROOT / 'test' / 'robots' / 'seven_dof.urdf'
    explained = []
    for options in ([], ['--friction']):
        assert main(['compare', str(urdf), 'run.csv', '--no-picture', *options]) == 0
        explained.append(float(capsys.readouterr().out.split()[3].strip('>%')))
    assert explained[1] > explained[0]
    assert explained[1] > 99.5


# ---- Its inputs ----------------------------------------------------------------------------


@pytest.fixture
def short(recorded):
    return recorded._replace(
        times=recorded.times[:1500],
        positions=recorded.positions[:1500],
        velocities=recorded.velocities[:1500],
        efforts=recorded.efforts[:1500],
    )


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_bags_their_files_and_csv_give_the_same_recording(short, storage, here):
    write_bag(here / 'run', short, storage)
    write_csv(here / 'run.csv', short)
    suffix = {'mcap': 'mcap', 'sqlite3': 'db3'}[storage]
    fractions = []
    for path in ('run', f'run/run.{suffix}', 'run.csv'):
        found, notes = read_measured_states(here / path, JOINTS, progress=fractions.append)
        assert notes == ()
        assert found.joint_names == JOINTS
        assert found.times == pytest.approx(short.times - short.times[0], abs=2e-9)
        order = [short.joint_names.index(name) for name in JOINTS]
        for field in ('positions', 'velocities', 'efforts'):
            assert getattr(found, field) == pytest.approx(getattr(short, field)[:, order])
    assert fractions[-1] == 1.0


def test_finds_the_topic_that_has_efforts(short, here, capsys):
    write_bag(here / 'run', short, topic='/arm/joint_states', extra=('/desired', '/gui'))
    assert read_measured_states(here / 'run', JOINTS)[0].efforts.shape == (1500, 6)
    assert compare('run', '--no-picture', '--topic', '/desired') == 1
    assert 'are empty or NaN, expected measured efforts' in capsys.readouterr().err
    assert compare('run', '--no-picture', '--topic', 'arm/joint_states') == 0


def test_unstamped_messages_have_the_time_of_the_recorder(short, here):
    write_bag(here / 'run', short, is_stamped=False)
    found, notes = read_measured_states(here / 'run', JOINTS)
    assert 'no time stamps' in notes[0]
    assert found.times == pytest.approx(short.times - short.times[0], abs=1e-3)


def test_unknown_and_missing_joints_are_reported(short, here, capsys):
    names = ('finger', *short.joint_names[1:])
    write_csv(here / 'run.csv', short._replace(joint_names=names))
    assert compare('run.csv', '--no-picture') == 0
    output = ' '.join(capsys.readouterr().out.split())
    assert 'Ignored joints that the robot does not have: finger' in output
    assert 'Joints that were not recorded and are assumed to rest at zero: joint_1' in output


@pytest.mark.parametrize('write', [write_bag, write_csv])
def test_a_joint_of_which_all_values_are_nan_was_not_recorded(write, short, here):
    fields = 'positions', 'velocities', 'efforts'
    is_known = np.array([name != 'joint_1' for name in short.joint_names])
    unknown = {field: np.where(is_known, getattr(short, field), np.nan) for field in fields}
    path = here / ('run.csv' if write is write_csv else 'run')
    write(path, short._replace(**unknown))
    found, notes = read_measured_states(path, JOINTS)
    assert notes == ('joints that were not recorded and are assumed to rest at zero: joint_1',)
    assert found.joint_names == JOINTS[1:]
    order = [short.joint_names.index(name) for name in JOINTS[1:]]
    for field in fields:
        np.testing.assert_array_equal(getattr(found, field), getattr(short, field)[:, order])


def test_a_recorded_mimic_joint_is_not_unknown(here, capsys):
    urdf = ROOT / 'test' / 'robots' / 'mimic_gripper.urdf'
    robot = load_urdf(urdf)
    assert robot.mimic_names
    times = 0.01 * np.arange(600)
    names = (*robot.joint_names, robot.mimic_names[0], 'stranger')
    positions = 0.01 * np.sin(times[:, None] + np.arange(len(names)))
    write_csv(here / 'run.csv', Recording(names, times, positions, None, 1.0 + positions))
    assert main(['compare', str(urdf), 'run.csv', '--no-picture']) == 0
    output = ' '.join(capsys.readouterr().out.split())
    assert 'Ignored joints that the robot does not have: stranger.' in output
    note = 'Ignored mimic joints, whose efforts are part of those of the joints that they mimic'
    assert f'{note}: {names[-2]}.' in output


def half_a_file(path, run):
    write_bag(path.with_name('run'), run)
    data = (path.with_name('run') / 'run.mcap').read_bytes()
    path.write_bytes(data[: len(data) // 2])


def without_metadata(path, run):
    write_bag(path, run)
    (path / 'metadata.yaml').unlink()


def one_joint_twice(path, run):
    write_bag(path, run._replace(joint_names=('joint_1', *run.joint_names[1:5], 'joint_1')))


def with_nan(name):
    return lambda path, run: write_csv(path, run._replace(**{name: np.nan * getattr(run, name)}))


# Other errors in CSV files, which are read as those of trajectories, are in test_effort.py.
@pytest.mark.parametrize(
    ('name', 'write', 'words'),
    [
        (
            'run.csv',
            lambda path, run: write_csv(path, run._replace(joint_names=tuple('abcdef'))),
            'has no joint of this robot, only a, b, c, d, e, f; expected some of joint_1',
        ),
        (
            'run.csv',
            lambda path, _: path.write_text('time\n0\n'),
            'has no joint names; expected some of joint_1',
        ),
        (
            'run.csv',
            with_nan('efforts'),
            'all efforts of the joints of this robot are empty or NaN',
        ),
        (
            'run.csv',
            with_nan('positions'),
            "all positions of joint 'joint_1' are empty or NaN",
        ),
        ('run', one_joint_twice, "/joint_states: message 0 names joint 'joint_1' more than once"),
        (
            'run',
            lambda path, run: write_bag(path, run, topic='/a', extra=('/b',), has_efforts=False),
            'several topics of type sensor_msgs/msg/JointState (/a, /b), none of',
        ),
        (
            'run',
            lambda path, run: write_bag(path, run, kind='std_msgs/msg/Header'),
            'has no topic of type sensor_msgs/msg/JointState; topics: /joint_states',
        ),
        ('half.mcap', half_a_file, 'half.mcap: '),
        (
            'run',
            without_metadata,
            'has no metadata.yaml, expected a rosbag2 folder, or one of these files',
        ),
        (
            'run.bagpipe',
            lambda path, _: path.write_text(''),
            "is a '.bagpipe' file, expected a rosbag2 folder, or a .mcap, .db3 or .csv file",
        ),
        ('nothing', lambda *_: None, 'no such file or folder'),
    ],
)
def test_errors_are_one_line(short, here, name, write, words, capsys):
    write(here / name, short)
    assert compare(name, '--no-picture') == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.startswith('inverse_dynamics: ')
    assert len(error.splitlines()) == 1


def test_a_topic_of_a_table_is_an_error(short, here, capsys):
    write_csv(here / 'run.csv', short)
    assert compare('run.csv', '--no-picture', '--topic', '/joint_states') == 1
    assert 'a CSV file has no topics' in capsys.readouterr().err


def test_the_node_accepts_the_parameters(recorded, here):
    parameters_of_node = pytest.importorskip('inverse_dynamics_node.node.parameters').PARAMETERS
    write_csv(here / 'run.csv', recorded)
    assert compare('run.csv', '--no-picture', '--parameters', 'friction.yaml') == 0
    parameters = yaml.safe_load((here / 'friction.yaml').read_text())['/**']['ros__parameters']
    assert set(parameters) <= set(parameters_of_node)
    for name, value in parameters.items():
        parameters_of_node[name].check(value)
