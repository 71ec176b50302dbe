"""The command `identify` on a simulated recording."""

import json

from identification_runs import exciting_motion, real_robot, record
from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.cli.main import main
import numpy as np
import pytest
from robot_files import ROOT
from simulated_runs import write_csv
import yaml

ROBOT = ROOT / 'test' / 'robots' / 'planar_2r.urdf'


def test_writes_urdf_parameters_report_and_picture(here, capsys, size_of):
    robot, rng = load_urdf(ROBOT), np.random.default_rng(0)
    real = real_robot(robot, rng)
    for name in ('fit', 'check'):
        write_csv(here / f'{name}.csv', record(real, exciting_motion(robot, rng, 15.0, 50.0), rng))
    outputs = ['--output', 'new.urdf', '--parameters', 'node.yaml']
    assert main(['identify', str(ROBOT), 'fit.csv', '--validate', 'check.csv', *outputs]) == 0
    text = capsys.readouterr().out
    assert text.startswith('On unseen data, the identified model leaves ')
    outputs = ['--output', 'other.urdf', '--no-picture', '--json']
    assert main(['identify', str(ROBOT), 'fit.csv', '--validate', 'check.csv', *outputs]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (here / 'other.urdf').read_text() == (here / 'new.urdf').read_text()
    assert report['accepted'] is True
    for joint in report['joints']:
        assert 0.0 < joint['noise'] < 2.0 * joint['identified'] < joint['friction']
        assert joint['friction'] < joint['urdf'] < 2.0 * joint['measured']
    for body in report['bodies']:
        assert abs(body['mass'] - body['mass_before']) < 3.0 * body['mass_error']
    written = load_urdf(here / 'new.urdf')
    masses = [written.link_mass[written.link_index(b['link'])] for b in report['bodies']]
    np.testing.assert_allclose(masses, [body['mass'] for body in report['bodies']])
    parameters = yaml.safe_load((here / 'node.yaml').read_text())['/**']['ros__parameters']
    assert parameters['joints'] == list(robot.joint_names)
    for name in ('damping', 'coulomb', 'coulomb_width', 'load_friction', 'armature'):
        assert all(isinstance(value, float) and value >= 0.0 for value in parameters[name])
    np.testing.assert_allclose(parameters['damping'], real.damping, rtol=0.2)
    assert size_of(here / 'planar_2r_identify.png')[0] == 900


def test_reports_a_recording_that_cannot_be_used(here, capsys):
    assert main(['identify', str(ROBOT), 'missing.csv']) == 1
    assert 'missing.csv: no such file or folder' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('mistake', 'expected'),
    [
        ('factor', ''),
        ('mounting', 'tilted'),
        ('sign', 'sign'),
        ('order', 'in the wrong order'),
        (None, ''),
    ],
)
def test_the_cause_of_a_bad_fit_is_named(here, capsys, mistake, expected):
    robot, rng = load_urdf(ROBOT), np.random.default_rng(0)
    real = real_robot(robot, rng, 0.05)
    motion = exciting_motion(robot, rng, 20.0, 50.0)
    recording = record(real, motion, rng)
    efforts = recording.efforts
    if mistake == 'mounting':
        efforts += real.efforts(*motion[1:], (9.8, 0.0, 0.0)) - real.efforts(*motion[1:])
    elif mistake == 'factor':
        efforts *= 0.1
    elif mistake == 'sign':
        efforts[:, 0] *= -1.0
    elif mistake == 'order':
        efforts[:] = efforts[:, ::-1].copy()
    write_csv(here / 'run.csv', recording)
    assert main(['identify', str(ROBOT), 'run.csv', '--no-picture']) == 0
    text = ' '.join(capsys.readouterr().out.split())
    warnings = text.partition('Measured minus modelled')[0].partition(' warning')[2]
    assert expected in warnings
    assert 'too small' not in warnings
    assert mistake or warnings == ''
