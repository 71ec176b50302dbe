"""
Move an arm without brakes slowly to a rest position, and stop the node.

Usage: python examples/park.py SPEED JOINT=POSITION...

    python examples/park.py 0.2 shoulder_lift=1.4 elbow=-2.6

The node must run in mode computed_torque. No joint moves faster than SPEED [rad/s, m/s]. Joints
that are not named stay where they are. At the end, the program stops the node with the service
~/enable, and the efforts fall to zero: choose a position in which the arm rests on something or
hangs. After Ctrl-C, the node continues without a reference: the arm floats.

"""

import signal
import sys
import time

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.ros.middleware import start_ros
import numpy as np
import rclpy
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

AT_REST = 1.0  # [s]: time in the rest position before the stop
LONGEST_STEP = 0.1  # [s]: the reference waits while no joint states arrive
LARGEST_ERROR = 0.2  # [rad, m]: with a larger error, the robot does not follow

speed = float(sys.argv[1])
wanted = {name: float(value) for name, value in (word.split('=') for word in sys.argv[2:])}

start_ros()  # without shared memory, because it could delay the driver
signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends the program while it waits
node = rclpy.create_node('park')
client = AsyncParameterClient(node, 'inverse_dynamics')
if not client.wait_for_services(timeout_sec=10.0):
    sys.exit('there is no node /inverse_dynamics')
answer = client.get_parameters(['mode'])
rclpy.spin_until_future_complete(node, answer, timeout_sec=10.0)
mode = answer.result().values[0].string_value if answer.done() else 'unknown'
if mode != 'computed_torque':
    sys.exit(f'the mode of the node is {mode}, expected computed_torque')
publisher = node.create_publisher(JointTrajectory, 'inverse_dynamics/reference', 10)
robot, names, start, way, duration, last, elapsed, stopped = *[None] * 6, 0.0, []


def on_description(message):
    """Check the rest position against the limits of the joints."""
    global robot
    robot = load_urdf(message.data)
    for name, position in wanted.items():
        if name not in robot.joint_names:
            sys.exit(f'there is no joint {name}; joints are {", ".join(robot.joint_names)}')
        i = robot.joint_names.index(name)
        if not robot.lower[i] <= position <= robot.upper[i]:
            sys.exit(f'{name}={position:g}: expected {robot.lower[i]:g} to {robot.upper[i]:g}')


def on_efforts(message):
    """Store the names of the joints that the node commands: a reference must contain all."""
    global names
    names = list(message.name)
    if not set(wanted) <= set(names):
        sys.exit(f'the node commands {", ".join(names)} only')


def plan(measured):
    """Plan the motion from the measured positions to the rest position."""
    global start, way, duration, last
    start, last = measured, time.monotonic()
    way = np.array([wanted.get(name, q) for name, q in zip(names, measured, strict=True)]) - start
    index = [robot.joint_names.index(name) for name in names]
    # Continuous joints turn in the shorter direction.
    way -= 2.0 * np.pi * np.round(way / (2.0 * np.pi)) * robot.is_continuous[index]
    duration = 1.875 * np.abs(way).max() / speed  # 1.875: the largest slope of the quintic below
    print(f'{duration:.1f} s to the rest position', flush=True)


def on_state(message):
    """Publish the reference for the current time: a quintic that starts and ends at rest."""
    global last, elapsed
    positions = dict(zip(message.name, message.position, strict=True))
    is_ready = names and robot and publisher.get_subscription_count()
    if not is_ready or not all(name in positions for name in names):
        return
    measured = np.array([positions[name] for name in names])
    if start is None:
        plan(measured)
    now, rate = time.monotonic(), 1.0 / max(duration, 0.001)
    last, elapsed = now, elapsed + min(now - last, LONGEST_STEP)
    u = min(elapsed * rate, 1.0)
    point = JointTrajectoryPoint(
        positions=(start + (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5) * way).tolist(),
        velocities=(30.0 * (u * (1.0 - u)) ** 2 * rate * way).tolist(),
        accelerations=(60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) * rate**2 * way).tolist(),
    )
    publisher.publish(JointTrajectory(joint_names=names, points=[point]))
    error = np.abs(measured - point.positions)
    worst = int(error.argmax())
    if error[worst] > LARGEST_ERROR:
        sys.exit(
            f'stopped: {names[worst]} is {error[worst]:.2f} rad or m behind; the node was not '
            'stopped. Does the robot follow its commands, and are the efforts cut to limits?'
        )


latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(String, 'inverse_dynamics/robot_description', on_description, latched)
node.create_subscription(JointState, 'inverse_dynamics/joint_efforts', on_efforts, 1)
node.create_subscription(JointState, 'joint_states', on_state, 1)
# Without this handler, Ctrl-C could end rclpy in the middle of a message.
signal.signal(signal.SIGINT, lambda number, _: stopped.append(number))
while not stopped and (start is None or elapsed < duration + AT_REST):
    rclpy.spin_once(node, timeout_sec=0.1)
if not stopped:
    enable = node.create_client(SetBool, 'inverse_dynamics/enable')
    enable.wait_for_service(timeout_sec=10.0)
    answer = enable.call_async(SetBool.Request(data=False))
    # The node holds the arm at the last reference until it has stopped.
    rclpy.spin_until_future_complete(node, answer, timeout_sec=10.0)
    is_well = answer.done() and answer.result().success
    print(f'parked: {answer.result().message}' if is_well else 'the node has not answered')

node.destroy_node()
rclpy.try_shutdown()
