"""
The simulated robot as a ROS process: publishes ``joint_states`` and applies ``commands``.

The robot behaves like an arm with joint_state_broadcaster and forward_command_controller, or like
an arm behind another driver. Joint states are sorted by name and published at a fixed rate. The
topic ``brakes`` reports whether the position controller of the robot holds it.

The parameter ``joints`` names the commanded joints, in the order of the commands. The others hold
their positions, such as those of a gripper.

Messages on two topics disturb the robot:

- ``~/payload`` attaches a load to a link; a mass of 0 removes the load.
- ``~/push`` applies a wrench to a link until the next message for this link. The wrench is in the
  link frame, about the origin of the frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import gc
from pathlib import Path
import signal
import sys
import time
from typing import Any, TypeVar

from geometry_msgs.msg import InertiaStamped, WrenchStamped
import numpy as np
from numpy.typing import ArrayLike
from rcl_interfaces.msg import ParameterDescriptor
import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import InverseDynamicsError
from ..robot.model import Floats, RobotModel
from ..robot.urdf import load_urdf
from ..robot.urdf.checks import inertia_tensor, MOMENTS
from ..ros.middleware import explained_start, LATCHED, start_ros
from .drivers import Actuation, Driver, Form, IDEAL, read_command, read_motion
from .hand_over import HandOver, PositionLoop, RELEASE
from .mujoco import MujocoRobot
from .trajectory import start_pose

COMPLAINT_PERIOD = 5.0  # [s]: shortest time between logs of wrong commands
_LARGEST_DELAY = 20_000_000  # [ns]: of the stamps behind the clock
MOST_LAG = 0.5  # [s]: largest lag of the simulated time behind the steady clock

N = TypeVar('N', bound=Node)


class RobotNode(Node):
    """
    Connects a simulated robot to its topics.

    With ``sways``, the robot moves back and forth until commands arrive. The robot follows the
    commands after they have arrived for ``release`` seconds. By default, the robot starts in a
    pose that is easy to hold. ``options`` are arguments of rclpy's ``Node``.
    """

    def __init__(
        self,
        robot: RobotModel,
        driver: Driver = IDEAL,
        *,
        start: ArrayLike | None = None,
        sways: bool = False,
        release: float = RELEASE,
        **options: Any,
    ) -> None:
        super().__init__('simulated_robot', **options)
        if start is None:
            start = start_pose(robot, InverseDynamics(robot))
        description = ParameterDescriptor(
            description='Commanded joints, in the order of the commands.', read_only=True
        )
        joints = self.declare_parameter('joints', list(robot.joint_names), description).value
        self.robot = MujocoRobot(robot, start, friction=False, joints=joints)
        self._actuation = Actuation(self.robot, driver)
        self._hand_over: HandOver | PositionLoop
        holder = 'its position controller'
        if driver.has_position_loop:
            self._hand_over = PositionLoop(self._actuation)
            holder = 'the position loops of its drives'
            self.create_subscription(JointState, '~/positions', self._on_positions, 10)
        else:
            self._hand_over = HandOver(self._actuation, self.get_logger(), sways, release)
        self._began: int | None = None
        self._elapsed = 0.0
        self._state = JointState(name=self.robot.state_names)
        self._states = self.create_publisher(JointState, 'joint_states', 10)
        self._is_held = Bool(data=True)
        self._brakes = self.create_publisher(Bool, 'brakes', LATCHED)
        self._brakes.publish(self._is_held)
        self._clocks = self.create_publisher(Clock, '/clock', 10) if driver.has_clock else None
        if driver.form is not Form.NONE:
            kind = Float64MultiArray if driver.form is Form.EFFORTS else JointState
            self.create_subscription(kind, 'commands', self._on_command, 10)
        self.create_subscription(InertiaStamped, '~/payload', self._on_payload, 10)
        self.create_subscription(WrenchStamped, '~/push', self._on_push, 10)
        # Log before the loop starts: the first call of a logger takes tens of milliseconds.
        awaits = f'awaits commands on {self.resolve_topic_name("commands")}'
        if driver.form is Form.NONE:
            awaits = 'takes no commands'
        self.get_logger().info(f'{robot.name!r} is held by {holder}, and {awaits}')

    def advance(self, duration: float) -> None:
        """Advance the simulation by a duration [s], and publish the new state."""
        self._hand_over.advance(self._elapsed, duration)
        self._elapsed += duration
        now = self.get_clock().now().nanoseconds
        if self._began is None:
            self._began = now
        # Stamps are in simulated time, because states are published late after a pause of the
        # machine. Without /clock, a simulation that is farther behind would look like a delay of
        # the driver.
        nanoseconds = self._began + round(self._elapsed * 1e9)
        if self._clocks is None:
            nanoseconds = max(nanoseconds, now - _LARGEST_DELAY)
        stamp = Time(nanoseconds=nanoseconds).to_msg()
        if self._clocks is not None:
            self._clocks.publish(Clock(clock=stamp))
        positions, velocities, efforts = self.robot.state()
        self._state.header.stamp = stamp
        self._state.position = positions.tolist()
        self._state.velocity = velocities.tolist()
        self._state.effort = self._actuation.measured(efforts).tolist()
        self._states.publish(self._state)
        if self._hand_over.is_held != self._is_held.data:
            self._is_held.data = self._hand_over.is_held
            self._brakes.publish(self._is_held)

    def _on_command(self, message: Float64MultiArray | JointState) -> None:
        try:
            command = read_command(self._actuation.driver, self.robot.command_names, message)
        except ValueError as error:
            text = f'command ignored: {error}'
            self.get_logger().error(text, throttle_duration_sec=COMPLAINT_PERIOD)
            return
        self._hand_over.command(command, self._elapsed)

    def _on_positions(self, message: JointState) -> None:
        """Let the position loops of the drives follow positions and velocities by name."""
        try:
            positions, velocities = read_motion(self.robot.command_names, message)
        except ValueError as error:
            text = f'positions ignored: {error}'
            self.get_logger().error(text, throttle_duration_sec=COMPLAINT_PERIOD)
            return
        if isinstance(self._hand_over, PositionLoop):
            self._hand_over.follow(positions, velocities)

    def _on_payload(self, message: InertiaStamped) -> None:
        load = message.inertia
        tensor = inertia_tensor([getattr(load, name) for name in MOMENTS])
        link = message.header.frame_id
        self._apply(lambda: self.robot.set_payload(link, load.m, _read(load.com), tensor))

    def _on_push(self, message: WrenchStamped) -> None:
        force, moment = _read(message.wrench.force), _read(message.wrench.torque)
        link = message.header.frame_id
        self._apply(lambda: self.robot.set_external_wrench(link, force, moment))

    def _apply(self, change: Callable[[], None]) -> None:
        try:
            change()
        except InverseDynamicsError as error:
            self.get_logger().error(str(error))


def _read(vector: Any) -> Floats:
    return np.array([vector.x, vector.y, vector.z])


@contextmanager
def executing(
    arguments: Sequence[str], make_node: Callable[[], N]
) -> Iterator[tuple[N, EventsExecutor]]:
    """Start ROS, and yield a new node and its executor; on exit, end all three."""
    with explained_start():
        start_ros(list(arguments))
    try:
        with explained_start():
            node = make_node()
        executor = EventsExecutor()
        executor.add_node(node)
        # Garbage collection of the objects of the libraries would take 0.1 s each time.
        gc.collect()
        gc.freeze()
        try:
            yield node, executor
        finally:
            executor.remove_node(node)
            executor.shutdown()
            node.destroy_node()
    finally:
        rclpy.shutdown()


def run(node: RobotNode, executor: Executor, rate: float, stop: Callable[[], object]) -> None:
    """
    Advance a simulated robot in step with the steady clock until ``stop`` returns a true value.

    After a pause of the machine, the simulation catches up at twice the normal speed. At a higher
    speed, a subscriber that keeps only the latest state would miss states.
    """
    period = 1.0 / rate
    due = time.monotonic()
    while not stop():
        now = time.monotonic()
        due = max(due + period, now - MOST_LAG)
        wake = max(due, now + 0.5 * period)
        while (left := wake - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
        node.advance(period)


def simulate(
    urdf: str | Path, driver: Driver, rate: float, arguments: Sequence[str], **options: Any
) -> int:
    """
    Run one simulated robot until SIGINT or SIGTERM; return the exit code.

    ``rate`` is the number of joint states per second, ``arguments`` are those of ROS, and
    ``options`` are those of `RobotNode`.
    """
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: stopped.append(number))
    try:
        robot = load_urdf(urdf)
        with executing(arguments, lambda: RobotNode(robot, driver, **options)) as (node, executor):
            run(node, executor, rate, lambda: stopped)
    except (InverseDynamicsError, ParameterException, OSError) as error:
        print(f'simulated robot: {error}', file=sys.stderr)
        return 1
    return 0
