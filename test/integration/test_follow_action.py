"""The action of the node, against control_msgs where it is installed."""

import signal

from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from node_process import PATIENCE
import numpy as np
import pytest
from robot_side import HOLD, NAMES, PATIENT, Q, ZERO
from test_joint_trajectory import TOPIC, trajectory

pytest.importorskip('control_msgs', reason='control_msgs is not on the Python package index')

from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action import ActionClient

Goal, Result = FollowJointTrajectory.Goal, FollowJointTrajectory.Result
NAME = 'inverse_dynamics/follow_joint_trajectory'
NEAR = trajectory([Q + 0.01], [0.6], NAMES)
SLOW = trajectory([Q + 0.01], [60.0], NAMES)
AGO = trajectory([Q], [1.0], NAMES)
AGO.header.stamp.sec = 1_000_000
MOVING = trajectory([Q, Q], [1.0, 2.0], NAMES)
for point in MOVING.points:
    point.velocities = [0.1] * 6


class Client:
    """A client of the action of a node that commands an arm at rest."""

    def __init__(self, run_node, robot):
        self.robot, self.feedback = robot, []
        robot.publish_state(NAMES, Q, ZERO)
        self.node = run_node(mode='computed_torque', **PATIENT)
        robot.wait_for_command(HOLD)
        self.client = ActionClient(robot.node, FollowJointTrajectory, NAME)
        robot.wait_until(self.client.server_is_ready, 'the action')

    def wait(self, future, what):
        self.robot.wait_until(future.done, what)
        return future.result()

    def send(self, goal):
        """Return the handle of a goal that has been accepted, and the future of its result."""
        future = self.client.send_goal_async(
            goal, lambda message: self.feedback.append(message.feedback)
        )
        handle = self.wait(future, 'answer')
        assert handle.accepted
        return handle, handle.get_result_async()


@pytest.fixture
def client(run_node, robot):
    found = Client(run_node, robot)
    yield found
    found.client.destroy()


def goal(message, path=0.0, end=0.0, patience=0, joint='joint_2'):
    return Goal(
        trajectory=message,
        path_tolerance=[JointTolerance(name=joint, position=path)],
        goal_tolerance=[JointTolerance(name=joint, position=end)],
        goal_time_tolerance=Duration(sec=patience),
    )


def test_each_goal_ends_with_its_code_and_reason(client):
    for request, code, text in (
        (goal(NEAR), Result.SUCCESSFUL, ''),
        (goal(NEAR, path=-1.0, end=0.02), Result.SUCCESSFUL, ''),
        (
            goal(NEAR, path=0.005),
            Result.PATH_TOLERANCE_VIOLATED,
            "the position of joint 'joint_2' is 0.01 rad off",
        ),
        (
            goal(NEAR, end=0.005, patience=1),
            Result.GOAL_TOLERANCE_VIOLATED,
            "the position of joint 'joint_2' is 0.01 rad off, tolerance 0.005 rad",
        ),
        (
            goal(trajectory([Q], [1.0], ['nope', *NAMES[1:]])),
            Result.INVALID_JOINTS,
            "joint 'nope' does not exist",
        ),
        (goal(NEAR, 0.1, joint='nope'), Result.INVALID_GOAL, "joint 'nope' does not exist"),
        (goal(AGO), Result.OLD_HEADER_TIMESTAMP, 'the trajectory ended '),
        (goal(MOVING), Result.INVALID_GOAL, "point 1: joint 'joint_1' moves at 0.1 rad/s"),
        (goal(trajectory([], [], NAMES)), Result.INVALID_GOAL, 'the trajectory has no points'),
        (
            goal(trajectory([Q[:1] + 2.0], [2.0], NAMES[:1])),
            Result.PATH_TOLERANCE_VIOLATED,
            'joint_1 is 0.5',
        ),
    ):
        _, future = client.send(request)
        found = client.wait(future, f'result {code}')
        is_well = code == Result.SUCCESSFUL
        status = GoalStatus.STATUS_SUCCEEDED if is_well else GoalStatus.STATUS_ABORTED
        assert (found.status, found.result.error_code) == (status, code), found
        assert found.result.error_string.startswith(text)
        assert bool(found.result.error_string) is not is_well


def test_goals_are_cancelled_and_preempted(client):
    first, cancelled = client.send(goal(SLOW))
    client.robot.wait_until(lambda: len(client.feedback) > 3, 'feedback')
    assert client.feedback[-1].joint_names == NAMES
    assert client.feedback[-1].actual.positions == pytest.approx(Q)
    error = np.subtract(client.feedback[-1].desired.positions, Q)
    assert client.feedback[-1].error.positions == pytest.approx(error)
    client.wait(first.cancel_goal_async(), 'answer of the cancellation')
    assert client.wait(cancelled, 'end').status == GoalStatus.STATUS_CANCELED

    _, preempted = client.send(goal(SLOW))
    client.feedback.clear()
    _, replaced = client.send(goal(SLOW))
    client.robot.wait_until(lambda: client.feedback, 'feedback of the second goal')
    found = client.wait(preempted, 'end of the first goal')
    assert found.status == GoalStatus.STATUS_ABORTED
    assert found.result.error_string == 'another goal has arrived'
    assert not replaced.done()
    client.robot.publish_once(TOPIC, NEAR)
    found = client.wait(replaced, 'end of the second goal')
    assert found.status == GoalStatus.STATUS_ABORTED
    assert found.result.error_string == 'another trajectory has arrived'


CLIENT = f"""
from control_msgs.action import FollowJointTrajectory
import rclpy
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectoryPoint
rclpy.init()
client = ActionClient(rclpy.create_node('client'), FollowJointTrajectory, '{NAME}')
client.wait_for_server()
goal = FollowJointTrajectory.Goal()
goal.trajectory.joint_names = {NAMES}
point = JointTrajectoryPoint(positions={(Q + 0.01).tolist()})
point.time_from_start.sec = 5
goal.trajectory.points = [point]
client.send_goal(goal)
"""


def test_a_goal_goes_on_without_its_client(client, run_program, wait_for_status):
    other = run_program('-c', CLIENT)
    wait_for_status('reference', b'\0', 'followed', 'trajectory', 'followed')
    other.send_signal(signal.SIGKILL)
    other.wait(PATIENCE)
    wait_for_status('reference', b'\0', 'followed', 'trajectory', 'held')
    client.node.interrupt()
    assert client.robot.wait_for_end(client.node) == 0
