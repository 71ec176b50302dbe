"""Loads, motion of the base, optional topics, locked joints and services."""

import math
import re
import time

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import (
    Inertia,
    InertiaStamped,
    Vector3,
    Vector3Stamped,
    Wrench,
    WrenchStamped,
)
from inverse_dynamics_node import InverseDynamics
import numpy as np
import pytest
from robot_files import ROOT
from robot_side import MODEL, NAMES, PATIENT, Q, QD, QDD, ZERO
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

TIP = MODEL.link_names[-1]
OWN = 'inverse_dynamics'


@pytest.fixture
def dynamics():
    return InverseDynamics(MODEL)


def vector3(values):
    return Vector3(**dict(zip('xyz', map(float, values), strict=True)))


def stamped(kind, link, **fields):
    return kind(header=Header(frame_id=link), **fields)


def payload(link, mass, com=(0.0, 0.0, 0.0), moments=(0.0, 0.0, 0.0)):
    body = Inertia(m=mass, com=vector3(com))
    body.ixx, body.iyy, body.izz = moments
    return stamped(InertiaStamped, link, inertia=body)


def imu(specific_force, angular_velocity=(0.0, 0.0, 0.0)):
    return Imu(
        linear_acceleration=vector3(specific_force), angular_velocity=vector3(angular_velocity)
    )


def trajectory(points):
    message = JointTrajectory(header=Header(frame_id='plan'), joint_names=NAMES[::-1])
    for at, *rows in points:
        point = JointTrajectoryPoint(time_from_start=Duration(sec=int(at), nanosec=500_000_000))
        for name, row in zip(('positions', 'velocities', 'accelerations'), rows, strict=False):
            setattr(point, name, list(row[::-1]))
        message.points.append(point)
    return message


WILD = trajectory([(0, Q), (1, Q)])
for point, sign in zip(WILD.points, (1.0, -1.0), strict=True):
    point.positions = [sign * 1e308] * 6
    point.time_from_start = Duration(nanosec=point.time_from_start.sec)

UNMEASURED = imu((0.0, 0.0, 9.8))
UNMEASURED.angular_velocity_covariance[0] = -1.0


def assert_not_above_the_ramp(robot, since, before, after, ramp):
    """Assert that no command is ahead of a ramp; on a busy machine, commands arrive late."""
    way = after - before
    fractions = (np.array(robot.commands) - before) @ way / (way @ way)
    times = np.array(robot.command_times)
    assert (fractions < 0.2 + np.maximum(times - since, 0.0) / ramp)[times > since].all()


# Loads and bases


def test_loads_on_topics_are_compensated_until_they_end(run_node, robot, dynamics):
    node = run_node(**PATIENT, wrench_timeout=1.0)
    robot.publish_state(NAMES, Q, QD)
    before = dynamics.efforts(Q, QD, ZERO)
    robot.wait_for_command(before)
    com, moments = (0.02, 0.0, 0.1), (0.01, 0.02, 0.015)
    dynamics.set_payload(TIP, 1.5, com, np.diag(moments))
    robot.publish_once(f'{OWN}/payload', payload(TIP, 1.5, com, moments))
    robot.wait_for_command(dynamics.efforts(Q, QD, ZERO))
    robot.publish_once(f'{OWN}/payload', payload(TIP, 0.0))
    robot.wait_for_command(before)
    dynamics.set_payload(TIP, 0.0)
    force, moment = (3.0, -2.0, -10.0), (0.1, 0.2, -0.3)
    wrench = Wrench(force=vector3(force), torque=vector3(moment))
    pushing = robot.keep_publishing(
        f'{OWN}/external_wrench', stamped(WrenchStamped, TIP, wrench=wrench)
    )
    dynamics.set_external_wrench(TIP, force, moment)
    robot.wait_for_command(dynamics.efforts(Q, QD, ZERO))
    robot.cease(pushing)
    robot.wait_for_command(before)
    text = (
        '~/external_wrench: force 3, -2, -10 N and moment 0.1, 0.2, -0.3 N m act on link '
        f"'{TIP}' until 1 s after the last message"
    )
    robot.wait_for_text(node, text)
    assert node.output.count(text) == 1
    assert f"~/payload: payload of 1.5 kg on link '{TIP}'" in node.output
    assert f"~/payload: payload on link '{TIP}' removed" in node.output


