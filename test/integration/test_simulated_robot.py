"""The topics of the simulated robot, seen by a controller."""

import time

from geometry_msgs.msg import Inertia, InertiaStamped
from lxml import etree
from node_process import shared_memory_of
import numpy as np
import pytest
from robot_files import ROOT, STANFORD

pytest.importorskip('mujoco')

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.simulation.robot import COMPLAINT_PERIOD, RobotNode
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from robot_side import LATCHED
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray, Header

pytestmark = pytest.mark.real_time
GRIPPER_ARM = ROOT / 'test' / 'robots' / 'gripper_arm.urdf'
COMMANDS = ['--ros-args', '-r', 'commands:=inverse_dynamics/commands']
PERIOD = 0.02  # [s]
RATE = 200  # [Hz]
PATIENCE = 120.0  # [s]


class Arm:
    """A simulated robot that follows after half a second, and a node that commands it."""

    def __init__(self, context):
        self.model = load_urdf(STANFORD)
        self.dynamics = InverseDynamics(self.model)
        self.start = np.array([0, 0.4, 0.5, 0, 0.5, 0])
        self.node = RobotNode(self.model, start=self.start, release=0.5, context=context)
        self.states, self.brakes = [], []
        self.side = Node('side', context=context)
        subscribe = self.side.create_subscription
        subscribe(JointState, 'joint_states', self.states.append, 1000)
        subscribe(Bool, 'brakes', lambda message: self.brakes.append(message.data), LATCHED)
        self._commands = self.side.create_publisher(Float64MultiArray, 'commands', 10)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.side)
        self.executor.add_node(self.node)
        self.wait_until(lambda: self._commands.get_subscription_count() > 0)
        self.wait_until(lambda: self.brakes == [True])

    def close(self):
        self.executor.shutdown()
        self.side.destroy_node()
        self.node.destroy_node()

    def disturb(self, topic, message):
        """Publish on a private topic of the simulated robot."""
        publisher = self.side.create_publisher(type(message), f'simulated_robot/{topic}', 10)
        self.wait_until(lambda: publisher.get_subscription_count() > 0)
        publisher.publish(message)

    def efforts(self):
        """Advance, and return the measured efforts in the order of the model."""
        count = len(self.states)
        self.node.advance(PERIOD)
        self.wait_until(lambda: len(self.states) > count)
        measured = dict(zip(self.states[-1].name, self.states[-1].effort, strict=True))
        return [measured[name] for name in self.model.joint_names]

    def send(self, efforts):
        self._commands.publish(Float64MultiArray(data=efforts))

    def follow(self, change=0.0):
        """Send efforts that hold the arm, with a small change, until the robot applies them."""
        efforts = (self.dynamics.gravity_efforts(self.start) + change).tolist()

        def applies():
            self.send(efforts)
            return self.efforts() == efforts

        self.wait_until(applies)

    def wait_until(self, is_true):
        deadline = time.monotonic() + PATIENCE
        while not is_true():
            assert time.monotonic() < deadline
            self.executor.spin_once(timeout_sec=0.02)


@pytest.fixture
def arm(domain_id):
    """Return the simulated robot and a controller's side of it, in one process."""
    context = Context()
    context.init(args=[], domain_id=domain_id)
    sides = Arm(context)
    yield sides
    sides.close()
    context.try_shutdown()


def test_the_robot_is_held_until_commands_have_arrived_for_a_while(arm):
    """Its joint states have sorted names, and stamps of simulated time."""
    expected = arm.dynamics.gravity_efforts(arm.start)
    assert abs(expected).max() > 10.0
    arm.efforts()
    arm.wait_until(lambda: arm.efforts() == pytest.approx(expected, abs=0.05))
    first, second = arm.states[-2:]
    assert list(first.name) == sorted(arm.model.joint_names)
    assert len(first.position) == len(first.velocity) == len(first.effort) == len(first.name)
    stamps = [s.header.stamp.sec * 10**9 + s.header.stamp.nanosec for s in (first, second)]
    assert stamps[1] - stamps[0] == round(PERIOD * 1e9)
    began = len(arm.states)
    arm.follow()
    assert (len(arm.states) - began) * PERIOD >= 0.5
    arm.wait_until(lambda: arm.brakes == [True, False])


