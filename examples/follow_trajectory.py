"""
Move a robot along a trajectory: publish a reference for every joint state.

Usage: python examples/follow_trajectory.py my_arm.urdf trajectory.yaml [SPEED]

The node must run in mode computed_torque. The robot first moves slowly from where it is to the
first point. SPEED scales the trajectory: 0.2 is a slow rehearsal. The file has a format of
`inverse_dynamics effort`.

"""

import contextlib
from pathlib import Path
import sys
import time

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.trajectory_files import read_trajectory
from inverse_dynamics_node.dynamics.trajectory import complete, refine, Trajectory
import numpy as np
import rclpy
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

APPROACH = 0.2  # [rad/s, m/s]; mean speed to the first point
AT_REST = 1.0  # [s] at the last point

robot = load_urdf(sys.argv[1])
speed = float(sys.argv[3]) if len(sys.argv) > 3 else 1.0
whole, _ = complete(read_trajectory(Path(sys.argv[2]), robot.joint_names).trajectory)
names = list(whole.joint_names)

rclpy.init()
node = rclpy.create_node('follow_trajectory')
publisher = node.create_publisher(JointTrajectory, 'inverse_dynamics/reference', 10)
motion, began, errors = None, 0.0, []


def with_approach(measured):
    """Return the motion in steps of 2 ms: from the measured positions, along the trajectory."""
    distance = np.abs(whole.positions[0] - measured).max()
    duration, rest = 1.0 + distance / APPROACH, np.zeros((1, len(names)))
    times = np.append(0.0, duration + (whole.times - whole.times[0]) / speed)
    positions = np.vstack([measured, whole.positions])
    velocities = np.vstack([rest, whole.velocities * speed])
    accelerations = np.vstack([rest, whole.accelerations * speed**2])
    return refine(
        Trajectory(whole.joint_names, times, positions, velocities, accelerations), 0.002
    )


def on_state(message):
    """Publish the reference for this moment."""
    global motion, began
    positions = dict(zip(message.name, message.position, strict=True))
    if not all(name in positions for name in names):
        return
    measured = np.array([positions[name] for name in names])
    if motion is None:
        motion, began = with_approach(measured)[0], time.monotonic()
        approach = motion.times[-1] - np.ptp(whole.times) / speed
        print(f'{motion.times[-1]:.1f} s, of which {approach:.1f} s to the first point')
    k = min(int(np.searchsorted(motion.times, time.monotonic() - began)), len(motion.times) - 1)
    point = JointTrajectoryPoint(
        positions=motion.positions[k].tolist(),
        velocities=motion.velocities[k].tolist(),
        accelerations=motion.accelerations[k].tolist(),
    )
    publisher.publish(JointTrajectory(joint_names=names, points=[point]))
    errors.append(np.abs(measured - motion.positions[k]))


node.create_subscription(JointState, 'joint_states', on_state, 1)
with contextlib.suppress(KeyboardInterrupt):
    while motion is None or time.monotonic() - began < motion.times[-1] + AT_REST:
        rclpy.spin_once(node, timeout_sec=1.0)
if not errors:
    sys.exit('no joint state of all joints of the trajectory has arrived')
print('largest error [rad, m]:')
for name, error in zip(names, np.max(errors, axis=0), strict=True):
    print(f'{name:20} {error:10.4f}')

node.destroy_node()
rclpy.try_shutdown()
