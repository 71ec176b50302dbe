"""Behaviour that all commands have in common: help, errors, signals, pipes."""

import os
import signal
import subprocess
import sys

from fork_server import SERVER
from inverse_dynamics_node.cli import arguments
from inverse_dynamics_node.cli.main import COMMANDS, main
from inverse_dynamics_node.cli.output_files import output_path, picture_path
import numpy as np
import pytest
from robot_files import ROOT, STANFORD


def code_of(*words):
    """Run a command; return its exit code."""
    try:
        return main(words)
    except SystemExit as end:  # of argparse
        return end.code


@pytest.mark.parametrize(
    'words', [[], ['chekc'], ['--verson'], ['check'], ['check', 'a', '--samples', '1']]
)
def test_usage_errors_exit_with_2(words):
    assert code_of(*words) == 2


def test_help_shows_all_commands_with_and_without_the_option(capsys):
    assert main([]) == 2
    without = capsys.readouterr().out
    assert main(['--help']) == 0
    text = capsys.readouterr().out
    assert text == without
    for command in COMMANDS:
        assert f'\n  {command} ' in text
    assert 'inverse_dynamics check my_arm.urdf' in text


def test_a_mistyped_command_or_option_leads_to_a_suggestion(capsys):
    for words, hint in (
        (['chekc', 'arm.urdf'], "no command 'chekc'; did you mean 'check'?"),
        (['--verson'], "no option '--verson'; did you mean '--version'?"),
        (['check', '--lnk', 'tool0'], "no option '--lnk'; did you mean '--link'?"),
        (['effort', 'a', '--gravty=0', '0', '9'], "'--gravty'; did you mean '--gravity'?"),
        (['watch', '--fro', '10'], "'--fro'; did you mean '--for'?"),
    ):
        assert code_of(*words) == 2
        assert hint in capsys.readouterr().err
    assert code_of('check', 'a', '--xyz') == 2
    error = capsys.readouterr().err
    assert error.startswith('usage: inverse_dynamics check ')
    assert error.endswith("error: there is no option '--xyz'\n")


@pytest.fixture(params=COMMANDS)
def help_of_a_command(request, monkeypatch, capsys):
    """Return the name of each command in turn, and its help on a narrow terminal."""
    if request.param == 'demo':
        pytest.importorskip('rclpy')
        pytest.importorskip('mujoco')
    monkeypatch.setenv('COLUMNS', '80')
    assert code_of(request.param, '--help') == 0
    return request.param, capsys.readouterr().out


def test_descriptions_and_options_fit_a_narrow_terminal(help_of_a_command):
    name, text = help_of_a_command
    assert text.startswith(f'usage: inverse_dynamics {name} ')
    options = text.split('\n  -h, --help ')[0]
    assert max(map(len, options.splitlines())) <= 80
    assert f'\n  inverse_dynamics {name} ' in text.split('\nexamples:\n')[1]
    assert '\nexit code' in text


def test_options_that_write_files_are_in_the_group_of_the_result(monkeypatch):
    pytest.importorskip('rclpy')
    pytest.importorskip('mujoco')
    groups = {}
    add = arguments.CommandParser.add_argument

    def record(parser, *names, group='', **properties):
        is_output = properties.get('type') in (output_path, picture_path)
        if is_output or names[0] in ('--force', '--strict'):
            groups[parser.prog, names[0]] = group
        return add(parser, *names, group=group, **properties)

    monkeypatch.setattr(arguments.CommandParser, 'add_argument', record)
    for command in COMMANDS:
        assert code_of(command, '--help') == 0
    assert len(groups) > 15
    assert set(groups.values()) == {arguments.RESULT}


def test_version_and_arguments_of_the_node(capsys):
    assert main(['--version']) == 0
    declared = (ROOT / 'setup.py').read_text().split("version='")[1].split("'")[0]
    assert capsys.readouterr().out == f'inverse_dynamics {declared}\n'
    assert main(['--ros-args', '-p', 'kp:=1.0']) == 2
    assert 'inverse_dynamics_node --ros-args ...' in capsys.readouterr().err


