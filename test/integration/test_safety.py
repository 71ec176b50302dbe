"""Crashing processes, clocks that jump, and velocities that disappear."""

import numpy as np
import pytest
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
        ('inputs.Inputs._on_joint_state', 9.0),
        ('runner.LoopRunner.step', 0.0),
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
