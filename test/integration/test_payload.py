"""`inverse_dynamics payload` beside a running node: --record and --apply."""

import json
import signal
import subprocess
import threading
import time

from fork_server import SERVER
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.recordings.measured_states import read_measured_states
import numpy as np
from payload_runs import Arm, motion_of, random_load
import pytest
from robot_files import ROOT
from simulated_runs import write_csv

pytest.importorskip('mujoco')

from geometry_msgs.msg import Inertia, InertiaStamped, Vector3
from inverse_dynamics_node.ros.qos import LATCHED
from inverse_dynamics_node.simulation.trajectory import plan, start_pose
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

URDF = ROOT / 'test' / 'robots' / 'seven_dof.urdf'
ROBOT = load_urdf(URDF)
NAMES = list(ROBOT.joint_names)


@pytest.fixture
def payload(domain_id, tmp_path):
    """Return a function that starts the command in a folder of its own."""

    def start(*arguments):
        command = ['-m', 'inverse_dynamics_node.cli.main', 'payload', URDF, *arguments]
        command += ['--link', 'tool0', '--json']
        environment = {'ROS_DOMAIN_ID': str(domain_id)}
        processes.append(SERVER.run(command, environment, tmp_path, stdout=subprocess.PIPE))
        return processes[-1]

    processes = []
    yield start
    for process in processes:
        process.kill()
        process.wait()


@pytest.fixture
def ended(robot):
    """Return a function that waits for the end of a command; it returns code and output."""

    def wait(process):
        outputs = []
        thread = threading.Thread(target=lambda: outputs.append(process.stdout.read()))
        thread.start()
        # The robot publishes only while it waits.
        robot.wait_until(lambda: not thread.is_alive(), 'end of the command')
        return process.wait(), outputs[0]

    return wait


def report_of(output):
    """Return the report, which follows the messages about the recording."""
    return json.loads(output.splitlines()[-1])


def test_the_node_takes_the_payload(run_node, robot, payload, ended, tmp_path):
    rng = np.random.default_rng(0)
    arm, (times, *signals) = Arm(ROBOT, rng), motion_of(ROBOT, rng, 16.0)
    motion = times[::3], *(signal[::3] for signal in signals)
    write_csv(tmp_path / 'empty.csv', arm.record(motion))
    write_csv(tmp_path / 'loaded.csv', arm.record(motion, random_load('tool0', rng, 2.0)))
    node = run_node(robot_description_file=URDF, state_timeout=5.0)
    robot.publish_state(NAMES, np.full(7, 0.5), np.zeros(7))
    robot.wait_for_text(node, 'floating')
    code, output = ended(
        payload('loaded.csv', '--empty', 'empty.csv', '--apply', '/inverse_dynamics')
    )
    mass = report_of(output)['mass']
    assert code == 0
    assert mass == pytest.approx(2.0, rel=0.02)
    assert f"payload of {mass:g} kg on link 'tool0'" in node.output


def hold(robot, efforts):
    """Publish the state of an arm at rest."""
    robot.publish_state(NAMES, np.full(7, 0.5), np.zeros(7), efforts)


def test_ctrl_c_ends_the_recording(run_node, robot, payload, ended, tmp_path):
    (tmp_path / 'run.csv').write_text('mine')
    hold(robot, np.arange(7.0))
    robot.wait_for_text(run_node(robot_description_file=URDF, state_timeout=5.0), 'floating')
    process = payload('run.csv', '--record', '1000', '--force')
    partial = tmp_path / 'run_partial.csv'
    robot.wait_until(lambda: partial.exists() and partial.stat().st_size > 10_000, 'rows')
    process.send_signal(signal.SIGINT)
    code, output = ended(process)
    assert code == 130
    assert 'recording /joint_states for 1000 s\nrun_partial.csv: ' in output
    assert (tmp_path / 'run.csv').read_text() == 'mine'  # an early end replaces no recording
    recording, _ = read_measured_states(partial, NAMES)
    assert set(np.diff(recording.times) > 0.0) == {True}
    assert np.all(recording.efforts == np.arange(7.0))


