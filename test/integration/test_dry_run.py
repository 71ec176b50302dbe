"""In a dry run, the node does everything except that it sends no commands."""

import time

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from robot_files import STANFORD
from robot_side import HOLD, NAMES, Q, ZERO
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

RAMPED = {
    'robot_description_file': STANFORD,
    'start_ramp': 1.0,
    'stop_ramp': 2.0,
    'state_timeout': 5.0,
}


def wait_for_efforts(robot, expected):
    """Wait for a message on ~/joint_efforts from now on."""
    robot.joint_efforts.clear()
    robot.wait_for(
        robot.joint_efforts,
        lambda message: list(message.effort) == pytest.approx(list(expected), abs=1e-9),
        'computed efforts',
    )


def wait_for_silence(robot):
    """Wait until efforts have been computed many times without a command being sent."""

    def is_silent():
        if len(robot.commands) > count[0]:
            count[0] = len(robot.commands)
            robot.joint_efforts.clear()
        return len(robot.joint_efforts) > 50

    count = [len(robot.commands)]
    robot.joint_efforts.clear()
    robot.wait_until(is_silent, 'end of the commands')


def assert_falls_to_zero(commands, times, start, since):
    """
    Assert that no magnitude grows, no sign changes, and the last command is zero.

    No command is far below the stop ramp that begins at `since` [s]: commands arrive late on a
    busy machine, but not early.

    """
    commands = np.array(commands)
    assert (np.abs(commands[0]) <= np.abs(start) + 1e-9).all()
    ramp = 1.0 - (np.array(times) - since) / RAMPED['stop_ramp']
    assert (np.abs(commands[:, 1]) >= np.abs(start[1]) * (ramp - 0.75)).all()
    assert (np.diff(np.abs(commands), axis=0) <= 1e-12).all()
    assert (commands * np.sign(start) >= 0.0).all()
    assert not commands[-1].any()


def test_a_dry_run_sends_no_command_and_can_be_switched_off_and_on(
    run_node, robot, wait_for_status
):
    node = run_node(**RAMPED, dry_run=True)
    robot.listen_to_joint_efforts()
    robot.publish_state(NAMES, Q, ZERO)
    wait_for_efforts(robot, HOLD)
    robot.wait_for_text(node, 'on ~/joint_efforts only (dry run); nothing is sent to')
    robot.wait_for_text(node, 'dry run: floating: no reference')
    for part in ('loop', 'efforts'):
        values = wait_for_status(part, DiagnosticStatus.OK, 'dry run: floating: no reference')
        assert values.get('dry run') == {'loop': 'yes'}.get(part)
    answer = robot.call(SetBool, 'enable', SetBool.Request(data=True))
    assert answer.success
    assert answer.message.endswith('(dry run: nothing is sent)')
    wait_for_silence(robot)
    assert robot.commands == []

    since = time.monotonic()
    assert robot.set_parameter('dry_run', False).successful
    robot.wait_for_command(HOLD)
    # Commands may be lost or arrive late, but none is above the ramp.
    fractions = np.array(robot.commands) @ HOLD / (HOLD @ HOLD)
    ramp = (np.array(robot.command_times) - since) / RAMPED['start_ramp']
    assert (fractions < ramp + 0.2).all()
    robot.wait_for_text(node, 'dry run: efforts rise from zero and are sent to /inverse_dynamics')

    count, since = len(robot.commands), time.monotonic()
    assert robot.set_parameter('dry_run', True).successful
    wait_for_silence(robot)
    assert_falls_to_zero(robot.commands[count:], robot.command_times[count:], HOLD, since)
    assert sum(not any(command) for command in robot.commands[count:]) > 3
    wait_for_efforts(robot, HOLD)  # the computed efforts have not been affected

    # The end of a dry run does not enable the node.
    assert robot.call(SetBool, 'enable', SetBool.Request(data=False)).success
    wait_for_efforts(robot, ZERO)
    robot.commands.clear()
    robot.set_parameter('dry_run', False)
    robot.wait_for_text(node, 'stopped, zeros sent: disabled by ~/enable')
    robot.wait_until(lambda: len(robot.commands) > 50, 'commands')
    assert not np.array(robot.commands).any()

    robot.set_parameter('dry_run', True)
    wait_for_silence(robot)
    count = len(robot.commands)
    node.interrupt()
    assert robot.wait_for_end(node) == 0
    assert len(robot.commands) == count  # another node may command the robot
    assert '(dry run: nothing to ramp down)' in node.output


def test_remapped_joint_efforts_are_commands_in_a_dry_run(run_node, robot):
    """A robot may receive its commands by name, as in Isaac Sim."""
    node = run_node('-r', '~/joint_efforts:=/joint_command', **RAMPED, dry_run=True)
    heard = robot.listen(JointState, '/joint_command')
    complete = robot.listen(JointState, 'inverse_dynamics/joint_commands')
    computed = robot.listen(JointState, 'inverse_dynamics/external_efforts')
    robot.publish_state(NAMES, Q, ZERO, ZERO)
    robot.wait_until(lambda: len(computed) > 100, 'external efforts')
    assert heard == complete == []
    robot.wait_for_text(node, ' or to /joint_command')
    robot.set_parameter('dry_run', False)
    robot.wait_for(heard, lambda m: list(m.effort) == pytest.approx(list(HOLD)), 'efforts')
    robot.wait_for(complete, lambda m: list(m.effort) == pytest.approx(list(HOLD)), 'efforts')
    node.interrupt()
    assert robot.wait_for_end(node) == 0
    robot.wait_for(complete, lambda m: not any(m.effort), 'zeros')
    assert list(complete[-1].position) == pytest.approx(list(Q))
