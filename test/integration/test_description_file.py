"""The parameter robot_description_file: paths, package:// and file://."""

import shutil

from inverse_dynamics_node.errors import ConfigurationError
from inverse_dynamics_node.node.description_file import load_file
import pytest
from robot_files import STANFORD


@pytest.fixture
def workspace(tmp_path, monkeypatch):
    """Return an installation with a package my_robot, and make its root the working directory."""
    shared = tmp_path / 'install' / 'share'
    for path in (shared / 'ament_index/resource_index/packages', shared / 'my_robot/urdf'):
        path.mkdir(parents=True)
    (shared / 'ament_index/resource_index/packages/my_robot').touch()
    shutil.copy(STANFORD, shared / 'my_robot/urdf/arm.urdf')
    shutil.copy(STANFORD, tmp_path / 'my arm.urdf')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'install'))
    monkeypatch.setenv('HOME', str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    'given',
    [
        'my arm.urdf',
        '~/my arm.urdf',
        '{here}/my arm.urdf',
        'file://{here}/my%20arm.urdf',
        'file://localhost{here}/my arm.urdf',
        'package://my_robot/urdf/arm.urdf',
    ],
)
def test_every_form_finds_the_file(workspace, given):
    assert load_file(given.format(here=workspace), 'warn').name == 'stanford'


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        (
            'robots/nope.urdf',
            'robot_description_file: no such file: {here}/robots/nope.urdf '
            "('robots/nope.urdf', working directory {here})",
        ),
        ('/nowhere.urdf', 'robot_description_file: no such file: /nowhere.urdf'),
        ('~/nope.urdf', "no such file: {here}/nope.urdf ('~/nope.urdf')"),
        ('file:///nowhere.urdf', "no such file: /nowhere.urdf ('file:///nowhere.urdf')"),
        (
            'package://my_robot/arm.urdf',
            "no such file: {here}/install/share/my_robot/arm.urdf ('package://my_robot/arm.urdf')",
        ),
        (
            'package://your_robot/arm.urdf',
            "'package://your_robot/arm.urdf': package 'your_robot' not found; "
            'AMENT_PREFIX_PATH is {here}/install',
        ),
        ('package://my_robot', 'expected package://PACKAGE/PATH'),
        ('package://not a name/arm.urdf', "package 'not a name' not found"),
        ('file://arm.urdf', 'expected file:///ABSOLUTE/PATH'),
        ('~nobody_of_this_name/arm.urdf', 'no such user'),
    ],
)
def test_a_file_that_is_not_there_is_named_in_full(workspace, given, message):
    with pytest.raises(ConfigurationError) as caught:
        load_file(given, 'warn')
    assert message.format(here=workspace) in str(caught.value)


def test_package_without_a_workspace(workspace, monkeypatch):
    monkeypatch.delenv('AMENT_PREFIX_PATH')
    with pytest.raises(ConfigurationError, match='AMENT_PREFIX_PATH is empty: source the setup'):
        load_file('package://my_robot/urdf/arm.urdf', 'warn')


def test_the_node_starts_with_a_package_uri(workspace, run_node, robot):
    node = run_node(robot_description_file='package://my_robot/urdf/arm.urdf')
    robot.wait_for_text(node, "robot 'stanford'")


def test_the_node_ends_when_the_file_is_missing(workspace, run_node):
    node = run_node(robot_description_file='nope.urdf')
    assert node.wait() == 1
    assert f'no such file: {workspace}/nope.urdf' in node.output
    assert 'Traceback' not in node.output
