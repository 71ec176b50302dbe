"""The layout of the package: which part imports which, read from the imports themselves."""

import ast
from graphlib import CycleError, TopologicalSorter
import os
import re
import subprocess
import sys

import pytest
from robot_files import ROOT

NAME = 'inverse_dynamics_node'
PACKAGE = ROOT / NAME
FILES = sorted(PACKAGE.rglob('*.py'))
PARTS = sorted(path.parent.name for path in PACKAGE.glob('*/__init__.py'))
ROS = ('rclpy', 'rcl_interfaces', 'ament_index_python', 'std_srvs')


def permitted_imports():
    """Read the table of CONTRIBUTING.md: part -> the parts that it may import."""
    text = (ROOT / 'CONTRIBUTING.md').read_text()
    rows = re.findall(r'^ *(\w+) +-> +([\w, ]+)$', text, re.MULTILINE)
    return {part: set(re.findall(r'\w+', imported)) for part, imported in rows}


def part_of(path):
    """Return the sub-package of a file, or the file's own name at the root of the package."""
    return path.relative_to(PACKAGE).with_suffix('').parts[0]


def imports_of(path):
    """List the imports of a file by full names, also those in functions and for type checkers."""
    folder = [NAME, *path.relative_to(PACKAGE).parent.parts]
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = folder[: len(folder) - node.level + 1] if node.level else []
            prefix = '.'.join([*base, *([node.module] if node.module else [])])
            names += [f'{prefix}.{alias.name}' for alias in node.names]
    return names


def own_module(name):
    """Return the file that an imported name comes from, or None if it is not one of ours."""
    package, *parts = name.split('.')
    if package != NAME:
        return None
    while parts:
        path = PACKAGE.joinpath(*parts)
        if path.with_suffix('.py').exists():
            return path.with_suffix('.py')
        if (path / '__init__.py').exists():
            return path / '__init__.py'
        parts.pop()
    return PACKAGE / '__init__.py'


def test_a_part_imports_only_what_contributing_permits():
    table, wrong = permitted_imports(), []
    for path in FILES:
        part = part_of(path)
        permitted = table.get(part, set()) | {part, 'errors'}
        for name in imports_of(path):
            package, *rest = name.split('.')
            if package == NAME and rest and rest[0] not in permitted and part != '__init__':
                wrong.append(f'{path.relative_to(PACKAGE)} imports {name}')
            is_ros = package in ROS or package.endswith('_msgs')
            if is_ros and part not in ('ros', 'node', 'simulation'):
                wrong.append(f'{path.relative_to(PACKAGE)} imports {name}, which belongs to ROS')
    assert not wrong


def test_the_table_of_imports_names_every_part():
    table = permitted_imports()
    named = set(table) | set().union(*table.values())
    assert named - {'errors'} == set(PARTS)
    assert len(PARTS) == 9


def test_no_file_imports_itself_through_others():
    graph = {
        path: {own_module(name) for name in imports_of(path)} - {None, path}
        for path in FILES
        if path != PACKAGE / '__init__.py'
    }
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        names = ' -> '.join(str(path.relative_to(PACKAGE)) for path in error.args[1])
        pytest.fail(f'import cycle: {names}')
    assert len(order) >= len(FILES) - 1


def test_the_root_of_the_package_has_no_other_files():
    names = {path.name for path in PACKAGE.iterdir() if path.is_file()}
    assert names == {'__init__.py', 'errors.py', 'py.typed'}


def test_a_file_has_fewer_than_600_lines():
    lengths = {str(path.relative_to(PACKAGE)): len(path.read_text().split('\n')) for path in FILES}
    # One public class, of which almost half is the documentation of its methods.
    assert lengths.pop('dynamics/inverse_dynamics.py') < 900
    assert not [name for name, length in lengths.items() if length > 600]


@pytest.mark.parametrize('part', PARTS)
def test_every_part_is_introduced_in_one_sentence(part):
    summary = ast.get_docstring(ast.parse((PACKAGE / part / '__init__.py').read_text()))
    assert summary
    assert '\n' not in summary


def test_the_core_can_be_imported_without_ros():
    code = (
        'import sys\n'
        'class Refuse:\n'
        '    def find_spec(self, name, *_):\n'
        f'        if name.split(".")[0] in {ROS!r} or name.split(".")[0].endswith("_msgs"):\n'
        '            raise ImportError(name)\n'
        'sys.meta_path.insert(0, Refuse())\n'
        f'import {NAME}\n'
        'assert "yourdfpy" not in sys.modules, "imported before a URDF is loaded"\n'
    )
    environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
    subprocess.run([sys.executable, '-c', code], env=environment, check=True, timeout=120)


def test_public_names_exist_and_are_documented():
    import inverse_dynamics_node

    for name in inverse_dynamics_node.__all__:
        assert getattr(inverse_dynamics_node, name).__doc__
