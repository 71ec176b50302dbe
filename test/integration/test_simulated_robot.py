"""The topics of the simulated robot, seen by a controller."""

import os
import signal
import subprocess
import sys
import time

from node_process import heed_signals, shared_memory_of
import numpy as np
import pytest
from robot_files import STANFORD

pytest.importorskip('rclpy')
pytest.importorskip('mujoco')
pytest.importorskip('rosbags')

from accelerated_robot import AcceleratedRobot
from geometry_msgs.msg import (
    Inertia,
    InertiaStamped,
    Vector3,
    Vector3Stamped,
    Wrench,
    WrenchStamped,
)
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.simulation.drive import PositionDrive
from inverse_dynamics_node.simulation.robot import COMPLAINT_PERIOD, RobotNode
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, Float64MultiArray, Header
from std_srvs.srv import SetBool

pytestmark = pytest.mark.real_time
IMU_ORIENTATION = (np.pi / 2, 0.0, np.pi / 2)
PATIENCE = 120.0  # [s]


class TestRobotNode:
    @pytest.fixture
    def arm(self, domain_id, request):
        """Return the simulated robot and a controller's side of it, in one process."""
        context = Context()
        context.init(args=[], domain_id=domain_id)
        sides = Arm(context, has_drive=getattr(request, 'param', False))
        yield sides
        sides.close()
        context.try_shutdown()

    def test_states_have_names_and_simulated_time(self, arm):
        def received_two():
            arm.node.advance(0.002)
            return len(arm.states) >= 2

        arm.wait_until(received_two)
        first, second = arm.states[:2]
        assert list(first.name) == list(arm.robot.state_names)
        assert len(first.position) == len(first.velocity) == len(first.effort) == len(first.name)
        stamps = [s.header.stamp.sec * 10**9 + s.header.stamp.nanosec for s in (first, second)]
        assert stamps[1] - stamps[0] == 2_000_000

    def test_incomplete_and_not_finite_commands_are_ignored(self, arm):
        efforts = []

        def applies_the_last():
            efforts.append(set(arm.robot.state()[2]))
            return efforts[-1] == {3.0}

        arm.send([1.0] * 6)
        for wrong in ([2.0] * 5, [2.0] * 7, [], [float('nan')] * 6, [2.0] * 5 + [float('inf')]):
            arm.send(wrong)
        arm.send([3.0] * 6)
        arm.wait_until(applies_the_last)
        assert set().union(*efforts) == {0.0, 1.0, 3.0}

    def test_invalid_commands_between_valid_ones_do_not_flood_the_log(self, arm, capfd):
        began = time.monotonic()
        for i in range(1, 101):
            arm.send([0.01 * i] * (5 + i % 3))
            arm.send_and_see([0.01 * i] * 6)
        lines = capfd.readouterr().err.count('command ignored: ')
        assert 1 <= lines <= 1 + (time.monotonic() - began) / COMPLAINT_PERIOD

    def test_brakes_open_after_commands_have_arrived_for_a_while(self, arm):
        arm.wait_until(lambda: arm.brakes == [True])
        arm.command_for(9)
        arm.node.advance(0.2)  # a gap restarts the time to the release
        arm.command_for(9)
        assert arm.robot.brakes_on
        arm.command_for(3)
        assert not arm.robot.brakes_on
        arm.wait_until(lambda: arm.brakes == [True, False])

    def test_payload_push_and_tilt_act_on_the_robot(self, arm):
        dynamics = InverseDynamics(arm.robot.robot)
        q = arm.robot.state()[0]

        arm.disturb('payload', InertiaStamped(header=at('link_6'), inertia=Inertia(m=2.0)))
        dynamics.set_payload('link_6', 2.0)
        arm.wait_until(lambda: arm.balance(dynamics, q) < 1e-9)
        wrench = Wrench(force=Vector3(x=3.0), torque=Vector3(z=0.5))
        arm.disturb('push', WrenchStamped(header=at('tool0'), wrench=wrench))
        dynamics.set_external_wrench('tool0', (3.0, 0.0, 0.0), (0.0, 0.0, 0.5))
        arm.wait_until(lambda: arm.balance(dynamics, q) < 1e-9)
        arm.disturb('tilt', Vector3Stamped(vector=Vector3(x=0.5)))
        dynamics.set_gravity((0.0, -9.80665 * np.sin(0.5), -9.80665 * np.cos(0.5)))
        arm.wait_until(lambda: arm.balance(dynamics, q) < 1e-9)

    def test_payload_on_an_unknown_link_changes_nothing(self, arm):
        arm.disturb('payload', InertiaStamped(header=at('nope'), inertia=Inertia(m=2.0)))
        for _ in range(20):
            arm.executor.spin_once(timeout_sec=0.01)
        dynamics = InverseDynamics(arm.robot.robot)
        assert arm.balance(dynamics, arm.robot.state()[0]) < 1e-9

    def test_imu_measures_gravity_and_rotation(self, arm):
        imus = []
        arm.side.create_subscription(Imu, 'imu', imus.append, 1000)

        def advance(seconds):
            received = len(imus)
            for _ in range(int(seconds / 0.05)):
                arm.node.advance(0.05)
            arm.wait_until(lambda: len(imus) >= received + int(seconds / 0.05))

        arm.wait_until(lambda: arm.node.advance(0.002) or imus)
        # The sensor's x axis is the base's y axis; its y axis points up.
        assert read(imus[-1].linear_acceleration) == pytest.approx([0.0, 9.80665, 0.0])
        assert read(imus[-1].angular_velocity) == [0.0, 0.0, 0.0]
        arm.disturb('tilt', Vector3Stamped(vector=Vector3(y=0.5)))
        before = len(imus)
        arm.wait_until(lambda: arm.node.advance(0.05) or imus[-1].angular_velocity.x > 0.0)
        advance(4.0)
        assert 0.05 * sum(imu.angular_velocity.x for imu in imus[before:]) == pytest.approx(
            0.5, abs=1e-3
        )
        cosine, sine = 9.80665 * np.cos(0.5), 9.80665 * np.sin(0.5)
        assert read(imus[-1].linear_acceleration) == pytest.approx([0.0, cosine, -sine])

    def test_without_sensors_joint_states_stop_and_brakes_go_on(self, arm):
        arm.wait_until(lambda: arm.brakes == [True])
        arm.command_for(12)
        arm.wait_until(lambda: arm.brakes == [True, False])
        arm.disturb('sensors', Bool(data=False))
        arm.wait_until(lambda: arm.brakes == [True, False, True])
        received = len(arm.states)
        arm.command_for(12)
        assert len(arm.states) == received
        assert arm.robot.brakes_on
        arm.disturb('sensors', Bool(data=True))
        arm.wait_until(lambda: arm.node.advance(0.002) or len(arm.states) > received)
        arm.command_for(12)
        assert not arm.robot.brakes_on

    @pytest.mark.parametrize('arm', [True], indirect=True)
    def test_position_controller_holds_the_robot_after_a_loss_of_sensors(self, arm):
        arm.wait_until(lambda: arm.brakes == [False])
        before = arm.robot.positions()
        arm.disturb('sensors', Bool(data=False))
        arm.wait_until(lambda: arm.brakes == [False, True])
        for i in range(12):  # these commands do not release the robot
            arm.send([0.1 * i] * 6)
            arm.executor.spin_once(timeout_sec=0.02)
            arm.node.advance(0.05)
        arm.disturb('sensors', Bool(data=True))
        arm.wait_until(lambda: arm.brakes == [False, True, False])
        for _ in range(12):
            arm.node.advance(0.05)
        assert arm.robot.positions() == pytest.approx(before, abs=1e-4)


