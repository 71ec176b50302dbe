"""The node as a process: inputs, outputs, parameters, the life cycle and signals."""

import math
import re
import signal
import subprocess
import threading
import time

from fork_server import SERVER
from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.node.parameters import PARAMETERS
from inverse_dynamics_node.node.ros_parameters import _REMOVED
import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from robot_files import ROOT, STANFORD
from robot_side import DYNAMICS, FAST, MODEL, NAMES, PATIENT, Q, QD, QDD, ZERO
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

HOLD = DYNAMICS.efforts(Q, QD, ZERO)


def publish_shuffled_state(robot):
    """Publish the state as drivers do: in another order, with other joints."""
    order = [4, 0, 3, 5, 1, 2]
    names = ['wheel', *(NAMES[k] for k in order), 'finger']
    robot.publish_state(names, [9.0, *Q[order], 7.0], [math.nan, *QD[order], 0.0])


# Inputs and outputs


def test_state_by_shuffled_names_gives_the_efforts_of_the_core(run_node, robot):
    run_node(**PATIENT)
    robot.listen_to_joint_efforts()
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    robot.publish_accelerations(QDD)
    expected = DYNAMICS.efforts(Q, QD, QDD)
    robot.wait_for_command(expected)
    message = robot.wait_for(
        robot.joint_efforts,
        lambda m: list(m.effort) == pytest.approx(list(expected)),
        'joint efforts',
    )
    assert list(message.name) == NAMES
    assert len(message.position) == len(message.velocity) == 0
    assert message.header.stamp.sec > 0


def test_a_subset_of_joints_is_commanded_in_the_requested_order(run_node, robot):
    joints = [NAMES[4], NAMES[1]]
    run_node(**PATIENT, joints=f'[{",".join(joints)}]', gravity='[0, 0, -5]')
    publish_shuffled_state(robot)
    robot.publish_accelerations([1.0, 2.0])
    qdd = np.array([0.0, 2.0, 0.0, 0.0, 1.0, 0.0])
    tau = InverseDynamics(MODEL, (0.0, 0.0, -5.0)).efforts(Q, QD, qdd)
    robot.wait_for_command([tau[4], tau[1]])


def test_a_reference_is_followed_by_name_and_ends(run_node, robot):
    """Only its first point is used, with all of its values."""
    node = run_node(**{**PATIENT, 'reference_timeout': 0.5}, mode='computed_torque', kp=50, kd=10)
    publish_shuffled_state(robot)
    effort, q_ref, qd_ref = 0.5 * np.arange(6.0), Q + 0.01, QD - 0.02
    rows = [row[::-1].tolist() for row in (q_ref, qd_ref, QDD, effort)]
    fields = ('positions', 'velocities', 'accelerations', 'effort')
    points = [
        JointTrajectoryPoint(**dict(zip(fields, rows, strict=True))),
        JointTrajectoryPoint(positions=[0.0] * 6),
    ]
    message = JointTrajectory(joint_names=NAMES[::-1], points=points)
    sent = robot.keep_publishing('inverse_dynamics/reference', message)
    complete = robot.listen(JointState, 'inverse_dynamics/joint_commands')
    expected = DYNAMICS.efforts(Q, QD, QDD + 50.0 * (q_ref - Q) + 10.0 * (qd_ref - QD)) + effort
    robot.wait_for_command(expected)
    values = pytest.approx([*q_ref, *qd_ref, *expected])
    command = robot.wait_for(
        complete, lambda m: [*m.position, *m.velocity, *m.effort] == values, 'complete command'
    )
    assert list(command.name) == NAMES
    assert command.header.stamp.sec > 0
    robot.cease(sent)
    robot.wait_for_command(HOLD)
    message.points = points * 1000
    robot.publish_once('inverse_dynamics/reference', message)
    robot.wait_for_text(node, 'expected at most 65536; only the first point is used')


