"""The node asks the controllers that receive its commands for their joints."""

from contextlib import contextmanager
import re
import signal
import subprocess

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fork_server import SERVER
from lifecycle_msgs.msg import State
from node_process import PATIENCE
import pytest
from robot_files import ROOT
from robot_side import HOLD, LATCHED, NAMES, PATIENT, Q, ZERO
from stalls import StallMeter
from std_srvs.srv import SetBool

OK, ERROR = DiagnosticStatus.OK, DiagnosticStatus.ERROR
TOPIC = '/inverse_dynamics/commands'
LONGEST_GAP = 0.02  # [s]; between commands, on a machine that does not stand still
REVERSED = ', '.join(NAMES[::-1])
ORDER = (
    '/fec expects the efforts in another order than that of the node; set the parameter joints to '
    f'[{REVERSED}]'
)
SUBSCRIBERS = 'subscribers of the commands'


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
        # One that spins leaves the graph at once; after SIGKILL, it would stay for 20 s.
        process.send_signal(signal.SIGKILL if delay == 'never' else signal.SIGTERM)
        process.wait(PATIENCE)


def test_a_dry_run_goes_on_while_the_order_of_the_joints_is_wrong(
    run_node, robot, domain_id, wait_for_status
):
    node = run_node(**PATIENT, dry_run=True)
    robot.publish_state(NAMES, Q, ZERO)
    with controller(domain_id, NAMES[::-1]):
        values = wait_for_status('other nodes', ERROR, ORDER)
        assert values['joints of the controllers'] == f'/fec: {REVERSED}'
        robot.wait_for_text(node, ORDER)
        assert re.search(rf'\[ERROR\] .*{re.escape(ORDER)}', node.output)
        arguments = ['-m', 'inverse_dynamics_node.cli.main', 'watch', '--for', '2']
        environment = {'ROS_DOMAIN_ID': str(domain_id)}
        watch = SERVER.run(arguments, environment, stdout=subprocess.PIPE)
        robot.wait_until(lambda: watch.poll() is not None, 'the end of watch')
        assert ORDER in watch.stdout.read()
        refused = robot.set_parameter('dry_run', False)
        assert not refused.successful
        assert refused.reason.startswith(f'the dry run goes on: {ORDER}')
        assert 'ignore_controller_joints' in refused.reason
        assert robot.get_parameter('dry_run')
        assert not robot.commands
        assert robot.set_parameter('ignore_controller_joints', True).successful
        assert robot.set_parameter('dry_run', False).successful
        robot.wait_for_command(HOLD)
        wait_for_status('other nodes', OK, '')
        for name, value in (('dry_run', True), ('ignore_controller_joints', False)):
            assert robot.set_parameter(name, value).successful
        # The joints of the controller end the problem, too.
        for transition in ('deactivate', 'cleanup'):
            assert robot.change_state(transition)
        assert robot.set_parameter('joints', NAMES[::-1]).successful
        for transition in ('configure', 'activate'):
            assert robot.change_state(transition)
        assert robot.set_parameter('dry_run', False).successful
        robot.wait_for_command(HOLD[::-1])


def test_commands_end_if_a_new_controller_expects_another_number(run_node, robot, domain_id):
    node = run_node(**PATIENT)
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


@pytest.mark.parametrize(
    ('delay', 'joints'),
    [('never', NAMES[::-1]), ('5', NAMES[::-1]), ('0', [])],
    ids=['never', 'late', 'no controller'],
)
def test_other_subscribers_do_not_interrupt_the_commands(
    run_node, robot, domain_id, wait_for_status, delay, joints
):
    """An answer after five seconds is reported, but the arm that floats meanwhile goes on."""
    node = run_node(**PATIENT, update_rate=200)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_for_command(HOLD)
    diagnostics = robot.listen(DiagnosticArray, '/diagnostics')
    with StallMeter() as stalls:
        with controller(domain_id, joints, delay):
            wait_for_status('other nodes', OK, '', SUBSCRIBERS, '/fec')
            if delay == '5':
                wait_for_status('other nodes', ERROR, ORDER)
                robot.wait_for_text(node, ORDER)
            else:
                count = len(diagnostics) + 4  # it is asked twice
                robot.wait_until(lambda: len(diagnostics) > count, 'requests')
                wait_for_status('other nodes', OK, '', SUBSCRIBERS, '/fec')
        robot.wait_for_command(HOLD)
    assert 'stopped: ' not in node.output
    assert delay == '5' or ORDER not in node.output
    worst = [
        1e-3 * float(pair.value)
        for message in diagnostics
        for status in message.status
        for pair in status.values
        if pair.key == 'period worst [ms]' and re.match(r'[\d.]+$', pair.value)
    ]
    assert len(worst) > 4
    assert max(worst) <= LONGEST_GAP + stalls.longest


def test_an_inactive_controller_is_named(run_node, robot, domain_id, wait_for_status):
    reason = 'controller_manager_msgs is not on the Python package index'
    messages = pytest.importorskip('controller_manager_msgs.msg', reason=reason)
    activity = robot.node.create_publisher(
        messages.ControllerManagerActivity, 'controller_manager/activity', LATCHED
    )

    def publish(label):
        state = messages.NamedLifecycleState(name='fec', state=State(label=label))
        activity.publish(messages.ControllerManagerActivity(controllers=[state]))

    publish('inactive')
    run_node(**PATIENT)
    robot.publish_state(NAMES, Q, ZERO)
    with controller(domain_id, NAMES):
        words = '/fec is inactive: it takes no commands until it is activated'
        values = wait_for_status('other nodes', DiagnosticStatus.WARN, words)
        assert values['joints of the controllers'] == f'/fec (inactive): {", ".join(NAMES)}'
        publish('active')
        wait_for_status('other nodes', OK, '')