def test_gravity_follows_the_topic(run_node, robot, dynamics):
    node = run_node(**PATIENT)
    robot.publish_state(NAMES, Q, QD)
    message = stamped(Vector3Stamped, 'hand', vector=vector3((1.0, 2.0, -9.0)))
    drop_with_reason(robot, node, [('gravity', message, "frame_id is 'hand', expected the base")])
    message.header.frame_id = ''
    for z, words in (
        (-9.0, "[INFO] ~/gravity: 1, 2, -9 m/s^2 in the frame of 'base_link'\n"),
        (
            9.0,
            "[WARN] ~/gravity: 1, 2, 9 m/s^2 in the frame of 'base_link' points against the "
            'parameter gravity (0, 0, -9.81); expected the free-fall acceleration',
        ),
    ):
        message.vector.z = z
        robot.publish_once(f'{OWN}/gravity', message)
        dynamics.set_gravity((1.0, 2.0, z))
        robot.wait_for_command(dynamics.efforts(Q, QD, ZERO))
        level, text = words.split(' ', 1)
        robot.wait_for_text(node, text)
        assert level in node.output.partition(text)[0].splitlines()[-1]


def test_the_imu_replaces_gravity_in_every_orientation_until_it_is_lost(run_node, robot, dynamics):
    node = run_node(
        **PATIENT,
        base_motion='imu',
        imu_orientation=f'[0.0, 0.0, {math.pi / 2}]',
    )
    robot.publish_state(NAMES, Q, QD)
    robot.wait_for_text(node, 'waiting for the motion of the base on /imu')  # and nothing else
    assert not robot.commands
    # The sensor's x is the base's y.
    measuring = robot.keep_publishing('imu', imu((4.0, -1.0, 9.0), (0.3, -0.1, 0.2)))
    dynamics.set_gravity((-1.0, -4.0, -9.0))
    dynamics.set_base_motion((0.1, 0.3, 0.2))
    robot.wait_for_command(dynamics.efforts(Q, QD, ZERO), tolerance=1e-6)
    assert 'frame_id' not in node.output
    measuring[1].header.frame_id = 'base_link'
    words = 'in the robot description differs from imu_orientation by 90 degrees'
    robot.wait_for_text(node, words)
    robot.cease(measuring)
    dynamics.set_base_motion((0.0, 0.0, 0.0))
    robot.wait_for_command(dynamics.efforts(Q, QD, ZERO), tolerance=1e-6)
    robot.wait_for_text(node, 'the motion of the base is unknown: no message on imu for more')
    unmeasured = 'the covariance says that angular velocity is not measured'
    gravity = stamped(Vector3Stamped, '', vector=Vector3(z=-9.8))
    cases = [
        ('/imu', imu((math.nan, 0.0, 0.0)), 'specific force is'),
        ('gravity', gravity, 'the IMU measures gravity'),
        ('/imu', UNMEASURED, unmeasured),
    ]
    drop_with_reason(robot, node, cases)
    robot.keep_publishing('imu', imu((4.0, -1.0, 9.0)))
    robot.wait_for_text(node, 'solved: the motion of the base is unknown')


def drop_with_reason(robot, node, cases):
    """Publish each message until the node has logged why it drops it."""
    for topic, message, words in cases:
        name = topic if topic.startswith('/') else f'{OWN}/{topic}'
        publication = robot.keep_publishing(name, message)
        robot.wait_for_text(node, f'message dropped: {words}')
        robot.cease(publication)


def test_invalid_messages_are_dropped_with_a_reason(run_node, robot, dynamics):
    node = run_node(**PATIENT)
    robot.publish_state(NAMES, Q, QD)
    path = trajectory([(0, Q)])
    no_subscriber = '~/joint_trajectory_out has no subscriber'
    drop_with_reason(robot, node, [('joint_trajectory_in', path, no_subscriber)])
    robot.listen(JointTrajectory, f'{OWN}/joint_trajectory_out')
    infinite = stamped(WrenchStamped, TIP, wrench=Wrench(force=Vector3(x=math.inf)))
    cases = [
        ('payload', payload('nope', 1.0), "link 'nope' does not exist; links are base_link"),
        ('payload', payload(TIP, -1.0), 'mass is -1.0'),
        ('external_wrench', infinite, 'force is'),
        ('gravity', Vector3Stamped(vector=Vector3(z=-101.0)), 'gravity is [0.0, 0.0, -101.0]'),
        ('joint_trajectory_in', JointTrajectory(joint_names=NAMES), 'there are no positions'),
        ('joint_trajectory_in', WILD, 'the spline overflows: points are too far apart'),
    ]
    drop_with_reason(robot, node, cases)
    robot.wait_for_command(dynamics.efforts(Q, QD, ZERO))


# Optional topics


