"""Crashing processes, clocks that jump, and velocities that disappear."""

import ast
import inspect

import numpy as np
import pytest
import rclpy.lifecycle.node
import rclpy.node
from robot_files import ROOT
from robot_side import DYNAMICS, FAST, HOLD, NAMES, PATIENT, Q, ZERO
from sensor_msgs.msg import JointState

NEARBY = Q + 0.015  # so near that no motion limit takes it for a fault
RAMPED = {**PATIENT, 'start_ramp': 0.5, 'stop_ramp': 1.0}

CRASH = """
import os, sys
from importlib import import_module
from inverse_dynamics_node.node import main
where, trigger = sys.argv.pop(1), sys.argv.pop(1)
module, class_name, method = where.split('.')
owner = getattr(import_module(f'inverse_dynamics_node.node.{module}'), class_name)
original = getattr(owner, method)
def crash(self, *arguments):
    if os.path.exists(trigger):
        raise RuntimeError('an error in the program')
    return original(self, *arguments)
setattr(owner, method, crash)
sys.exit(main.main(sys.argv))
"""


@pytest.mark.parametrize(
    ('where', 'stop_damping'),
    [
        ('inputs.Inputs._on_reference', 0.0),
        ('inputs.Inputs._on_joint_state', 9.0),
        ('runner.LoopRunner.step', 0.0),
        ('runner.LoopRunner._on_watch', 0.0),
        ('status_publisher.StatusPublisher._on_timer', 0.0),
    ],
)
def test_a_crash_in_a_callback_leaves_the_stop_ramp_and_zeros(
    run_node, robot, where, stop_damping, tmp_path
):
    trigger = tmp_path / 'crash'
    program = ('-c', CRASH, where, str(trigger))
    node = run_node(program=program, may_crash=True, **RAMPED, stop_damping=stop_damping)
    robot.publish_state(NAMES, Q, ZERO)
    robot.publish_accelerations(ZERO)
    robot.wait_for_command(HOLD)
    trigger.touch()
    assert robot.wait_for_end(node) == 1
    robot.wait_for_command(ZERO, tolerance=0.0)
    assert 'an error in the program' in node.output
    if stop_damping:
        assert 'stop damping ended: an error in the program' in node.output
    if where != 'runner.LoopRunner.step':  # which computes the ramp
        shares = np.array(robot.commands)[:, 2] / HOLD[2]
        assert np.count_nonzero((shares > 0.1) & (shares < 0.9)) > 10


def test_a_jump_of_the_clock_causes_no_jump_of_the_efforts(run_node, robot):
    node = run_node(**RAMPED, use_sim_time=True, update_rate=100)
    jump = robot.keep_ticking(100.0)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    count = len(robot.commands)
    for seconds in (-90.0, 1000.0):
        robot.publish_state(NAMES, NEARBY, ZERO)
        jump(seconds)
        robot.wait_for_command(DYNAMICS.gravity_efforts(NEARBY))
        robot.publish_state(NAMES, Q, ZERO)
        robot.wait_for_command(HOLD)
    assert node.process.poll() is None
    assert len(robot.commands) > count + 10


def test_velocities_that_disappear_are_reported_with_their_publisher(run_node, robot):
    node = run_node(**{**FAST, 'state_timeout': 0.5})
    robot.publish_state(NAMES, Q)
    robot.wait_for_command(HOLD)
    # The subscription is best effort and keeps one message: this one may be lost.
    words = f'velocities of {", ".join(NAMES)} are missing in new messages from /robot; zero is'
    message = JointState(name=NAMES, position=Q, velocity=ZERO)
    robot.publish_until(lambda: words in node.output, words, 'joint_states', message)
    robot.wait_for_command(HOLD)


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
