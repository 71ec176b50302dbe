"""The node as a process: commands, invalid inputs, parameters and the life cycle."""

import math
import re
import signal
import subprocess
import threading
import time

from fork_server import SERVER
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.node.parameters import PARAMETERS
from inverse_dynamics_node.node.ros_parameters import _REMOVED
import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters
from robot_files import ROOT, STANFORD
from sensor_msgs.msg import JointState

MODEL = load_urdf(STANFORD)
DYNAMICS = InverseDynamics(MODEL)
NAMES = list(MODEL.joint_names)
Q = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
# So slow that positions that do not change do not contradict it within a second.
QD = 0.05 * np.array([0.1, -0.2, 0.05, 0.3, -0.1, 0.4])
QDD = np.array([0.5, 0.4, -0.3, 0.2, 0.1, -0.6])
HOLD = DYNAMICS.efforts(Q, QD, np.zeros(6))
FAST = {'robot_description_file': STANFORD, 'start_ramp': 0.0, 'stop_ramp': 0.2}
# With a time-out that a busy machine does not reach between two messages.
PATIENT = {**FAST, 'state_timeout': 5.0, 'reference_timeout': 5.0}


def publish_shuffled_state(robot):
    """Publish the state as drivers do: in another order, with other joints."""
    order = [4, 0, 3, 5, 1, 2]
    names = ['wheel', *(NAMES[k] for k in order), 'finger']
    robot.publish_state(names, [9.0, *Q[order], 7.0], [math.nan, *QD[order], 0.0])


def test_state_by_shuffled_names_gives_the_efforts_of_the_core(run_node, robot):
    run_node(**PATIENT)
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    robot.publish_accelerations(QDD)
    robot.wait_for_command(DYNAMICS.efforts(Q, QD, QDD))


def test_reference_by_names_adds_its_effort(run_node, robot):
    run_node(**PATIENT)
    publish_shuffled_state(robot)
    effort = np.arange(6.0)
    robot.publish_reference(NAMES[::-1], QDD[::-1], effort[::-1])
    robot.wait_for_command(DYNAMICS.efforts(Q, QD, QDD) + effort)


def test_a_subset_of_joints_is_commanded_in_the_requested_order(run_node, robot):
    joints = [NAMES[4], NAMES[1]]
    run_node(**PATIENT, joints=f'[{",".join(joints)}]', gravity='[0, 0, -5]')
    publish_shuffled_state(robot)
    robot.publish_accelerations([1.0, 2.0])
    qdd = np.array([0.0, 2.0, 0.0, 0.0, 1.0, 0.0])
    tau = InverseDynamics(MODEL, (0.0, 0.0, -5.0)).efforts(Q, QD, qdd)
    robot.wait_for_command([tau[4], tau[1]])


def test_an_incomplete_state_gives_no_command_and_names_the_missing_joint(run_node, robot):
    node = run_node(**PATIENT)
    robot.publish_state(NAMES[2:] + NAMES[:1], [0.1] * 5)
    robot.wait_for_text(node, f'waiting for the position of {NAMES[1]} on /joint_states')
    assert robot.commands == []


def test_a_state_may_be_split_over_several_messages(run_node, robot):
    node = run_node(**{**PATIENT, 'state_timeout': 60.0})
    robot.publish_state(NAMES[:2], Q[:2], QD[:2])
    robot.wait_for_text(node, f'waiting for the positions of {", ".join(NAMES[2:])} on')
    robot.publish_state(NAMES[2:], Q[2:], QD[2:])
    robot.wait_for_command(HOLD)


def test_nan_is_never_passed_on(run_node, robot):
    node = run_node(**PATIENT)
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    for bad in (math.nan, math.inf):
        robot.publish_accelerations([*QDD[:5], bad])
        robot.wait_for_text(node, f"acceleration of joint '{NAMES[5]}' is")
        robot.publish_reference(NAMES, QDD, [bad] * 6)
        robot.wait_for_text(node, f"effort of joint '{NAMES[0]}' is")
    robot.publish_state(NAMES, [math.inf, *Q[1:]], QD)
    robot.wait_for_text(node, f"position of joint '{NAMES[0]}' is inf")
    robot.publish_state(NAMES, [math.nan] * 6, [math.nan] * 6)
    count = len(robot.commands)
    publish_shuffled_state(robot)
    robot.wait_until(lambda: len(robot.commands) > count, 'another command')
    assert np.isfinite(robot.commands).all()
    assert {len(command) for command in robot.commands} == {6}


