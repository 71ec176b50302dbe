"""Outputs never replace inputs, nor files of the user, and are never half written."""

import os
import resource
import subprocess
import sys

from inverse_dynamics_node.cli.console import check_outputs, new_file, OutputError
from inverse_dynamics_node.cli.main import main
import pytest
from robot_files import ROOT, STANFORD

MOVE = """\
joint_names: [joint_2, joint_3]
points:
- {positions: [-1.0, 0.4], time_from_start: 0}
- {positions: [-1.5, 0.9], time_from_start: 0.5}
- {positions: [-1.0, 0.4], time_from_start: 1}
"""


@pytest.fixture(autouse=True)
def inputs(here):
    """Write a robot description, a trajectory and the files of a recording."""
    (here / 'arm.urdf').write_text(STANFORD.read_text())
    (here / 'move.yaml').write_text(MOVE)
    (here / 'move.csv').write_text('time,joint_2\n0,-1\n1,-1.5\n')
    (here / 'bag').mkdir()
    for name in ('metadata.yaml', 'bag_0.mcap'):
        (here / 'bag' / name).write_text(name)


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob('*') if path.is_file()}


@pytest.mark.parametrize(
    ('command', 'option', 'name'),
    [
        ('effort arm.urdf move.csv', '--csv', 'move.csv'),
        ('effort arm.urdf move.csv', '--picture', 'move_link.png'),
        ('compare arm.urdf bag', '--parameters', 'bag/bag_0.mcap'),
        ('compare arm.urdf bag', '--parameters', 'bag/metadata.yaml'),
        ('excite arm.urdf', '--trajectory-out', 'arm.urdf'),
        ('identify arm.urdf move.csv', '--output', 'arm.urdf'),
        ('identify arm.urdf move.yaml --validate move.csv', '--parameters', 'move.csv'),
        ('payload arm.urdf move.csv --empty move.yaml', '--picture', 'move_link.png'),
    ],
)
def test_an_input_is_never_replaced(command, option, name, here, capsys):
    for file in ('arm.urdf', 'move.csv'):
        (here / f'{file.partition(".")[0]}_link.png').symlink_to(file)
    before = contents(here)
    assert main([*command.split(), option, name, '--force']) == 2
    error = f'{option} {name} is an input, which is never replaced; choose another name'
    assert capsys.readouterr().err == f'inverse_dynamics: {error}\n'
    assert contents(here) == before


def test_standard_input_is_not_replaced(here):
    before = contents(here)
    command = [sys.executable, '-m', 'inverse_dynamics_node.cli.main']
    with (here / 'arm.urdf').open() as file:
        result = subprocess.run(
            [*command, 'identify', '-', 'move.csv', '--output', 'arm.urdf', '--force'],
            stdin=file,
            env={**os.environ, 'PYTHONPATH': str(ROOT)},
            capture_output=True,
            text=True,
            timeout=300,
        )
    assert result.returncode == 2
    assert '--output arm.urdf is an input, which is never replaced' in result.stderr
    assert contents(here) == before


def test_two_outputs_with_one_name_are_refused(here, capsys):
    (here / 'same.yaml').symlink_to('same.urdf')
    options = ['--output', 'same.urdf', '--parameters', 'same.yaml']
    assert main(['identify', 'arm.urdf', 'move.csv', *options]) == 2
    assert '--parameters same.yaml is also the output of --output' in capsys.readouterr().err
    assert main(['effort', 'arm.urdf', 'move.csv', '--csv', 'move_efforts.png']) == 2


@pytest.mark.parametrize(
    ('command', 'name'),
    [
        ('effort arm.urdf move.yaml --picture mine.png', 'mine.png'),
        ('effort arm.urdf move.yaml', 'move_efforts.csv'),
        ('effort arm.urdf move.yaml', 'move_efforts.png'),
        ('compare arm.urdf move.csv', 'move_compare.png'),
        ('excite arm.urdf', 'arm_excite.yaml'),
        ('excite arm.urdf', 'arm_excite_rehearsal.yaml'),
        ('identify arm.urdf move.csv', 'arm_identify.png'),
        ('identify arm.urdf move.csv --output mine.urdf', 'mine.urdf'),
    ],
)
def test_an_existing_file_is_not_replaced_without_force(command, name, here, capsys):
    (here / name).write_text('mine')
    before = contents(here)
    assert main(command.split()) == 2
    error = capsys.readouterr().err
    assert f' {name} already exists; choose another name, or replace the file with --f' in error
    assert contents(here) == before


def test_the_example_does_not_replace_a_recording(here):
    pytest.importorskip('rclpy')
    before = contents(here)
    result = subprocess.run(
        [sys.executable, ROOT / 'examples' / 'record_joint_states.py', 'move.csv'],
        env={**os.environ, 'PYTHONPATH': str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert result.returncode == 1
    assert result.stderr.startswith('move.csv: exists; ')
    assert contents(here) == before


def test_force_replaces_a_file(here):
    (here / 'move_efforts.csv').write_text('mine')
    assert main(['effort', 'arm.urdf', 'move.yaml', '--no-picture', '--force']) == 0
    assert (here / 'move_efforts.csv').read_text().startswith('time,joint_2')


def test_a_full_disk_leaves_the_old_file_whole(here):
    (here / 'old.csv').write_text('old')
    before = contents(here)
    result = subprocess.run(
        [
            *(sys.executable, '-m', 'inverse_dynamics_node.cli.main', 'effort', 'arm.urdf'),
            *('move.yaml', '--csv', 'old.csv', '--force', '--no-picture'),
        ],
        env={**os.environ, 'PYTHONPATH': str(ROOT)},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000)),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert (result.returncode, result.stderr) == (1, 'inverse_dynamics: old.csv: File too large\n')
    assert 'Peaks compared with the limits' in result.stdout
    assert contents(here) == before


def test_the_target_of_a_link_is_replaced(here):
    (here / 'link.txt').symlink_to('real.txt')
    with new_file(here / 'link.txt') as path:
        path.write_text('new')
    assert (here / 'link.txt').is_symlink()
    assert (here / 'real.txt').read_text() == 'new'


def test_streams_are_written_as_they_are(here, capfd):
    arguments = ['effort', 'arm.urdf', 'move.yaml', '--no-picture', '--csv']
    assert main([*arguments, '/dev/stdout']) == 0
    assert 'time,joint_2' in capfd.readouterr().out
    check_outputs([], {'--a': here / '/dev/null', '--b': here / '/dev/null'})


def test_outputs_beside_a_recording_are_permitted(here):
    check_outputs([here / 'bag'], {'--picture': here / 'bag' / 'compare.png'})
    (here / 'bag' / 'compare.png').write_text('mine')
    with pytest.raises(OutputError, match='exists'):
        check_outputs([here / 'bag'], {'--picture': here / 'bag' / 'compare.png'})
    check_outputs([here / 'bag'], {'--picture': here / 'bag' / 'compare.png'}, force=True)
