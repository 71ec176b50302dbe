"""Inputs and conditions that must neither end nor block the node."""

import os
import pty
import re
import select
import signal
import subprocess
import sys

from diagnostic_msgs.msg import DiagnosticArray
from fork_server import MAIN, SERVER
from geometry_msgs.msg import InertiaStamped, Vector3Stamped, WrenchStamped
from inverse_dynamics_node.node.runner import Watchdog
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from node_process import PATIENCE
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.experimental.events_executor import EventsExecutor
from robot_files import ROOT
from robot_side import FAST, HOLD, NAMES, PATIENT, Q, RATE, ZERO
from rosgraph_msgs.msg import Clock
from type_description_interfaces.srv import GetTypeDescription

LOSING = {**FAST, 'state_timeout': 1.0}  # longer than the usual pauses of a busy machine


def start(domain_id, stderr, **parameters):
    settings = [x for k, v in parameters.items() for x in ('-p', f'{k}:={v}')]
    command = ['-m', MAIN, '--ros-args', *settings]
    with open(os.devnull, 'w') as nothing:
        files = {'stdout': nothing.fileno(), 'stderr': stderr or nothing.fileno()}
        return SERVER.run(command, {'ROS_DOMAIN_ID': str(domain_id)}, **files)


def fill(writer):
    """Write until nothing more fits, then let writing block again."""
    os.set_blocking(writer, False)
    for size in (4096, 1):
        try:
            while True:
                os.write(writer, b'x' * size)
        except BlockingIOError:
            pass
    os.set_blocking(writer, True)


@pytest.mark.parametrize('channel', [os.pipe, pty.openpty], ids=['pipe', 'terminal'])
def test_commands_continue_while_stderr_has_no_reader(domain_id, robot, channel):
    reader, writer = channel()
    fill(writer)
    node = start(domain_id, writer, **LOSING)
    try:
        robot.publish_state(NAMES, Q, ZERO)
        robot.wait_for_command(HOLD)
        robot.publish_accelerations([1.0])  # rejected, which is logged
        robot.state = None
        robot.wait_for_command(ZERO)
        robot.publish_state(NAMES, Q, ZERO)
        robot.wait_for_command(HOLD)
        node.send_signal(signal.SIGTERM)
        robot.wait_until(lambda: node.poll() is not None, 'end of the node')
        robot.wait_for_command(ZERO)
        assert node.returncode == 0
        os.set_blocking(writer, False)
        assert os.get_blocking(reader)  # other processes may share this end with the node
    finally:
        node.kill()
        node.wait()
        os.close(reader)
        os.close(writer)


def test_a_node_without_stderr_works(domain_id, robot):
    settings = [x for k, v in PATIENT.items() for x in ('-p', f'{k}:={v}')]
    node = subprocess.Popen(
        ['/bin/sh', '-c', 'exec "$@" 2>&- >&-', 'sh', sys.executable, '-m', MAIN, '--ros-args']
        + [str(x) for x in settings],
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)},
    )
    try:
        robot.publish_state(NAMES, Q, ZERO)
        robot.wait_for_command(HOLD)
        opened = {os.readlink(f'/proc/{node.pid}/fd/{number}') for number in (1, 2)}
        assert opened == {'/dev/null'}, 'the log could be written into a socket'
    finally:
        node.terminate()
        assert node.wait(PATIENCE) == 0


def parameter(name, kind):
    return Parameter(name=name, value=ParameterValue(type=kind))


def test_no_request_ends_the_process(run_node, robot):
    node = run_node(**PATIENT)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    requests = SetParameters.Request(parameters=[parameter('kp', 10), parameter('kd', 255)])
    results = robot.call(SetParameters, 'set_parameters', requests).results
    assert [result.successful for result in results] == [False, False]
    assert results[0].reason == "parameter 'kp' has type 10, expected 0 to 9"
    request = SetParametersAtomically.Request(parameters=[parameter('kp', 77)])
    result = robot.call(SetParametersAtomically, 'set_parameters_atomically', request).result
    assert not result.successful
    assert result.reason == "parameter 'kp' has type 77, expected 0 to 9"
    for name in ('', 'x' * 100_000, 'a\x00b', 'line\nfeed', '/', '\u00fc', 'kp.', '~'):
        requests = SetParameters.Request(parameters=[parameter(name, k) for k in range(12)])
        answer = robot.call(SetParameters, 'set_parameters', requests)
        assert len(answer.results) == 12
        assert not any(result.successful for result in answer.results[10:])
        assert max(len(result.reason) for result in answer.results) < 1000
        for kind, request_name, values in (
            (DescribeParameters, 'describe_parameters', {'names': [name]}),
            (GetParameterTypes, 'get_parameter_types', {'names': [name]}),
            (GetParameters, 'get_parameters', {'names': [name]}),
            (ListParameters, 'list_parameters', {'prefixes': [name], 'depth': 2**63}),
            (GetTypeDescription, 'get_type_description', {'type_name': name}),
            (ChangeState, 'change_state', {'transition': Transition(id=99, label=name)}),
        ):
            robot.call(kind, request_name, kind.Request(**values))
    robot.wait_for_command(HOLD)
    assert node.process.poll() is None