@pytest.mark.parametrize('locked', [False, True])
def test_an_arm_starts_and_goes_on_beside_a_gripper_whose_position_is_nan(run_node, robot, locked):
    parameters = {**PATIENT, 'joints': f'[{", ".join(NAMES[:5])}]'}
    if locked:
        parameters[f'locked_positions.{NAMES[5]}'] = Q[5]
    node = run_node(**parameters)
    zeros = np.zeros(5)
    if not locked:
        robot.publish_state(NAMES, Q, [*zeros, 0.0])
        robot.wait_for_command(DYNAMICS.gravity_efforts(Q)[:5])
    moved = [*(Q[:5] + 0.01), Q[5]]
    robot.publish_state(NAMES, [*moved[:5], math.nan], [*zeros, math.nan])
    robot.wait_for_command(DYNAMICS.gravity_efforts(moved)[:5])
    assert 'dropped' not in node.output


def test_bytes_that_are_not_a_joint_state_are_dropped_with_a_message(run_node, robot):
    node = run_node(**PATIENT)
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    robot.state = None
    # The subscription is best effort: a single message may be lost.
    robot._always = [(robot._states, b'\x00\x01\x00\x00' + b'\xff' * 40)]
    robot.wait_for_text(node, '44 bytes cannot be read as a JointState')
    robot._always = []
    count = len(robot.commands)
    publish_shuffled_state(robot)
    robot.wait_until(lambda: len(robot.commands) > count, 'another command')


def test_references_of_other_sizes_or_joints_are_dropped_with_a_message(run_node, robot):
    node = run_node(**PATIENT)
    publish_shuffled_state(robot)
    robot.publish_accelerations([1.0, 2.0])
    robot.wait_for_text(node, '2 acceleration values, expected 6')
    robot.publish_reference([*NAMES[:5], 'nose'], QDD)
    robot.wait_for_text(node, f'nose; expected {", ".join(NAMES)}')
    robot.publish_accelerations([])
    robot.wait_for_text(node, '0 acceleration values, expected 6')
    robot.wait_for_command(HOLD)


def test_reference_that_is_lost_leaves_the_arm_floating(run_node, robot):
    run_node(**{**PATIENT, 'reference_timeout': 0.5})
    publish_shuffled_state(robot)
    robot.publish_accelerations(QDD)
    robot.wait_for_command(DYNAMICS.efforts(Q, QD, QDD))
    robot._always = []
    robot.wait_for_command(HOLD)


