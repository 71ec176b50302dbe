"""Nothing but motion makes a command differ much from the last one, with the node as a process."""

import re
import time

import numpy as np
import pytest
from std_srvs.srv import SetBool
from suspensions import ALLOWED, FILE, largest_step, MODEL, move, NAMES, PARAMETERS

Q = np.array([0.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0])
ZERO = np.zeros(7)


@pytest.mark.parametrize('rate', [pytest.param(0, marks=pytest.mark.long), 200])
def test_no_effort_jumps_after_a_suspension_while_the_arm_moves(run_node, robot, rate):
    node = run_node(**PARAMETERS, update_rate=rate)
    commands = move(robot)
    robot.wait_until(lambda: len(commands) > 100, 'the end of the start ramp')
    for duration in (0.5, 1.0, 2.0)[: 2 if rate else 3]:
        assert largest_step(robot, node, commands, duration) < ALLOWED


@pytest.mark.parametrize('stop', ['enable', 'dry_run', 'enable, dry_run'])
def test_a_stop_without_joint_states_begins_at_once_and_does_not_catch_up(run_node, robot, stop):
    node = run_node(robot_description_file=FILE, state_timeout=60.0, start_ramp=0.0, stop_ramp=0.5)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_until(lambda: robot.commands and np.any(robot.commands[-1]), 'commands')
    top, count = np.array(robot.commands[-1]), len(robot.commands)
    robot.state = None  # as at an emergency stop
    if 'enable' in stop:
        assert robot.call(SetBool, 'enable', SetBool.Request(data=False)).success
        robot.wait_until(lambda: abs(robot.commands[-1][1]) < abs(top[1]), 'a fall')
    if 'dry_run' in stop:
        assert robot.set_parameter('dry_run', True).successful
    robot.wait_for_command(ZERO, tolerance=0.0)
    if stop == 'enable, dry_run':  # the fall continues
        robot.wait_for_text(node, 'dry run: the commands end')
        (left,) = re.findall(r'the commands end after the stop ramp \((.*) s\)', node.output)
        assert float(left) < 0.5
    assert time.monotonic() < robot.last_state + 60.0  # before the states are lost
    commands = np.array(robot.commands[count - 1 :])
    steps = np.abs(np.diff(commands, axis=0))
    # A ramp advances by 2 % at a time; not every command arrives.
    assert (steps <= 0.15 * np.abs(top) + 1e-9).all()
    assert (steps.max(axis=0) < 0.05 * MODEL.effort_limits).all()