def test_invalid_messages_are_dropped_with_a_reason(run_node, robot):
    node = run_node(**PATIENT)
    robot.listen(JointState, 'inverse_dynamics/external_efforts')  # which needs measured efforts
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    for values, words in (
        ([*QDD[:5], math.nan], f"acceleration of joint '{NAMES[5]}' is"),
        ([1.0, 2.0], '2 acceleration values, expected 6'),
        ([], '0 acceleration values, expected 6'),
    ):
        robot.publish_accelerations(values)
        robot.wait_for_text(node, words)
    for names, effort, words in (
        (NAMES, [math.inf] * 6, f"effort of joint '{NAMES[0]}' is"),
        ([*NAMES[:5], 'nose'], (), f'nose; expected {", ".join(NAMES)}'),
    ):
        robot.publish_reference(names, QDD, effort)
        robot.wait_for_text(node, words)
    robot._always = []
    robot.publish_state(NAMES, [math.inf, *Q[1:]], QD)
    robot.wait_for_text(node, f"position of joint '{NAMES[0]}' is inf")
    robot.publish_state(NAMES, Q, QD, [1.0, 2.0])
    robot.wait_for_text(node, '6 names, but 2 efforts')
    robot.wait_for_command(HOLD)  # with the positions of this message
    robot.publish_state(NAMES, [math.nan] * 6, [math.nan] * 6)
    # The subscription is best effort: a single message may be lost.
    bytes_of_no_state = b'\x00\x01\x00\x00' + b'\xff' * 40
    robot._always = [(robot._states, bytes_of_no_state)]
    robot.wait_for_text(node, '44 bytes cannot be read as a JointState')
    robot._always, count = [], len(robot.commands)
    publish_shuffled_state(robot)
    robot.wait_until(lambda: len(robot.commands) > count, 'another command')
    assert np.isfinite(robot.commands).all()
    assert {len(command) for command in robot.commands} == {6}


@pytest.mark.parametrize(
    'update_rate',
    [0, 50, pytest.param(2, marks=pytest.mark.long)],
)
def test_a_lost_state_leads_to_zeros_that_continue(run_node, robot, update_rate):
    timeout, ramp = 1.0, 2.0
    node = run_node(
        **{**FAST, 'state_timeout': timeout, 'stop_ramp': ramp}, update_rate=update_rate
    )
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    robot.state, count = None, len(robot.commands)
    robot.wait_for_command(np.zeros(6), tolerance=0.0)
    # The ramp begins at the time-out at the earliest, and takes stop_ramp. On a busy machine,
    # commands arrive late, but not early.
    fractions = np.array(robot.commands[count:]) @ HOLD / (HOLD @ HOLD)
    times = np.array(robot.command_times[count:])
    fallen = (times - robot.last_state - timeout) / ramp
    assert (fractions > 0.8 - np.maximum(fallen, 0.0)).all()
    assert (np.diff(fractions) <= 1e-9).all()
    assert ((fractions > 0.01) & (fractions < 0.99)).any()
    count = len(robot.commands)
    robot.wait_until(lambda: len(robot.commands) > count + 20, 'zeros that continue')
    assert not np.any(robot.commands[count:])
    reason = f'no joint state of {", ".join(NAMES)} for more than 1 s'
    robot.wait_for_text(node, f'ramping efforts down: {reason}')
    robot.wait_for_text(node, f'stopped, zeros sent: {reason}')
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)


def test_commands_are_sent_at_the_update_rate(run_node, robot):
    run_node(**PATIENT, update_rate=50)
    robot.listen_to_joint_efforts()
    publish_shuffled_state(robot)  # at 200 Hz

    def rate():
        """Return the rate of the latest commands by the clock of the node, NaN at first."""
        stamps = [m.header.stamp for m in robot.joint_efforts[-50:]]
        times = [stamp.sec + 1e-9 * stamp.nanosec for stamp in stamps]
        return 1.0 / np.median(np.diff(times)) if len(times) == 50 else math.nan

    # On a busy machine, it takes a while until most of the commands in a row are in time.
    robot.wait_until(lambda: rate() == pytest.approx(50.0, rel=0.2), 'commands at 50 Hz')


# Signals


@pytest.mark.parametrize(
    ('number', 'update_rate'),
    [(signal.SIGINT, 0), (signal.SIGTERM, 1000), (signal.SIGHUP, 0)],
)
def test_signal_ends_with_zeros_and_code_0(run_node, robot, number, update_rate):
    node = run_node(**PATIENT, update_rate=update_rate)
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    node.interrupt(number)
    assert robot.wait_for_end(node) == 0
    robot.wait_for_command(np.zeros(6), tolerance=0.0)
    assert 'Traceback' not in node.output


def test_second_signal_skips_the_ramp_but_not_the_zeros(run_node, robot):
    node = run_node(**{**PATIENT, 'stop_ramp': 60.0})
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    node.interrupt()
    # Otherwise both signals may arrive as one.
    robot.wait_for_text(node, 'ramping efforts down: the process is ending')
    count = len(robot.commands)
    robot.wait_until(lambda: len(robot.commands) > count + 10, 'ramp')
    assert np.any(robot.commands[-1])
    began = time.monotonic()
    node.interrupt()  # so soon that it may be the first one again
    robot.wait_until(lambda: time.monotonic() > began + 1.1, 'another second')
    assert np.any(robot.commands[-1])
    node.interrupt()
    assert robot.wait_for_end(node) == 0
    robot.wait_for_command(np.zeros(6), tolerance=0.0)


