"""What the node reports about itself, its inputs and other nodes: diagnostics and log."""

import math
import re
import time

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Inertia, InertiaStamped
from inverse_dynamics_node import InverseDynamics, load_urdf
from robot_files import STANFORD
from robot_side import FAST, HOLD, NAMES, PATIENT, Q, ZERO
from std_msgs.msg import Float64MultiArray, Header

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def lines(node, words):
    return [line for line in node.output.splitlines() if words in line]


def test_a_description_that_arrives_later_is_used_at_the_next_configuration(
    run_node, robot, wait_for_status
):
    node = run_node(start_ramp=0.0, stop_ramp=0.2, state_timeout=5.0)
    text = STANFORD.read_text()
    robot.publish_description(text)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    links = ''.join(
        f'<link name="x{k}"/><joint name="y{k}" type="fixed"><parent link="base_link"/>'
        f'<child link="x{k}"/></joint>'
        for k in range(60_000)
    )
    robot.publish_again(text.replace('</robot>', f'{links}</robot>'))
    wait_for_status('model', WARN, 'another robot description has arrived')
    robot.wait_for_command(HOLD)
    assert robot.change_state('deactivate')
    assert robot.change_state('cleanup')
    assert not robot.change_state('configure')
    robot.wait_for_text(node, 'links, expected at most 1000')
    heavier = re.sub('<mass value="([^"]*)"', lambda m: f'<mass value="{1.2 * float(m[1])}"', text)
    robot.publish_again(heavier)
    robot.wait_until(lambda: robot.change_state('configure'), 'configuration')
    assert robot.change_state('activate')
    robot.wait_for_command(InverseDynamics(load_urdf(heavier)).gravity_efforts(Q))
    assert 'set /inverse_dynamics $x; done' in node.output


def test_the_status_follows_the_inputs_and_the_lifecycle(run_node, robot, wait_for_status):
    node = run_node(state_timeout=5.0, stop_ramp=0.1)
    wait_for_status('loop', OK, 'unconfigured')
    robot.publish_description(STANFORD.read_text())
    waiting = f'waiting for the positions of {NAMES[0]}'
    robot.wait_for_text(node, 'no command yet')
    # A second after the node was configured. How long the discovery takes is up to the middleware.
    assert 'publisher' in lines(node, 'no command yet')[0]
    assert wait_for_status('joint states', ERROR, waiting, 'publishers', '1')['age [s]'] == 'never'
    robot.publish_state(['joint1', *NAMES[1:]], Q, ZERO)
    robot.wait_for_text(node, "(received similar names: 'joint1')")
    robot.publish_state(NAMES, [Q[0], 57.3, *Q[2:]], ZERO)
    text = f'{NAMES[1]} is at 57.3 rad, outside its limits -1.745 to 1.745 (in degrees?)'
    wait_for_status('joint states', WARN, text)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_text(node, f'solved: {text}')
    assert robot.change_state('deactivate')
    wait_for_status('loop', OK, 'inactive')


def test_values_are_those_of_the_running_node(run_node, robot, wait_for_status):
    run_node(**PATIENT, update_rate=100, effort_limits=1.0)
    robot.publish_state(NAMES, Q, ZERO)
    robot.publish_accelerations([math.nan] * 6)
    load = InertiaStamped(header=Header(frame_id='tool0'), inertia=Inertia(m=1.25))
    robot.publish_once('inverse_dynamics/payload', load)
    key = f"~/desired_accelerations: acceleration of joint '{NAMES[0]}' is nan"
    key += ', expected a number of at most 1e+09'
    first = int(wait_for_status('messages', WARN, 'since the last report', key)[key])
    assert int(wait_for_status('messages', WARN, 'since the last report', key)[key]) > first > 0
    values = wait_for_status('loop', OK, 'floating: no reference', 'mode', 'inverse_dynamics')
    assert (values['state'], values['requested rate [Hz]']) == ('active', '100')
    for name in ('compute time p99 [ms]', 'period worst [ms]', 'period p99 [ms]', 'rate [Hz]'):
        assert float(values[name]) > 0.0
    assert 0.0 <= float(wait_for_status('joint states', OK, 'fresh')['age [s]']) < 5.0
    values = wait_for_status('efforts', WARN, NAMES[1], 'receivers', '1')
    assert int(values[f'{NAMES[1]} cut to limit']) > 0
    wait_for_status('model', OK, 'stanford', 'payload', '1.25 kg on tool0')


