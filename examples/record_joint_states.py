"""
Record joint states as a CSV file, for `inverse_dynamics compare` and `identify`.

Usage: python examples/record_joint_states.py recording.csv

The program records until Ctrl-C. If rosbag2 is installed, `ros2 bag record /joint_states` is an
alternative.

"""

import csv
import os
from pathlib import Path
import signal
import sys

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from sensor_msgs.msg import JointState

QUANTITIES = ('position', 'velocity', 'effort')
path, stopped = Path(sys.argv[1]), []
if path.exists():
    sys.exit(f'{path}: exists; a recording is not replaced, choose another name')
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda number, _: stopped.append(number))
os.environ.setdefault('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')  # shared memory may delay drivers
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node('record_joint_states')
names, columns, count = [], [], 0

with path.open('w', newline='') as file:
    rows = csv.writer(file)

    def on_state(message):
        """Write one row: the stamp (or the arrival time if the stamp is zero) and the values."""
        global names, columns, count
        if not names:
            names = list(message.name)
            columns = [quantity for quantity in QUANTITIES if getattr(message, quantity)]
            rows.writerow(['time', *(f'{name}.{x}' for x in columns for name in names)])
            print(f'recording {", ".join(columns)} of {", ".join(names)}', flush=True)
        if list(message.name) == names:  # other nodes may publish other joints
            time = (
                Time.from_msg(message.header.stamp).nanoseconds
                or node.get_clock().now().nanoseconds
            )
            values = (value for quantity in columns for value in getattr(message, quantity))
            rows.writerow([f'{1e-9 * time:.6f}', *values])
            count += 1

    node.create_subscription(JointState, 'joint_states', on_state, 1000)
    while not stopped:
        rclpy.spin_once(node, timeout_sec=0.1)

print(f'{path}: {count} joint states')
node.destroy_node()
rclpy.shutdown()