RECEIVER = """
import sys
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray
rclpy.init()
node = rclpy.create_node('controller')
quality = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
def take(message):
    print(*message.data, flush=True)
node.create_subscription(Float64MultiArray, 'inverse_dynamics/commands', take, quality)
rclpy.spin(node)
"""


@pytest.mark.parametrize(
    'attempt', [0, *(pytest.param(k, marks=pytest.mark.long) for k in range(1, 20))]
)
def test_zeros_reach_a_best_effort_receiver_that_stands_still(run_node, robot, domain_id, attempt):
    """As forward_command_controller does while the controller manager stands still."""
    node = run_node(**{**PATIENT, 'stop_ramp': 0.1})
    publish_shuffled_state(robot)
    environment = {'ROS_DOMAIN_ID': str(domain_id)}
    receiver = SERVER.run(['-c', RECEIVER], environment, stdout=subprocess.PIPE)
    taken = []

    def read():
        for line in receiver.stdout:
            taken.append([float(x) for x in line.split()])

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        robot.wait_until(lambda: taken and np.any(taken[-1]), 'commands at the receiver')
        receiver.send_signal(signal.SIGSTOP)
        began = time.monotonic()
        node.interrupt()
        robot.wait_until(lambda: time.monotonic() > began + 0.6, 'a stall of the receiver')
        receiver.send_signal(signal.SIGCONT)
        assert robot.wait_for_end(node) == 0
        robot.wait_until(lambda: not np.any(taken[-1]), 'zeros at the receiver')
        assert 'stopped, zeros sent for 1 s: the process is ending' in node.output
    finally:
        receiver.kill()
        receiver.wait()


def test_signal_before_the_first_state_ends_with_code_0(run_node, robot):
    node = run_node(**PATIENT)
    robot.wait_for_text(node, 'no command yet')
    node.interrupt()
    assert robot.wait_for_end(node) == 0
    assert robot.commands == []


# Parameters


BAD_URDF = '<robot name="r"><link name="a"/><link name="a"/></robot>'


@pytest.mark.parametrize(
    ('parameters', 'words'),
    [
        ({'robot_description': f"'{BAD_URDF}'"}, "duplicate link name 'a'"),
        ({**FAST, 'robot_description': f"'{BAD_URDF}'"}, 'are both set'),
        ({**FAST, 'use_sim_time': 'soon'}, "of type 'STRING', expecting type 'BOOL'"),
        ({**FAST, 'gravity': '[0.0, 0, -9.8]'}, 'Sequence should be of same type'),
        (dict.fromkeys(_REMOVED, 1.0), f"'{list(_REMOVED)[-1]}' was removed: "),
    ],
)
def test_bad_start_ends_with_one_clear_message(run_node, parameters, words):
    node = run_node(**parameters)
    assert node.wait() == 1
    assert node.output.count(words) == 1
    assert 'Traceback' not in node.output


def test_every_bad_parameter_has_a_line_of_its_own(run_node):
    wrong = {'update_rate': -1.0, 'mode': 'fast', 'joints': '3', 'kp': '.nan'}
    wrong |= {f'locked_positions.{NAMES[5]}': 'x'}
    unknown = {'effort_limit': 30.0, 'locked_position.joint_6': 0.1}
    unknown |= {'locked_positions': 0.3, 'zebra': 1}
    node = run_node(**{**FAST, **wrong}, **unknown)
    assert node.wait() == 1
    output = [line for line in node.output.splitlines() if 'is deprecated' not in line]  # Kilted
    assert [line.split('[inverse_dynamics]: ')[1] for line in output] == [
        "parameter 'joints' is 3, expected a list of names",
        "parameter 'update_rate' is -1.0, expected 0 or 1 to 10000",
        "parameter 'mode' is 'fast', expected one of inverse_dynamics, computed_torque, "
        'gravity_compensation, joint_impedance',
        "parameter 'kp' is nan, expected a finite number, or a list with one number for each "
        'commanded joint',
        f"parameter 'locked_positions.{NAMES[5]}' is 'x', expected a finite number",
        "unknown parameter 'effort_limit'; did you mean 'effort_limits'?",
        "unknown parameter 'locked_position.joint_6'; did you mean 'locked_positions.joint_6'?",
        "unknown parameter 'locked_positions'; did you mean 'locked_positions.<joint>'?",
        "unknown parameter 'zebra'",
        'to ignore unknown parameters, for example in a file that several nodes share, set '
        'allow_unknown_parameters to true',
    ]


