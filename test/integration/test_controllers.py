"""The node asks the controllers that receive its commands for their joints."""

from contextlib import contextmanager
import re
import signal
import subprocess

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fork_server import SERVER
from inverse_dynamics_node import InverseDynamics, load_urdf
from node_process import PATIENCE
import numpy as np
import pytest
from robot_files import ROOT, STANFORD
from stalls import StallMeter
from std_srvs.srv import SetBool

NAMES = list(load_urdf(STANFORD).joint_names)
Q = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
HOLD = InverseDynamics(load_urdf(STANFORD)).gravity_efforts(Q)
ZERO = np.zeros(6)
SETTINGS = {
    'robot_description_file': STANFORD,
    'start_ramp': 0.0,
    'stop_ramp': 0.1,
    'state_timeout': 5.0,
}
TOPIC = '/inverse_dynamics/commands'
LONGEST_GAP = 0.02  # [s]; between commands, on a machine that does not stand still
ORDER = '/fec expects the efforts in another order than that of the node'
SET_ORDER = f'set the parameter joints to [{", ".join(NAMES[::-1])}]'


@contextmanager
def controller(domain_id, joints, delay='0', name='fec'):
    """Run a controller of these joints, which answers after a delay [s]."""
    process = SERVER.run(
        [str(ROOT / 'test/controller_process.py'), name, delay, TOPIC, *joints],
        {'ROS_DOMAIN_ID': str(domain_id)},
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait(PATIENCE)


def other_nodes(diagnostics):
    """Return the latest status of the part `other nodes`."""
    found = [s for m in diagnostics for s in m.status if s.name.endswith('other nodes')]
    return found[-1] if found else DiagnosticStatus()


def wait_for_subscriber(robot, diagnostics):
    def is_there():
        values = {pair.key: pair.value for pair in other_nodes(diagnostics).values}
        return '/fec' in values.get('subscribers of the commands', '')

    robot.wait_until(is_there, 'the controller in the diagnostics')


def wait_for_status(robot, diagnostics, level, words):
    def is_there():
        status = other_nodes(diagnostics)
        return status.level == level and words in status.message

    robot.wait_until(is_there, f'{words!r} in the diagnostics')


def test_a_dry_run_goes_on_while_the_order_of_the_joints_is_wrong(run_node, robot, domain_id):
    diagnostics = robot.listen(DiagnosticArray, '/diagnostics')
    node = run_node(**SETTINGS, dry_run=True)
    robot.publish_state(NAMES, Q, ZERO)
    with controller(domain_id, NAMES[::-1]):
        wait_for_status(robot, diagnostics, DiagnosticStatus.ERROR, f'{ORDER}; {SET_ORDER}')
        values = {pair.key: pair.value for pair in other_nodes(diagnostics).values}
        assert values['joints of the controllers'] == f'/fec: {", ".join(NAMES[::-1])}'
        robot.wait_for_text(node, ORDER)
        assert re.search(rf'\[ERROR\] .*{re.escape(f"{ORDER}; {SET_ORDER}")}', node.output)
        arguments = ['-m', 'inverse_dynamics_node.cli.main', 'watch', '--for', '2']
        environment = {'ROS_DOMAIN_ID': str(domain_id)}
        watch = SERVER.run(arguments, environment, stdout=subprocess.PIPE)
        robot.wait_until(lambda: watch.poll() is not None, 'the end of watch')
        assert f'{ORDER}; {SET_ORDER}' in watch.stdout.read()
        refused = robot.set_parameter('dry_run', False)
        assert not refused.successful
        assert refused.reason.startswith(f'the dry run goes on: {ORDER}; {SET_ORDER}')
        assert 'ignore_controller_joints' in refused.reason
        assert robot.get_parameter('dry_run')
        assert not robot.commands
        assert robot.set_parameter('ignore_controller_joints', True).successful
        assert robot.set_parameter('dry_run', False).successful
        robot.wait_for_command(HOLD)
        wait_for_status(robot, diagnostics, DiagnosticStatus.OK, '')


def test_a_dry_run_ends_once_the_joints_are_those_of_the_controller(run_node, robot, domain_id):
    diagnostics = robot.listen(DiagnosticArray, '/diagnostics')
    run_node(**SETTINGS, dry_run=True)
    robot.publish_state(NAMES, Q, ZERO)
    with controller(domain_id, NAMES[::-1]):
        wait_for_status(robot, diagnostics, DiagnosticStatus.ERROR, ORDER)
        assert robot.change_state('deactivate')
        assert robot.change_state('cleanup')
        assert robot.set_parameter('joints', NAMES[::-1]).successful
        assert robot.change_state('configure')
        assert robot.change_state('activate')
        assert robot.set_parameter('dry_run', False).successful
        robot.wait_for_command(HOLD[::-1])
        wait_for_status(robot, diagnostics, DiagnosticStatus.OK, '')


def test_commands_end_if_a_new_controller_expects_another_number(run_node, robot, domain_id):
    node = run_node(**SETTINGS)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    with controller(domain_id, NAMES[:5]):
        text = 'stopped: /fec expects 5 efforts, but the node commands 6; set the parameter joints'
        robot.wait_for_text(node, text)
        robot.wait_for_command(ZERO, tolerance=0.0)
        answer = robot.call(SetBool, 'enable', SetBool.Request(data=True))
        assert not answer.success
        assert 'expects 5 efforts' in answer.message
        assert robot.change_state('deactivate')
        assert not robot.change_state('activate')
    robot.wait_until(lambda: robot.change_state('activate'), 'an activation')
    robot.wait_for_command(HOLD)


@pytest.mark.parametrize(('delay', 'joints'), [('never', NAMES[::-1]), ('5', NAMES[::-1])])
def test_late_answers_do_not_interrupt_the_commands(run_node, robot, domain_id, delay, joints):
    """An answer after five seconds is reported, but the arm that floats meanwhile goes on."""
    diagnostics = robot.listen(DiagnosticArray, '/diagnostics')
    node = run_node(**SETTINGS, update_rate=200)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    diagnostics.clear()
    with StallMeter() as stalls:
        with controller(domain_id, joints, delay):
            wait_for_subscriber(robot, diagnostics)
            if delay == 'never':
                count = len(diagnostics)
                robot.wait_until(lambda: len(diagnostics) > count + 12, 'requests')
                assert other_nodes(diagnostics).level == DiagnosticStatus.OK
            else:
                wait_for_status(robot, diagnostics, DiagnosticStatus.ERROR, ORDER)
        robot.wait_for_command(HOLD)
    assert 'stopped: ' not in node.output
    worst = [
        1e-3 * float(pair.value)
        for message in diagnostics
        for status in message.status
        for pair in status.values
        if pair.key == 'period worst [ms]' and re.match(r'[\d.]+$', pair.value)
    ]
    assert len(worst) > 4
    assert max(worst) <= LONGEST_GAP + stalls.longest


def test_subscribers_that_are_no_controllers_change_nothing(run_node, robot, domain_id):
    diagnostics = robot.listen(DiagnosticArray, '/diagnostics')
    run_node(**SETTINGS)
    robot.publish_state(NAMES, Q, ZERO)
    with controller(domain_id, []):
        wait_for_subscriber(robot, diagnostics)
        diagnostics.clear()
        robot.wait_until(lambda: len(diagnostics) > 4, 'diagnostics')
    robot.wait_for_command(HOLD)
    assert {other_nodes([message]).level for message in diagnostics} == {DiagnosticStatus.OK}