def test_a_timer_that_was_due_before_a_cleanup_does_nothing(run_node, robot):
    node = run_node(**{**PATIENT, 'stop_ramp': 1.0})
    client = robot.node.create_client(ChangeState, 'inverse_dynamics/change_state')
    robot.wait_until(client.service_is_ready, 'life cycle')

    def request(number):
        return client.call_async(ChangeState.Request(transition=Transition(id=number)))

    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    request(Transition.TRANSITION_DEACTIVATE)
    # In the second half of the ramp, which is one callback, the timer of the loop is due.
    robot.wait_until(lambda: abs(robot.commands[-1][1]) < abs(0.5 * HOLD[1]), 'half of the ramp')
    future = request(Transition.TRANSITION_CLEANUP)
    robot.wait_until(future.done, 'answer')
    assert future.result().success
    assert robot.change_state('configure')
    assert robot.change_state('activate')
    robot.wait_for_command(HOLD)
    assert node.process.poll() is None


def test_a_clock_before_zero_is_ignored(run_node, robot):
    node = run_node(**PATIENT, use_sim_time=True)
    jump = robot.keep_ticking(100.0)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    broken = Clock()
    broken.clock.sec = -5
    broken_clock = robot.keep_publishing('/clock', broken)
    robot.wait_for_text(node, '/clock: message dropped: ')
    robot.cease(broken_clock)
    jump(1.0)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    assert node.process.poll() is None


def test_a_queue_that_never_becomes_empty_is_interrupted(robot):
    executor = EventsExecutor(context=robot.context)
    count = [0]

    def again():
        count[0] += 1
        executor.create_task(again)

    again()
    watchdog = Watchdog()
    try:
        for spins in range(1, 4):
            watchdog.spin(executor)  # without the interruption, it never returns
            assert watchdog.is_congested
            assert count[0] > spins
    finally:
        watchdog.close()
        executor.shutdown()


def test_lost_states_and_signals_are_noticed_during_a_storm(domain_id, robot, run_program):
    # Its log is not read: bytes that are not a message make the middleware write a lot.
    node = start(domain_id, None, **LOSING)
    try:
        robot.publish_state(NAMES, Q, ZERO)
        robot.wait_for_command(HOLD)
        storm = [
            ROOT / 'test/storm.py',
            '--messages',
            10**9,
            '--seconds',
            2.0 * PATIENCE,
            '--seed',
        ]
        processes = [run_program(*storm, seed, stdout=subprocess.PIPE) for seed in range(2)]
        # Each prints a line as soon as it has found all subscriptions.
        lines = {process.stdout for process in processes}
        robot.wait_until(
            lambda: len(select.select(lines, (), (), 0.0)[0]) == len(lines), 'a storm in progress'
        )
        sent = robot.sent
        robot.wait_until(lambda: robot.sent > sent + RATE, 'a storm for a while')
        robot.state = None
        robot.wait_for_command(ZERO)
        node.send_signal(signal.SIGTERM)
        robot.wait_until(lambda: node.poll() is not None, 'end of the node')
        assert node.returncode == 0
        # Otherwise it may have been the end of the storm that let the node continue.
        assert all(process.poll() is None for process in processes), 'the storm was over'
    finally:
        node.kill()
        node.wait()


def test_long_texts_are_shortened_everywhere(run_node, robot):
    node = run_node(**PATIENT)
    statuses = robot.listen(DiagnosticArray, '/diagnostics')
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    text = 'frame\n' + 'x' * 1_000_000
    for topic, kind in (
        ('payload', InertiaStamped),
        ('external_wrench', WrenchStamped),
        ('gravity', Vector3Stamped),
    ):
        message = kind()
        message.header.frame_id = text
        robot.publish_once(f'inverse_dynamics/{topic}', message)
        robot.wait_for_text(node, f'~/{topic}: message dropped')
    robot.wait_until(lambda: len(statuses) > 2, 'diagnostics')
    assert max(map(len, node.output.splitlines())) < 2000
    assert re.search(r'frame\\nx+\.\.\. \(1000006 characters\)', node.output)
    values = [pair for m in statuses for status in m.status for pair in status.values]
    assert max(len(pair.key) + len(pair.value) for pair in values) < 2000
