"""
The simulated robot as a ROS process: publishes ``joint_states`` and obeys ``commands``.

It behaves as an arm behind joint_state_broadcaster and forward_command_controller: joint states
come at a fixed rate, sorted by name, and the last complete, finite command is held for ever.

Brakes hold the arm until commands have come for a while, as they do on an arm that is switched on:
whatever commands it may start late, and ramp its efforts up, without dropping it. The topic
``brakes`` says whether they are on. Once open they stay open, also when commands stop.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import math
from pathlib import Path
import signal
import sys
import time
from typing import Any

import rclpy
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from ..dynamics import InverseDynamics
from ..errors import InverseDynamicsError
from ..urdf import load_urdf
from .mujoco_robot import MujocoRobot
from .trajectory import start_pose

MOST_LAG = 0.5  # [s]: beyond this the simulated time waits for the machine
GAP = 0.1  # [s]: commands further apart than this are not a flow that brakes can rely on
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class RobotNode(Node):
    """
    Topics of a simulated robot.

    Parameters
    ----------
    robot : MujocoRobot
        The hardware.
    brake_release : float
        How long commands must have come before the brakes open [s].
    **options
        For rclpy's ``Node``.

    """

    def __init__(self, robot: MujocoRobot, brake_release: float, **options: Any) -> None:
        super().__init__('simulated_robot', **options)
        self._robot = robot
        self._brake_release = brake_release
        self._last_command = -math.inf
        self._flow_began = -math.inf
        self._began = self.get_clock().now().nanoseconds
        self._elapsed = 0.0
        self._complaint = ''
        self._state = JointState(name=robot.state_names)
        self._states = self.create_publisher(JointState, 'joint_states', 10)
        self._brakes = self.create_publisher(Bool, 'brakes', LATCHED)
        self._brakes.publish(Bool(data=robot.brakes_on))
        self.create_subscription(Float64MultiArray, 'commands', self._on_command, 10)
        # The first word to a logger takes tens of milliseconds: better now than in the loop.
        self.get_logger().info(f'{robot.robot.name!r} stands with its brakes on')

    def advance(self, duration: float) -> None:
        """Let time pass [s] and say where the joints are then."""
        self._robot.advance(duration)
        self._elapsed += duration
        # Stamps count simulated time: after a stall of the machine they tell when the state was
        # true for the robot, not when the machine got round to it.
        stamp = Time(nanoseconds=self._began + round(self._elapsed * 1e9))
        positions, velocities, efforts = self._robot.state()
        self._state.header.stamp = stamp.to_msg()
        self._state.position = positions.tolist()
        self._state.velocity = velocities.tolist()
        self._state.effort = efforts.tolist()
        self._states.publish(self._state)

    def _on_command(self, message: Float64MultiArray) -> None:
        complaint = self._fault(message)
        if complaint != self._complaint and complaint:
            self.get_logger().error(complaint)
        self._complaint = complaint
        if not complaint:
            self._robot.command(message.data)
            self._update_brakes()

    def _fault(self, message: Float64MultiArray) -> str:
        expected = len(self._robot.robot.joint_names)
        if len(message.data) != expected:
            return f'command ignored: it has {len(message.data)} efforts, expected {expected}'
        if not all(map(math.isfinite, message.data)):
            return 'command ignored: an effort in it is not finite'
        return ''

    def _update_brakes(self) -> None:
        now = self._elapsed
        if now - self._last_command > GAP:
            self._flow_began = now
        self._last_command = now
        if self._robot.brakes_on and now - self._flow_began >= self._brake_release:
            self._robot.brakes_on = False
            self._brakes.publish(Bool(data=False))
            self.get_logger().info('brakes open')


def run(node: RobotNode, executor: Executor, rate: float, stop: Callable[[], bool]) -> None:
    """
    Keep a simulated robot in step with the steady clock.

    When the machine stalls, the robot catches up at twice its speed: no state is left out, and no
    burst of states overruns a subscriber that keeps only the newest.

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


def main(arguments: list[str] | None = None) -> int:
    """Run one simulated robot until SIGINT or SIGTERM; return the exit code."""
    options = _parse(remove_ros_args(sys.argv if arguments is None else ['', *arguments])[1:])
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: stopped.append(number))
    try:
        robot = load_urdf(options.robot)
        start = start_pose(robot, InverseDynamics(robot))
        hardware = MujocoRobot(options.robot, robot, start, options.friction)
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        try:
            _serve(hardware, options, lambda: bool(stopped))
        finally:
            rclpy.shutdown()
    except (InverseDynamicsError, OSError) as error:
        print(f'simulated robot: {error}', file=sys.stderr)
        return 1
    return 0


def _serve(hardware: MujocoRobot, options: argparse.Namespace, stop: Callable[[], bool]) -> None:
    node = RobotNode(hardware, options.brake_release)
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        run(node, executor, options.rate, stop)
    finally:
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description='A simulated robot behind ROS topics.')
    parser.add_argument('robot', type=Path, help='its URDF')
    parser.add_argument('--rate', type=float, default=500.0, help='of joint states [Hz]')
    parser.add_argument(
        '--brake-release',
        type=float,
        default=1.5,
        help='how long commands must have come before the brakes open [s]',
    )
    parser.add_argument(
        '--friction',
        action='store_true',
        help='give the joints the damping and friction of the URDF, else they have none',
    )
    return parser.parse_args(arguments)


if __name__ == '__main__':
    sys.exit(main())