@pytest.mark.parametrize(
    'update_rate',
    [0, pytest.param(2, marks=pytest.mark.long), pytest.param(250, marks=pytest.mark.long)],
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
    robot.wait_for_text(node, 'stopped, zeros sent: no joint state of ')
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize('update_rate', [0, 1000])
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


BAD_URDF = '<robot name="r"><link name="a"/><link name="a"/></robot>'


@pytest.mark.parametrize(
    ('parameters', 'words'),
    [
        ({'robot_description_file': '/nowhere.urdf'}, '/nowhere.urdf'),
        ({'robot_description': f"'{BAD_URDF}'"}, "duplicate link name 'a'"),
        (
            {'robot_description': 'arm.urdf'},
            "is 'arm.urdf', expected the URDF as XML text; for a file",
        ),
        ({**FAST, 'robot_description': f"'{BAD_URDF}'"}, 'are both set'),
        ({**FAST, 'joints': '[nose]'}, "joints lists 'nose'"),
        ({**FAST, 'joints': '3'}, "parameter 'joints' is 3, expected a list of names"),
        ({**FAST, 'update_rate': -1}, "parameter 'update_rate' is -1, expected 0 to 10000"),
        ({**FAST, 'update_rate': -1.0}, "parameter 'update_rate' is -1.0, expected 0 to 10000"),
        ({**FAST, 'update_rate': '.nan'}, "'update_rate' is nan, expected a finite number"),
        ({**FAST, 'update_rate': 1e-10}, 'expected 0 or at least 1'),
        ({**FAST, 'use_sim_time': 'soon'}, "of type 'STRING', expecting type 'BOOL'"),
        ({**FAST, 'state_timeout': 'soon'}, "'state_timeout' is 'soon', expected a finite number"),
        ({**FAST, 'gravity': '[0.0, -9.8]'}, "'gravity' is [0.0, -9.8], expected three finite"),
        ({**FAST, 'gravity': '[0.0, 0, -9.8]'}, 'Sequence should be of same type'),
        ({**FAST, 'use_urdf_effort_limits': 1}, 'is 1, expected true or false'),
    ],
)
def test_bad_start_ends_with_one_clear_message(run_node, parameters, words):
    node = run_node(**parameters)
    assert node.wait() != 0
    assert words in node.output
    assert 'Traceback' not in node.output
    assert node.output.count(words) == 1


def test_every_bad_parameter_has_a_line_of_its_own(run_node):
    wrong = {'kp': 'x', 'update_rate': -1.0, 'stop_ramp': 1e3}
    unknown = {'effort_limit': 30.0, 'locked_position.joint_6': 0.1}
    unknown |= {'locked_positions': 0.3, 'payload_transition_time': 0.5, 'zebra': 1}
    node = run_node(**{**FAST, **wrong}, **unknown)
    assert node.wait() == 1
    output = [line for line in node.output.splitlines() if 'is deprecated' not in line]  # Kilted
    lines = [line.split('[inverse_dynamics]: ')[1] for line in output]
    assert lines == [
        "parameter 'update_rate' is -1.0, expected 0 to 10000",
        "parameter 'kp' is 'x', expected a finite number, or a list with one number for each "
        'commanded joint',
        "parameter 'stop_ramp' is 1000.0, expected 0 to 60",
        "unknown parameter 'effort_limit'; did you mean 'effort_limits'?",
        "unknown parameter 'locked_position.joint_6'; did you mean 'locked_positions.joint_6'?",
        "unknown parameter 'locked_positions'; did you mean 'locked_positions.<joint>'?",
        "parameter 'payload_transition_time' was removed: a new payload is blended in over "
        'start_ramp',
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


def test_stop_ramp_that_launch_cuts_short_is_reported(run_node, robot):
    node = run_node(**{**FAST, 'stop_ramp': 5.0})
    robot.wait_for_text(node, 'stop_ramp is 5 s, but ros2 launch sends SIGTERM 5 s after SIGINT')
    robot.wait_for_text(node, "robot 'stanford'")
    assert robot.set_parameter('stop_ramp', 4.9).successful
    assert robot.change_state('deactivate')
    assert robot.change_state('cleanup')
    assert robot.change_state('configure')
    robot.wait_until(lambda: node.output.count("robot 'stanford'") == 2, 'configured again')
    assert node.output.count('sigterm_timeout') == 1


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


def test_configure_without_a_description_fails_with_a_message(run_node, robot):
    node = run_node(autostart=False)
    assert not robot.change_state('configure')
    robot.wait_for_text(node, 'no robot description')
    assert robot.get_state() == 'unconfigured'


def test_invalid_changes_of_parameters_are_rejected_with_a_reason(run_node, robot):
    run_node(**PATIENT)
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    for name, value, words in (
        ('update_rate', 100.0, 'deactivate and clean up the node first'),
        ('joints', None, "'joints' cannot be unset"),
        ('kp', [1.0, 2.0], 'kp has 2 numbers, expected one, or one for each of 6 joints'),
        ('mode', 'fast', "'fast', expected one of inverse_dynamics, computed_torque, gravity"),
        ('state_timeout', 0.0, 'out of range'),
        ('kp', [1.0, 1.0, 1.0, 1.0, 1.0, -1.0], '1.0, -1.0], expected at least 0'),
        ('kp', [2e9] * 6, 'expected at most 1e+09'),
        ('kp', '1e3', 'commanded joint; YAML reads 1e3 as text, write 1000.0'),
        ('effort_limit', 5.0, "unknown parameter 'effort_limit'; did you mean 'effort_limits'?"),
        ('locked_positions.hand', 0.0, "hand' can only be set when the process starts"),
        ('', 5.0, 'a parameter without a name'),
        ('autostart', False, 'read-only'),
    ):
        result = robot.set_parameter(name, value)
        assert not result.successful, (name, value)
        assert words in result.reason
        robot.commands.clear()
        robot.wait_for_command(HOLD)


def test_removed_parameters_are_refused_with_what_to_do_instead(run_node):
    node = run_node(**dict.fromkeys(_REMOVED, 1.0))
    assert node.wait() == 1
    for name, instead in _REMOVED.items():
        assert f"parameter '{name}' was removed: {instead}" in node.output


def test_parameters_that_are_read_at_the_start_cannot_change(run_node, robot):
    run_node()
    for name, value in (
        ('autostart', False),
        ('robot_description_file', 'another.urdf'),
        ('allow_unknown_parameters', True),
    ):
        result = robot.set_parameter(name, value)
        assert not result.successful
        assert 'read-only' in result.reason, name


def test_parameters_describe_their_ranges(run_node, robot):
    run_node()
    request = DescribeParameters.Request(names=list(PARAMETERS))
    answer = robot.call(DescribeParameters, 'describe_parameters', request)
    ranges = {d.name: d.floating_point_range or d.integer_range for d in answer.descriptors}
    for name, parameter in PARAMETERS.items():
        found = [(r.from_value, r.to_value) for r in ranges[name]]
        assert found == ([parameter.range] if parameter.range else []), name
    for name in ('kp', 'kd', 'effort_limits', 'effort_rate_limits', 'armature', 'stop_ramp'):
        assert ranges[name][0].from_value == 0.0, name
    assert robot.set_parameter('kp', 5).successful  # an integer
    assert robot.set_parameter('kp', [5.0, 6.0]).successful
    assert not robot.set_parameter('kp', -1).successful


def test_live_parameters_apply_at_once(run_node, robot):
    run_node(**PATIENT)
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    weightless = InverseDynamics(MODEL, (0.0, 0.0, 0.0)).efforts(Q, QD, 0.0 * Q)
    assert robot.set_parameter('include_gravity', False).successful
    robot.wait_for_command(weightless)
    assert robot.set_parameter('include_gravity', True).successful
    assert robot.set_parameter('effort_scale', [0.5, 1.0, 1.0, 1.0, 1.0, 2.0]).successful
    robot.wait_for_command(HOLD * [0.5, 1.0, 1.0, 1.0, 1.0, 2.0])
    assert robot.set_parameter('effort_limits', 1).successful
    robot.wait_for_command(np.clip(HOLD * [0.5, 1.0, 1.0, 1.0, 1.0, 2.0], -1.0, 1.0))


def test_computed_torque_drives_back_to_the_reference(run_node, robot):
    node = run_node(**PATIENT, mode='computed_torque', kp=50, kd=10)
    publish_shuffled_state(robot)
    q_ref, qd_ref = Q + 0.01, QD - 0.02
    robot.publish_reference(NAMES, QDD, positions=q_ref, velocities=qd_ref)
    qdd = QDD + 50.0 * (q_ref - Q) + 10.0 * (qd_ref - QD)
    robot.wait_for_command(DYNAMICS.efforts(Q, QD, qdd))
    assert robot.set_parameter('kd', 1e4).successful
    robot.wait_for_text(node, 'joint_1 may oscillate: with a delay of 5 ms, kd should be at most')


def test_joint_impedance_holds_the_arm_and_follows_the_reference(run_node, robot):
    node = run_node(**PATIENT, mode='joint_impedance', stiffness=50, impedance_damping=4)
    publish_shuffled_state(robot)
    robot.wait_for_text(node, 'holding position: no reference')
    robot.wait_for_command(HOLD - 4.0 * QD)
    moved = Q + 0.02
    robot.publish_state(NAMES, moved, QD)
    model = DYNAMICS.efforts(moved, QD, np.zeros(6))
    robot.wait_for_command(model + 50.0 * (Q - moved) - 4.0 * QD)
    assert robot.set_parameter('stiffness', [50.0, 50.0, 50.0, 0.0, 0.0, 0.0]).successful
    stiffness = np.array([50.0, 50.0, 50.0, 0.0, 0.0, 0.0])
    robot.wait_for_command(model + stiffness * (Q - moved) - 4.0 * QD)
    q_ref, qd_ref = Q + 0.05, QD - 0.02
    robot.publish_reference(NAMES, QDD, positions=q_ref, velocities=qd_ref)
    model = DYNAMICS.efforts(moved, QD, QDD)
    robot.wait_for_command(model + stiffness * (q_ref - moved) + 4.0 * (qd_ref - QD))


def test_friction_and_armature_are_added_on_request(run_node, robot):
    run_node(**PATIENT, include_friction=True, damping=2, coulomb=0.5, armature=0.3)
    publish_shuffled_state(robot)
    robot.publish_accelerations(QDD)
    own = 2.0 * QD + 0.5 * np.tanh(QD / 0.01) + 0.3 * QDD
    robot.wait_for_command(DYNAMICS.efforts(Q, QD, QDD) + own)


def test_joint_efforts_contain_names_and_efforts_only(run_node, robot):
    run_node(**PATIENT)
    publish_shuffled_state(robot)
    robot.listen_to_joint_efforts()
    message = robot.wait_for(
        robot.joint_efforts,
        lambda message: list(message.effort) == pytest.approx(HOLD.tolist()),
        'joint efforts',
    )
    assert list(message.name) == NAMES
    assert len(message.position) == len(message.velocity) == 0
    assert message.header.stamp.sec > 0


def test_complete_commands_contain_the_motion_of_the_reference(run_node, robot):
    run_node(**PATIENT)
    publish_shuffled_state(robot)
    heard = robot.listen(JointState, 'inverse_dynamics/joint_commands')

    def wait_for(position, velocity, effort):
        expected = [*position, *velocity, *effort]
        return robot.wait_for(
            heard,
            lambda m: [*m.position, *m.velocity, *m.effort] == pytest.approx(expected),
            'a complete command',
        )

    message = wait_for(Q, QD, HOLD)
    assert list(message.name) == NAMES
    assert message.header.stamp.sec > 0
    target, speed = Q + 0.1, QD - 0.2
    robot.publish_reference(NAMES, QDD, positions=target, velocities=speed)
    wait_for(target, speed, DYNAMICS.efforts(Q, QD, QDD))


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


def test_topics_can_be_remapped_and_put_into_a_namespace(run_node, robot):
    node = run_node(
        '-r',
        '__ns:=/left',
        '-r',
        'joint_states:=/joint_states',
        '-r',
        '~/commands:=/inverse_dynamics/commands',
        **PATIENT,
    )
    publish_shuffled_state(robot)
    robot.wait_for_command(HOLD)
    topic = '/left/inverse_dynamics/desired_accelerations'
    robot.wait_until(lambda: robot.node.count_subscribers(topic), topic)
    node.interrupt()
    assert robot.wait_for_end(node) == 0


def test_topics_are_those_of_the_documentation(run_node, robot):
    node = run_node(**PATIENT)
    robot.wait_for_text(node, 'no command yet')
    robot.wait_until(lambda: 'inverse_dynamics' in robot.node.get_node_names(), 'discovery')
    of_rclpy = {'/parameter_events', '/rosout', '/inverse_dynamics/transition_event'}
    page = (ROOT / 'doc' / 'interface.md').read_text()
    for title, list_topics in (
        ('## Subscribed topics', robot.node.get_subscriber_names_and_types_by_node),
        ('## Published topics', robot.node.get_publisher_names_and_types_by_node),
    ):
        table = page.split(title)[1].split('\n## ')[0]
        rows = re.findall(r'^\| `([\w~/]+)` \| (\w+)/(\w+) \|', table, re.M)
        expected = {
            (
                f'/{name}'.replace('/~', '/inverse_dynamics').replace('//', '/'),
                f'{package}/msg/{kind}',
            )
            for name, package, kind in rows
        }
        assert expected

        def topics(list_topics=list_topics):
            pairs = list_topics('inverse_dynamics', '/')
            return {(name, types[0]) for name, types in pairs if name not in of_rclpy}

        robot.wait_until(lambda topics=topics, rows=expected: topics() == rows, title)