COMMAND = [sys.executable, '-m', 'inverse_dynamics_node.cli.main', 'check', str(STANFORD)]
ENVIRONMENT = {**os.environ, 'PYTHONPATH': str(ROOT)}


WITHOUT_MATPLOTLIB = """
import sys
sys.modules['matplotlib'] = None
from inverse_dynamics_node.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def run_without_matplotlib(tmp_path):
    """Return a function that runs a command in a process that cannot import matplotlib."""
    return lambda *command: SERVER.call(
        ['-c', WITHOUT_MATPLOTLIB, *command], {'PYTHONPATH': str(ROOT)}, tmp_path, timeout=300
    )


@pytest.fixture
def recording(tmp_path):
    """Write a recording of the Stanford arm at rest at one end and moving at the other."""
    names = [f'joint_{i}' for i in range(1, 7)]
    columns = [f'{name}.{kind}' for name in names for kind in ('position', 'effort')]
    times = np.linspace(0.0, 4.0, 401)
    rows = [[t, *(np.sin(t * t) * np.arange(1, 13) / 12)] for t in times]
    lines = [['time', *columns], *rows]
    path = tmp_path / 'run.csv'
    path.write_text('\n'.join(','.join(map(str, line)) for line in lines))
    return path


@pytest.mark.long
def test_commands_report_without_matplotlib(run_without_matplotlib, recording, tmp_path):
    pick = ROOT / 'doc' / 'stanford_pick.yaml'
    for command, report in (
        (['effort', STANFORD, pick], 'peaks compared with the limits'),
        (['compare', STANFORD, recording], 'measured and modelled efforts'),
    ):
        result = run_without_matplotlib(*command)
        assert (result.returncode, result.stderr) == (0, '')
        assert report in result.stdout.lower()
        assert 'no picture: matplotlib cannot be imported' in result.stdout
        assert 'sudo apt install python3-matplotlib' in result.stdout
    assert 'no picture' not in run_without_matplotlib(*command, '--no-picture').stdout
    assert not list(tmp_path.glob('*.png'))


def test_a_requested_picture_without_matplotlib_is_an_error(run_without_matplotlib):
    result = run_without_matplotlib('check', STANFORD, '--picture', 'arm.png')
    assert result.returncode == 1
    assert 'the robot can hold up to' in result.stdout
    assert "pip install 'inverse_dynamics_node[cli]'" in result.stderr
    assert 'in a virtual environment' in result.stderr
    assert 'Traceback' not in result.stderr


def test_runs_as_a_process_without_colours_in_a_pipe():
    result = subprocess.run(
        COMMAND, env=ENVIRONMENT, capture_output=True, text=True, timeout=120, check=True
    )
    assert '\x1b' not in result.stdout + result.stderr
    assert 'the robot can hold up to' in result.stdout


def test_a_closed_pipe_is_not_an_error():
    process = subprocess.Popen(
        COMMAND, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    process.stdout.close()
    assert process.wait(120) == 141
    assert process.stderr.read() == ''
    process.stderr.close()


def test_an_interrupt_ends_quietly(tmp_path):
    fifo = tmp_path / 'slow.yaml'
    os.mkfifo(fifo)
    process = subprocess.Popen(
        [*COMMAND[:3], 'effort', str(STANFORD), str(fifo)],
        env=ENVIRONMENT,
        stderr=subprocess.PIPE,
        text=True,
        # A shell makes background processes ignore interrupts, and children inherit this.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    with fifo.open('w'):  # waits until the command reads: it is in the middle of its work
        process.send_signal(signal.SIGINT)
        assert process.wait(120) == 130
    assert process.stderr.read() == ''
    process.stderr.close()


def test_only_watch_simulate_and_demo_need_ros():
    code = (
        'import sys\n'
        'class Refuse:\n'
        '    def find_spec(self, name, *_):\n'
        '        package = name.split(".")[0]\n'
        '        if package in ("rclpy", "mujoco") or package.endswith("_msgs"):\n'
        '            raise ModuleNotFoundError(f"No module named {name!r}", name=name)\n'
        'sys.meta_path.insert(0, Refuse())\n'
        'from inverse_dynamics_node.cli.main import main\n'
        f'assert main(["check", {str(STANFORD)!r}]) == 0\n'
        f'assert main(["demo", {str(STANFORD)!r}]) == 1\n'
        f'assert main(["simulate", {str(STANFORD)!r}]) == 1\n'
        'sys.exit(main(["watch"]))\n'
    )
    result = subprocess.run(
        [sys.executable, '-c', code], env=ENVIRONMENT, capture_output=True, text=True, timeout=120
    )
    assert result.returncode == 1
    for text in (
        'source the setup file of ROS 2, or, in a virtual environment, run ',
        "pip install 'inverse_dynamics_node[ros,demo]'",
    ):
        assert result.stderr.count(text) == 2  # of demo and watch
    assert result.stderr.count('No module named') == 3
    assert 'Traceback' not in result.stderr


@pytest.mark.parametrize(
    ('name', 'words'),
    [
        ('nowhere/a.png', "folder 'nowhere' does not exist"),
        ('.', 'is a folder'),
        ('a.jpg', 'expected .png, .svg or .pdf'),
    ],
)
@pytest.mark.parametrize(
    'command',
    [
        ['check', 'arm.urdf'],
        ['effort', 'arm.urdf', 'move.yaml'],
        ['compare', 'arm.urdf', 'run'],
        ['demo', 'arm.urdf'],
    ],
    ids=lambda command: command[0],
)
def test_invalid_picture_paths_are_rejected_before_the_work(command, name, words, capsys):
    if command[0] == 'demo':
        pytest.importorskip('rclpy')
        pytest.importorskip('mujoco')
    with pytest.raises(SystemExit) as exit_:
        main([*command, '--picture', name])
    assert exit_.value.code == 2
    error = capsys.readouterr().err
    assert f'inverse_dynamics {command[0]}: error: argument --picture: ' in error
    assert words in error


@pytest.mark.parametrize(
    'command',
    [
        ['check', 'arm.urdf', '--poses'],
        ['effort', 'arm.urdf', 'move.yaml', '--csv'],
        ['effort', 'arm.urdf', 'move.yaml', '--trajectory-out'],
        ['compare', 'arm.urdf', 'run', '--parameters'],
    ],
    ids=lambda command: command[-1],
)
def test_invalid_output_paths_are_rejected_before_the_work(command, capsys):
    with pytest.raises(SystemExit) as exit_:
        main([*command, 'nowhere/file'])
    assert exit_.value.code == 2
    assert f"argument {command[-1]}: folder 'nowhere' does not exist" in capsys.readouterr().err


def test_the_suffix_selects_the_format_of_a_picture(tmp_path):
    for name, start in (('a.png', b'\x89PNG'), ('a.svg', b'<?xml'), ('a.pdf', b'%PDF')):
        assert main(['check', str(STANFORD), '--picture', name]) == 0
        assert (tmp_path / name).read_bytes().startswith(start)


def test_a_missing_file_is_reported_in_one_line(capsys):
    assert main(['effort', str(STANFORD), 'nowhere.yaml']) == 1
    assert capsys.readouterr().err == 'inverse_dynamics: nowhere.yaml: No such file or directory\n'


def test_every_module_of_a_command_is_one_of_the_commands():
    folder = ROOT / 'inverse_dynamics_node' / 'cli'
    modules = {path.stem for path in folder.glob('*.py') if 'def make_parser(' in path.read_text()}
    assert modules == set(COMMANDS)
