"""Behaviour that all commands have in common: help, errors, signals, pipes."""

import os
import re
import signal
import subprocess
import sys

from fork_server import SERVER
from inverse_dynamics_node.cli.main import COMMANDS, main
import pytest
from robot_files import ROOT, STANFORD


def code_of(*words):
    """Run a command; return its exit code."""
    try:
        return main(words)
    except SystemExit as end:  # of argparse
        return end.code


@pytest.mark.parametrize(
    ('line', 'message'),
    [
        ('chekc arm.urdf', "there is no command 'chekc'; did you mean 'check'?"),
        ('--verson', "there is no option '--verson'; did you mean '--version'?"),
        ('check', 'check: error: the following arguments are required: urdf'),
        ('check a --xyz', 'check: error: unrecognized arguments: --xyz'),
        ('effort a b --pict c.png', 'effort: error: unrecognized arguments: --pict c.png'),
        ('effort a b --picture .', "argument --picture: '.' is a folder"),
        ('effort a b --picture c.jpg', 'argument --picture: .*expected .png, .svg or .pdf'),
        ('effort a b --picture no/c.png', "argument --picture: folder 'no' does not exist"),
        ('effort a b --csv no/c', "argument --csv: folder 'no' does not exist"),
        ('compare a b --parameters no/c', "argument --parameters: folder 'no' does not exist"),
        ('check a --ros-args', 'only these commands accept --ros-args: '),
    ],
)
def test_usage_errors_exit_with_2(line, message, capsys):
    assert code_of(*line.split()) == 2
    assert re.search(message.replace('?', '[?]'), capsys.readouterr().err.splitlines()[-1])


def test_help_shows_all_commands_with_and_without_the_option(capsys):
    assert main([]) == 2
    without = capsys.readouterr().out
    assert main(['--help']) == 0
    text = capsys.readouterr().out
    assert text == without
    for command in COMMANDS:
        assert f'\n  {command} ' in text
    assert 'inverse_dynamics check my_arm.urdf' in text


@pytest.mark.parametrize('command', COMMANDS)
def test_the_help_of_a_command_shows_examples_and_exit_codes(command, capsys):
    if command == 'demo':
        pytest.importorskip('rclpy')
        pytest.importorskip('mujoco')
    assert code_of(command, '--help') == 0
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 100
    assert f'\n  inverse_dynamics {command} ' in text.split('\nexamples:\n')[1]
    assert '\nexit code' in text


def test_version_and_arguments_of_the_node(capsys):
    assert main(['--version']) == 0
    declared = (ROOT / 'setup.py').read_text().split("version='")[1].split("'")[0]
    assert capsys.readouterr().out == f'inverse_dynamics {declared}\n'
    assert main(['--ros-args', '-p', 'kp:=1.0']) == 2
    assert 'inverse_dynamics_node --ros-args ...' in capsys.readouterr().err


PICK = ROOT / 'doc' / 'stanford_pick.yaml'
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


@pytest.mark.long
def test_a_command_reports_without_matplotlib(run_without_matplotlib, tmp_path):
    command = 'effort', STANFORD, PICK
    result = run_without_matplotlib(*command)
    assert (result.returncode, result.stderr) == (0, '')
    assert 'peaks compared with the limits' in result.stdout.lower()
    assert 'no picture: matplotlib cannot be imported' in result.stdout
    assert 'sudo apt install python3-matplotlib' in result.stdout
    assert 'no picture' not in run_without_matplotlib(*command, '--no-picture', '--force').stdout
    assert not list(tmp_path.glob('*.png'))


def test_a_requested_picture_without_matplotlib_is_an_error(run_without_matplotlib):
    result = run_without_matplotlib('effort', STANFORD, PICK, '--picture', 'arm.png')
    assert result.returncode == 1
    assert 'Peaks compared with the limits' in result.stdout
    assert 'run pip install matplotlib, or sudo apt install python3-mat' in result.stderr
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
        'source the setup file of ROS 2, or run ',
        "pip install '.[ros,demo]' in a copy of the repository",
    ):
        assert result.stderr.count(text) == 3
    assert result.stderr.count('No module named') == 3
    assert 'Traceback' not in result.stderr


def test_outside_of_a_virtual_environment_pip_must_be_allowed_to_install():
    code = (
        'import sys\nsys.prefix = sys.base_prefix\n'
        'from inverse_dynamics_node.cli.main import _ADVICE\nprint(_ADVICE["rosbags"])'
    )
    result = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert result.stdout == "run pip install --break-system-packages rosbags 'numpy<2'\n"


def test_the_suffix_selects_the_format_of_a_picture(tmp_path):
    for name, start in (('a.png', b'\x89PNG'), ('a.svg', b'<?xml'), ('a.pdf', b'%PDF')):
        assert main(['effort', str(STANFORD), str(PICK), '--picture', name, '--force']) == 0
        assert (tmp_path / name).read_bytes().startswith(start)


def test_a_missing_file_is_reported_in_one_line(capsys):
    assert main(['effort', str(STANFORD), 'nowhere.yaml']) == 1
    assert capsys.readouterr().err == 'inverse_dynamics: nowhere.yaml: No such file or directory\n'


def test_every_module_of_a_command_is_one_of_the_commands():
    folder = ROOT / 'inverse_dynamics_node' / 'cli'
    modules = {path.stem for path in folder.glob('*.py') if 'def make_parser(' in path.read_text()}
    assert modules == set(COMMANDS)
