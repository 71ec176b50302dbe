"""The node as a process, and the robot that it is connected to, on their own domain."""

from array import array
from collections.abc import Callable
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

# Before rclpy is loaded: nothing that a test sends may leave this machine.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ.pop('ROS_STATIC_PEERS', None)
os.environ['PYTHONUNBUFFERED'] = '1'

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time
from domain_coordinator import domain_id as unused_domain_id
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import GetParameters, SetParameters
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

MAIN = 'inverse_dynamics_node.node.main'
RUNNING = []  # nodes of the test; an error in one of them ends the waiting
PATIENCE = 60.0  # [s]; ten times as long as a loaded machine needs


@pytest.fixture
def domain_id():
    with unused_domain_id() as number:
        yield number


@pytest.fixture
def run_node(domain_id):
    """Return a function that starts the node as a process, with ROS arguments."""
    nodes = []

    def run(*arguments, **parameters):
        nodes.append(NodeProcess(domain_id, arguments, parameters))
        RUNNING.append(nodes[-1])
        return nodes[-1]

    yield run
    for node in nodes:
        node.kill()
    RUNNING.clear()


@pytest.fixture
def robot(domain_id):
    """Return a robot that publishes joint states and stores the commands that it receives."""
    context = Context()
    context.init(args=[], domain_id=domain_id)
    side = RobotSide(context)
    yield side
    side.close()


def heed_signals():
    """Reset signals that nohup, or a shell with background jobs, ignores in its children."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


class NodeProcess:
    """The node, as `ros2 run` starts it."""

    def __init__(self, domain_id, arguments, parameters):
        settings = [x for k, v in parameters.items() for x in ('-p', f'{k}:={v}')]
        self.output = ''
        self.process = subprocess.Popen(
            [sys.executable, '-m', MAIN, '--ros-args', *arguments, *settings],
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            preexec_fn=heed_signals,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.output += line

    def wait(self):
        """Wait for the process to end; return its exit code."""
        code = self.process.wait(PATIENCE)
        self._reader.join(PATIENCE)
        return code

    def interrupt(self, number=signal.SIGINT):
        self.process.send_signal(number)

    def kill(self):
        """End the process; SIGTERM first, so that it removes its shared memory."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(10.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._reader.join(PATIENCE)