def test_external_efforts_are_published_while_efforts_are_measured(run_node, robot, dynamics):
    run_node(**PATIENT)
    # They would overflow, but they are not computed without a subscriber.
    robot.publish_state(NAMES, Q, QD, np.full(6, 1e308))
    robot.wait_for_command(dynamics.efforts(Q, QD, ZERO))
    push = np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    measured = dynamics.efforts(Q, ZERO, ZERO) + push
    measured[4] = math.nan
    robot.publish_state([*NAMES, 'wheel'], [*Q, 0.0], np.zeros(7), [*measured, 5.0])
    robot.wait_for_command(dynamics.efforts(Q, ZERO, ZERO))
    heard = robot.listen(JointState, f'{OWN}/external_efforts')
    expected = pytest.approx(list(np.delete(push, 4)), abs=1e-6)
    message = robot.wait_for(heard, lambda m: list(m.effort) == expected, 'external efforts')
    assert list(message.name) == NAMES[:4] + NAMES[5:]
    robot.publish_state(NAMES, Q, ZERO)
    last = [len(robot.commands)]

    def is_silent():
        if heard:  # sent before
            heard.clear()
            last[0] = len(robot.commands)
        return len(robot.commands) > last[0] + 40

    robot.wait_until(is_silent, '40 commands in a row without external efforts')


def test_the_wrench_on_the_tool_is_published_with_the_sign_of_the_external_wrench(run_node, robot):
    run_node(**PATIENT)
    pushed = InverseDynamics(MODEL)
    pushed.set_external_wrench('tool0', (5.0, -3.0, 8.0), (0.5, 0.2, -0.4))
    robot.publish_state(NAMES, Q, ZERO, pushed.efforts(Q, ZERO, ZERO))
    heard = robot.listen(WrenchStamped, f'{OWN}/tool_wrench')

    def is_found(message):
        force, moment = message.wrench.force, message.wrench.torque
        found = force.x, force.y, force.z, moment.x, moment.y, moment.z
        return found == pytest.approx((5.0, -3.0, 8.0, 0.5, 0.2, -0.4), abs=1e-3)

    assert robot.wait_for(heard, is_found, 'the wrench').header.frame_id == 'tool0'


def test_external_efforts_follow_the_parameters_of_the_driver(run_node, robot, dynamics):
    sign = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    held = dynamics.gravity_efforts(Q)
    settings = {'include_gravity': False, 'measured_effort_scale': sign.tolist()}
    run_node(**PATIENT, **settings, measured_gravity='included')
    heard = robot.listen(JointState, f'{OWN}/external_efforts')
    robot.publish_state(NAMES, Q, ZERO, sign * held)

    def wait_for_external_efforts(expected):
        near = pytest.approx(list(expected), abs=1e-6)
        robot.wait_for(heard, lambda m: list(m.effort) == near, 'external efforts')

    wait_for_external_efforts(ZERO)
    assert robot.set_parameter('measured_gravity', 'as_commanded').successful
    wait_for_external_efforts(held)
    assert robot.set_parameter('measured_effort_scale', (-sign).tolist()).successful
    wait_for_external_efforts(-held)


def test_trajectories_are_filled_with_efforts_also_while_inactive(run_node, robot, dynamics):
    node = run_node(**PATIENT, autostart=False)
    robot.wait_until(lambda: robot.change_state('configure'), 'configured')
    heard = robot.listen(JointTrajectory, f'{OWN}/joint_trajectory_out')
    states = [(Q, QD, QDD), (Q + 0.1, -QD, QDD), (Q - 0.1, QD, -QDD)]
    sent = trajectory([(k, *state) for k, state in enumerate(states)])
    sending = robot.keep_publishing(f'{OWN}/joint_trajectory_in', sent)
    message = robot.wait_for(heard, lambda _: True, 'trajectory')
    assert message.header.frame_id == 'plan'
    assert list(message.joint_names) == NAMES[::-1]
    for point, given, state in zip(message.points, sent.points, states, strict=True):
        assert list(point.effort)[::-1] == pytest.approx(list(dynamics.efforts(*state)))
        assert point.positions == given.positions
        assert point.time_from_start == given.time_from_start
    assert 'derived' not in node.output
    robot.cease(sending)
    sent = trajectory([(k, Q + 0.1 * k) for k in range(4)])
    robot.keep_publishing(f'{OWN}/joint_trajectory_in', sent)
    message = robot.wait_for(heard, lambda m: len(m.points) == 4, 'trajectory')
    robot.wait_for_text(node, 'accelerations derived from a cubic spline')
    for point in message.points:
        state = [list(x)[::-1] for x in (point.positions, point.velocities, point.accelerations)]
        assert list(point.effort)[::-1] == pytest.approx(list(dynamics.efforts(*state)))
    assert np.abs(message.points[1].velocities).max() > 0.05
    assert robot.change_state('activate')
    words = 'bytes, expected at most 1000000 while the node is active'
    long = trajectory([(k, Q) for k in range(15000)])
    topic = f'{OWN}/joint_trajectory_in'
    robot.publish_until(lambda: words in node.output, words, topic, long)