def test_unknown_parameters_can_be_allowed(run_node, robot):
    qos = {'qos_overrides./joint_states.subscription.depth': 2}
    known = {**PATIENT, **qos, 'use_sim_time': False, 'start_type_description_service': True}
    node = run_node(**known, staet_timeout=1.0, allow_unknown_parameters=True)
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    robot.wait_for_text(node, "robot 'stanford'")  # comes after these
    assert (
        "ignored unknown parameter 'staet_timeout'; did you mean 'state_timeout'?" in node.output
    )
    assert node.output.count('unknown parameter') == 1
    assert robot.get_parameter('allow_unknown_parameters') is True


def test_parameters_describe_their_ranges_and_refuse_other_values(run_node, robot):
    run_node(**PATIENT)
    request = DescribeParameters.Request(names=list(PARAMETERS))
    answer = robot.call(DescribeParameters, 'describe_parameters', request)
    for each in answer.descriptors:
        found = [
            (r.from_value, r.to_value) for r in each.floating_point_range or each.integer_range
        ]
        expected = PARAMETERS[each.name].range
        assert found == ([expected] if expected else []), each.name
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    for name, value, words in (
        ('update_rate', 100.0, 'deactivate and clean up the node first'),
        ('joints', None, "'joints' cannot be unset"),
        ('kp', [1.0, 2.0], 'kp has 2 numbers, expected one, or one for each of 6 joints'),
        ('kp', [1.0, 1.0, 1.0, 1.0, 1.0, -1.0], '1.0, -1.0], expected at least 0'),
        ('effort_limit', 5.0, "unknown parameter 'effort_limit'; did you mean 'effort_limits'?"),
        ('locked_positions.hand', 0.0, "hand' can only be set when the process starts"),
        ('', 5.0, 'a parameter without a name'),
        ('drive_coupling', 1.0, "coupling of joint 'joint_1' is 1.0, expected 0"),
        ('robot_description_file', 'another.urdf', 'read-only'),
    ):
        result = robot.set_parameter(name, value)
        assert not result.successful, (name, value)
        assert words in result.reason
    count = len(robot.commands)
    robot.wait_until(lambda: len(robot.commands) > count + 10, 'further commands')
    assert robot.commands[-1] == pytest.approx(list(HOLD))


def test_live_parameters_of_every_kind_apply_at_once(run_node, robot):
    run_node(**PATIENT, include_friction=True, damping=2, coulomb=0.5, armature=0.3)
    publish_shuffled_state(robot)
    robot.publish_accelerations(QDD)
    dynamics = InverseDynamics(MODEL)
    dynamics.set_friction(2.0, 0.5)
    dynamics.set_armature(0.3)

    def set_each(**values):
        for name, value in values.items():
            assert robot.set_parameter(name, value).successful

    robot.wait_for_command(dynamics.efforts(Q, QD, QDD))
    coupling = [0.0, 0.0, 0.0, 0.0, 0.0, 0.8]
    set_each(drive_coupling=coupling, spring_stiffness=19.0, spring_rest=0.1)
    dynamics.set_drive_coupling(coupling)
    dynamics.set_springs(19.0, 0.1)
    robot.wait_for_command(dynamics.efforts(Q, QD, QDD))
    set_each(include_gravity=False)
    dynamics.set_gravity((0.0, 0.0, 0.0))
    robot.wait_for_command(dynamics.efforts(Q, QD, QDD))
    set_each(include_gravity=True, effort_scale=[0.5, 1.0, 1.0, 1.0, 1.0, 2.0], effort_limits=1)
    dynamics.set_gravity((0.0, 0.0, -9.80665))
    scaled = dynamics.efforts(Q, QD, QDD) * [0.5, 1.0, 1.0, 1.0, 1.0, 2.0]
    robot.wait_for_command(np.clip(scaled, -1.0, 1.0))
    robot._always = []
    set_each(effort_scale=1.0, effort_limits=0, mode='joint_impedance', impedance_damping=4)
    held = dynamics.efforts(Q, QD, ZERO)
    robot.wait_for_command(np.clip(held, -MODEL.effort_limits, MODEL.effort_limits) - 4.0 * QD)
    moved, stiffness = Q + 0.02, np.array([50.0, 50.0, 50.0, 0.0, 0.0, 0.0])
    set_each(stiffness=stiffness.tolist())
    robot.publish_state(NAMES, moved, QD)
    held = dynamics.efforts(moved, QD, ZERO)
    robot.wait_for_command(held + stiffness * (Q - moved) - 4.0 * QD)


