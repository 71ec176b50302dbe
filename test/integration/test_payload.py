"""`inverse_dynamics payload --apply` beside a running node."""

import json
import subprocess
import threading
import time

from fork_server import SERVER
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.recordings.signals import Recording
import numpy as np
from payload_runs import Arm, motion_of, random_load
import pytest
from robot_files import ROOT
from simulated_runs import write_csv

pytest.importorskip('mujoco')

from geometry_msgs.msg import Inertia, InertiaStamped, Vector3
from inverse_dynamics_node.simulation.trajectory import plan, start_pose
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

URDF = ROOT / 'test' / 'robots' / 'seven_dof.urdf'
ROBOT = load_urdf(URDF)
NAMES = list(ROBOT.joint_names)


@pytest.fixture
def measure(domain_id, robot, tmp_path):
    """Return a function that runs the command on two recordings, and returns its report."""

    def measure(empty, loaded):
        write_csv(tmp_path / 'empty.csv', empty)
        write_csv(tmp_path / 'loaded.csv', loaded)
        runs = [URDF, tmp_path / 'loaded.csv', '--empty', tmp_path / 'empty.csv']
        command = ['-m', 'inverse_dynamics_node.cli.main', 'payload', *map(str, runs)]
        command += ['--link', 'tool0', '--json', '--apply', '/inverse_dynamics']
        environment = {'ROS_DOMAIN_ID': str(domain_id)}
        process = SERVER.run(command, environment, stdout=subprocess.PIPE)
        outputs = []
        thread = threading.Thread(target=lambda: outputs.append(process.stdout.read()))
        thread.start()
        # The robot publishes only while it waits.
        robot.wait_until(lambda: not thread.is_alive(), 'end of the command')
        assert process.wait() == 0
        return json.loads(outputs[0])

    return measure


def test_the_node_takes_the_payload(run_node, robot, measure):
    rng = np.random.default_rng(0)
    arm, (times, *signals) = Arm(ROBOT, rng), motion_of(ROBOT, rng, 16.0)
    motion = times[::3], *(signal[::3] for signal in signals)
    empty = arm.record(motion)
    loaded = arm.record(motion, random_load('tool0', rng, 2.0))
    node = run_node(robot_description_file=URDF, state_timeout=5.0)
    robot.publish_state(NAMES, np.full(7, 0.5), np.zeros(7))
    robot.wait_for_text(node, 'floating')
    mass = measure(empty, loaded)['mass']
    assert mass == pytest.approx(2.0, rel=0.02)
    assert f"payload on link 'tool0': {mass:g} kg" in node.output


class Tracking:
    """Follows a motion, and records joint states and errors."""

    def __init__(self, robot, duration):
        self.robot, self.duration = robot, duration
        dynamics = InverseDynamics(ROBOT)
        self.start = start_pose(ROBOT, dynamics)
        self.plan = plan(ROBOT, dynamics, self.start, duration)
        self.began = np.inf
        self.rows = []
        robot.node.create_subscription(JointState, 'joint_states', self._on_state, 100)
        robot.keep_publishing('inverse_dynamics/reference', self._reference, JointTrajectory)

    def _now(self):
        return min(max(time.monotonic() - self.began, 0.0), self.duration)

    def _reference(self):
        q, qd, qdd = (x.tolist() for x in self.plan.sample(self._now()))
        point = JointTrajectoryPoint(positions=q, velocities=qd, accelerations=qdd)
        return JointTrajectory(joint_names=NAMES, points=[point])

    def _on_state(self, state):
        stamp = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
        order = [state.name.index(name) for name in NAMES]
        values = np.array([state.position, state.velocity, state.effort])[:, order]
        error = self.plan.sample(self._now())[0] - values[0]
        self.rows.append((stamp, values, error))

    def follow(self):
        """Follow the motion once; return the recording, and the RMS error [rad]."""
        self.began, self.rows = time.monotonic(), []
        self.robot.wait_until(lambda: self._now() >= self.duration, 'end of the motion')
        self.began = np.inf
        stamps, values, errors = (np.array(each) for each in zip(*self.rows, strict=True))
        times = stamps - stamps[0]
        recording = Recording(ROBOT.joint_names, times, *values.transpose(1, 0, 2))
        return recording, float(np.sqrt(np.mean(errors**2)))


@pytest.mark.long
@pytest.mark.real_time
def test_a_load_is_measured_and_applied_and_the_arm_follows_again(
    domain_id, run_node, robot, measure
):
    tracking = Tracking(robot, 12.0)
    brakes = robot.listen(Bool, 'brakes')
    program = ['-m', 'inverse_dynamics_node.simulation.robot', str(URDF), '--rate', '200']
    start = ['--start', *(f'{x:.9f}' for x in tracking.start)]
    remap = ['--ros-args', '-r', 'commands:=inverse_dynamics/commands']
    simulated = SERVER.run([*program, *start, *remap], {'ROS_DOMAIN_ID': str(domain_id)})
    try:
        run_node(
            robot_description_file=URDF,
            mode='computed_torque',
            kp=400.0,
            kd=40.0,
            state_timeout=5.0,
            reference_timeout=5.0,
        )
        robot.wait_until(lambda: brakes and not brakes[-1].data, 'open brakes')
        empty, before = tracking.follow()
        load = Inertia(m=1.5, com=Vector3(x=0.02, y=-0.03, z=0.06), ixx=4e-3, iyy=4e-3, izz=4e-3)
        message = InertiaStamped(header=Header(frame_id='tool0'), inertia=load)
        robot.publish_once('simulated_robot/payload', message)
        loaded, unknown = tracking.follow()
        report = measure(empty, loaded)
        _, known = tracking.follow()
    finally:
        simulated.terminate()
        simulated.wait(60.0)
    assert report['mass'] == pytest.approx(1.5, rel=0.02)
    np.testing.assert_allclose(report['com'], [0.02, -0.03, 0.06], atol=0.005)
    assert unknown > 2.0 * before
    assert known < 0.5 * unknown
