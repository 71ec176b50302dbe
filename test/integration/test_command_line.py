"""The command line of the node: --help, --version and unrecognized arguments."""

import os
import subprocess
import sys

import pytest
from robot_files import ROOT

NODE = [sys.executable, '-m', 'inverse_dynamics_node.node.main']
WITHOUT_ROS = """
import sys

class Refuse:
    def find_spec(self, name, *_):
        if name.split('.')[0] in ('rclpy', 'rcl_interfaces') or name.endswith('_msgs'):
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Refuse())
from inverse_dynamics_node.node.main import main
sys.exit(main(['inverse_dynamics_node', *sys.argv[1:]]))
"""


def run(command):
    environment = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    return subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=120
    )


def version():
    return (ROOT / 'setup.py').read_text().split("version='")[1].split("'")[0]


def test_help_ends_with_the_parameter_file_and_needs_no_ros():
    result = run([sys.executable, '-c', WITHOUT_ROS, '--help'])
    assert (result.returncode, result.stderr) == (0, '')
    assert result.stdout.startswith('usage: inverse_dynamics_node')
    assert result.stdout.endswith((ROOT / 'config/inverse_dynamics.yaml').read_text() + '\n')
    assert max(map(len, result.stdout.splitlines())) <= 100


def test_help_is_the_same_with_ros_arguments():
    result = run([*NODE, '--ros-args', '-p', 'kp:=1.0', '--help'])
    assert result.returncode == 0
    assert result.stdout == run([sys.executable, '-c', WITHOUT_ROS, '-h']).stdout


def test_version():
    for command in (NODE, [sys.executable, '-c', WITHOUT_ROS]):
        result = run([*command, '--version'])
        assert (result.returncode, result.stderr) == (0, '')
        assert result.stdout == f'inverse_dynamics_node {version()}\n'


def test_version_of_a_source_tree_that_is_not_installed():
    code = (
        'from importlib import metadata\n'
        'def version(name):\n'
        '    raise metadata.PackageNotFoundError(name)\n'
        'metadata.version = version\n'
        'from inverse_dynamics_node.ros import version\n'
        'print(version())\n'
    )
    assert run([sys.executable, '-c', code]).stdout == f'{version()}\n'


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['--foo', 'bar'], 'unrecognized arguments: --foo bar'),
        (['--ros-args', '--foo'], "unrecognized ROS arguments: '--foo'"),
    ],
)
def test_unrecognized_arguments_end_with_the_usage_and_code_2(arguments, words, domain_id):
    result = run([*NODE, *arguments])
    assert result.returncode == 2
    assert f'inverse_dynamics_node: {words}\nusage: ' in result.stderr
    assert 'Traceback' not in result.stderr


def test_an_argument_that_is_not_utf_8_is_named(domain_id):
    result = run([*NODE, '--ros-args', '-p', b'mode:=\xff'])
    assert result.returncode == 1
    expected = "inverse_dynamics_node: argument 'mode:=\\udcff' is not UTF-8\n"
    assert result.stderr == expected
