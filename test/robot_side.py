"""The robot that a node is connected to."""

from array import array
from collections.abc import Callable
import itertools
import time

from builtin_interfaces.msg import Time
from inverse_dynamics_node import InverseDynamics, load_urdf
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from node_process import PATIENCE, RUNNING
import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters, SetParameters
import rclpy
from rclpy.duration import Duration
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile
from robot_files import STANFORD
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

ANSWER_TIME = 10.0  # [s]; a request without an answer for this long is sent again
REPETITION = 3.0  # [s]; between messages that may be lost
RATE = 100  # [Hz]; of joint states and everything else that is published without pause
CHECK_PERIOD = 0.1  # [s]; of the nodes, for errors
MODEL = load_urdf(STANFORD)
DYNAMICS = InverseDynamics(MODEL)
NAMES = list(MODEL.joint_names)
Q, ZERO = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2]), np.zeros(6)
# So slow that positions that do not change do not contradict it within a second.
QD = 0.05 * np.array([0.1, -0.2, 0.05, 0.3, -0.1, 0.4])
QDD = np.array([0.5, 0.4, -0.3, 0.2, 0.1, -0.6])
HOLD = DYNAMICS.gravity_efforts(Q)
FAST = {'robot_description_file': STANFORD, 'start_ramp': 0.0, 'stop_ramp': 0.2}
# With a time-out that a busy machine does not reach between two messages.
PATIENT = {**FAST, 'state_timeout': 5.0, 'reference_timeout': 5.0}
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def check_nodes(what):
    """Fail if a node has crashed, or ended before a condition was true."""
    for node in RUNNING:
        assert node.may_crash or 'Traceback' not in node.output, 'a node has crashed'
        has_ended = node.process.poll() is not None
        assert node.may_end or not has_ended, f'{what}: a node has ended before'


def recording_at_rest(names, positions, efforts):
    """Return joint states of an arm at rest, with the noise of sensors, in the order of time."""
    random = np.random.default_rng(1)

    def noise(size):
        return random.normal(scale=size, size=len(names))

    return [
        JointState(
            name=list(names),
            position=list(positions + noise(1e-5)),
            velocity=list(noise(1e-3)),
            effort=list(efforts + noise(0.02)),
        )
        for _ in range(200)
    ]


