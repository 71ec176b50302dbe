"""
Record a motion that is shown by hand, and replay it.

Usage: python examples/record_and_replay.py [SPEED]

The program lets the arm float in mode gravity_compensation. Guide it, and press Ctrl-C at the end.
The program then changes the mode to computed_torque, and the arm moves slowly to where the motion
began and repeats it SPEED times as fast, 0.5 by default. The node then holds the arm. Another
Ctrl-C stops the motion, and ends the program.

"""

import os
import signal
import sys

import numpy as np
import rclpy
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

APPROACH = 0.2  # [rad/s, m/s]: mean speed to the begin of the motion
PERIOD, PATIENCE = 0.1, 10.0  # [s]: between points, which are averages; for answers of the node
speed = float(sys.argv[1]) if len(sys.argv) > 1 else 0.5
os.environ.setdefault('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')  # shared memory may delay drivers
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
stopped, names, latest, times, rows = [], [], {}, [], []
signal.signal(signal.SIGINT, lambda number, _: stopped.append(number))
node = rclpy.create_node('record_and_replay')
publisher = node.create_publisher(JointTrajectory, 'inverse_dynamics/joint_trajectory', 10)
client = AsyncParameterClient(node, 'inverse_dynamics')


def set_mode(mode):
    """Set the mode of the node."""
    client.wait_for_services(timeout_sec=PATIENCE)
    answer = client.set_parameters([Parameter('mode', value=mode)])
    rclpy.spin_until_future_complete(node, answer, timeout_sec=PATIENCE)
    if not answer.done() or not answer.result().results[0].successful:
        sys.exit(f'the node /inverse_dynamics does not change its mode to {mode}')


def on_state(message):
    """Record the positions of the commanded joints."""
    latest.update(zip(message.name, message.position, strict=True))
    if names and latest.keys() >= set(names):
        times.append(1e-9 * node.get_clock().now().nanoseconds)
        rows.append([latest[name] for name in names])


set_mode('gravity_compensation')
efforts = 'inverse_dynamics/joint_efforts'  # has the names of the commanded joints
node.create_subscription(JointState, efforts, lambda m: names or names.extend(m.name), 1)
node.create_subscription(JointState, 'joint_states', on_state, 10)
print('guide the arm, then press Ctrl-C', flush=True)
while not stopped:
    rclpy.spin_once(node, timeout_sec=0.1)
if not rows:
    sys.exit('no joint states have arrived')
moments, motion = np.array(times) - times[0], np.array(rows)
window = np.abs(np.arange(0.0, moments[-1], PERIOD)[:, None] - moments) <= PERIOD
window = window[window.any(axis=1)]
path = window @ motion / window.sum(axis=1, keepdims=True)
seconds = window @ moments / window.sum(axis=1) / speed
set_mode('computed_torque')
seconds += 1.0 + np.abs(path[0] - motion[-1]).max() / APPROACH - seconds[0]
trajectory = JointTrajectory(joint_names=names)
for q, time_from_start in zip(path, seconds, strict=True):
    point = JointTrajectoryPoint(positions=q.tolist())
    point.time_from_start = Duration(seconds=time_from_start).to_msg()
    trajectory.points.append(point)
publisher.publish(trajectory)
print(f'replayed within {seconds[-1]:.1f} s; Ctrl-C stops the arm', flush=True)
while len(stopped) < 2:
    rclpy.spin_once(node, timeout_sec=0.1)
publisher.publish(JointTrajectory())
publisher.wait_for_all_acked()
rclpy.shutdown()
