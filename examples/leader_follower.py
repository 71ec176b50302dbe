"""
Let a follower arm do what a leader arm does, and let the leader feel what the follower touches.

Usage: python examples/leader_follower.py [GAIN]

Two nodes command two arms with the same joint names: /leader/inverse_dynamics in mode
inverse_dynamics, in which the leader floats, and /follower/inverse_dynamics in mode
computed_torque. The follower first moves slowly to the pose of the leader, which must not move
meanwhile. GAIN is the share of the external efforts of the follower that the leader feels, 0.3 by
default. The follower needs measured efforts, and a model that `watch` agrees with. Ctrl-C ends the
program: the leader floats, and the follower floats after `reference_timeout`.

"""

import os
import signal
import sys

import rclpy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

SPEED = 0.2  # [rad/s, m/s]: mean speed of the follower on its way to the leader
CLOSE = 0.05  # [rad, m]: distance at which the follower begins to follow

gain = float(sys.argv[1]) if len(sys.argv) > 1 else 0.3
os.environ.setdefault('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')  # shared memory may delay drivers
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
stopped, positions, touch, is_following = [], {}, {}, False
signal.signal(signal.SIGINT, lambda number, _: stopped.append(number))
node = rclpy.create_node('leader_follower')


def publisher(topic):
    """Return a publisher of trajectories on a topic."""
    return node.create_publisher(JointTrajectory, topic, 1)


to_leader = publisher('leader/inverse_dynamics/reference')
to_follower = publisher('follower/inverse_dynamics/reference')
approach = publisher('follower/inverse_dynamics/joint_trajectory')


def on_leader(message):
    """Send the pose of the leader to the follower, and the efforts of the follower back."""
    global is_following
    names = list(message.name)
    if not positions.keys() >= set(names) or not approach.get_subscription_count():
        return
    point = JointTrajectoryPoint(positions=message.position, velocities=message.velocity)
    pose = dict(zip(names, message.position, strict=True))
    distance = max(abs(pose[name] - positions[name]) for name in names)
    if is_following or distance < CLOSE:
        is_following = True
        to_follower.publish(JointTrajectory(joint_names=names, points=[point]))
    elif is_following is False:
        point.velocities = []
        point.time_from_start.sec = 2 + int(distance / SPEED)
        approach.publish(JointTrajectory(joint_names=names, points=[point]))
        print(f'the follower needs {point.time_from_start.sec} s to the leader', flush=True)
        is_following = None  # it is on its way
    # External efforts are measured minus modelled efforts: minus the efforts of a push.
    push = [-gain * touch.get(name, 0.0) for name in names]
    felt = JointTrajectoryPoint(effort=push)
    to_leader.publish(JointTrajectory(joint_names=names, points=[felt]))


def store(values, field):
    """Return a callback that stores a field of joint states by name."""
    return lambda m: values.update(zip(m.name, getattr(m, field), strict=True))


node.create_subscription(JointState, 'leader/joint_states', on_leader, 1)
node.create_subscription(JointState, 'follower/joint_states', store(positions, 'position'), 1)
efforts = 'follower/inverse_dynamics/external_efforts'
node.create_subscription(JointState, efforts, store(touch, 'effort'), 1)
while not stopped:
    rclpy.spin_once(node, timeout_sec=0.1)
node.destroy_node()
rclpy.try_shutdown()
