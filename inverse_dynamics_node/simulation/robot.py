"""
The simulated robot as a ROS process: publishes ``joint_states`` and applies ``commands``.

The robot behaves like an arm with joint_state_broadcaster and forward_command_controller. Joint
states are sorted by name and published at a fixed rate. A command applies until the next command
that is complete and finite.

Brakes hold the robot until commands have arrived for a while. A controller may therefore start
late and ramp up its efforts without dropping the arm. The topic ``brakes`` reports whether the
brakes are on. Open brakes stay open if the commands stop, but not if the sensors are lost.

With ``--drive``, a position controller replaces the brakes. While this controller holds the robot,
the joint states contain the efforts of the controller. The commands take over after they have
arrived for a while and their efforts are steady. The controller takes over again when the
commands stop, when a joint becomes too fast, or when the service ``~/hold`` is called. With
``--driver``, commands and measured efforts follow the conventions of a driver.

Messages on four topics disturb the robot:

- ``~/payload`` attaches a load to a link; a mass of 0 removes the load.
- ``~/push`` applies a wrench to a link until the next message for this link. The wrench is in the
  link frame, about the origin of the frame.
- ``~/tilt`` turns the base to a new attitude in 3 s. The attitude is a rotation vector [rad]
  relative to the level base.
- ``~/sensors`` simulates a loss of the encoders: false stops the joint states and applies the
  brakes, and true resumes the joint states.

The topic ``imu`` has the measurements of an IMU on the base.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import gc
import math
from pathlib import Path
import signal
import sys
import time
from typing import Any

from geometry_msgs.msg import InertiaStamped, Vector3Stamped, WrenchStamped
import numpy as np
import rclpy
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.time import Time
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import SetBool

from ..dynamics.arguments import read_vector
from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import InverseDynamicsError
from ..robot.kinematics import rotation_of_rpy
from ..robot.model import Floats
from ..robot.urdf import load_urdf
from ..robot.urdf.schema import inertia_tensor, MOMENTS
from ..ros.middleware import explained_start, start_ros
from ..ros.qos import LATCHED
from .drive import COMPLAINT_PERIOD, GAP, HandOver, PositionDrive
from .drivers import Actuation, Driver, DRIVERS, Form, read_command, TORQUES
from .mujoco.hardware import MujocoRobot
from .mujoco.model import SimulationError
from .mujoco.world import Tilt
from .trajectory import start_pose

MOST_LAG = 0.5  # [s]: largest lag of the simulated time behind the steady clock


class RobotNode(Node):
    """
    Connects a simulated robot to its topics.

    The brakes open after commands have arrived for ``brake_release`` seconds. A ``drive`` replaces
    the brakes. ``imu_orientation`` is roll, pitch and yaw of the IMU in the base frame [rad].
    ``options`` are arguments of rclpy's ``Node``.
    """

    def __init__(
        self,
        robot: MujocoRobot,
        brake_release: float,
        imu_orientation: Sequence[float] = (0.0, 0.0, 0.0),
        drive: PositionDrive | None = None,
        driver: Driver = TORQUES,
        **options: Any,
    ) -> None:
        super().__init__('simulated_robot', **options)
        self._robot = robot
        self._actuation = Actuation(robot, driver)
        self._hand_over: HandOver | None = None
        if drive is not None:
            self._hand_over = HandOver(self._actuation, drive, brake_release, self.get_logger())
            self.create_service(SetBool, '~/hold', self._on_hold)
        self._R_BS = rotation_of_rpy(*imu_orientation)
        self._tilt = Tilt()
        self._has_sensors = True
        self._brake_release = brake_release
        self._last_command = self._flow_began = -math.inf
        self._began: int | None = None
        self._elapsed = 0.0
        self._complaint_due = -math.inf
        self._ignored = 0
        self._state = JointState(name=robot.state_names)
        self._states = self.create_publisher(JointState, 'joint_states', 10)
        self._brakes = self.create_publisher(Bool, 'brakes', LATCHED)
        self._brakes.publish(Bool(data=robot.brakes_on))
        self._imu = Imu()
        self._imu.header.frame_id = 'imu'
        self._imu.orientation_covariance[0] = -1.0  # the sensor reports no orientation
        self._imus = self.create_publisher(Imu, 'imu', 10)
        self._clocks = self.create_publisher(Clock, '/clock', 10) if driver.has_clock else None
        if driver.form is not Form.NONE:
            kind = Float64MultiArray if driver.form is Form.EFFORTS else JointState
            self.create_subscription(kind, 'commands', self._on_command, 10)
        for message, topic, callback in (
            (InertiaStamped, '~/payload', self._on_payload),
            (WrenchStamped, '~/push', self._on_push),
            (Vector3Stamped, '~/tilt', self._on_tilt),
            (Bool, '~/sensors', self._on_sensors),
        ):
            self.create_subscription(message, topic, callback, 10)
        # Log before the loop starts: the first call of a logger takes tens of milliseconds.
        held, topic = 'stands with its brakes on', self.resolve_topic_name('commands')
        if drive is not None:
            awaits = (
                'takes no commands' if driver.form is Form.NONE else f'awaits commands on {topic}'
            )
            held = f'is held by its position controller, and {awaits}'
        self.get_logger().info(f'{robot.robot.name!r} {held}')

    def advance(self, duration: float) -> None:
        """Advance the simulation by a duration [s], and publish the new state."""
        self._robot.world.set_base_motion(*self._tilt.motion(self._elapsed))
        if self._hand_over is None:
            self._robot.advance(duration)
        else:
            self._hand_over.advance(self._elapsed, duration)
        self._elapsed += duration
        if self._began is None:
            self._began = self.get_clock().now().nanoseconds
        # Stamps are in simulated time, because states are published late after a pause of the
        # machine.
        stamp = Time(nanoseconds=self._began + round(self._elapsed * 1e9)).to_msg()
        if self._clocks is not None:
            self._clocks.publish(Clock(clock=stamp))
        if self._has_sensors:
            self._publish_state(stamp)
        if self._imus.get_subscription_count():
            self._publish_imu(stamp)

    def _publish_state(self, stamp: Any) -> None:
        positions, velocities, efforts = self._robot.state()
        self._state.header.stamp = stamp
        self._state.position = positions.tolist()
        self._state.velocity = velocities.tolist()
        self._state.effort = self._actuation.measured(efforts).tolist()
        self._states.publish(self._state)

    def _publish_imu(self, stamp: Any) -> None:
        gravity, angular_velocity, _ = self._tilt.motion(self._elapsed)
        self._imu.header.stamp = stamp
        _write(self._imu.angular_velocity, self._R_BS.T @ angular_velocity)
        # The IMU measures only gravity, because the base turns about the IMU.
        _write(self._imu.linear_acceleration, -self._R_BS.T @ gravity)
        self._imus.publish(self._imu)

    # Disturbances

    def _on_payload(self, message: InertiaStamped) -> None:
        load = message.inertia
        tensor = inertia_tensor([getattr(load, name) for name in MOMENTS])
        link, world = message.header.frame_id, self._robot.world
        self._apply(lambda: world.set_payload(link, load.m, _read(load.com), tensor))

    def _on_push(self, message: WrenchStamped) -> None:
        force, moment = _read(message.wrench.force), _read(message.wrench.torque)
        link, world = message.header.frame_id, self._robot.world
        self._apply(lambda: world.set_external_wrench(link, force, moment))

    def _on_tilt(self, message: Vector3Stamped) -> None:
        vector, now = _read(message.vector), self._elapsed
        self._apply(lambda: self._tilt.turn_to(read_vector('tilt', vector, 'rad'), now))

    def _on_sensors(self, message: Bool) -> None:
        self._has_sensors = message.data
        if not message.data:
            self._set_brakes(True)
        elif self._hand_over is not None:  # the position controller replaces the brakes
            self._set_brakes(False)

    def _apply(self, change: Callable[[], None]) -> None:
        try:
            change()
        except InverseDynamicsError as error:
            self.get_logger().error(str(error))

    # Commands

    def _on_command(self, message: Float64MultiArray | JointState) -> None:
        try:
            command = read_command(self._actuation.driver, self._robot.command_names, message)
        except ValueError as error:
            self._ignore(str(error))
            return
        if self._hand_over is None:
            self._update_brakes()
            self._actuation.command = command
            self._actuation.act()
        elif self._has_sensors:
            self._hand_over.command(command, self._elapsed)

    def _on_hold(self, request: Any, response: Any) -> Any:
        assert self._hand_over is not None
        response.success, response.message = self._hand_over.hold(request.data, self._elapsed)
        self.get_logger().info(response.message)
        return response

    def _ignore(self, fault: str) -> None:
        """Log an ignored command, at most once per `COMPLAINT_PERIOD`."""
        self._ignored += 1
        now = time.monotonic()
        if now < self._complaint_due:
            return
        self._complaint_due = now + COMPLAINT_PERIOD
        others = f' ({self._ignored} ignored so far)' if self._ignored > 1 else ''
        self.get_logger().error(f'command ignored: {fault}{others}')

    def _update_brakes(self) -> None:
        now = self._elapsed
        if now - self._last_command > GAP or not self._has_sensors:
            self._flow_began = now
        self._last_command = now
        if now - self._flow_began >= self._brake_release:
            self._set_brakes(False)

    def _set_brakes(self, on: bool) -> None:
        if on != self._robot.brakes_on:
            self._robot.brakes_on = on
            self._brakes.publish(Bool(data=on))
            self.get_logger().info('brakes on' if on else 'brakes open')


def _read(vector: Any) -> Floats:
    return np.array([vector.x, vector.y, vector.z])


def _write(vector: Any, values: Floats) -> None:
    vector.x, vector.y, vector.z = values.tolist()


def run(node: RobotNode, executor: Executor, rate: float, stop: Callable[[], bool]) -> None:
    """
    Advance a simulated robot in step with the steady clock until ``stop`` returns True.

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


