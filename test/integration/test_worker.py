"""Commands continue while the node reads and fills trajectories in a process of its own."""

import os
from pathlib import Path
import pickle
import signal

from builtin_interfaces.msg import Duration
from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Settings
from inverse_dynamics_node.node.trajectory_filler import fill
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from robot_side import HOLD, MODEL, NAMES, PATIENT, Q
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

OUT = 'inverse_dynamics/joint_trajectory_out'


def children(pid):
    """Return the child processes."""
    found = []
    for path in Path('/proc').glob('[0-9]*'):
        fields = status(path.name)
        if fields and int(fields[1]) == pid:
            found.append(int(path.name))
    return found


def status(pid):
    """Return the fields of the status of a process from the third one on, [] after its end."""
    try:
        fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    except OSError:
        return []
    return fields if fields[0] != 'Z' else []


def test_the_efforts_of_a_trajectory_have_the_scale_and_the_limits_of_the_commands():
    joints, scale = [NAMES[4], NAMES[1]], np.array([1.0, 3.0, 1.0, 1.0, -2.0, 1.0])
    limit = float(-2.0 * HOLD[4])
    settings = Settings(effort_scale=(-2.0, 3.0), effort_limits=(abs(limit), 1.0))
    filled = fill(ControlLoop(MODEL, joints, settings), serialize_message(trajectory(2)))
    points = deserialize_message(filled.data, JointTrajectory).points
    assert [list(point.effort) for point in points] == [pytest.approx(scale * HOLD)] * 2
    assert filled.beyond == [NAMES[1]]


def trajectory(points):
    return JointTrajectory(
        joint_names=NAMES,
        points=[
            JointTrajectoryPoint(positions=list(Q), time_from_start=Duration(sec=k))
            for k in range(points)
        ],
    )


def test_commands_continue_during_long_work(run_node, robot):
    node = run_node(**PATIENT)
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.wait_for_command(HOLD)
    (worker,) = children(node.process.pid)
    assert os.sched_getscheduler(worker) == os.SCHED_OTHER
    filled = robot.listen(JointTrajectory, OUT)
    robot.wait_until(lambda: robot.node.count_publishers(OUT), 'trajectories')

    os.kill(worker, signal.SIGSTOP)  # any work takes forever now
    sent = robot.keep_publishing('inverse_dynamics/joint_trajectory_in', trajectory(2))
    robot.wait_for_text(node, '10 trajectories are already queued')
    count = len(robot.commands)
    robot.wait_until(lambda: len(robot.commands) > count + 100, 'commands')
    robot.wait_for_command(HOLD)
    assert not filled
    os.kill(worker, signal.SIGCONT)
    message = robot.wait_for(filled, lambda _: True, 'trajectory')
    np.testing.assert_allclose(message.points[1].effort, HOLD, rtol=1e-9)

    robot.cease(sent)

    os.kill(worker, signal.SIGKILL)  # as the kernel does without memory
    robot.keep_publishing('inverse_dynamics/joint_trajectory_in', trajectory(3))
    robot.wait_for_text(node, 'dropped: the process that reads trajectories has ended')
    count = len(robot.commands)
    robot.wait_until(lambda: len(robot.commands) > count + 100, 'commands')
    robot.wait_for_command(HOLD)
    assert all(len(message.points) == 2 for message in filled)
    node.interrupt()
    assert robot.wait_for_end(node) == 0


def test_the_process_for_long_work_ends_with_the_node(run_node, robot):
    node = run_node(**PATIENT)
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.wait_for_command(HOLD)
    (worker,) = children(node.process.pid)
    node.process.kill()
    node.wait()
    robot.wait_until(lambda: not status(worker), 'end of the process')


WITHOUT_FORK = """
import os, sys
def refuse():
    raise BlockingIOError(11, 'Resource temporarily unavailable')
os.fork = refuse
from inverse_dynamics_node.node.main import main
sys.exit(main())
"""


def test_a_node_that_may_not_fork_drops_trajectories_and_keeps_commanding(run_node, robot):
    node = run_node(**PATIENT, program=('-c', WITHOUT_FORK))
    filled = robot.listen(JointTrajectory, OUT)
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.wait_for_command(HOLD)
    reason = (
        'cannot create the process that reads trajectories '
        '([Errno 11] Resource temporarily unavailable)'
    )
    assert f'warning: {reason}' in node.output
    robot.wait_until(lambda: robot.node.count_publishers(OUT), 'trajectories')
    robot.keep_publishing('inverse_dynamics/joint_trajectory_in', trajectory(2))
    robot.wait_for_text(node, f'dropped: {reason}')
    count = len(robot.commands)
    robot.wait_until(lambda: len(robot.commands) > count + 100, 'commands')
    robot.wait_for_command(HOLD)
    assert not filled
    node.interrupt()
    assert robot.wait_for_end(node) == 0


def test_pickled_dynamics_have_the_same_loads():
    dynamics = InverseDynamics(MODEL, gravity=(1.0, 2.0, -9.0))
    dynamics.set_payload(MODEL.link_names[-1], 1.5, (0.0, 0.1, 0.2), 0.1 * np.eye(3))
    dynamics.set_friction(np.full(6, 0.3), np.full(6, 0.2))
    copy = pickle.loads(pickle.dumps(dynamics))
    ours, theirs = (each.efforts(Q, Q, Q) for each in (dynamics, copy))
    np.testing.assert_array_equal(ours, theirs)
    assert abs(ours - InverseDynamics(MODEL).efforts(Q, Q, Q)).min() > 1e-3
    np.testing.assert_array_equal(copy.gravity, (1.0, 2.0, -9.0))
