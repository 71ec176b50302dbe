"""The launch file agrees with the node; launch itself is not on PyPI, so the XML is read here."""

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from inverse_dynamics_node.control.stop_damping import TIMEOUT
from inverse_dynamics_node.node.parameters import PARAMETERS
from launch_arguments import ARGUMENTS, FOLDER, LAUNCH, NODE, ros_arguments, SUBSTITUTIONS
import rclpy
from rclpy.context import Context
from robot_files import ROOT, STANFORD

# Attributes of the elements used here, of those that launch_xml and launch_ros accept.
ATTRIBUTES = {
    'launch': set(),
    'arg': {'name', 'default', 'description'},
    'node': {'pkg', 'exec', 'name', 'namespace', 'output', 'ros_args', 'sigterm_timeout'},
    'param': {'from', 'allow_substs'},
    'remap': {'from', 'to'},
}
FILLED_IN = (FOLDER / 'arguments.yaml').read_text()


def test_elements_attributes_and_substitutions_are_those_of_launch():
    values = [FILLED_IN]
    for element in LAUNCH.iter():
        assert set(element.attrib) <= ATTRIBUTES[element.tag], element.tag
        values += element.attrib.values()
    for value in values:
        assert set(re.findall(r'\$\(([\w-]+)', value)) <= set(SUBSTITUTIONS), value
        assert set(re.findall(r'\$\(var ([^)]*)\)', value)) <= set(ARGUMENTS), value


def test_arguments_are_documented_used_and_have_a_default():
    assert list(ARGUMENTS) == ['urdf', 'params_file', 'namespace', 'commands', 'joints', 'dry_run']
    text = ElementTree.tostring(NODE, encoding='unicode') + FILLED_IN
    for name, argument in ARGUMENTS.items():
        assert argument.get('default') is not None
        assert argument.get('description')
        assert f'$(var {name})' in text


def test_the_longest_stop_by_default_is_not_cut_short():
    stop_ramp = PARAMETERS['stop_ramp'].default
    assert float(NODE.get('sigterm_timeout')) > 2.0 * stop_ramp + TIMEOUT + 5.0


def test_executable_parameters_and_topics_are_those_of_the_node():
    setup = (ROOT / 'setup.py').read_text()
    assert NODE.get('pkg') in setup
    assert "{package_name} = {package_name}.node.main:run'" in setup
    assert NODE.get('exec') == NODE.get('pkg') == 'inverse_dynamics_node'
    names = re.findall(r'[\'"](\w+): ', FILLED_IN)
    assert names == ['robot_description_file', 'joints', 'dry_run']
    assert set(names) <= set(PARAMETERS)
    assert [remap.get('from') for remap in NODE.findall('remap')] == ['~/commands']


def test_documents_give_arguments_that_exist():
    commands = [
        command
        for page in (ROOT / 'README.md', *(ROOT / 'doc').rglob('*.md'))
        for command in re.findall(r'^ros2 launch .*(?:\\\n.*)*', page.read_text(), re.M)
    ]
    given = {name for command in commands for name in re.findall(r' (\w+):=', command)}
    assert {'urdf', 'params_file', 'joints'} <= given <= set(ARGUMENTS)


def test_it_is_installed_and_its_dependencies_are_declared():
    assert "/launch', glob('launch/*'))" in (ROOT / 'setup.py').read_text()
    manifest = ElementTree.parse(ROOT / 'package.xml').getroot()
    depends = {element.text for element in manifest.findall('exec_depend')}
    assert {'launch_ros', 'launch_xml', 'ros2launch', 'xacro'} <= depends


def test_arguments_take_precedence_over_the_file(run_node, robot, tmp_path):
    urdf = tmp_path / 'my arm.urdf'
    urdf.write_text(STANFORD.read_text())
    (tmp_path / 'arm.yaml').write_text(
        '/**:\n  ros__parameters:\n    stop_ramp: 0.7\n'
        '/left/inverse_dynamics:\n  ros__parameters:\n'
        '    robot_description_file: other.urdf\n    joints: [joint_3]\n    dry_run: false\n'
    )
    topic = 'forward_effort_controller/commands'
    node = run_node(
        *ros_arguments(
            tmp_path,
            urdf=str(urdf),
            params_file=str(tmp_path / 'arm.yaml'),
            namespace='left',
            commands=topic,
            joints='[joint_2, joint_1]',
            dry_run='true',
        )
    )
    robot.peer = '/left/inverse_dynamics'
    robot.wait_for_text(node, f'(dry run); nothing is sent to /left/{topic}')
    assert robot.get_parameter('dry_run') is True
    assert robot.get_parameter('robot_description_file') == str(urdf)
    assert robot.get_parameter('joints') == ['joint_2', 'joint_1']
    assert robot.get_parameter('stop_ramp') == 0.7


def test_arguments_that_are_not_given_do_not_change_the_file(run_node, robot, tmp_path):
    path = tmp_path / 'arm.yaml'
    path.write_text(
        f'/**:\n  ros__parameters:\n    robot_description_file: {STANFORD}\n'
        '    joints: [joint_3]\n    dry_run: false\n'
    )
    node = run_node(*ros_arguments(tmp_path, params_file=str(path), dry_rum='true'))
    robot.wait_for_text(node, 'efforts for joint_3 are sent to /inverse_dynamics/commands')
    assert robot.get_parameter('dry_run') is False


def test_without_a_word_on_it_the_node_starts_dry(tmp_path, domain_id):
    (tmp_path / 'arm.yaml').write_text('/**:\n  ros__parameters:\n    kp: 25.0\n')
    for given in ({}, {'params_file': str(tmp_path / 'arm.yaml'), 'dry_rum': 'true'}):
        context = Context()
        context.init(args=['--ros-args', *ros_arguments(tmp_path, **given)], domain_id=domain_id)
        try:
            node = rclpy.create_node('x', context=context, enable_rosout=False)
            assert node._parameter_overrides['dry_run'].value is True
            node.destroy_node()
        finally:
            context.shutdown()


def test_a_parameter_file_that_does_not_exist_ends_the_start(domain_id, tmp_path):
    node = [sys.executable, '-m', 'inverse_dynamics_node.node.main', '--ros-args']
    result = subprocess.run(
        [*node, *ros_arguments(tmp_path, params_file=str(tmp_path / 'nosuch.yaml'))],
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 1
    assert f"params file: '--params-file {tmp_path}/nosuch.yaml'" in result.stderr
    assert 'Traceback' not in result.stderr