def test_joint_states_have_to_contain_efforts(run_node, robot, payload, ended, tmp_path):
    hold(robot, ())
    robot.wait_for_text(run_node(robot_description_file=URDF, state_timeout=5.0), 'floating')
    code, output = ended(payload('run.csv', '--record', '1'))
    assert code == 1
    assert 'the joint states on /joint_states have no efforts; configure the driver' in output
    assert not [*tmp_path.iterdir()]


class Tracking:
    """Repeats a motion, and measures the error of the arm."""

    def __init__(self, robot, duration):
        self.robot, self.duration = robot, duration
        dynamics = InverseDynamics(ROBOT)
        self.start = start_pose(ROBOT, dynamics)
        self.plan = plan(ROBOT, dynamics, self.start, duration)
        self.began = np.inf
        self.errors = []
        robot.node.create_subscription(JointState, 'joint_states', self._on_state, 100)
        robot.keep_publishing('inverse_dynamics/reference', self._reference, JointTrajectory)

    def _now(self):
        return max(time.monotonic() - self.began, 0.0) % self.duration

    def _reference(self):
        q, qd, qdd = (x.tolist() for x in self.plan.sample(self._now()))
        point = JointTrajectoryPoint(positions=q, velocities=qd, accelerations=qdd)
        return JointTrajectory(joint_names=NAMES, points=[point])

    def _on_state(self, state):
        q = np.array([state.position[state.name.index(name)] for name in NAMES])
        self.errors.append(self.plan.sample(self._now())[0] - q)

    def error_of(self, wait, *arguments):
        """Wait for something; return the RMS error in this time [rad], and the result."""
        self.errors = []
        result = wait(*arguments)
        return float(np.sqrt(np.mean(np.square(self.errors)))), result

    def repeat(self):
        """Wait until the motion is complete once more."""
        end = time.monotonic() + self.duration
        self.robot.wait_until(lambda: time.monotonic() >= end, 'end of the motion')


@pytest.mark.long
@pytest.mark.real_time
def test_a_load_is_recorded_measured_and_applied_and_the_arm_follows_again(
    domain_id, run_node, robot, payload, ended
):
    tracking = Tracking(robot, 6.0)
    brakes = []
    robot.node.create_subscription(Bool, 'brakes', lambda m: brakes.append(m.data), LATCHED)
    program = ['-m', 'inverse_dynamics_node.simulation.robot', str(URDF), '--rate', '200']
    start = ['--start', *(f'{x:.9f}' for x in tracking.start)]
    remap = ['--ros-args', '-r', 'commands:=inverse_dynamics/commands']
    simulated = SERVER.run([*program, *start, *remap], {'ROS_DOMAIN_ID': str(domain_id)})
    try:
        node = run_node(
            robot_description_file=URDF,
            mode='computed_torque',
            kp=1000.0,  # with less, the load pulls the light wrist into other poses
            kd=60.0,
            state_timeout=5.0,
            reference_timeout=5.0,
        )
        robot.wait_until(lambda: brakes and not brakes[-1], 'open brakes')
        tracking.began = time.monotonic()
        record = '--record', '6'
        before, (code, _) = tracking.error_of(ended, payload('empty.csv', *record))
        assert code == 3  # the arm carries nothing
        load = Inertia(m=0.4, com=Vector3(x=0.02, y=-0.03, z=0.06), ixx=1e-3, iyy=1e-3, izz=1e-3)
        message = InertiaStamped(header=Header(frame_id='tool0'), inertia=load)
        robot.publish_once('simulated_robot/payload', message)
        unknown, _ = tracking.error_of(tracking.repeat)
        code, output = ended(payload('loaded.csv', *record, '--empty', 'empty.csv', '--apply'))
        assert code == 0, output
        known, _ = tracking.error_of(tracking.repeat)
    finally:
        simulated.terminate()
        simulated.wait(60.0)
    report = report_of(output)
    assert report['mass'] == pytest.approx(0.4, rel=0.05)
    np.testing.assert_allclose(report['com'], [0.02, -0.03, 0.06], atol=0.01)
    assert f"payload of {report['mass']:g} kg on link 'tool0'" in node.output
    assert unknown > 2.0 * before
    assert known < 0.5 * unknown