# The robot description and the life cycle


def test_the_robot_description_may_be_published_before_or_after_the_start(run_node, robot):
    node = run_node(start_ramp=0.0, state_timeout=5.0)
    publish_shuffled_state(robot)
    robot.wait_for_text(node, 'waiting for a robot description on /robot_description')
    assert robot.get_state() == 'unconfigured'
    robot.publish_description(BAD_URDF)
    robot.wait_for_text(node, "duplicate link name 'a'")
    robot.publish_description(STANFORD.read_text())
    robot.wait_for_command(HOLD)
    node.interrupt()
    robot.wait_for_end(node)
    robot.commands.clear()
    run_node(start_ramp=0.0, state_timeout=5.0)  # the description has been published already
    robot.wait_for_command(HOLD)


def test_lifecycle_by_hand(run_node, robot):
    node = run_node(**PATIENT, autostart=False)
    publish_shuffled_state(robot)
    assert robot.get_state() == 'unconfigured'
    assert not robot.change_state('activate')  # not possible from here
    assert robot.change_state('configure')
    assert robot.get_state() == 'inactive'
    assert robot.commands == []
    assert robot.change_state('activate')
    robot.wait_for_command(HOLD)
    assert robot.change_state('deactivate')
    robot.wait_for_command(np.zeros(6), tolerance=0.0)
    assert robot.change_state('cleanup')
    assert robot.set_parameter('gravity', [0.0, 0.0, 0.0]).successful
    assert robot.change_state('configure')
    assert robot.change_state('activate')
    robot.wait_for_command(InverseDynamics(MODEL, (0.0, 0.0, 0.0)).efforts(Q, QD, 0.0 * Q))
    node.may_end = True
    assert robot.change_state('active_shutdown')
    assert robot.wait_for_end(node) == 0
    # A client on a busy machine would lose an answer if the node left at once.
    [*_, stopped] = re.findall(r'\[(\d+\.\d+)\] .*: stopped, zeros sent', node.output)
    assert time.time() - float(stopped) > 1.0
    robot.wait_for_command(np.zeros(6), tolerance=0.0)
    assert 'Traceback' not in node.output


def test_a_description_after_a_shutdown_is_ignored(run_node, robot):
    node = run_node()
    robot.wait_for_text(node, 'waiting for a robot description')
    node.may_end = True
    assert robot.change_state('unconfigured_shutdown')
    robot.publish_description(STANFORD.read_text())
    assert robot.wait_for_end(node) == 0
    assert 'Traceback' not in node.output


# Names


def test_topics_are_those_of_the_documentation(run_node, robot):
    """Names, types and quality of service; the middleware does not report the depth."""
    node = run_node(**PATIENT)
    robot.wait_for_text(node, 'no command yet')
    robot.wait_until(lambda: 'inverse_dynamics' in robot.node.get_node_names(), 'discovery')
    of_rclpy = {'/parameter_events', '/rosout', '/inverse_dynamics/transition_event'}
    page = (ROOT / 'doc' / 'interface.md').read_text()
    reads = robot.node
    for title, list_topics, describe in (
        (
            '## Subscribed topics',
            reads.get_subscriber_names_and_types_by_node,
            reads.get_subscriptions_info_by_topic,
        ),
        (
            '## Published topics',
            reads.get_publisher_names_and_types_by_node,
            reads.get_publishers_info_by_topic,
        ),
    ):
        table = page.split(title)[1].split('\n## ')[0]
        rows = re.findall(r'^\| `([\w~/]+)` \| (\w+)/(\w+) \| ([\w ,]+), \d+ \|', table, re.M)
        expected = {
            (
                f'/{name}'.replace('/~', '/inverse_dynamics').replace('//', '/'),
                f'{package}/msg/{kind}',
                quality,
            )
            for name, package, kind, quality in rows
        }
        assert expected

        def topics(list_topics=list_topics, describe=describe):
            names = {name for name, _ in list_topics('inverse_dynamics', '/')} - of_rclpy
            return {
                (name, each.topic_type, quality_of(each.qos_profile))
                for name in names
                if '/_action/' not in name  # of control_msgs, where it is installed
                for each in describe(name)
                if each.node_name == 'inverse_dynamics'
            }

        robot.wait_until(lambda topics=topics, rows=expected: topics() == rows, title)


def quality_of(profile):
    """Return the quality of service in the words of the documentation."""
    is_reliable = profile.reliability is ReliabilityPolicy.RELIABLE
    is_latched = profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
    words = 'reliable' if is_reliable else 'best effort'
    return f'{words}, transient local' if is_latched else words
