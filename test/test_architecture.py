"""The rooms of the house, and the one way through them, read from the imports."""

import ast
import os
from pathlib import Path
import subprocess
import sys

import pytest
from robot_files import ROOT

PACKAGE = ROOT / 'inverse_dynamics_node'
# What each room may import of ours; rooms not named may import nothing.
ARROWS = {
    'model': set(),
    'errors': set(),
    'compilation': set(),
    'urdf': {'model', 'errors'},
    'columns': {'compilation', 'model'},
    'equations': {'compilation'},
    'mass_matrix': {'columns', 'equations', 'newton_euler', 'compilation'},
    'arguments': {'errors', 'model'},
    'newton_euler': {'columns', 'equations', 'compilation'},
    'lanes': {'newton_euler', 'columns', 'equations', 'compilation', 'model'},
    'dynamics': {
        'newton_euler',
        'loaded_robot',
        'mass_matrix',
        'batch_mass_matrix',
        'lanes',
        'columns',
        'arguments',
        'compilation',
        'model',
        'errors',
    },
    'batch_mass_matrix': {
        'columns',
        'equations',
        'mass_matrix',
        'lanes',
        'newton_euler',
        'compilation',
        'model',
    },
    'loaded_robot': {'columns', 'compilation', 'model', 'errors'},
    'specialise': {'newton_euler', 'dynamics', 'columns', 'equations', 'compilation', 'model'},
    'trajectory': {'dynamics', 'lanes', 'model', 'errors'},
    'identification': {'dynamics', 'model', 'errors'},
    'advice': set(),
    'destinations': set(),
    'kinematics': {'model'},
    'plausibility': {'model'},
    'demands': {'dynamics', 'trajectory', 'model'},
    'report': {'advice', 'dynamics', 'plausibility', 'model', 'errors'},
    'workspace': {'dynamics', 'model', 'errors'},
    'loads': {'dynamics', 'arguments', 'model', 'errors'},
    'residual': {'dynamics', 'model'},
    'alternation': {'compilation', 'model'},
    'state': {'alternation', 'compilation', 'model', 'errors'},
    'blending': {'compilation', 'model'},
    'controller': {'blending', 'dynamics', 'state', 'model', 'errors'},
    'rig': {
        'controller',
        'plausibility',
        'loads',
        'residual',
        'report',
        'state',
        'dynamics',
        'model',
        'errors',
    },
    'monitor': {'rig', 'controller', 'plausibility', 'model'},
    'node': {
        'rig',
        'plausibility',
        'monitor',
        'trajectory',
        'controller',
        'loads',
        'dynamics',
        'urdf',
        'model',
        'errors',
    },
    'cli': {
        'advice',
        'destinations',
        'report',
        'workspace',
        'identification',
        'kinematics',
        'plausibility',
        'trajectory',
        'demands',
        'simulation',
        'dynamics',
        'urdf',
        'model',
        'errors',
    },
    'simulation': {'destinations', 'dynamics', 'workspace', 'urdf', 'model', 'errors'},
    '__init__': {'dynamics', 'specialise', 'errors', 'model', 'urdf'},
}
ROS = ('rclpy', 'rcl_interfaces', 'ament_index_python', 'std_srvs')


def room_of(path):
    return path.relative_to(PACKAGE).with_suffix('').parts[0]


def imports_of(path):
    """List the modules that a file imports, by their full names."""
    names = []
    depth = len(path.relative_to(PACKAGE).parts)
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            prefix = node.module or ''
            if node.level:
                inside = ['inverse_dynamics_node', *path.relative_to(PACKAGE).parts[:-1]]
                prefix = '.'.join(
                    inside[: depth - node.level + 1] + ([node.module] if node.module else [])
                )
            names += [f'{prefix}.{alias.name}' for alias in node.names]
    return names


FILES = sorted(PACKAGE.rglob('*.py'))


@pytest.mark.parametrize('path', FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_arrows_go_one_way(path):
    room = room_of(path)
    for name in imports_of(path):
        package, *rest = name.split('.')
        if package == 'inverse_dynamics_node' and rest:
            assert rest[0] in ARROWS[room] | {room}, f'{room} imports {name}'


@pytest.mark.parametrize('path', FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_only_node_and_simulation_know_ros(path):
    if room_of(path) in ('node', 'simulation'):
        return
    for name in imports_of(path):
        package = name.split('.')[0]
        assert package not in ROS, name
        assert not package.endswith('_msgs'), name


def test_core_imports_with_ros_out_of_reach():
    code = (
        'import sys\n'
        'class Refuse:\n'
        '    def find_spec(self, name, *_):\n'
        f'        if name.split(".")[0] in {ROS!r} or name.split(".")[0].endswith("_msgs"):\n'
        '            raise ImportError(name)\n'
        'sys.meta_path.insert(0, Refuse())\n'
        'import inverse_dynamics_node\n'
        'assert "yourdfpy" not in sys.modules, "half a second for who does not load a URDF"\n'
    )
    environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
    subprocess.run([sys.executable, '-c', code], env=environment, check=True, timeout=120)


def test_public_names_exist_and_are_documented():
    import inverse_dynamics_node

    for name in inverse_dynamics_node.__all__:
        assert getattr(inverse_dynamics_node, name).__doc__


def test_version_stands_once_in_each_file_that_needs_it():
    setup = (ROOT / 'setup.py').read_text().split("version='")[1].split("'")[0]
    package = (ROOT / 'package.xml').read_text().split('<version>')[1].split('<')[0]
    changelog = (ROOT / 'CHANGELOG.rst').read_text()
    assert setup == package
    assert setup in changelog or 'Forthcoming' in changelog


def test_no_room_is_missing_from_the_arrows():
    assert {room_of(path) for path in FILES} == set(ARROWS) | {Path('__init__').stem}
