"""
Move an arm without brakes slowly to a rest position, and stop the node.

Usage: python examples/park.py SPEED JOINT=POSITION...

    python examples/park.py 0.2 shoulder_lift=1.4 elbow=-2.6

The node must run in mode computed_torque. No joint moves faster than SPEED [rad/s, m/s]. Joints
that are not named stay where they are. At the end, the program stops the node with the service
~/enable, and the efforts fall to zero: choose a position in which the arm rests on something or
hangs. After Ctrl-C, the node holds the arm.

"""

import os
import signal
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.duration import Duration
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

PATIENCE = 10.0  # [s]

speed = float(sys.argv[1])
wanted = {name: float(value) for name, value in (word.split('=') for word in sys.argv[2:])}

os.environ.setdefault('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')  # shared memory may delay drivers
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
stopped, measured, reported = [], {}, []
signal.signal(signal.SIGINT, lambda number, _: stopped.append(number))
node = rclpy.create_node('park')
publisher = node.create_publisher(JointTrajectory, 'inverse_dynamics/joint_trajectory', 10)
enable = node.create_client(SetBool, 'inverse_dynamics/enable')


def on_diagnostics(message):
    """Store whether the node follows or holds a trajectory."""
    for status in message.status:
        if status.name == 'inverse_dynamics: reference':
            reported.extend(pair.value for pair in status.values if pair.key == 'trajectory')


def wait_for(is_true, what, patience=PATIENCE):
    """Wait for a condition; after Ctrl-C, let the node hold the arm, and end."""
    end = time.monotonic() + patience
    while not is_true():
        rclpy.spin_once(node, timeout_sec=0.1)
        if stopped:
            publisher.publish(JointTrajectory())
            publisher.wait_for_all_acked()
            sys.exit('not parked')
        if time.monotonic() > end:
            sys.exit(f'{what}: not within {patience:g} s; see the log of the node')


node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)
node.create_subscription(
    JointState,
    'joint_states',
    lambda m: measured.update(zip(m.name, m.position, strict=False)),
    10,
)
wait_for(lambda: measured.keys() >= wanted.keys(), 'the joint states of these joints')
wait_for(lambda: enable.service_is_ready() and publisher.get_subscription_count(), 'the node')
# A motion from rest to rest is 1.875 times as fast in the middle as on average.
way = max(abs(position - measured[name]) for name, position in wanted.items())
duration = 1.0 + 1.875 * way / speed
point = JointTrajectoryPoint(positions=list(wanted.values()))
point.time_from_start = Duration(seconds=duration).to_msg()
publisher.publish(JointTrajectory(joint_names=list(wanted), points=[point]))
print(f'{duration:.1f} s to the rest position', flush=True)
wait_for(lambda: 'followed' in reported, 'the motion begins')
wait_for(lambda: reported[-1] != 'followed', 'the rest position', duration + PATIENCE)
if reported[-1] != 'held':
    sys.exit(f'not parked: {reported[-1]}')
answer = enable.call_async(SetBool.Request(data=False))
rclpy.spin_until_future_complete(node, answer, timeout_sec=PATIENCE)
is_well = answer.done() and answer.result().success
print(f'parked: {answer.result().message}' if is_well else 'the node has not answered')
node.destroy_node()
rclpy.try_shutdown()
