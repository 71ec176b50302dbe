"""Names that this package and rclpy use in the same objects."""

import ast
import inspect

import pytest
from robot_files import ROOT

pytest.importorskip('rclpy')

import rclpy.lifecycle.node
import rclpy.node

PACKAGE = ROOT / 'inverse_dynamics_node'
# Of named tuples, of `os`, and of our own objects.
OTHERS = {'_asdict', '_replace', '_exit', '_fields'}
OF_HANDLES = {'take_message', 'service_take_request'}  # methods of the C++ objects of rclpy


def test_private_names_of_rclpy_are_used_in_one_file():
    found = set()
    for part in ('node', 'ros', 'simulation'):
        for path in (PACKAGE / part).glob('*.py'):
            for each in ast.walk(ast.parse(path.read_text())):
                if isinstance(each, ast.Attribute) and not is_own(each.value):
                    is_private = each.attr.startswith('_') and not each.attr.startswith('__')
                    if (is_private and each.attr not in OTHERS) or each.attr in OF_HANDLES:
                        found.add(path.name)
    assert found == {'private.py'}


def is_own(value):
    return isinstance(value, ast.Name) and value.id in ('self', 'cls')


def test_no_name_of_the_node_is_used_by_rclpy():
    # rclpy has attributes of its own in the same object.
    ours, theirs = NodeNames(), NodeNames()
    ours.visit(ast.parse((ROOT / 'inverse_dynamics_node/node/node.py').read_text()))
    for module in (rclpy.node, rclpy.lifecycle.node):
        theirs.visit(ast.parse(inspect.getsource(module)))
    assert '_publishers' in theirs.names
    overridden = {name for name in ours.names & theirs.names if name.startswith('on_')}
    assert ours.names & theirs.names - overridden == {'__init__', 'get_logger', 'destroy_node'}


class NodeNames(ast.NodeVisitor):
    """Collects the names of functions and of attributes of self."""

    def __init__(self):
        self.names = set()

    def visit_FunctionDef(self, node):
        self.names.add(node.name)
        self.generic_visit(node)

    def visit_Attribute(self, node):
        is_own = isinstance(node.value, ast.Name) and node.value.id == 'self'
        if is_own and isinstance(node.ctx, ast.Store):
            self.names.add(node.attr)
        self.generic_visit(node)
