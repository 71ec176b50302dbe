"""Hostile and odd inputs lead to one clear line, or to a result in reasonable time."""

import time

from inverse_dynamics_node.analysis import sizing
from inverse_dynamics_node.analysis.trajectory_files import read_trajectory
from inverse_dynamics_node.cli.main import main
from inverse_dynamics_node.dynamics import trajectory
import numpy as np
import pytest
from robot_files import STANFORD
from simulated_runs import write_bag
import yaml

LISTS = 'joint_names: [joint_2, joint_3]\ntimes: {times}\npositions: [[-1, 0.4], [-1.5, 0.9]]\n'
POINTS = 'joint_names: [joint_2]\npoints:\n- positions: [-1]\n  time_from_start: {time}\n'
BOMB = 'a0: &a0 [x, x]\n' + ''.join(
    f'a{i}: &a{i} [{", ".join([f"*a{i - 1}"] * 9)}]\n' for i in range(1, 12)
)
JOINTS = tuple(f'joint_{i}' for i in range(1, 7))


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('&a {trajectory: *a}', 'alias \\*a is used before it is defined'),
        ('&a [*a]', 'alias'),
        (BOMB + 'joint_names: *a11\npoints: []', r'joint_names is \[\['),
        (BOMB + 'joint_names: [j]\ntimes: [0]\npositions: [*a11]', 'expected 1 numbers, got 9'),
        (BOMB + 'joint_names: [j]\ntimes: *a11\npositions: *a11', 'times contain a list'),
        (BOMB + 'joint_names: [j]\npoints: [{positions: [0], time_from_start: *a11}]', r'is \[\['),
        ('[' * 200_000, 'line 1: lists are nested more than|nesting depth'),
        ('joint_names: ' + '{a: ' * 50_000, 'line 1: lists are nested more than|nesting depth'),
        ('- ' * 50_000, 'line 1: lists are nested more than|nesting depth'),
        (LISTS.format(times='[0, 1700000000]'), r'3.4e\+11 states are too many'),
        (LISTS.format(times=f'[0, {"1" * 400}]'), 'one of the times is inf, expected finite'),
        (LISTS.format(times='[0, 2026-11-22]'), "times: could not convert .*'2026-11-22'"),
        (LISTS.format(times='[0, 2026-11-22 10:00:00]'), 'times: could not convert'),
        (LISTS.format(times='[0, !!python/object:os.system x]'), "could not convert .*'x'"),
        (LISTS.format(times='[0, !!binary aGk=]'), 'times: could not convert'),
        (LISTS.format(times='!!set {a, b}'), 'no list of times'),
        (POINTS.format(time='{sec: ' + '1' * 400 + '}'), 'one of the times is inf'),
        (POINTS.format(time='2026-11-22'), "time_from_start of point 0 is '2026-11-22'"),
        (POINTS.format(time='{sec: [1]}'), 'time_from_start of point 0 is'),
        (POINTS.format(time='!!float x'), "time_from_start of point 0 is 'x'"),
    ],
)
def test_odd_yaml_is_one_line(text, words, here, capsys):
    (here / 'move.yaml').write_text(text)
    started = time.process_time()
    assert main(['effort', str(STANFORD), 'move.yaml', '--no-picture']) == 1
    assert time.process_time() - started < 30.0
    error = capsys.readouterr().err
    assert error.startswith('inverse_dynamics: ')
    assert error.count('\n') == 1
    assert len(error) < 400
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(error)


def test_yaml_may_have_anchors_and_several_documents(here):
    (here / 'move.yaml').write_text(
        '# comment\n---\nhome: &home [-1.0, 4e-1]\n---\njoint_names: &names [joint_2, "joint_3"]\n'
        'times: [0, .5, +1.5]\npositions: [&a [-1, 0.4], [-1.5, 0.9], *a]\nvelocities: ~\n'
        'accelerations: []\n---\n...\n'
    )
    loaded = read_trajectory(here / 'move.yaml', JOINTS).trajectory
    assert loaded.joint_names == ('joint_2', 'joint_3')
    np.testing.assert_array_equal(loaded.times, [0.0, 0.5, 1.5])
    np.testing.assert_array_equal(loaded.positions, [[-1, 0.4], [-1.5, 0.9], [-1, 0.4]])
    assert loaded.velocities is loaded.accelerations is None


def test_written_yaml_is_that_of_pyyaml(here):
    (here / 'move.yaml').write_text(LISTS.format(times='[0, 0.00000001]'))
    options = ['--no-picture', '--trajectory-out', 'out.yaml', '--rate', '0']
    assert main(['effort', str(STANFORD), 'move.yaml', *options]) == 0
    text = (here / 'out.yaml').read_text()
    assert 'e+' in text
    message = yaml.safe_load(text)
    assert all(isinstance(x, float) for point in message['points'] for x in point['effort'])
    assert text == yaml.safe_dump(message, sort_keys=False, default_flow_style=None, width=10**6)