# Joints and links that are not commanded


def test_a_joint_that_is_never_reported_uses_its_locked_position(run_node, robot, dynamics):
    locked = {f'locked_positions.{NAMES[5]}': 0.2, f'locked_positions.{NAMES[2]}': 0.5}
    joints = [NAMES[k] for k in (0, 1, 3, 4)]
    node = run_node(**PATIENT, **locked, joints=f'[{", ".join(joints)}]')
    robot.publish_state(joints, Q[[0, 1, 3, 4]], QD[[0, 1, 3, 4]])
    still = QD * [1, 1, 0, 1, 1, 0]
    robot.wait_for_command(dynamics.efforts(Q, still, ZERO)[[0, 1, 3, 4]])
    robot.wait_for_text(node, f"'{NAMES[2]}' is not reported; its locked position is used")
    heard = robot.listen(JointState, f'{OWN}/external_efforts')
    push = np.array([1.0, -2.0, 0.1, 0.2])
    measured = dynamics.efforts(Q, ZERO, ZERO)[[0, 1, 3, 4]] + push
    robot.publish_state(joints, Q[[0, 1, 3, 4]], np.zeros(4), measured)
    expected = pytest.approx(list(push), abs=1e-6)
    message = robot.wait_for(heard, lambda m: list(m.effort) == expected, 'external efforts')
    assert list(message.name) == joints
    seen = [0, 1, 3, 4, 2]
    elsewhere = Q.copy()
    elsewhere[2] = 0.6
    robot.publish_state([*joints, NAMES[2]], elsewhere[seen], still[seen])
    robot.wait_for_command(dynamics.efforts(elsewhere, still, ZERO)[[0, 1, 3, 4]])


# Services


def test_enable_ramps_down_and_up(run_node, robot, dynamics):
    node = run_node(**{**PATIENT, 'start_ramp': 0.5})
    robot.publish_state(NAMES, Q, QD)
    hold = dynamics.efforts(Q, QD, ZERO)
    robot.wait_for_command(hold)
    answer = robot.call(SetBool, 'enable', SetBool.Request(data=False))
    assert answer.success
    robot.wait_for_command(ZERO)
    k = len(robot.commands)
    robot.wait_until(lambda: len(robot.commands) > k + 20, 'zeros that continue')
    assert not np.any(robot.commands[k:])
    since = time.monotonic()
    robot.call(SetBool, 'enable', SetBool.Request(data=True))
    robot.wait_for_command(hold)
    assert_not_above_the_ramp(robot, since, ZERO, hold, 0.5)
    assert node.process.poll() is None


def test_check_model_reports_the_robot_and_its_holding_efforts(run_node, robot, dynamics):
    node = run_node(**PATIENT, joints=f'[{", ".join(NAMES[::-1])}]')
    robot.wait_for_text(node, 'no command yet')
    answer = robot.call(Trigger, 'check_model', Trigger.Request())
    assert answer.success
    text = f'not known yet: waiting for the positions of {", ".join(NAMES)} on joint_states.'
    assert text in answer.message
    robot.publish_state(NAMES, Q, QD)
    robot.wait_for_command(dynamics.efforts(Q, QD, ZERO)[::-1])
    lines = robot.call(Trigger, 'check_model', Trigger.Request()).message.splitlines()
    effort = f'{dynamics.gravity_efforts(Q)[2]:.2f}'
    assert any(NAMES[2] in line and f'{Q[2]:.4f}' in line and effort in line for line in lines)
    assert max(map(len, lines)) <= 100


def test_services_are_those_of_the_documentation_and_need_a_robot(run_node, robot):
    run_node(autostart=False)
    answer = robot.call(SetBool, 'enable', SetBool.Request(data=True))
    assert (answer.success, answer.message) == (False, 'the node is not active')
    answer = robot.call(Trigger, 'check_model', Trigger.Request())
    assert (answer.success, answer.message) == (False, 'the node is not configured')
    page = (ROOT / 'doc' / 'interface.md').read_text().split('## Services')[1].split('\n## ')[0]
    rows = re.findall(r'^\| `~/(\w+)` \| (\w+)/(\w+) \|', page, re.M)
    expected = {(f'/{OWN}/{name}', f'{package}/srv/{kind}') for name, package, kind in rows}

    def services():
        if OWN not in robot.node.get_node_names():
            return set()
        pairs = robot.node.get_service_names_and_types_by_node(OWN, '/')
        return {(name, types[0]) for name, types in pairs if types[0].startswith('std_srvs')}

    robot.wait_until(lambda: services() == expected, 'services')