@pytest.fixture
def simulated(domain_id, tmp_path):
    """Run `inverse_dynamics simulate` as a process; return it and the path of its log."""
    log = tmp_path / 'log'
    command = (sys.executable, '-m', 'inverse_dynamics_node.cli.main', 'simulate', str(STANFORD))
    with log.open('w') as output:
        process = subprocess.Popen(
            [*command, '--commands', 'commands'],
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)},
            stderr=output,
            preexec_fn=heed_signals,
        )
    yield process, log
    if process.poll() is None:
        process.kill()
    process.wait()


@pytest.mark.long
def test_process_survives_commands_that_are_far_too_large(simulated, robot):
    process, log = simulated
    states = robot.listen(JointState, 'joint_states')

    def log_has(text):
        assert process.poll() is None, log.read_text()
        return text in log.read_text()

    robot.wait_until(lambda: states, 'joint state')
    assert shared_memory_of(process.pid) == []  # it would hold up its joint states now and then
    topic = robot.keep_publishing('commands', Float64MultiArray(data=[1e4, -1e4, 1e4] * 2))
    robot.wait_until(lambda: log_has('the robot follows the commands'), 'hand-over')
    robot.wait_until(lambda: log_has('the position controller brakes the robot'), 'supervision')
    assert log_has("joint 'joint_")
    assert log_has('(velocity limit')
    robot.wait_until(lambda: max(map(abs, states[-1].velocity)) < 1e-3, 'rest')
    assert np.isfinite([*states[-1].position, *states[-1].effort]).all()
    robot.peer = 'simulated_robot'
    refused = robot.call(SetBool, 'hold', SetBool.Request(data=False))
    assert not refused.success
    assert refused.message == 'commands are ignored until they pause for 0.5 s'
    robot.cease(topic)
    robot.wait_until(lambda: log_has('the commands have paused'), 'end of the commands')
    held = robot.call(SetBool, 'hold', SetBool.Request(data=True))
    assert held.success
    assert held.message == 'the position controller holds the robot; commands are ignored'
    process.send_signal(signal.SIGINT)
    robot.wait_until(lambda: process.poll() is not None, 'end of the robot')
    assert process.returncode == 0


