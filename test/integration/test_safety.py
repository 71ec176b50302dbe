"""Suspended and crashing processes, clocks that jump, live changes and new descriptions."""

import ast
import inspect
import re
import signal
import time

from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
import rclpy.lifecycle.node
import rclpy.node
from robot_files import ROOT, STANFORD
from robot_side import RATE
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

MODEL = load_urdf(STANFORD)
NAMES = list(MODEL.joint_names)
Q = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
ELSEWHERE = np.array([-0.3, 1.6, 0.9, 0.4, -0.6, 0.0])
NEARBY = Q + 0.015  # so near that no motion limit takes it for a fault
ZERO = np.zeros(6)
DYNAMICS = InverseDynamics(MODEL)
HOLD = DYNAMICS.gravity_efforts(Q)
HOLD_ELSEWHERE = DYNAMICS.gravity_efforts(ELSEWHERE)
FAST = {'robot_description_file': STANFORD, 'start_ramp': 0.0, 'stop_ramp': 0.2}
PATIENT = {**FAST, 'state_timeout': 5.0, 'reference_timeout': 5.0}
RAMPED = {**PATIENT, 'start_ramp': 2.0}


def assert_ramped(robot, since, start, way, ramp=2.0):
    """Assert that no command since a time is further along its way than the ramp allows."""
    for time_, command in zip(robot.command_times, robot.commands, strict=True):
        if time_ > since:
            gone = np.abs(command - start).max() / np.abs(way).max()
            assert gone < 0.1 + (time_ - since) / ramp


@pytest.mark.parametrize('rate', [0, pytest.param(100, marks=pytest.mark.long)])
def test_a_suspended_process_continues_from_its_last_command(run_node, robot, rate):
    node = run_node(**{**RAMPED, 'state_timeout': 0.5, 'stop_ramp': 2.0}, update_rate=rate)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    node.interrupt(signal.SIGSTOP)
    robot.publish_state(NAMES, ELSEWHERE, ZERO)  # the arm moves while the node is suspended
    ticks = robot.sent
    robot.wait_until(lambda: robot.sent > ticks + RATE, 'a second of states')
    since = time.monotonic()
    node.interrupt(signal.SIGCONT)
    robot.wait_for_command(HOLD_ELSEWHERE)
    assert_ramped(robot, since, HOLD, HOLD)


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
    'where',
    [
        'inputs.Inputs._on_reference',
        'runner.LoopRunner.step',
        'status_publisher.StatusPublisher._on_timer',
        'runner.LoopRunner._on_watch',
    ],
)
def test_a_crash_in_a_callback_leaves_zeros(run_node, robot, where, tmp_path):
    trigger = tmp_path / 'crash'
    node = run_node(program=('-c', CRASH, where, str(trigger)), may_crash=True, **RAMPED)
    robot.publish_state(NAMES, Q, ZERO)
    robot.publish_accelerations(ZERO)
    robot.wait_for_command(HOLD)
    trigger.touch()
    assert robot.wait_for_end(node) == 1
    robot.wait_for_command(ZERO, tolerance=0.0)
    assert 'an error in the program' in node.output


def test_a_crash_while_joint_states_are_read_leaves_the_stop_ramp(run_node, robot, tmp_path):
    trigger = tmp_path / 'crash'
    program = ('-c', CRASH, 'inputs.Inputs._on_joint_state', str(trigger))
    node = run_node(
        program=program, may_crash=True, **{**RAMPED, 'stop_ramp': 1.0}, stop_damping=9.0
    )
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    trigger.touch()
    assert robot.wait_for_end(node) == 1
    robot.wait_for_command(ZERO, tolerance=0.0)
    assert 'stop damping ended: an error in the program' in node.output
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


def test_two_nodes_command_their_own_joints(run_node, robot):
    names = {'left': NAMES[:3], 'right': NAMES[3:]}
    heard = {}
    for side, joints in names.items():
        run_node('-r', f'__node:={side}', **PATIENT, joints=f'[{", ".join(joints)}]')
        heard[side] = robot.listen(Float64MultiArray, f'{side}/commands')
    robot.publish_state(NAMES, Q, ZERO)
    for side, expected in (('left', HOLD[:3]), ('right', HOLD[3:])):
        robot.wait_for(
            heard[side], lambda m, e=expected: list(m.data) == pytest.approx(list(e)), side
        )


def test_two_arms_in_separate_namespaces(run_node, robot):
    run_node('-r', '__ns:=/left', **PATIENT)
    run_node('-r', '__ns:=/right', '-r', 'joint_states:=/joint_states', **PATIENT)
    left = robot.listen(Float64MultiArray, '/left/inverse_dynamics/commands')
    right = robot.listen(Float64MultiArray, '/right/inverse_dynamics/commands')
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for(right, lambda m: list(m.data) == pytest.approx(list(HOLD)), 'right arm')
    assert not left