class RobotSide:
    """Publishes the topics of a robot while it waits for a condition."""

    def __init__(self, context):
        self.context = context
        self.node = rclpy.create_node('robot', context=context)
        self.executor = EventsExecutor(context=context)
        self.executor.add_node(self.node)
        self.commands = []
        self.command_times = []
        self.joint_efforts = []
        self.peer = 'inverse_dynamics'  # the node whose services are called
        self.sent = 0  # timer events, RATE per second if the machine is fast enough
        self.age = 0.0  # [s]; of the stamps of joint states
        self.state = None
        self.last_state = 0.0  # steady time at which the last joint state was published [s]
        self._clients = {}
        create_publisher = self.node.create_publisher
        self._states = create_publisher(JointState, 'joint_states', 10)
        self._accelerations = create_publisher(
            Float64MultiArray, 'inverse_dynamics/desired_accelerations', 10
        )
        self._reference = create_publisher(JointTrajectory, 'inverse_dynamics/reference', 10)
        self._command_topic = self.node.create_subscription(
            Float64MultiArray, 'inverse_dynamics/commands', self._on_command, 100
        )
        self._always = []
        self._timer = self.node.create_timer(1.0 / RATE, self._on_timer)

    def close(self):
        self.executor.remove_node(self.node)  # before its entities end, or their events may crash
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def _on_command(self, message):
        self.commands.append(list(message.data))
        self.command_times.append(time.monotonic())

    def _on_timer(self):
        self.sent += 1
        if self.state is not None:
            stamp = self.node.get_clock().now() - Duration(seconds=self.age)
            self.state.header.stamp = stamp.to_msg()
            self.last_state = time.monotonic()
            self._states.publish(self.state)
        for publisher, message in self._always:
            publisher.publish(message() if callable(message) else message)

    def publish_state(self, names, positions, velocities=(), efforts=()):
        """Publish a joint state from now on, RATE times a second."""
        self.state = JointState(
            name=list(names),
            position=list(positions),
            velocity=list(velocities),
            effort=list(efforts),
        )

    def replay(self, recording):
        """Publish joint states from now on, one after the other, RATE times a second."""
        self._always.append((self._states, itertools.cycle(recording).__next__))

    def keep_publishing(self, topic, message, kind=None):
        """
        Publish a message from now on, RATE times a second; return the argument of `cease`.

        A function that returns the message needs the kind of message, too.
        """
        publisher = self.node.create_publisher(kind or type(message), topic, 10)
        self._always.append((publisher, message))
        return self._always[-1]

    def keep_ticking(self, start):
        """Publish a /clock that advances by one period at a time; return a function for jumps."""
        time = [start]

        def message():
            time[0] += 1.0 / RATE
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

    def publish_until(self, is_true, what, topic, message):
        """Publish a message once, and again every few seconds until a condition is true."""
        publisher = self.node.create_publisher(type(message), topic, 10)
        self.wait_until(publisher.get_subscription_count, f'subscription to {topic}')
        due = [0.0]

        def try_again():
            if not is_true() and time.monotonic() > due[0]:
                publisher.publish(message)
                due[0] = time.monotonic() + REPETITION
            return is_true()

        self.wait_until(try_again, what)

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
        """Publish desired accelerations from now on, RATE times a second."""
        message = Float64MultiArray(data=list(accelerations))
        self._always = [(self._accelerations, message)]

    def publish_reference(self, names, accelerations, effort=(), positions=(), velocities=()):
        """Publish a reference from now on, RATE times a second."""
        point = JointTrajectoryPoint(
            accelerations=list(accelerations),
            effort=list(effort),
            positions=list(positions),
            velocities=list(velocities),
        )
        message = JointTrajectory(joint_names=list(names), points=[point])
        self._always = [(self._reference, message)]

    def publish_description(self, text):
        self._description = self.node.create_publisher(String, 'robot_description', LATCHED)
        self._description.publish(String(data=text))

    def publish_again(self, description):
        """Publish another description with the same publisher, which keeps them in order."""
        self._description.publish(String(data=description))

    def listen_to_joint_efforts(self):
        self.joint_efforts = self.listen(JointState, 'inverse_dynamics/joint_efforts')

    def wait_until(self, is_true: Callable[[], bool], what):
        """Spin until a condition is true; fail with a description if it never is."""
        deadline, check_at = time.monotonic() + PATIENCE, 0.0
        while not is_true():
            if time.monotonic() >= check_at:
                assert time.monotonic() < deadline, f'{what}: not within {PATIENCE:g} s'
                check_nodes(what)
                check_at = time.monotonic() + CHECK_PERIOD
            self.executor.spin_once(timeout_sec=0.05)

    def describe(self):
        """Describe which messages and nodes have arrived, for the report of a failure."""
        return '\n'.join(
            [
                f'joint states and other messages were published {self.sent} times',
                f'{len(self.commands)} commands received, the last: {self.commands[-1:]}',
                f'nodes: {self.node.get_node_names()}',
                *(
                    f'{publisher.topic_name}: {publisher.get_subscription_count()} subscribers'
                    for publisher in self.node.publishers
                ),
                *(
                    f'{subscription.topic_name}: '
                    f'{self.node.count_publishers(subscription.topic_name)} publishers'
                    for subscription in self.node.subscriptions
                ),
            ]
        )

    def wait_for_command(self, expected, tolerance=1e-9):
        """Wait for a command of these efforts."""
        wanted, compared = pytest.approx(list(expected), rel=tolerance, abs=tolerance), [None]

        def is_there():
            """Compare the last command, if it is another one than before."""
            last, compared[0] = compared[0], self.commands[-1] if self.commands else None
            return compared[0] is not last and compared[0] == wanted

        try:
            self.wait_until(is_there, 'command')
        except AssertionError as error:
            last = self.commands[-1] if self.commands else None
            raise AssertionError(f'expected {list(expected)}, last was {last}') from error

    def wait_for_text(self, node, text):
        self.wait_until(
            lambda: text in node.output or node.process.poll() is not None, f"'{text}' in the log"
        )
        if node.process.poll() is not None:
            node.wait()  # until all of its log has been read
        assert text in node.output, f'{text!r} is not in the log'

    def wait_for_end(self, node):
        """Wait for the node to end while the robot keeps publishing; return the exit code."""
        node.may_end = True
        self.wait_until(lambda: node.process.poll() is not None, 'end of the node')
        code = node.wait()
        # The node has waited for the acknowledgement of its last command: it is in the queue.
        while self._take_command():
            pass
        return code

    def _take_command(self):
        with self._command_topic.handle:
            taken = self._command_topic.handle.take_message(Float64MultiArray, False)
        if taken is not None:
            self._on_command(taken[0])
        return taken is not None

    def call(self, type_, name, request):
        key = type_, f'{self.peer}/{name}'
        if key not in self._clients:
            self._clients[key] = self.node.create_client(*key)
        client = self._clients[key]
        self.wait_until(client.service_is_ready, f'service {name}')
        # The middleware drops an answer if it has not discovered the client by then.
        futures, due = [], [0.0]

        def has_answer():
            if time.monotonic() > due[0]:
                futures.append(client.call_async(request))
                due[0] = time.monotonic() + ANSWER_TIME
            return any(future.done() for future in futures)

        self.wait_until(has_answer, f'answer of {name}')
        return next(future for future in futures if future.done()).result()

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
