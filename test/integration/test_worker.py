"""Commands continue while the node does long tasks in a process of its own."""

import os
from pathlib import Path
import pickle
import signal
import threading
import time

from builtin_interfaces.msg import Duration
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.node import description_file
from inverse_dynamics_node.node.worker import Worker
from node_process import PATIENCE
import numpy as np
from robot_files import STANFORD
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

MODEL = load_urdf(STANFORD)
NAMES = list(MODEL.joint_names)
Q = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
HOLD = InverseDynamics(MODEL).gravity_efforts(Q)
PATIENT = {'start_ramp': 0.0, 'stop_ramp': 0.2, 'state_timeout': 5.0}
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
    robot.publish_description(STANFORD.read_text())
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.wait_for_command(HOLD)
    (worker,) = children(node.process.pid)
    assert os.sched_getscheduler(worker) == os.SCHED_OTHER
    filled = robot.listen(JointTrajectory, OUT)
    robot.wait_until(lambda: robot.node.count_publishers(OUT), 'trajectories')

    os.kill(worker, signal.SIGSTOP)  # any work takes forever now
    sent = robot.keep_publishing('inverse_dynamics/joint_trajectory_in', trajectory(2))
    robot.wait_for_text(node, '10 trajectories are already queued')
    robot.publish_again(STANFORD.read_text() + '<!-- new -->')
    robot.wait_for_text(node, 'received a new robot description')
    count = len(robot.commands)
    robot.wait_until(lambda: len(robot.commands) > count + 100, 'commands')
    robot.wait_for_command(HOLD)
    assert not filled
    assert node.output.count("robot 'stanford'") == 1
    os.kill(worker, signal.SIGCONT)
    robot.wait_until(lambda: node.output.count("robot 'stanford'") == 2, 'description in use')
    message = robot.wait_for(filled, lambda _: True, 'trajectory')
    np.testing.assert_allclose(message.points[1].effort, HOLD, rtol=1e-9)

    robot.cease(sent)

    os.kill(worker, signal.SIGKILL)  # as the kernel does without memory; a thread replaces it
    robot.keep_publishing('inverse_dynamics/joint_trajectory_in', trajectory(3))
    message = robot.wait_for(filled, lambda message: len(message.points) == 3, 'trajectory')
    np.testing.assert_allclose(message.points[2].effort, HOLD, rtol=1e-9)
    robot.wait_for_command(HOLD)
    node.interrupt()
    assert robot.wait_for_end(node) == 0


def test_the_process_for_long_work_ends_with_the_node(run_node, robot):
    node = run_node(**PATIENT, robot_description_file=STANFORD)
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.wait_for_command(HOLD)
    (worker,) = children(node.process.pid)
    node.process.kill()
    node.wait()
    robot.wait_until(lambda: not status(worker), 'end of the process')


READ, MAY_END = [], threading.Event()


def read_slowly(configuration, description):
    READ.append(description)
    MAY_END.wait(PATIENCE)


def test_superseded_descriptions_are_not_read(monkeypatch):
    monkeypatch.setattr(description_file, 'load_robot', read_slowly)
    loader = description_file.DescriptionLoader(Worker())
    for k in range(50):
        loader.load(None, k)
    MAY_END.set()
    deadline = time.monotonic() + PATIENCE
    while not loader.poll():
        assert time.monotonic() < deadline
    assert READ == [0, 49]


def test_a_huge_description_does_not_delay_the_next_one(run_node, robot):
    node = run_node(**PATIENT)
    text = STANFORD.read_text()
    robot.publish_description(text)
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.wait_for_command(HOLD)
    links = ''.join(
        f'<link name="x{k}"/><joint name="y{k}" type="fixed"><parent link="base_link"/>'
        f'<child link="x{k}"/></joint>'
        for k in range(60_000)
    )
    robot.publish_again(text.replace('</robot>', f'{links}</robot>'))
    robot.wait_for_text(node, 'links, expected at most 1000')
    robot.publish_again(text.replace('"stanford"', '"next"'))
    robot.wait_for_text(node, "robot 'next'")
    robot.wait_for_command(HOLD)


WITHOUT_FORK = """
import os, sys
def refuse():
    raise BlockingIOError(11, 'Resource temporarily unavailable')
os.fork = refuse
from inverse_dynamics_node.node.main import main
sys.exit(main())
"""


def test_a_node_that_may_not_fork_uses_a_thread(run_node, robot):
    node = run_node(**PATIENT, program=('-c', WITHOUT_FORK))
    robot.publish_description(STANFORD.read_text())
    robot.publish_state(NAMES, Q, np.zeros(6))
    robot.wait_for_command(HOLD)
    text = 'cannot create a process for long tasks ([Errno 11] Resource temporarily unavailable)'
    assert text in node.output
    robot.publish_again(STANFORD.read_text().replace('"stanford"', '"next"'))
    robot.wait_for_text(node, "robot 'next'")
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
