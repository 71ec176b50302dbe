"""The launch file agrees with the node; launch itself is not on PyPI, so the XML is read here."""

import re
import xml.etree.ElementTree as ElementTree

from inverse_dynamics_node.node.parameters import PARAMETERS
from inverse_dynamics_node.node.usage import PUBLISHED, SUBSCRIBED
from launch_arguments import ARGUMENTS, LAUNCH, NODE, ros_arguments, TYPES
from robot_files import ROOT, STANFORD

# Attributes of the elements used here, of those that launch_xml and launch_ros accept.
ATTRIBUTES = {
    'launch': set(),
    'arg': {'name', 'default', 'description'},
    'node': {'pkg', 'exec', 'name', 'namespace', 'output'},
    'param': {'from', 'name', 'value', 'type'},
    'remap': {'from', 'to'},
}


def test_elements_attributes_and_substitutions_are_those_of_launch():
    for element in LAUNCH.iter():
        assert set(element.attrib) <= ATTRIBUTES[element.tag], element.tag
        for value in element.attrib.values():
            for kind, name in re.findall(r'\$\(([\w-]+) ?([^)]*)\)', value):
                assert (kind, name) == ('find-pkg-share', 'inverse_dynamics_node') or (
                    kind == 'var' and name in ARGUMENTS
                ), value


def test_arguments_are_documented_used_and_have_a_default():
    assert list(ARGUMENTS) == ['urdf', 'params_file', 'namespace', 'commands', 'dry_run']
    text = ElementTree.tostring(NODE, encoding='unicode')
    for name, argument in ARGUMENTS.items():
        assert argument.get('default') is not None
        assert argument.get('description')
        assert f'$(var {name})' in text


def test_executable_parameters_and_topics_are_those_of_the_node():
    setup = (ROOT / 'setup.py').read_text()
    assert NODE.get('pkg') in setup
    assert "{package_name} = {package_name}.node.main:run'" in setup
    assert NODE.get('exec') == NODE.get('pkg') == 'inverse_dynamics_node'
    names = [param.get('name') for param in NODE.findall('param') if param.get('name')]
    assert names == ['robot_description_file', 'dry_run']
    for param in NODE.findall('param'):
        if param.get('name'):
            declared = PARAMETERS[param.get('name')].default
            assert type(declared) is TYPES[param.get('type')]
            argument = re.fullmatch(r'\$\(var (\w+)\)', param.get('value'))[1]
            default = ARGUMENTS[argument].get('default')
            assert default == (str(declared).lower() if declared is False else declared)
    for remap in NODE.findall('remap'):
        assert remap.get('from') in {*PUBLISHED, *SUBSCRIBED}


def test_it_is_installed_and_its_dependencies_are_declared():
    assert "/launch', glob('launch/*'))" in (ROOT / 'setup.py').read_text()
    manifest = ElementTree.parse(ROOT / 'package.xml').getroot()
    depends = {element.text for element in manifest.findall('exec_depend')}
    assert {'launch_ros', 'launch_xml', 'ros2launch', 'xacro'} <= depends


def test_the_node_starts_with_what_launch_passes(run_node, robot, tmp_path):
    urdf = tmp_path / 'my arm.urdf'
    urdf.write_text(STANFORD.read_text())
    topic = 'forward_effort_controller/commands'
    node = run_node(
        *ros_arguments(urdf=str(urdf), dry_run='true', namespace='left', commands=topic)
    )
    robot.peer = '/left/inverse_dynamics'
    robot.wait_for_text(node, f'dry run, nothing is sent to /left/{topic}')
    assert robot.get_parameter('dry_run') is True
    assert robot.get_parameter('robot_description_file') == str(urdf)
    assert 'remap' not in node.output