def main(arguments: list[str] | None = None) -> int:
    """Run one simulated robot until SIGINT or SIGTERM; return the exit code."""
    options = _parse(remove_ros_args(sys.argv if arguments is None else ['', *arguments])[1:])
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: stopped.append(number))
    try:
        robot = load_urdf(options.robot)
        start = np.array(options.start or start_pose(robot, InverseDynamics(robot)))
        if len(start) != len(robot.joint_names):
            raise SimulationError(
                f'--start has {len(start)} numbers, expected {len(robot.joint_names)}'
            )
        if len(options.armature) not in (1, len(start)):
            raise SimulationError(
                f'--armature has {len(options.armature)} numbers, expected 1 or {len(start)}'
            )
        hardware = MujocoRobot(
            options.robot, robot, start, options.friction, options.held, options.armature
        )
        with explained_start():
            start_ros(arguments)
        try:
            _serve(hardware, options, lambda: bool(stopped))
        finally:
            rclpy.shutdown()
    except (InverseDynamicsError, OSError) as error:
        print(f'simulated robot: {error}', file=sys.stderr)
        return 1
    return 0


def _serve(hardware: MujocoRobot, options: argparse.Namespace, stop: Callable[[], bool]) -> None:
    drive = None
    driver = DRIVERS[options.driver] if options.driver else TORQUES
    if options.drive or options.sway or options.driver:
        hardware.brakes_on = False
        drive = PositionDrive(hardware, options.sway)
    with explained_start():
        node = RobotNode(hardware, options.brake_release, options.imu_orientation, drive, driver)
    executor = EventsExecutor()
    executor.add_node(node)
    # Garbage collection of the imported objects would take 0.1 s, and the node would time out.
    gc.collect()
    gc.freeze()
    try:
        run(node, executor, options.rate, stop)
    finally:
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description='A simulated robot behind ROS topics.')
    parser.add_argument('robot', type=Path, help='URDF of the robot')
    parser.add_argument('--rate', type=float, default=500.0, help='rate of joint states [Hz]')
    parser.add_argument(
        '--start',
        type=float,
        nargs='+',
        default=[],
        metavar='POSITION',
        help='start pose [rad, m] in the order of the URDF (default: a pose that is easy to hold)',
    )
    parser.add_argument(
        '--brake-release',
        type=float,
        default=1.5,
        help='time for which commands must arrive before the brakes open [s]',
    )
    parser.add_argument(
        '--friction',
        action='store_true',
        help='give the joints the damping and friction of the URDF (default: none)',
    )
    parser.add_argument(
        '--held',
        nargs='+',
        default=[],
        metavar='JOINT',
        help='joints that hold their position and accept no commands, such as gripper joints',
    )
    parser.add_argument(
        '--drive', action='store_true', help='replace the brakes with a position controller'
    )
    parser.add_argument(
        '--sway', action='store_true', help='like --drive, and move every joint back and forth'
    )
    parser.add_argument(
        '--driver', choices=DRIVERS, help='like --drive, and use the conventions of a driver'
    )
    parser.add_argument(
        '--armature',
        type=float,
        nargs='+',
        default=[0.0],
        help='reflected inertia of rotors and gears [kg m^2, kg]: one number, or one per joint',
    )
    parser.add_argument(
        '--imu-orientation',
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=('ROLL', 'PITCH', 'YAW'),
        help='orientation of the IMU in the base frame [rad]',
    )
    return parser.parse_args(arguments)


if __name__ == '__main__':
    sys.exit(main())