def test_a_node_that_publishes_the_same_commands_is_named(run_node, robot, wait_for_status):
    began, topic = time.monotonic(), '/inverse_dynamics/commands'
    node = run_node(**PATIENT)
    robot.publish_state(NAMES, Q, ZERO)
    wait_for_status('other nodes', OK, '')
    rival = run_node('-r', '__node:=left_behind', '-r', f'~/commands:={topic}', **PATIENT)
    words = f'{topic} is also published by /left_behind'
    robot.wait_for_text(node, words)
    assert '[ERROR]' in lines(node, words)[0]
    wait_for_status('other nodes', ERROR, words)
    # The other one reports this one.
    robot.wait_for_text(rival, f'{topic} is also published by /inverse_dynamics')
    rival.interrupt()
    robot.wait_for_end(rival)
    robot.wait_for_text(node, f'solved: {words}')
    assert '[INFO]' in lines(node, f'solved: {words}')[0]
    wait_for_status('other nodes', OK, '')
    # Repeated every 10 s, although it is found once a second.
    assert len(lines(node, words)) < 3 + 0.2 * (time.monotonic() - began)


def test_a_node_with_the_same_name_is_reported(run_node, robot):
    nodes = [run_node(**PATIENT), run_node(**PATIENT)]
    robot.publish_state(NAMES, Q, ZERO)
    words = 'another node has the name /inverse_dynamics'
    for node in nodes:
        robot.wait_for_text(node, words)
        assert '[ERROR]' in lines(node, words)[0]
    nodes[1].interrupt()
    robot.wait_for_end(nodes[1])
    ended = time.monotonic()
    robot.wait_until(lambda: lines(nodes[0], 'solved: '), 'the end of the problem')
    assert words in lines(nodes[0], 'solved: ')[0]
    # A node that does not leave the graph stays listed for 20 s.
    assert time.monotonic() - ended < 10.0


def test_joints_topic_and_subscribers_are_reported_on_activation(run_node, robot):
    joints = f'{NAMES[2]}, {NAMES[0]}'
    node = run_node('-r', '~/commands:=/left/efforts', **PATIENT, joints=f'[{joints}]')
    to = 'are sent to /left/efforts'
    robot.wait_for_text(node, f'efforts for {joints} {to} (no subscriber yet)')
    robot.wait_for_text(node, 'the commands have no subscribers')
    robot.listen(Float64MultiArray, '/left/efforts')
    robot.wait_for_text(node, 'solved: the commands have no subscribers')

    def is_named():
        # The name of a node may arrive seconds after its subscription.
        assert robot.change_state('deactivate')
        assert robot.change_state('activate')
        return f'efforts for {joints} {to} (/robot)' in node.output

    robot.wait_until(is_named, 'name of the subscriber')


def test_a_silent_publisher_of_joint_states_is_reported(run_node, robot, wait_for_status):
    node = run_node(**FAST, state_timeout=1.0)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_text(node, 'floating: no reference')
    robot.state = None  # the publisher stays connected
    wait_for_status('joint states', ERROR, 'although 1 publisher is connected')
    robot.wait_for_text(
        node, '(a killed publisher stays connected for up to 20 s); if ros2 topic hz'
    )
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_text(node, 'solved: joint states ')
    wait_for_status('joint states', OK, 'fresh')


def test_simulated_time_that_stands_still_is_reported(run_node, robot, wait_for_status):
    node = run_node(**PATIENT, use_sim_time=True)
    robot.publish_state(NAMES, Q, ZERO)
    words = 'use_sim_time is set, but nothing publishes /clock'
    robot.wait_for_text(node, words)
    assert '[WARN]' in lines(node, words)[0]
    robot.keep_ticking(100.0)
    robot.wait_for_text(node, f'solved: {words}')
    wait_for_status('clock', OK, '')
    robot._always = []  # the publisher remains, as that of a simulation that is paused
    wait_for_status('clock', WARN, 'is the simulation paused?')
    robot.wait_for_text(node, 'simulated time has not advanced for more than 5 s')
    # What happens is logged by steady time, since simulated time has stopped.
    robot.publish_accelerations([1.0])
    robot.wait_for_text(node, '1 acceleration values, expected 6')
