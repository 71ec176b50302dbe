"""The launch file agrees with the node; launch itself is not on PyPI, so the XML is read here."""

import re
import xml.etree.ElementTree as ElementTree

from inverse_dynamics_node.control.stop_damping import TIMEOUT
from inverse_dynamics_node.node.parameters import PARAMETERS
from launch_arguments import ARGUMENTS, FOLDER, LAUNCH, NODE, SUBSTITUTIONS
from robot_files import ROOT

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
    assert list(ARGUMENTS) == [
        'urdf',
        'params_file',
        'name',
        'namespace',
        'commands',
        'joints',
        'dry_run',
        'use_sim_time',
    ]
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
    assert names == ['robot_description_file', 'joints', 'dry_run', 'use_sim_time']
    assert set(names) - set(PARAMETERS) == {'use_sim_time'}
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