def test_an_activation_waits_for_a_new_joint_state(run_node, robot):
    timeout = 1.0
    node = run_node(**{**FAST, 'state_timeout': timeout})
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    assert robot.change_state('deactivate')
    robot.wait_for_command(ZERO, tolerance=0.0)
    robot.state = None
    robot.wait_until(
        lambda: time.monotonic() > robot.last_state + 1.5 * timeout, 'an old joint state'
    )
    robot.commands.clear()
    assert robot.change_state('activate')
    robot.wait_for_text(node, f'no command yet: waiting for new joint states of {NAMES[0]}')
    assert not robot.commands
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    assert ZERO.tolist() not in robot.commands


def test_one_message_with_velocities_does_not_stop_an_arm_without_them(run_node, robot):
    node = run_node(**{**FAST, 'state_timeout': 2.5})
    robot.publish_state(NAMES, Q)
    robot.wait_for_command(HOLD)
    # The subscription is best effort and keeps one message: this one may be lost.
    words = f'velocities of {", ".join(NAMES)} are missing in new messages'
    message = JointState(name=NAMES, position=Q, velocity=ZERO)
    robot.publish_until(lambda: words in node.output, words, 'joint_states', message)
    count, since = len(robot.commands), time.monotonic()
    robot.wait_until(lambda: time.monotonic() > since + 3.0, 'longer than the time-out')
    robot.wait_for_command(HOLD)
    assert all(command == pytest.approx(list(HOLD)) for command in robot.commands[count:])
    robot.wait_for_text(node, 'in new messages from /robot; zero is used')


def test_the_log_reports_a_lost_imu_and_its_return(run_node, robot):
    node = run_node(**PATIENT, base_motion='imu')
    measured = Imu()
    measured.linear_acceleration.z = 9.80665
    publication = robot.keep_publishing('imu', measured)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    robot.cease(publication)
    robot.wait_for_text(node, 'the motion of the base is unknown: no message on imu for more')
    robot.keep_publishing('imu', measured)
    robot.wait_for_text(node, 'solved: the motion of the base is unknown')
    robot.wait_for_command(HOLD)


def test_the_log_follows_jumps_of_the_clock(run_node, robot):
    node = run_node(**{**FAST, 'stop_ramp': 0.0}, use_sim_time=True)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_text(node, 'floating: no reference')
    jump = robot.keep_ticking(100.0)

    def stamps(words):
        """Return the times at which the node wrote some words [s]."""
        lines = [line for line in node.output.splitlines() if words in line]
        return [float(re.findall(r'\[(\d+\.\d+)\]', line)[0]) for line in lines]

    # The commands continue with the next state. If the log missed this, the text would be repeated
    # after 2 s. A busy machine may take as long, but not every time.
    took = []
    while not took or took[-1] > 1.9:
        assert len(took) < 5, took
        count = 1 + len(took)
        robot.wait_until(
            lambda count=count: len(stamps('stopped, zeros sent: no joint state')) >= count, 'stop'
        )
        robot.wait_until(lambda count=count: len(stamps('floating')) > count, 'floating')
        took.append(stamps('floating')[count] - stamps('stopped')[count - 1])
        jump(100.0)


def test_only_the_first_point_of_a_reference_is_used(run_node, robot):
    node = run_node(**{**PATIENT, 'reference_timeout': 0.5})
    robot.publish_state(NAMES, Q, ZERO)
    wanted = np.array([0.5, -0.4, 0.3, 0.2, -0.1, 0.6])
    points = [JointTrajectoryPoint(accelerations=a) for a in (wanted, ZERO)]
    message = JointTrajectory(joint_names=NAMES, points=points)
    sent = robot.keep_publishing('inverse_dynamics/reference', message)
    robot.wait_for_command(DYNAMICS.efforts(Q, ZERO, wanted))
    robot.cease(sent)
    message.points = points * 1000
    robot.publish_once('inverse_dynamics/reference', message)
    robot.wait_for_text(node, 'expected at most 65536; only the first point is used')
    robot.wait_for_command(HOLD)


@pytest.mark.parametrize('rate', [0, 50])
def test_the_stop_ramp_starts_when_the_loss_of_states_is_detected(run_node, robot, rate):
    run_node(**{**FAST, 'state_timeout': 1.0, 'stop_ramp': 1.0}, update_rate=rate)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    robot.state, count = None, len(robot.commands)
    robot.wait_for_command(ZERO, tolerance=0.0)
    fractions = np.array(robot.commands[count:])[:, 2] / HOLD[2]
    times = np.array(robot.command_times[count:])
    assert (np.diff(fractions) <= 1e-9).all()
    # A command may arrive late, but never early.
    assert (fractions[times < robot.last_state + 0.8] >= 0.9).all()
    assert ((fractions > 0.5) & (fractions < 0.99)).any()


def test_positions_are_used_if_the_number_of_measured_efforts_is_wrong(run_node, robot):
    node = run_node(**PATIENT)
    robot.listen(JointState, 'inverse_dynamics/external_efforts')  # which needs measured efforts
    robot.publish_state(NAMES, Q, ZERO, [1.0, 2.0])
    robot.wait_for_text(node, '6 names, but 2 efforts')
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
