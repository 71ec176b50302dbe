"""Other nodes and the simulated clock are reported in the log and in the diagnostics."""

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from inverse_dynamics_node import load_urdf
import numpy as np
import pytest
from robot_files import STANFORD
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray

NAMES = list(load_urdf(STANFORD).joint_names)
Q = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
COMMANDS = '/inverse_dynamics/commands'
FAST = {'robot_description_file': STANFORD, 'start_ramp': 0.0, 'stop_ramp': 0.1}
PATIENT = {**FAST, 'state_timeout': 5.0, 'reference_timeout': 5.0}


@pytest.fixture
def wait_for_level(robot):
    """Return a function that waits for the level of a status; it returns the message."""
    heard = robot.listen(DiagnosticArray, '/diagnostics')

    def wait(part, level):
        heard.clear()
        found = []

        def is_there():
            found[:] = [
                status.message
                for array in heard
                for status in array.status
                if status.name == f'inverse_dynamics: {part}' and status.level == level
            ]
            return bool(found)

        robot.wait_until(is_there, f'{part} at level {level}')
        return found[-1]

    return wait


def lines(node, words):
    return [line for line in node.output.splitlines() if words in line]


def test_a_node_that_publishes_the_same_commands_is_named(run_node, robot, wait_for_level):
    began = time.monotonic()
    node = run_node(**PATIENT)
    robot.publish_state(NAMES, Q, np.zeros(6))
    wait_for_level('other nodes', DiagnosticStatus.OK)
    rival = run_node('-r', '__node:=left_behind', '-r', f'~/commands:={COMMANDS}', **PATIENT)
    words = f'{COMMANDS} is also published by /left_behind'
    robot.wait_for_text(node, words)
    assert '[ERROR]' in lines(node, words)[0]
    assert words in wait_for_level('other nodes', DiagnosticStatus.ERROR)
    # The other one reports this one.
    robot.wait_for_text(rival, f'{COMMANDS} is also published by /inverse_dynamics')
    rival.interrupt()
    robot.wait_for_end(rival)
    robot.wait_for_text(node, 'no other node publishes the commands')
    assert '[INFO]' in lines(node, 'no other node publishes the commands')[0]
    wait_for_level('other nodes', DiagnosticStatus.OK)
    # Repeated every 10 s, although it is found once a second.
    assert len(lines(node, words)) < 3 + 0.2 * (time.monotonic() - began)


def test_a_node_with_the_same_name_is_reported(run_node, robot):
    nodes = [run_node(**PATIENT), run_node(**PATIENT)]
    robot.publish_state(NAMES, Q, np.zeros(6))
    words = 'another node has the name /inverse_dynamics'
    for node in nodes:
        robot.wait_for_text(node, words)
        assert '[ERROR]' in lines(node, words)[0]
    nodes[1].interrupt()
    robot.wait_for_end(nodes[1])
    ended = time.monotonic()
    robot.wait_for_text(nodes[0], 'no other node publishes the commands')
    # A node that does not leave the graph stays listed for 20 s.
    assert time.monotonic() - ended < 10.0


def test_joints_topic_and_subscribers_are_reported_on_activation(run_node, robot):
    joints = f'{NAMES[2]}, {NAMES[0]}'
    node = run_node('-r', '~/commands:=/left/efforts', **PATIENT, joints=f'[{joints}]')
    to = 'are sent to /left/efforts'
    robot.wait_for_text(node, f'efforts for {joints} {to} (no subscriber yet)')
    subscription = robot.node.create_subscription(
        Float64MultiArray, '/left/efforts', lambda message: None, 10
    )
    robot.wait_for_text(node, 'first subscriber of /left/efforts: ')
    # The name of a node may arrive seconds after its subscription.
    (line,) = lines(node, 'first subscriber')
    assert line.endswith((': /robot', ': a node with an unknown name'))

    def is_named():
        assert robot.change_state('deactivate')
        assert robot.change_state('activate')
        return f'efforts for {joints} {to} (/robot)' in node.output

    robot.wait_until(is_named, 'name of the subscriber')
    robot.node.destroy_subscription(subscription)
    robot.wait_for_text(node, 'the last subscriber of /left/efforts is gone')
    assert len(lines(node, 'first subscriber')) == 1


def test_publishers_are_not_reported_missing_while_they_are_discovered(run_node, robot):
    node = run_node(**PATIENT)
    robot.wait_for_text(node, 'no command yet')
    # A second after the node was configured. How long the discovery takes is up to the middleware.
    assert 'publisher' in lines(node, 'no command yet')[0]
    robot.wait_for_text(node, '(1 publisher)')


def test_activities_are_reported_in_plain_words(run_node, robot):
    node = run_node(**{**FAST, 'state_timeout': 2.0, 'stop_ramp': 1.0})
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.wait_for_text(node, '[INFO]')
    robot.wait_for_text(node, 'floating: no reference')
    robot.publish_accelerations(np.zeros(6))
    robot.wait_for_text(node, 'following the reference')
    robot._always = []
    robot.wait_for_text(node, 'floating: no reference for more than 0.5 s')
    robot.state = None
    reason = f'no joint state of {", ".join(NAMES)} for more than 2 s'
    robot.wait_for_text(node, f'ramping efforts down: {reason}')
    robot.wait_for_text(node, f'stopped, zeros sent: {reason}')
    robot.publish_state(NAMES, Q, np.zeros(6))
    count = len(lines(node, 'floating'))
    robot.wait_until(lambda: len(lines(node, 'floating')) > count, 'floating again')
    node.interrupt()
    assert robot.wait_for_end(node) == 0
    assert lines(node, 'ramping efforts down: the process is ending')
    assert lines(node, 'stopped, zeros sent: the process is ending')


def test_simulated_time_without_a_clock_is_an_error(run_node, robot, wait_for_level):
    node = run_node(**PATIENT, use_sim_time=True)
    robot.publish_state(NAMES, Q, np.zeros(6))
    words = 'use_sim_time is set, but nothing publishes /clock'
    robot.wait_for_text(node, words)
    assert '[WARN]' in lines(node, words)[0]
    assert wait_for_level('clock', DiagnosticStatus.ERROR) == words
    robot.wait_until(
        lambda: any('[ERROR]' in line for line in lines(node, words)[1:]), 'the error'
    )
    ticks = robot.keep_publishing('/clock', Clock())
    robot.cease(ticks)
    robot.keep_ticking(100.0)
    robot.wait_for_text(node, 'simulated time advances')
    wait_for_level('clock', DiagnosticStatus.OK)
    robot._always = []  # the publisher remains, as that of a simulation that is paused
    assert 'is the simulation paused?' in wait_for_level('clock', DiagnosticStatus.WARN)
    robot.wait_for_text(node, 'simulated time has not advanced for more than 5 s')
    # Lasting problems are repeated by steady time, since simulated time has stopped.
    robot.publish_accelerations([1.0])
    words = '1 acceleration values, expected 6'
    robot.wait_until(lambda: len(lines(node, words)) > 1, 'another warning')
