"""The node, as a process, leads a simulated arm along trajectories."""

import os
import signal

from builtin_interfaces.msg import Duration
from inverse_dynamics_node import load_urdf
import numpy as np
import pytest
from robot_files import ROOT
from robot_side import HOLD, NAMES, PATIENT, Q, ZERO
from sensor_msgs.msg import JointState
from test_worker import children
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

ARM = ROOT / 'test/robots/seven_dof.urdf'
JOINTS = list(load_urdf(ARM).joint_names)
TOPIC = 'inverse_dynamics/joint_trajectory'
CLOSE = 2e-3  # [rad]


def trajectory(positions, seconds, joints=JOINTS, stamp=None):
    message = JointTrajectory(joint_names=joints)
    if stamp is not None:
        message.header.stamp = stamp
    for row, time in zip(positions, seconds, strict=True):
        second, fraction = divmod(time, 1.0)
        when = Duration(sec=int(second), nanosec=int(1e9 * fraction))
        message.points.append(JointTrajectoryPoint(positions=list(row), time_from_start=when))
    return message


@pytest.mark.real_time
def test_a_trajectory_is_followed_replaced_in_motion_and_held(drive_arm, robot, wait_for_status):
    pytest.importorskip('mujoco')
    states = robot.listen(JointState, 'joint_states')
    settings = {'reference_timeout': 0.1, 'state_timeout': 1.0, 'start_ramp': 0.1}
    node = drive_arm(ARM, mode='computed_torque', **settings)

    def positions():
        return np.array([states[-1].position[states[-1].name.index(name)] for name in JOINTS])

    start = positions()
    robot.publish_once(TOPIC, trajectory([start + 0.5], [2.0]))
    robot.wait_until(lambda: (positions() > start + 0.1).all(), 'motion')
    del robot.commands[:-1]
    robot.publish_once(TOPIC, trajectory([start + 0.3, start - 0.2], [1.0, 3.0]))
    robot.wait_until(lambda: (positions() < start - 0.1).all(), 'the other way')
    # A part of the joints, for which two of four seconds have passed.
    stamp = (robot.node.get_clock().now()).to_msg()
    stamp.sec -= 2
    target, others = start[:2], positions()[2:]
    path = [start[:2] - 0.2, target]
    robot.publish_once(TOPIC, trajectory(path, [0.0, 4.0], JOINTS[:2], stamp))
    robot.wait_for_text(node, 'a trajectory of 2 points begins, which lasts 2 s')
    values = wait_for_status('reference', b'\0', 'followed', 'trajectory', 'held')
    assert float(values['trajectory largest error [rad, m]']) < 0.1
    assert values['trajectory progress [%]'] == '100'
    assert positions()[:2] == pytest.approx(target, abs=CLOSE)
    assert positions()[2:] == pytest.approx(others, abs=0.3)
    jumps = np.abs(np.diff(robot.commands, axis=0)).max(axis=0)
    assert (jumps < 0.3 * np.ptp(robot.commands, axis=0)).all()
    resting, count = positions(), len(robot.commands)
    robot.wait_until(lambda: len(robot.commands) > count + 300, 'commands')
    assert positions() == pytest.approx(resting, abs=CLOSE)
    assert 'stopped' not in node.output


def test_a_message_that_cannot_be_followed_is_dropped_with_its_reason(run_node, robot):
    robot.publish_state(NAMES, Q, ZERO)
    node = run_node(mode='computed_torque', **PATIENT)
    robot.wait_for_command(HOLD)
    for message, reason in (
        (trajectory([Q], [1.0], ['nope', *NAMES[1:]]), "joint 'nope' does not exist; joints are"),
        (
            trajectory([Q[:1] + 0.6], [0.0], NAMES[:1]),
            "joint 'joint_1' is 0.6 rad from the trajectory",
        ),
    ):
        publishing = robot.keep_publishing(TOPIC, message)
        robot.wait_for_text(node, f'~/joint_trajectory: message dropped: {reason}')
        robot.cease(publishing)
    robot.wait_for_command(HOLD)


def test_commands_continue_while_a_long_trajectory_is_read_and_an_empty_one_is_quicker(
    run_node, robot, wait_for_status
):
    robot.publish_state(NAMES, Q, ZERO)
    node = run_node(mode='computed_torque', **PATIENT)
    robot.wait_for_command(HOLD)
    (worker,) = children(node.process.pid)
    long = trajectory([Q] * 10_000, 0.01 * np.arange(1.0, 10_001.0), NAMES)
    for messages, text in (
        ([long, JointTrajectory()], 'dropped: another message or a stop has come before'),
        ([long], 'a trajectory of 10001 points begins, which lasts 100 s'),
    ):
        os.kill(worker, signal.SIGSTOP)  # any work takes forever now
        for message in messages:
            robot.publish_once(TOPIC, message)
            count = len(robot.commands)  # only the latest message is kept until it is read
            robot.wait_until(lambda count=count: len(robot.commands) > count + 100, 'commands')
        os.kill(worker, signal.SIGCONT)
        robot.wait_for_text(node, text)
    robot.wait_for_command(HOLD)
    wait_for_status('reference', b'\0', 'followed', 'trajectory', 'followed')


def test_after_a_suspension_the_arm_is_held_where_it_is_found(run_node, robot, wait_for_status):
    robot.publish_state(NAMES, Q, ZERO)
    node = run_node(mode='computed_torque', **PATIENT)
    robot.wait_for_command(HOLD)
    robot.publish_once(TOPIC, trajectory([Q + 0.05], [60.0], NAMES))
    wait_for_status('reference', b'\0', 'followed', 'trajectory', 'followed')
    node.interrupt(signal.SIGSTOP)
    sent = robot.sent
    robot.wait_until(lambda: robot.sent > sent + 100, 'a second')
    node.interrupt(signal.SIGCONT)
    wait_for_status('reference', b'\0', 'followed', 'trajectory', 'held: there was no joint state')
    robot.wait_for_command(HOLD)
