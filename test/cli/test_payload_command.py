"""The command `payload` on simulated recordings."""

import json
from xml.etree import ElementTree

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.cli.main import main
import numpy as np
from payload_runs import Arm, motion_of, poses_of
import pytest
from robot_files import ROOT
from simulated_runs import write_csv

URDF = ROOT / 'test' / 'robots' / 'seven_dof.urdf'
MASS, COM = 2.0, np.array([0.02, -0.03, 0.07])
RUNS = [str(URDF), 'loaded.csv', '--empty', 'empty.csv', '--link', 'tool0']


def record(here, motion=motion_of, **options):
    """Record an arm without and with a load."""
    robot, rng = load_urdf(URDF), np.random.default_rng(0)
    arm, motion = Arm(robot, rng), motion(robot, rng, **options)
    motion = tuple(signal[::3] for signal in motion)
    for name, load in (('empty', None), ('loaded', ('tool0', MASS, COM, 0.004 * np.eye(3)))):
        write_csv(here / f'{name}.csv', arm.record(motion, load))


def test_prints_a_sentence_and_an_element_of_the_payload(here, capsys, size_of):
    record(here, duration=16.0)
    assert main(['payload', *RUNS, '--picture', 'payload.png']) == 0
    text = capsys.readouterr().out
    assert text.startswith("Link 'tool0' carries ")
    (element,) = (line for line in text.splitlines() if line.startswith('<inertial>'))
    element = ElementTree.fromstring(element)
    assert float(element.find('mass').get('value')) == pytest.approx(MASS, rel=0.02)
    origin = [float(x) for x in element.find('origin').get('xyz').split()]
    np.testing.assert_allclose(origin, COM, atol=0.005)
    moments = {name: float(text) for name, text in element.find('inertia').attrib.items()}
    assert set(moments) == {'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'}
    assert min(moments['ixx'], moments['iyy'], moments['izz']) > 0.0
    assert size_of(here / 'payload.png')[0] == 900


def test_prints_json(here, capsys):
    record(here, duration=16.0)
    assert main(['payload', *RUNS, '--json', '--ros-args', '--enclave', '/operator']) == 0
    report = json.loads(capsys.readouterr().out)
    assert report['mass'] == pytest.approx(MASS, abs=3.0 * report['mass_error'])
    assert 0.0 < report['mass_error'] < 0.3
    assert np.abs(np.array(report['com']) - COM).max() < 0.005
    assert report['is_certain'] is True
    assert 0.9 < report['matched'] <= 1.0
    assert report['ratio'] == pytest.approx(1.0, abs=0.2)
    assert report['ratio_error'] < 0.1


def test_one_pose_shows_the_mass_at_most(here, capsys):
    record(here, poses_of, count=1)
    assert main(['payload', *RUNS, '--apply']) == 3
    text = capsys.readouterr().out
    assert '<inertial>' not in text


def test_reports_an_unknown_link(here, capsys):
    record(here, duration=5.0)
    assert main(['payload', *RUNS[:-1], 'tool']) == 1
    assert "tool'" in capsys.readouterr().err


def test_a_single_recording_is_refused(here, capsys):
    (here / 'loaded.csv').write_text('')
    assert main(['payload', str(URDF), 'loaded.csv']) == 2
    assert '--empty is missing' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        ('loaded.csv --force', '--record loaded.csv already exists'),
        ('loaded.mcap', "LOADED is 'loaded.mcap', but --record writes a .csv file"),
        ('nowhere/loaded.csv', "folder 'nowhere' does not exist"),
    ],
)
def test_a_recording_needs_a_new_file(arguments, words, here, capsys):
    (here / 'loaded.csv').write_text('the last recording')
    assert main(['payload', str(URDF), '--record', '1', *arguments.split()]) == 2
    assert words in capsys.readouterr().err
    assert (here / 'loaded.csv').read_text() == 'the last recording'


def test_a_bad_run_without_the_payload_is_found_before_the_recording(here, capsys):
    (here / 'empty.csv').write_text('time\n')
    run = ['payload', str(URDF), 'loaded.csv', '--record', '1', '--empty', 'empty.csv']
    assert main(run) == 1
    assert 'empty.csv: has no rows' in capsys.readouterr().err
    assert not (here / 'loaded.csv').exists()
