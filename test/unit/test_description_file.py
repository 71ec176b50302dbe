"""The robot description: text, paths, package://, file:// and xacro."""

import shutil
import sys

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.errors import ConfigurationError, UrdfError
from inverse_dynamics_node.node.description_file import load_file, load_robot
from parameter_values import configured
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
    robot, description = load_file(given.format(here=workspace))
    assert robot.name == 'stanford'
    assert load_urdf(description).joint_names == robot.joint_names


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        (
            'robots/nope.urdf',
            'robot_description_file: no such file: {here}/robots/nope.urdf '
            "(given as 'robots/nope.urdf' in {here})",
        ),
        ('/nowhere.urdf', 'robot_description_file: no such file: /nowhere.urdf'),
        ('~/nope.urdf', "no such file: {here}/nope.urdf (given as '~/nope.urdf')"),
        ('file:///nowhere.urdf', "no such file: /nowhere.urdf (given as 'file:///nowhere.urdf')"),
        (
            'package://my_robot/arm.urdf',
            'no such file: {here}/install/share/my_robot/arm.urdf '
            "(given as 'package://my_robot/arm.urdf')",
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
        load_file(given)
    assert message.format(here=workspace) in str(caught.value)


XACRO = """<?xml version="1.0"?>
<robot name="stanford" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="hand" default=""/>
  <xacro:arg name="mass" default="1.0"/>
  <link name="base"/>
  <link name="$(arg hand)tip">
    <inertial>
      <mass value="${2 * $(arg mass)}"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="hinge" type="continuous"><parent link="base"/><child link="$(arg hand)tip"/></joint>
</robot>
"""


@pytest.mark.parametrize(
    ('given', 'tip', 'mass'),
    [
        ('my arm.urdf.xacro', 'tip', 2.0),
        ('package://my_robot/urdf/arm.xacro', 'tip', 2.0),
        ('{here}/my arm.urdf.xacro hand:=left_ mass:=1.5', 'left_tip', 3.0),
        ('file://{here}/my%20arm.urdf.xacro mass:=4 ', 'tip', 8.0),
    ],
)
def test_xacro_files_are_processed_with_their_arguments(workspace, given, tip, mass):
    pytest.importorskip('xacro')
    (workspace / 'my arm.urdf.xacro').write_text(XACRO)
    (workspace / 'install/share/my_robot/urdf/arm.xacro').write_text(XACRO)
    robot, description = load_file(given.format(here=workspace))
    assert load_urdf(description).name == robot.name
    assert robot.link_names[-1] == tip
    assert robot.mass.sum() == mass


def test_problems_of_xacro_files_name_the_file(workspace):
    pytest.importorskip('xacro')
    (workspace / 'arm.xacro').write_text(XACRO.replace('2 *', '2 * nope *'))
    with pytest.raises(ConfigurationError, match=r"'arm.xacro': xacro failed: .*nope"):
        load_file('arm.xacro')
    (workspace / 'arm.xacro').write_text(XACRO)
    with pytest.raises(ConfigurationError) as error:
        load_file('arm.xacro mas:=2')
    expected = "'mas' is not declared; the arguments are hand, mass; did you mean 'mass'?"
    assert (
        str(error.value) == f"robot_description_file 'arm.xacro mas:=2': xacro argument {expected}"
    )
    with pytest.raises(UrdfError, match=f'output of xacro for {workspace}/arm.xacro: .*mass'):
        load_file('arm.xacro mass:=-1')
    with pytest.raises(ConfigurationError, match=f'no such file: {workspace}/your.xacro'):
        load_file('your.xacro mass:=1')
    with pytest.raises(ConfigurationError, match='give arguments of xacro as NAME:=VALUE'):
        load_file('arm.xacro mass=1')


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ('<xacro:arg name="mass" default="1.0"/>', '',
         "Undefined substitution argument mass when evaluating expression '2 * $(arg mass)'; "
         'give it as mass:=VALUE after the file name'),
        ('2 *', '2 * nope *', "name 'nope' is not defined when evaluating expression '2 * nope"),
        ('<link name="base"/>', '<xacro:include filename="no.xacro"/>',
         'No such file or directory: {here}/no.xacro'),
        ('"base"', '"$(find nothing)"', "package 'nothing' not found"),
    ],
)  # fmt: skip
def test_errors_of_xacro_appear_once(workspace, old, new, message):
    pytest.importorskip('xacro')
    (workspace / 'arm.xacro').write_text(XACRO.replace(old, new))
    with pytest.raises(ConfigurationError) as error:
        load_file('arm.xacro')
    text = str(error.value)
    expected = "robot_description_file 'arm.xacro': xacro failed: "
    assert text.startswith(expected + message.format(here=workspace))
    assert '<class' not in text
    assert text.count(message[:15]) == 1


def test_without_xacro_the_message_says_how_to_install_it(workspace, monkeypatch):
    (workspace / 'arm.xacro').write_text(XACRO)
    monkeypatch.setitem(sys.modules, 'xacro', None)
    with pytest.raises(ConfigurationError, match='apt install ros-jazzy-xacro'):
        load_file('arm.xacro')


def test_package_without_a_workspace(workspace, monkeypatch):
    monkeypatch.delenv('AMENT_PREFIX_PATH')
    with pytest.raises(ConfigurationError, match='AMENT_PREFIX_PATH is empty: source the setup'):
        load_file('package://my_robot/urdf/arm.urdf')


def test_a_description_that_is_not_a_urdf_is_quoted():
    where = (
        "parameter 'robot_description' is 'arm.urdf', expected the URDF as XML text; for a file"
    )
    with pytest.raises(ConfigurationError, match=where):
        load_robot(configured(robot_description='arm.urdf'), '')
    with pytest.raises(ConfigurationError, match="the robot description is 'nope', expected the"):
        load_robot(configured(), 'nope')
    with pytest.raises(
        ConfigurationError, match='there is no robot description: none has arrived'
    ):
        load_robot(configured(), '')


def test_a_file_or_a_parameter_takes_precedence_over_the_topic():
    text = STANFORD.read_text()
    other = text.replace('stanford', 'other')
    for values, topic in (
        ({'robot_description_file': str(STANFORD)}, other),
        ({'robot_description': text}, other),
        ({}, text),
    ):
        assert load_robot(configured(**values), topic)[0].name == 'stanford'
