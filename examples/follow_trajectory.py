"""
Move a robot along a trajectory: publish it once, and watch the node follow it.

Usage: python examples/follow_trajectory.py my_arm.urdf trajectory.yaml [SPEED]

The node should run in mode computed_torque. The robot first moves slowly from its current position
to the first point. SPEED scales the trajectory: 0.2 is a slow rehearsal. The trajectory file has
one of the formats that `inverse_dynamics effort` reads. Joints that are not in the file stay where
they are. Ctrl-C stops the motion; the node then holds the arm.

"""

from pathlib import Path
import signal
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from inverse_dynamics_node import InverseDynamicsError, load_urdf
from inverse_dynamics_node.analysis.trajectory_files import read_trajectory
from inverse_dynamics_node.dynamics.trajectory import complete
from inverse_dynamics_node.ros.middleware import start_ros
import numpy as np
import rclpy
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

APPROACH = 0.2  # [rad/s, m/s]: mean speed to the first point
PATIENCE = 10.0  # [s]

if len(sys.argv) not in (3, 4):
    sys.exit(__doc__)
speed = float(sys.argv[3]) if len(sys.argv) > 3 else 1.0
try:
    robot = load_urdf(sys.argv[1])
    planned, _ = complete(read_trajectory(Path(sys.argv[2]), robot.joint_names).trajectory)
except InverseDynamicsError as error:
    sys.exit(f'error: {error}')

start_ros()  # without shared memory, because it could delay the driver
stopped, measured, values = [], {}, {}
signal.signal(signal.SIGINT, lambda number, _: stopped.append(number))
node = rclpy.create_node('follow_trajectory')
publisher = node.create_publisher(JointTrajectory, 'inverse_dynamics/joint_trajectory', 10)


def on_diagnostics(message):
    """Store what the node reports about the trajectory."""
    for status in message.status:
        if status.name == 'inverse_dynamics: reference':
            values.update((pair.key, pair.value) for pair in status.values)


def wait_for(is_true, what, patience=PATIENCE):
    """Wait for a condition, or for Ctrl-C."""
    end = time.monotonic() + patience
    while not (is_true() or stopped):
        rclpy.spin_once(node, timeout_sec=0.1)
        if time.monotonic() > end:
            sys.exit(f'{what}: not within {patience:g} s; see the log of the node')


node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)
node.create_subscription(
    JointState,
    'joint_states',
    lambda m: measured.update(zip(m.name, m.position, strict=False)),
    10,
)
names = planned.joint_names
wait_for(lambda: measured.keys() >= set(names) and publisher.get_subscription_count(), 'the node')
way = planned.positions[0] - [measured.get(name, 0.0) for name in names]
way -= (
    2.0 * np.pi * np.round(way / (2.0 * np.pi)) * robot.is_continuous[robot.joint_indices(names)]
)
approach = 1.0 + np.abs(way).max() / APPROACH
times = approach + (planned.times - planned.times[0]) / speed
trajectory = JointTrajectory(joint_names=names)
for q, qd, qdd, seconds in zip(*planned[2:], times, strict=True):
    point = JointTrajectoryPoint(time_from_start=Duration(seconds=seconds).to_msg())
    point.positions, point.velocities = q.tolist(), (qd * speed).tolist()
    point.accelerations = (qdd * speed**2).tolist()
    trajectory.points.append(point)
publisher.publish(trajectory)
print(f'{times[-1]:.1f} s, of which {approach:.1f} s to the first point', flush=True)
wait_for(lambda: values.get('trajectory') == 'followed', 'the trajectory begins')
wait_for(lambda: values.get('trajectory') != 'followed', 'its end', times[-1] + PATIENCE)
if stopped:
    publisher.publish(JointTrajectory())
    publisher.wait_for_all_acked()
print(f'largest error [rad, m]: {values.get("trajectory largest error [rad, m]")}')
if values.get('trajectory') != 'held':
    sys.exit(f'stopped: {values.get("trajectory")}')
node.destroy_node()
rclpy.try_shutdown()
