"""The command line of the node: --help, --version and unrecognized arguments."""

from importlib import metadata
import os
import subprocess
import sys

from fork_server import MAIN, SERVER
from inverse_dynamics_node import ros
from node_process import PATIENCE
import pytest
from robot_files import ROOT

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
    result = run([sys.executable, '-c', WITHOUT_ROS, '--ros-args', '-p', 'kp:=1.0', '--help'])
    assert (result.returncode, result.stderr) == (0, '')
    assert result.stdout.startswith('usage: inverse_dynamics_node')
    assert result.stdout.endswith((ROOT / 'config/inverse_dynamics.yaml').read_text() + '\n')
    assert max(map(len, result.stdout.splitlines())) <= 100


def test_version_needs_no_ros():
    result = run([sys.executable, '-c', WITHOUT_ROS, '--version'])
    assert (result.returncode, result.stderr) == (0, '')
    assert result.stdout == f'inverse_dynamics_node {version()}\n'


def test_version_of_a_source_tree_that_is_not_installed(monkeypatch):
    def no_version(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, 'version', no_version)
    assert ros.version() == version()


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['--foo', 'bar'], 'unrecognized arguments: --foo bar'),
        (['--ros-args', '--foo'], "unrecognized ROS arguments: '--foo'"),
    ],
)
def test_unrecognized_arguments_end_with_the_usage_and_code_2(arguments, words, domain_id):
    environment = {'ROS_DOMAIN_ID': str(domain_id)}
    result = SERVER.call(['-m', MAIN, *arguments], environment, timeout=PATIENCE)
    assert result.returncode == 2
    assert f'inverse_dynamics_node: {words}\nusage: ' in result.stderr
    assert 'Traceback' not in result.stderr


def test_an_argument_that_is_not_utf_8_is_named(domain_id):
    result = run([sys.executable, '-m', MAIN, '--ros-args', '-p', b'mode:=\xff'])
    assert result.returncode == 1
    expected = "inverse_dynamics_node: argument 'mode:=\\udcff' is not UTF-8\n"
    assert result.stderr == expected
