"""The demo as a user runs it, and its simulated robot as a controller meets it."""

from contextlib import contextmanager
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from robot_files import STANFORD

pytest.importorskip('rclpy')
pytest.importorskip('mujoco')

from geometry_msgs.msg import (
    Inertia,
    InertiaStamped,
    Vector3,
    Vector3Stamped,
    Wrench,
    WrenchStamped,
)
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.simulation.commander import resolved_acceleration
from inverse_dynamics_node.simulation.mujoco_robot import MujocoRobot
from inverse_dynamics_node.simulation.robot import RobotNode
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, Float64MultiArray, Header

IMU_ORIENTATION = (np.pi / 2, 0.0, np.pi / 2)
PATIENCE = 90.0  # [s]; a demo that can do nothing gives up by itself before this
MASSLESS = """
<robot name="massless"><link name="base"/><link name="tip"/>
<joint name="idle" type="continuous"><parent link="base"/><child link="tip"/></joint></robot>
"""


@contextmanager
def running_demo(domain_id, *arguments):
    """Run the demo; whatever becomes of the test, nothing stays behind."""
    demo = subprocess.Popen(
        [sys.executable, '-m', 'inverse_dynamics_node.simulation.demo', *map(str, arguments)],
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield demo
    finally:
        if demo.poll() is None:
            demo.terminate()
            demo.communicate(timeout=PATIENCE)


def finish(demo):
    """Wait for the end of the demo; return its exit code and what it printed."""
    output, _ = demo.communicate(timeout=PATIENCE)
    return demo.returncode, output


def children_of(process):
    task = Path(f'/proc/{process.pid}/task/{process.pid}/children')
    return [int(number) for number in task.read_text().split()]


def read_until(process, text):
    """Return the lines up to the first that contains a text."""
    lines = []
    for line in process.stdout:
        lines.append(line)
        if text in line:
            return lines
    raise AssertionError(f'ended without {text!r}: {"".join(lines)}')


def is_gone(number):
    deadline = time.monotonic() + 10.0
    while Path(f'/proc/{number}').exists():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


class TestDemo:
    def test_robot_tracks_and_the_result_is_printed(self, domain_id):
        with running_demo(domain_id, STANFORD, '--duration', 6) as demo:
            code, output = finish(demo)
        assert 'Traceback' not in output
        assert code == 0, output
        joints = load_urdf(STANFORD).joint_names
        number = r'(\d+\.\d+)'
        for name in joints:
            errors = re.search(rf'^{name} +{number} (mrad|mm) +{number} \2', output, re.MULTILINE)
            assert float(errors[1]) < 10.0
            assert float(errors[3]) < 1.0
        rate = re.search(rf'^rate: {number} of 500\.0 commands/s', output, re.MULTILINE)
        assert float(rate[1]) == pytest.approx(500.0, rel=0.02)
        assert re.search(r'^PASSED', output, re.MULTILINE)
        assert len(re.findall(r'^t = ', output, re.MULTILINE)) == 6

    @pytest.mark.parametrize(
        ('text', 'words'),
        [
            (MASSLESS, "no mass resists the motion of joint 'idle'"),
            ('<robot name="r"><link name="a"/></robot>', 'no joint'),
            ('<sdf/>', 'root element is <sdf>'),
            ('', 'file is empty'),
        ],
        ids=['massless', 'nothing moves', 'not a URDF', 'empty'],
    )
    def test_robot_that_cannot_be_simulated_is_refused_in_words(
        self, domain_id, tmp_path, text, words
    ):
        path = tmp_path / 'robot.urdf'
        path.write_text(text)
        with running_demo(domain_id, path) as demo:
            code, output = finish(demo)
        assert code == 1
        assert words in output
        assert 'Traceback' not in output

    @pytest.mark.parametrize('arguments', [['--rate', '0'], ['--duration', 'nan']])
    def test_settings_out_of_range_are_refused(self, domain_id, arguments):
        with running_demo(domain_id, STANFORD, *arguments) as demo:
            code, output = finish(demo)
        assert code == 2
        assert f'{arguments[0]} {arguments[1]} is not' in output
        assert 'Traceback' not in output

    @pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
    def test_signal_ends_all_of_it_in_peace(self, domain_id, number):
        with running_demo(domain_id, STANFORD) as demo:
            read_until(demo, 't = 1.0')
            children = children_of(demo)
            demo.send_signal(number)
            code, output = finish(demo)
        assert code == 128 + number
        assert 'Traceback' not in output
        assert len(children) == 2
        assert all(map(is_gone, children))

    def test_killed_demo_leaves_nobody_behind(self, domain_id):
        with running_demo(domain_id, STANFORD) as demo:
            read_until(demo, 't = 1.0')
            children = children_of(demo)
            demo.kill()
            finish(demo)
        assert all(map(is_gone, children))

    @pytest.mark.parametrize(('child', 'name'), [(0, 'the simulated robot'), (1, 'the node')])
    def test_process_that_dies_ends_the_demo(self, domain_id, child, name):
        with running_demo(domain_id, STANFORD) as demo:
            read_until(demo, 't = 1.0')
            children = children_of(demo)
            os.kill(children[child], signal.SIGKILL)
            code, output = finish(demo)
        assert code == 1
        assert f'demo: {name} ended early, with exit code -9' in output
        assert all(map(is_gone, children))


def test_resolved_acceleration_brings_an_error_to_zero():
    """Integrated with the effect it asks for, an error of a radian is gone after a second."""
    q, qd, step = np.array([1.0]), np.array([0.0]), 0.001
    for _ in range(1000):
        zero = np.zeros(1)
        qdd = resolved_acceleration((zero, zero, zero), q, qd, 400.0, 40.0)
        qd = qd + step * qdd
        q = q + step * qd
    assert abs(q[0]) < 1e-6


class TestRobotNode:
    @pytest.fixture
    def arm(self, domain_id):
        """Return the simulated robot and a controller's side of it, in one process."""
        context = Context()
        context.init(args=[], domain_id=domain_id)
        sides = Arm(context)
        yield sides
        sides.close()
        context.try_shutdown()

    def test_states_come_by_name_with_simulated_time(self, arm):
        def two_came():
            arm.node.advance(0.002)
            return len(arm.states) >= 2

        arm.wait_until(two_came)
        first, second = arm.states[:2]
        assert list(first.name) == list(arm.robot.state_names)
        assert len(first.position) == len(first.velocity) == len(first.effort) == len(first.name)
        stamps = [s.header.stamp.sec * 10**9 + s.header.stamp.nanosec for s in (first, second)]
        assert stamps[1] - stamps[0] == 2_000_000

    def test_incomplete_and_not_finite_commands_are_ignored(self, arm):
        efforts = []

        def obeys_the_last():
            efforts.append(set(arm.robot.state()[2]))
            return efforts[-1] == {3.0}

        arm.send([1.0] * 6)
        for wrong in ([2.0] * 5, [2.0] * 7, [], [float('nan')] * 6, [2.0] * 5 + [float('inf')]):
            arm.send(wrong)
        arm.send([3.0] * 6)
        arm.wait_until(obeys_the_last)
        assert set().union(*efforts) == {0.0, 1.0, 3.0}

    def test_brakes_open_once_commands_have_come_for_a_while(self, arm):
        def command_for(times):
            for i in range(times):
                arm.send_and_see([0.1 + 0.1 * i] * 6)
                arm.node.advance(0.05)

        arm.wait_until(lambda: arm.brakes == [True])
        command_for(9)
        arm.node.advance(0.2)  # a gap: the count starts all over
        command_for(9)
        assert arm.robot.brakes_on
        command_for(3)
        assert not arm.robot.brakes_on
        arm.wait_until(lambda: arm.brakes == [True, False])

    def test_load_push_and_tilt_are_felt(self, arm):
        dynamics = InverseDynamics(arm.robot.robot)
        q = arm.robot.state()[0]

        arm.tell('payload', InertiaStamped(header=at('link_6'), inertia=Inertia(m=2.0)))
        dynamics.set_payload('link_6', 2.0)
        arm.wait_until(lambda: arm.balance(dynamics, q) < 1e-9)
        wrench = Wrench(force=Vector3(x=3.0), torque=Vector3(z=0.5))
        arm.tell('push', WrenchStamped(header=at('tool0'), wrench=wrench))
        dynamics.set_external_wrench('tool0', (3.0, 0.0, 0.0), (0.0, 0.0, 0.5))
        arm.wait_until(lambda: arm.balance(dynamics, q) < 1e-9)
        arm.tell('tilt', Vector3Stamped(vector=Vector3(x=0.5)))
        dynamics.set_gravity((0.0, -9.80665 * np.sin(0.5), -9.80665 * np.cos(0.5)))
        arm.wait_until(lambda: arm.balance(dynamics, q) < 1e-9)

    def test_load_on_a_link_that_is_not_there_changes_nothing(self, arm):
        arm.tell('payload', InertiaStamped(header=at('nope'), inertia=Inertia(m=2.0)))
        for _ in range(20):
            arm.executor.spin_once(timeout_sec=0.01)
        dynamics = InverseDynamics(arm.robot.robot)
        assert arm.balance(dynamics, arm.robot.state()[0]) < 1e-9

    def test_imu_feels_the_ground_and_the_turning(self, arm):
        imus = []
        arm.side.create_subscription(Imu, 'imu', imus.append, 1000)

        def advance(seconds):
            came = len(imus)
            for _ in range(int(seconds / 0.05)):
                arm.node.advance(0.05)
            arm.wait_until(lambda: len(imus) >= came + int(seconds / 0.05))

        arm.wait_until(lambda: arm.node.advance(0.002) or imus)
        # The sensor's x axis is the base's y axis, its y axis looks up.
        assert read(imus[-1].linear_acceleration) == pytest.approx([0.0, 9.80665, 0.0])
        assert read(imus[-1].angular_velocity) == [0.0, 0.0, 0.0]
        arm.tell('tilt', Vector3Stamped(vector=Vector3(y=0.5)))
        before = len(imus)
        arm.wait_until(lambda: arm.node.advance(0.05) or imus[-1].angular_velocity.x > 0.0)
        advance(4.0)
        assert 0.05 * sum(imu.angular_velocity.x for imu in imus[before:]) == pytest.approx(
            0.5, abs=1e-3
        )
        cosine, sine = 9.80665 * np.cos(0.5), 9.80665 * np.sin(0.5)
        assert read(imus[-1].linear_acceleration) == pytest.approx([0.0, cosine, -sine])

    def test_without_sensors_joint_states_stop_and_brakes_go_on(self, arm):
        def command_for(times):
            for i in range(times):
                arm.send_and_see([0.1 + 0.1 * i] * 6)
                arm.node.advance(0.05)

        arm.wait_until(lambda: arm.brakes == [True])
        command_for(12)
        arm.wait_until(lambda: arm.brakes == [True, False])
        arm.tell('sensors', Bool(data=False))
        arm.wait_until(lambda: arm.brakes == [True, False, True])
        came = len(arm.states)
        command_for(12)
        assert len(arm.states) == came
        assert arm.robot.brakes_on
        arm.tell('sensors', Bool(data=True))
        arm.wait_until(lambda: arm.node.advance(0.002) or len(arm.states) > came)
        command_for(12)
        assert not arm.robot.brakes_on


def at(link):
    return Header(frame_id=link)


def read(vector):
    return [vector.x, vector.y, vector.z]


class Arm:
    """A simulated robot whose brakes open after half a second, and who commands it."""

    def __init__(self, context):
        self.robot = MujocoRobot(STANFORD, load_urdf(STANFORD), [0, 0, 0.5, 0, 0.5, 0])
        self.node = RobotNode(self.robot, 0.5, IMU_ORIENTATION, context=context)
        self.states, self.brakes = [], []
        self.side = Node('side', context=context)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        subscribe = self.side.create_subscription
        subscribe(JointState, 'joint_states', self.states.append, 1000)
        subscribe(Bool, 'brakes', lambda message: self.brakes.append(message.data), latched)
        self._commands = self.side.create_publisher(Float64MultiArray, 'commands', 10)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.side)
        self.executor.add_node(self.node)
        self.wait_until(lambda: self._commands.get_subscription_count() > 0)

    def close(self):
        self.executor.shutdown()
        self.side.destroy_node()
        self.node.destroy_node()

    def tell(self, topic, message):
        """Publish on a topic of the simulated robot's own."""
        publisher = self.side.create_publisher(type(message), f'simulated_robot/{topic}', 10)
        self.wait_until(lambda: publisher.get_subscription_count() > 0)
        publisher.publish(message)

    def balance(self, dynamics, q):
        """Let time pass with brakes on; return by how much efforts and accelerations disagree."""
        self.node.advance(0.05)
        accelerations = self.robot.accelerations()
        return abs(dynamics.efforts(q, np.zeros(len(q)), accelerations)).max()

    def send(self, efforts):
        self._commands.publish(Float64MultiArray(data=efforts))

    def send_and_see(self, efforts):
        """Send a command, and wait until the robot obeys it."""
        self.send(efforts)
        self.wait_until(lambda: set(self.robot.state()[2]) == set(efforts))

    def wait_until(self, is_true):
        deadline = time.monotonic() + PATIENCE
        while not is_true():
            assert time.monotonic() < deadline
            self.executor.spin_once(timeout_sec=0.02)
