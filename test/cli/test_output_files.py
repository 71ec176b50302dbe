"""Outputs never replace inputs, nor files of the user, and are never half written."""

import os
import resource
import subprocess
import sys

from inverse_dynamics_node.cli.main import main
from inverse_dynamics_node.cli.output_files import check_outputs, new_file, OutputError
import pytest
from robot_files import ROOT, STANFORD

MOVE = """\
joint_names: [joint_2, joint_3]
times: [0.0, 0.5, 1]
positions: [[-1.0, 0.4], [-1.5, 0.9], [-1.0, 0.4]]
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


@pytest.fixture
def supports_marks(here):
    try:
        os.setxattr(here / 'arm.urdf', 'user.test', b'')
    except OSError:
        pytest.skip(f'no extended attributes in {here}')


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob('*') if path.is_file()}


COMMANDS = {
    'check arm.urdf': ['--poses', '--picture'],
    'effort arm.urdf move.csv': ['--csv', '--trajectory-out', '--picture'],
    'compare arm.urdf move.csv': ['--parameters', '--picture'],
    'compare arm.urdf bag': ['--parameters'],
    'excite arm.urdf': ['--csv', '--trajectory-out', '--picture'],
    'identify arm.urdf move.csv': ['--output', '--parameters', '--json', '--picture'],
    'identify arm.urdf move.yaml --validate move.csv': ['--json'],
    'payload arm.urdf move.csv': ['--picture'],
    'demo arm.urdf': ['--picture'],
}
OPTIONS = [(command, option) for command, options in COMMANDS.items() for option in options]


@pytest.mark.parametrize(('command', 'option'), OPTIONS)
def test_an_input_is_never_replaced(command, option, here, capsys):
    if command.startswith('demo'):
        pytest.importorskip('rclpy')
        pytest.importorskip('mujoco')
    files = [
        'arm.urdf',
        *(
            name
            for name in ('move.csv', 'bag/metadata.yaml', 'bag/bag_0.mcap')
            if name.partition('/')[0] in command
        ),
    ]
    for file in files:
        names = [f'{file[:3]}_{kind}.png' for kind in ('symbolic', 'hard')]
        (here / names[0]).symlink_to(here / file)
        (here / names[1]).hardlink_to(here / file)
        if option != '--picture':
            names.append(file)
        before = contents(here)
        for name in names:
            arguments = [*command.split(), option, name, '--force']
            assert main(arguments) == 2
            error = capsys.readouterr().err
            assert error.startswith(f'inverse_dynamics: {option} {name} is the input {file}')
            assert error.count('\n') == 1
        assert contents(here) == before
        for name in names[:2]:
            (here / name).unlink()


def test_standard_input_is_not_replaced(here):
    before = contents(here)
    command = [sys.executable, '-m', 'inverse_dynamics_node.cli.main']
    with (here / 'arm.urdf').open() as file:
        result = subprocess.run(
            [*command, 'check', '-', '--poses', 'arm.urdf', '--force'],
            stdin=file,
            env={**os.environ, 'PYTHONPATH': str(ROOT)},
            capture_output=True,
            text=True,
            timeout=300,
        )
    assert result.returncode == 2
    assert '--poses arm.urdf is the input -, which is never replaced' in result.stderr
    assert contents(here) == before


def test_two_outputs_with_one_name_are_refused(here, capsys):
    (here / 'same.json').symlink_to('same.urdf')
    options = ['--output', 'same.urdf', '--json', 'same.json']
    assert main(['identify', 'arm.urdf', 'move.csv', *options]) == 2
    assert '--json same.json is also the output of --output' in capsys.readouterr().err
    assert main(['effort', 'arm.urdf', 'move.csv', '--csv', 'move_efforts.png']) == 2
    assert main(['excite', 'arm.urdf', '--csv', 'arm_excite_start.yaml']) == 2


@pytest.mark.parametrize(
    ('command', 'name'),
    [
        ('check arm.urdf --picture mine.png', 'mine.png'),
        ('effort arm.urdf move.yaml', 'move_efforts.csv'),
        ('effort arm.urdf move.yaml', 'move_efforts.png'),
        ('compare arm.urdf move.csv', 'move_compare.png'),
        ('excite arm.urdf --speed 0.2', 'arm_excite_speed_0.2.csv'),
        ('excite arm.urdf', 'arm_excite_start.yaml'),
        ('identify arm.urdf move.csv', 'arm_identify.png'),
        ('identify arm.urdf move.csv --output mine.urdf', 'mine.urdf'),
    ],
)
def test_files_of_the_user_are_not_replaced(command, name, here, capsys):
    (here / name).write_text('mine')
    before = contents(here)
    assert main(command.split()) == 2
    error = capsys.readouterr().err
    assert f' {name} already exists' in error
    assert '--force' in error
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
    (here / 'poses.csv').write_text('mine')
    arguments = ['check', 'arm.urdf', '--poses', 'poses.csv', '--force']
    assert main(arguments) == 0
    assert (here / 'poses.csv').read_text().startswith('joint,gravity_effort')


def test_an_output_is_replaced_until_it_is_changed(supports_marks, here):
    arguments = ['effort', 'arm.urdf', 'move.yaml', '--trajectory-out', 'out.yaml']
    assert main(arguments) == 0
    light = contents(here)
    assert main([*arguments, '--payload', '2']) == 0
    heavy = contents(here)
    for name in ('move_efforts.csv', 'move_efforts.png', 'out.yaml'):
        assert heavy[here / name] != light[here / name]
    with (here / 'out.yaml').open('a') as file:
        file.write('# mine\n')
    before = contents(here)
    assert main(arguments) == 2
    assert contents(here) == before


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


def test_a_picture_that_cannot_be_finished_leaves_the_old_one(here, monkeypatch, capsys):
    pyplot = pytest.importorskip('matplotlib.figure')
    (here / 'arm.png').write_text('old')
    before = contents(here)

    def savefig(self, path, **_):
        path.write_text('half')
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(pyplot.Figure, 'savefig', savefig)
    assert main(['check', 'arm.urdf', '--picture', 'arm.png', '--force']) == 1
    assert capsys.readouterr().err == 'inverse_dynamics: arm.png: No space left on device\n'
    assert contents(here) == before


def test_links_and_permissions_of_an_output_stay(here):
    (here / 'real.txt').write_text('old')
    (here / 'real.txt').chmod(0o640)
    (here / 'link.txt').symlink_to('real.txt')
    with new_file(here / 'link.txt') as path:
        path.write_text('new')
    assert (here / 'link.txt').is_symlink()
    assert (here / 'real.txt').read_text() == 'new'
    assert (here / 'real.txt').stat().st_mode & 0o777 == 0o640
    with new_file(here / 'fresh.txt') as path:
        path.write_text('new')
    assert (here / 'fresh.txt').stat().st_mode & 0o777 == 0o666 & ~current_umask()


def current_umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_streams_are_written_as_they_are(here, capfd):
    arguments = ['check', 'arm.urdf', '--poses']
    assert main([*arguments, '/dev/stdout']) == 0
    assert '\njoint_1,' in capfd.readouterr().out
    assert main([*arguments, '/dev/null']) == 0
    check_outputs([], {'--a': here / '/dev/null', '--b': here / '/dev/null'})


def test_outputs_beside_a_recording_are_permitted(here):
    check_outputs([here / 'bag'], {'--picture': here / 'bag' / 'compare.png'})
    (here / 'bag' / 'compare.png').write_text('mine')
    with pytest.raises(OutputError, match='exists'):
        check_outputs([here / 'bag'], {'--picture': here / 'bag' / 'compare.png'})
    check_outputs([here / 'bag'], {'--picture': here / 'bag' / 'compare.png'}, force=True)
