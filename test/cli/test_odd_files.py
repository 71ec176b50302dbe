"""Hostile and odd inputs lead to one clear line, or to a result in reasonable time."""

from inverse_dynamics_node.analysis.trajectory_files import write_trajectory
from inverse_dynamics_node.cli.main import main
from inverse_dynamics_node.dynamics import trajectory
import numpy as np
import pytest
from robot_files import STANFORD
import yaml

JOINTS = tuple(f'joint_{i}' for i in range(1, 7))


def test_written_yaml_is_that_of_pyyaml(here):
    times, rows = np.array([0.0, 1e-8]), np.array([[-1, 0.4], [-1.5, 0.9]])
    motion = trajectory.Trajectory(JOINTS[1:3], times, rows, 1e20 * rows, 0.0 * rows)
    write_trajectory(here / 'out.yaml', motion)
    text = (here / 'out.yaml').read_text()
    assert 'e+' in text
    message = yaml.safe_load(text)
    assert all(isinstance(x, float) for point in message['points'] for x in point['velocities'])
    assert text == yaml.safe_dump(message, sort_keys=False, default_flow_style=None, width=10**6)


def test_times_of_a_clock_count_from_the_first_point(here, capsys):
    points = [{'positions': [-1.0], 'time_from_start': 1.7e9 + t} for t in (0.25, 0.5)]
    text = yaml.safe_dump({'joint_names': ['joint_2'], 'points': points})
    (here / 'move.yaml').write_text(text)
    assert main(['effort', str(STANFORD), 'move.yaml', '--no-picture']) == 0
    output = capsys.readouterr().out
    assert 'times are counted from the first point, which was at 1700000000.250 s' in output
    assert 'in 0.25 s' in output
    written = np.genfromtxt(here / 'move_efforts.csv', delimiter=',', names=True)
    assert written['time'][0] == 0.0
    assert np.all(np.diff(written['time']) > 0.0)


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