@pytest.mark.parametrize('name', ['move.yaml', 'move.csv'])
def test_times_of_a_clock_count_from_the_first_point(name, here, capsys):
    reports = []
    for start in (0, 1_700_000_000):
        times = [start + 0.25, start + 0.5]
        rows = [[-1, 0.4], [-1.5, 0.9]]
        (here / 'move.yaml').write_text(LISTS.format(times=times))
        (here / 'move.csv').write_text(
            'time,joint_2,joint_3\n'
            + ''.join(
                f'{t},{",".join(map(str, row))}\n' for t, row in zip(times, rows, strict=True)
            )
        )
        assert main(['effort', str(STANFORD), name, '--no-picture', '--force']) == 0
        reports.append(capsys.readouterr().out)
    assert 'times are counted from the first point, which was at 1700000000.250 s' in reports[1]
    assert 'in 0.25 s' in reports[0]
    assert 'in 0.25 s' in reports[1]
    written = np.genfromtxt(here / 'move_efforts.csv', delimiter=',', names=True)
    assert written['time'][0] == 0.0
    assert np.all(np.diff(written['time']) > 0.0)


def test_a_bag_with_a_jump_of_the_clock_is_one_line(here, capsys):
    times = np.array([0.0, 1.0, 4e8, 4e8 + 1.0])
    write_states(here / 'run', times)
    assert main(['effort', str(STANFORD), 'run', '--no-picture']) == 1
    error = capsys.readouterr().err
    assert 'states are too many' in error
    assert error.count('\n') == 1


def write_states(path, times):
    """Write a bag with these stamps."""
    from inverse_dynamics_node.analysis.recordings.signals import Recording

    zeros = np.tile([0, -1, 0.5, 0, 0, 0], (len(times), 1))
    write_bag(path, Recording(JOINTS, times, zeros, 0.0 * zeros, zeros))


@pytest.mark.parametrize('seconds', [0.3, 1.0, 2.5])
@pytest.mark.parametrize('rate', [30, 100])
@pytest.mark.parametrize('options', [[], ['--currents']])
def test_a_short_recording_is_one_line(seconds, rate, options, here, capsys):
    write_recording(here / 'run.csv', seconds, rate)
    assert main(['identify', str(STANFORD), 'run.csv', '--no-picture', *options]) == 1
    error = capsys.readouterr().err
    assert error.count('\n') == 1
    assert 'expected at least 3 s' in error or 'too short to be differentiated' in error


def write_recording(path, seconds, rate):
    times = np.arange(0.0, seconds, 1.0 / rate)
    waves = np.sin(np.outer(times, np.arange(1, 13)))
    header = [f'{joint}.{kind}' for kind in ('position', 'effort') for joint in JOINTS]
    table = np.column_stack([times, waves])
    np.savetxt(path, table, delimiter=',', header=','.join(['time', *header]), comments='')


def test_a_fit_without_a_solution_is_one_line(here, capsys, monkeypatch):
    write_recording(here / 'run.csv', 4.0, 50)
    singular = np.linalg.LinAlgError('Singular matrix')
    name = 'inverse_dynamics_node.analysis.identification.fit.minimise'
    monkeypatch.setattr(name, lambda *_: (_ for _ in ()).throw(singular))
    assert main(['identify', str(STANFORD), 'run.csv', '--no-picture']) == 1
    error = capsys.readouterr().err
    assert 'contain too little information: the fit has no solution (Singular' in error
    assert error.count('\n') == 1


def test_many_joints_shorten_the_search_of_check(here, capsys, monkeypatch):
    assert main(['check', str(STANFORD), '--samples', '64']) == 0
    thorough = capsys.readouterr().out
    assert 'With this many joints' not in thorough
    monkeypatch.setattr(sizing, '_MOST_BODIES', 2000.0)
    assert main(['check', str(STANFORD), '--samples', '64']) == 0
    assert 'With this many joints' in capsys.readouterr().out


@pytest.mark.parametrize('joints', [6, 30, 60, 100, 200, 500, 2000])
def test_the_search_of_check_is_bounded(joints):
    starts, windows, moved = sizing._extent_of_search(joints)
    bodies = joints * starts * len(windows) * min(moved, joints) * 35 * joints
    assert bodies <= max(sizing._MOST_BODIES, 35 * joints**2)
    if joints <= 60:
        assert (starts, len(windows)) == (3, 4)
        assert moved >= joints


@pytest.mark.long
def test_a_long_recording_is_read_and_written_quickly(here):
    count = 20_000
    times = np.arange(count) * 0.005
    waves = 0.1 * np.sin(np.outer(times, np.arange(1, 7))) + [0, -1, 0.5, 0, 0, 0]
    table = np.column_stack([times, waves])
    np.savetxt('run.csv', table, '%.9g', ',', header=','.join(['time', *JOINTS]), comments='')
    started = time.process_time()
    assert (
        main(['effort', str(STANFORD), 'run.csv', '--no-picture', '--trajectory-out', 'o.yaml'])
        == 0
    )
    assert time.process_time() - started < 12.0  # the emitter of PyYAML alone takes 24 s
    loaded = read_trajectory(here / 'o.yaml', JOINTS).trajectory
    np.testing.assert_allclose(loaded.positions, table[:, 1:], atol=1e-8)


def test_states_are_limited_by_memory():
    whole, _ = trajectory.complete(
        trajectory.Trajectory(('a',), np.array([0.0, 1e6]), np.array([[0.0], [1.0]]))
    )
    with pytest.raises(trajectory.TrajectoryError, match='1e\\+09 states are too many'):
        trajectory.refine(whole, 1e-3)