class RobotSide:
    """Publishes the topics of a robot while it waits for a condition."""

    def __init__(self, context):
        self.context = context
        self.node = rclpy.create_node('robot', context=context)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.commands = []
        self.command_times = []
        self.joint_efforts = []
        self.peer = 'inverse_dynamics'  # the node whose services are called
        self.sent = 0  # timer events, 5 ms apart if the machine is fast enough
        self.state = None
        create_publisher = self.node.create_publisher
        self._states = create_publisher(JointState, 'joint_states', 10)
        self._accelerations = create_publisher(
            Float64MultiArray, 'inverse_dynamics/desired_accelerations', 10
        )
        self._reference = create_publisher(JointTrajectory, 'inverse_dynamics/reference', 10)
        self.node.create_subscription(
            Float64MultiArray, 'inverse_dynamics/commands', self._on_command, 100
        )
        self._always = []
        self._timer = self.node.create_timer(0.005, self._on_timer)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def _on_command(self, message):
        self.commands.append(list(message.data))
        self.command_times.append(time.monotonic())

    def _on_timer(self):
        self.sent += 1
        if self.state is not None:
            self.state.header.stamp = self.node.get_clock().now().to_msg()
            self._states.publish(self.state)
        for publisher, message in self._always:
            publisher.publish(message() if callable(message) else message)

    def publish_state(self, names, positions, velocities=(), efforts=()):
        """Publish a joint state from now on, 200 times a second."""
        self.state = JointState(
            name=list(names),
            position=list(positions),
            velocity=list(velocities),
            effort=list(efforts),
        )

    def keep_publishing(self, topic, message):
        """Publish a message from now on, 200 times a second; return the argument of `cease`."""
        self._always.append((self.node.create_publisher(type(message), topic, 10), message))
        return self._always[-1]

    def keep_ticking(self, start):
        """Publish a /clock that advances by 5 ms at a time; return a function for jumps."""
        time = [start]

        def message():
            time[0] += 0.005
            return Clock(clock=Time(sec=int(time[0]), nanosec=int(time[0] % 1.0 * 1e9)))

        self._always.append((self.node.create_publisher(Clock, '/clock', 10), message))

        def jump(seconds):
            time[0] += seconds

        return jump

    def cease(self, publication):
        """Stop publishing a message."""
        self._always.remove(publication)

    def publish_once(self, topic, message):
        """Publish a message as soon as there is a subscriber."""
        publisher = self.node.create_publisher(type(message), topic, 10)
        self.wait_until(publisher.get_subscription_count, f'subscription to {topic}')
        publisher.publish(message)

    def listen(self, kind, topic):
        """Return a list to which every message of a topic is appended."""
        received = []
        self.node.create_subscription(kind, topic, received.append, 100)
        return received

    def wait_for(self, messages, is_good, what):
        """Wait for a message that fulfils a condition; return it."""
        self.wait_until(lambda: any(map(is_good, messages)), what)
        return next(filter(is_good, messages))

    def publish_accelerations(self, accelerations):
        """Publish desired accelerations from now on, 200 times a second."""
        message = Float64MultiArray(data=list(accelerations))
        self._always = [(self._accelerations, message)]

    def publish_reference(self, names, accelerations, effort=(), positions=(), velocities=()):
        """Publish a reference from now on, 200 times a second."""
        point = JointTrajectoryPoint(
            accelerations=list(accelerations),
            effort=list(effort),
            positions=list(positions),
            velocities=list(velocities),
        )
        message = JointTrajectory(joint_names=list(names), points=[point])
        self._always = [(self._reference, message)]

    def publish_description(self, text):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._description = self.node.create_publisher(String, 'robot_description', latched)
        self._description.publish(String(data=text))

    def publish_again(self, description):
        """Publish another description with the same publisher, which keeps them in order."""
        self._description.publish(String(data=description))

    def listen_to_joint_efforts(self):
        self.joint_efforts = self.listen(JointState, 'inverse_dynamics/joint_efforts')

    def wait_until(self, is_true: Callable[[], bool], what):
        """Spin until a condition is true; fail with a description if it never is."""
        deadline = time.monotonic() + PATIENCE
        while not is_true():
            assert time.monotonic() < deadline, f'{what}: not within {PATIENCE:g} s'
            for node in RUNNING:
                assert 'Traceback' not in node.output, node.output
            self.executor.spin_once(timeout_sec=0.05)

    def wait_for_command(self, expected, tolerance=1e-9):
        """Wait for a command of these efforts."""

        def is_there():
            return bool(self.commands) and self.commands[-1] == pytest.approx(
                list(expected), rel=tolerance, abs=tolerance
            )

        try:
            self.wait_until(is_there, 'command')
        except AssertionError as error:
            last = self.commands[-1] if self.commands else None
            raise AssertionError(f'expected {list(expected)}, last was {last}') from error

    def wait_for_text(self, node, text):
        self.wait_until(
            lambda: text in node.output or node.process.poll() is not None, f"'{text}' in the log"
        )
        assert text in node.output

    def wait_for_end(self, node):
        """Wait for the node to end while the robot keeps publishing; return the exit code."""
        self.wait_until(lambda: node.process.poll() is not None, 'end of the node')
        code = node.wait()
        # Handle the messages that have been delivered.
        for _ in range(20):
            self.executor.spin_once(timeout_sec=0.02)
        return code

    def call(self, type_, name, request):
        client = self.node.create_client(type_, f'{self.peer}/{name}')
        self.wait_until(client.service_is_ready, f'service {name}')
        future = client.call_async(request)
        self.wait_until(future.done, f'answer of {name}')
        return future.result()

    def change_state(self, name):
        """Request a lifecycle transition by name; return whether it succeeded."""
        number = getattr(Transition, f'TRANSITION_{name.upper()}')
        request = ChangeState.Request(transition=Transition(id=number))
        return self.call(ChangeState, 'change_state', request).success

    def get_state(self):
        return self.call(GetState, 'get_state', GetState.Request()).current_state.label

    def get_parameter(self, name):
        answer = self.call(GetParameters, 'get_parameters', GetParameters.Request(names=[name]))
        value = parameter_value_to_python(answer.values[0])
        return list(value) if isinstance(value, (list, array)) else value

    def set_parameter(self, name, value):
        parameter = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        return self.call(SetParameters, 'set_parameters', request).results[0]