def at(link):
    return Header(frame_id=link)


def read(vector):
    return [vector.x, vector.y, vector.z]


class Arm:
    """A simulated robot whose brakes open after half a second, and a node that commands it."""

    def __init__(self, context, has_drive=False):
        self.robot = AcceleratedRobot(STANFORD, load_urdf(STANFORD), [0, 0, 0.5, 0, 0.5, 0])
        self.robot.brakes_on = not has_drive
        drive = PositionDrive(self.robot, False) if has_drive else None
        self.node = RobotNode(self.robot, 0.5, IMU_ORIENTATION, drive, context=context)
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

    def disturb(self, topic, message):
        """Publish on a private topic of the simulated robot."""
        publisher = self.side.create_publisher(type(message), f'simulated_robot/{topic}', 10)
        self.wait_until(lambda: publisher.get_subscription_count() > 0)
        publisher.publish(message)

    def balance(self, dynamics, q):
        """Advance with brakes on; return the efforts that the core computes for no command."""
        self.node.advance(0.05)
        accelerations = self.robot.accelerations()
        return abs(dynamics.efforts(q, np.zeros(len(q)), accelerations)).max()

    def send(self, efforts):
        self._commands.publish(Float64MultiArray(data=efforts))

    def send_and_see(self, efforts):
        """Send a command, and wait until the robot applies it."""
        self.send(efforts)
        self.wait_until(lambda: set(self.robot.state()[2]) == set(efforts))

    def command_for(self, steps):
        """Send a command and advance by 50 ms, several times."""
        for i in range(steps):
            self.send_and_see([0.1 + 0.1 * i] * 6)
            self.node.advance(0.05)

    def wait_until(self, is_true):
        deadline = time.monotonic() + PATIENCE
        while not is_true():
            assert time.monotonic() < deadline
            self.executor.spin_once(timeout_sec=0.02)
