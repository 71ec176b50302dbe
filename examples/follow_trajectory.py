"""
Move a robot along a trajectory: publish a reference for every joint state.

Usage: python examples/follow_trajectory.py my_arm.urdf trajectory.yaml [SPEED]

The node must run in mode computed_torque. The robot first moves slowly from its current position
to the first point. SPEED scales the trajectory: 0.2 is a slow rehearsal. The trajectory file has
one of the formats that `inverse_dynamics effort` reads. Joints that are not in the file stay where
they are.

"""

from pathlib import Path
import signal
import sys
import time

from inverse_dynamics_node import InverseDynamicsError, load_urdf
from inverse_dynamics_node.analysis.trajectory_files import read_trajectory
from inverse_dynamics_node.dynamics.trajectory import complete, refine, Trajectory
from inverse_dynamics_node.ros.middleware import start_ros
import numpy as np
import rclpy
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

APPROACH = 0.2  # [rad/s, m/s]: mean speed to the first point
AT_REST = 1.0  # [s]: time at the last point
LARGEST_ERROR = 0.5  # [rad, m]: with a larger error, the robot does not follow

if len(sys.argv) not in (3, 4):
    sys.exit(__doc__)
speed = float(sys.argv[3]) if len(sys.argv) > 3 else 1.0
try:
    robot = load_urdf(sys.argv[1])
    planned, _ = complete(read_trajectory(Path(sys.argv[2]), robot.joint_names).trajectory)
except InverseDynamicsError as error:
    sys.exit(f'error: {error}')

start_ros()  # without shared memory, because it could delay the driver
signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends the program while it waits
node = rclpy.create_node('follow_trajectory')
client = AsyncParameterClient(node, 'inverse_dynamics')
if not client.wait_for_services(timeout_sec=10.0):
    sys.exit('there is no node /inverse_dynamics')
answer = client.get_parameters(['mode'])
rclpy.spin_until_future_complete(node, answer, timeout_sec=10.0)
mode = answer.result().values[0].string_value if answer.done() else 'unknown'
if mode != 'computed_torque':
    sys.exit(f'the mode of the node is {mode}, expected computed_torque')
publisher = node.create_publisher(JointTrajectory, 'inverse_dynamics/reference', 10)
names, motion, began, errors, stopped = None, None, 0.0, [], []


def with_approach(names, measured):
    """Return the motion in steps of 2 ms: first to the trajectory, then along the trajectory."""
    points = len(planned.times)
    positions, velocities, accelerations = np.zeros((3, points + 1, len(names)))
    positions[:] = measured
    index = [names.index(name) for name in planned.joint_names]
    # Continuous joints turn in the shorter direction.
    is_continuous = [robot.is_continuous[robot.joint_names.index(x)] for x in planned.joint_names]
    turns = np.round((measured[index] - planned.positions[0]) / (2.0 * np.pi))
    positions[1:, index] = planned.positions + 2.0 * np.pi * turns * is_continuous
    velocities[1:, index] = planned.velocities * speed
    accelerations[1:, index] = planned.accelerations * speed**2
    approach = 1.0 + np.abs(positions[1] - measured).max() / APPROACH
    times = np.append(0.0, approach + (planned.times - planned.times[0]) / speed)
    errors.append(np.zeros(len(names)))
    print(f'{times[-1]:.1f} s, of which {approach:.1f} s to the first point')
    return refine(Trajectory(tuple(names), times, positions, velocities, accelerations), 0.002)[0]


def on_efforts(message):
    """Store the names of the joints that the node commands: a reference must contain all."""
    global names
    if names is None:
        names = list(message.name)
        others = set(planned.joint_names) - set(names)
        if others:
            sys.exit(f'the node does not command {", ".join(sorted(others))}')


def on_state(message):
    """Publish the reference for the current time."""
    global motion, began
    positions = dict(zip(message.name, message.position, strict=True))
    is_ready = names and publisher.get_subscription_count()
    if not is_ready or not all(name in positions for name in names):
        return
    measured = np.array([positions[name] for name in names])
    if motion is None:
        motion, began = with_approach(names, measured), time.monotonic()
    k = min(int(np.searchsorted(motion.times, time.monotonic() - began)), len(motion.times) - 1)
    point = JointTrajectoryPoint(
        positions=motion.positions[k].tolist(),
        velocities=motion.velocities[k].tolist(),
        accelerations=motion.accelerations[k].tolist(),
    )
    publisher.publish(JointTrajectory(joint_names=names, points=[point]))
    errors.append(np.abs(measured - motion.positions[k]))
    worst = int(errors[-1].argmax())
    if errors[-1][worst] > LARGEST_ERROR:
        sys.exit(
            f'stopped: {names[worst]} is {errors[-1][worst]:.2f} rad or m behind; does the robot '
            'follow the commands of the node, and are the efforts cut to limits? See their logs'
        )


node.create_subscription(JointState, 'inverse_dynamics/joint_efforts', on_efforts, 1)
node.create_subscription(JointState, 'joint_states', on_state, 1)
# Without this handler, Ctrl-C could end rclpy in the middle of a message.
signal.signal(signal.SIGINT, lambda number, _: stopped.append(number))
while not stopped and (motion is None or time.monotonic() - began < motion.times[-1] + AT_REST):
    rclpy.spin_once(node, timeout_sec=0.1)
if not errors:
    sys.exit('no message on joint_states or inverse_dynamics/joint_efforts has arrived')
print('largest error [rad, m]:')
for name, error in zip(names, np.max(errors, axis=0), strict=True):
    print(f'{name:20} {error:10.4f}')

node.destroy_node()
rclpy.try_shutdown()