def test_wrong_commands_are_ignored_and_do_not_flood_the_log(arm, capfd):
    arm.follow()
    began = time.monotonic()
    for i in range(1, 10):
        for wrong in ([2.0] * 5, [2.0] * 7, [], [float('nan')] * 6, [2.0] * 5 + [float('inf')]):
            arm.send(wrong)
        arm.follow(1e-6 * i)
    applied = {effort for state in arm.states for effort in state.effort}
    assert 2.0 not in applied
    lines = capfd.readouterr().err.count('command ignored: ')
    assert 1 <= lines <= 1 + (time.monotonic() - began) / COMPLAINT_PERIOD


def test_payload_acts_on_the_robot(arm, capfd):
    def is_balanced():
        efforts, state = arm.efforts(), arm.states[-1]
        q = [state.position[state.name.index(name)] for name in arm.model.joint_names]
        expected = arm.dynamics.efforts(q, np.zeros(6), np.zeros(6))
        return efforts == pytest.approx(expected, abs=0.05)

    arm.disturb('payload', InertiaStamped(header=at('link_6'), inertia=Inertia(m=0.5)))
    arm.dynamics.set_payload('link_6', 0.5)
    arm.wait_until(is_balanced)
    arm.disturb('payload', InertiaStamped(header=at('nope'), inertia=Inertia(m=2.0)))
    text = []
    arm.wait_until(lambda: text.append(capfd.readouterr().err) or 'nope' in ''.join(text))
    arm.wait_until(is_balanced)


def at(link):
    return Header(frame_id=link)


SIMULATE = ['-m', 'inverse_dynamics_node.cli.main', 'simulate', '--rate', RATE]


@pytest.mark.parametrize('has_mass', [True, pytest.param(False, marks=pytest.mark.long)])
def test_gravity_compensation_includes_the_mass_of_uncommanded_joints(
    run_program, run_node, robot, tmp_path, has_mass
):
    """The arm stays in place if the node's description has the fingers, and falls without them."""
    root = etree.parse(str(GRIPPER_ARM)).getroot()
    for link in root.iter('link'):
        if 'finger' in link.get('name') and not has_mass:
            link.remove(link.find('inertial'))
    description = tmp_path / 'description.urdf'
    description.write_text(etree.tostring(root, encoding='unicode'))
    names = [name for name in load_urdf(GRIPPER_ARM).joint_names if name != 'finger_left']
    joints = f'[{", ".join(names)}]'
    states, brakes = robot.listen(JointState, 'joint_states'), []
    robot.node.create_subscription(Bool, 'brakes', lambda m: brakes.append(m.data), LATCHED)
    process = run_program(*SIMULATE, GRIPPER_ARM, *COMMANDS, '-p', f'joints:={joints}')
    node = run_node(
        robot_description_file=f"'{description}'",
        mode='gravity_compensation',
        joints=joints,
        state_timeout=5.0,
    )
    robot.wait_until(lambda: brakes and not brakes[-1], 'a robot that follows')
    open_at = len(states)
    robot.wait_until(lambda: len(states) > open_at + 2 * RATE, 'two seconds')
    assert node.process.poll() is None
    assert shared_memory_of(process.pid) == []  # it would hold up joint states now and then
    before, after = (
        np.array([dict(zip(state.name, state.position, strict=True))[name] for name in names])
        for state in (states[open_at], states[-1])
    )
    moved = abs(after - before).max()
    assert (moved < 0.01) if has_mass else (moved > 0.03), moved
