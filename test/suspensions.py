"""
Suspends the node while the arm moves, and measures the steps of its commands beyond the motion.

Usage: python test/suspensions.py: 20 suspensions of 0.5 to 5 s, at update_rate 0 and 200.

"""

import math
import os
import signal
import sys
import time

from fork_server import MAIN
from inverse_dynamics_node import InverseDynamics, load_urdf
from node_process import heed_signals, NodeProcess
import numpy as np
from rclpy.context import Context
from robot_files import ROOT
from robot_side import RobotSide
from sensor_msgs.msg import JointState

FILE = ROOT / 'test/robots/seven_dof.urdf'
MODEL = load_urdf(FILE)
NAMES = list(MODEL.joint_names)
DYNAMICS = InverseDynamics(MODEL)
TOPIC = 'inverse_dynamics/joint_commands'  # efforts, and the measured motion that they are for
PARAMETERS = {
    'robot_description_file': FILE,
    'velocity_limits': 0.0,  # otherwise efforts fade while the arm moves at 1 rad/s
    # No command is lost while this process waits for the machine.
    f'qos_overrides./{TOPIC}.publisher.depth': 1000,
}
ALLOWED = 1.0  # of the step that a blend over twice the largest effort explains
RAMP = 0.5  # [s]; default of start_ramp
NOMINAL, JITTER = 0.02, 0.003  # [s]; ramps advance by at most as long; of the time of a command
_SPEED = 1.0  # [rad/s]; of the arm between its turning points


def move(robot):
    """Let the second joint, which carries the arm, swing from now on; return the commands."""
    began = time.monotonic()
    commands = []
    robot.node.create_subscription(JointState, TOPIC, commands.append, 1000)

    def state():
        """Return the position and the velocity of the second joint: a triangle of 2 rad."""
        phase = (time.monotonic() - began) * _SPEED % 4.0
        return (phase - 1.0, _SPEED) if phase < 2.0 else (3.0 - phase, -_SPEED)

    message = JointState(name=NAMES, position=[0.0] * 7, velocity=[0.0] * 7)
    message.position[3] = 0.5

    def moved():
        message.position[1], message.velocity[1] = state()
        return message

    robot._always.append((robot._states, moved))
    return commands


def largest_step(robot, node, commands, duration):
    """
    Suspend the node; return the largest step of its commands around and after the suspension.

    The step that the motion between two commands explains is subtracted. The result is relative to
    the step that a blend explains.
    """
    del commands[:-50]
    node.interrupt(signal.SIGSTOP)
    end = time.monotonic() + duration
    robot.wait_until(lambda: time.monotonic() > end, 'end of the suspension')
    before = len(commands)
    node.interrupt(signal.SIGCONT)
    end = time.monotonic() + 1.5
    robot.wait_until(lambda: time.monotonic() > end, 'commands after it')
    assert len(commands) > before + 20
    efforts = np.array([message.effort for message in commands])
    q, qd = (np.array([getattr(m, name) for m in commands]) for name in ('position', 'velocity'))
    times = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in commands])
    motion = np.abs(np.diff(DYNAMICS.efforts(q, qd, 0.0 * q), axis=0))
    elapsed = np.minimum(np.diff(times), NOMINAL) + JITTER
    blend = 2.0 * np.abs(efforts).max() * elapsed / RAMP
    return float(((np.abs(np.diff(efforts, axis=0)) - motion).max(axis=1) / blend).max())


def main():
    domain = 100 + os.getpid() % 100
    worst = 0.0
    for rate in (0, 200):
        context = Context()
        context.init(args=[], domain_id=domain)
        robot = RobotSide(context)
        parameters = {**PARAMETERS, 'update_rate': rate}
        node = NodeProcess(domain, (), parameters, ('-m', MAIN), heed_signals, may_crash=False)
        try:
            commands = move(robot)
            robot.wait_until(lambda c=commands: len(c) > 200, 'commands')
            for k in range(10):
                duration = 0.5 * 10.0 ** (k / 9.0)
                step = largest_step(robot, node, commands, duration)
                worst = max(worst, step)
                print(f'update_rate {rate}, {duration:.2f} s: largest step {step:.2f} of a blend')
        finally:
            node.kill()
            robot.close()
    print(f'largest step of all: {worst:.2f} of what a blend explains')
    return int(not worst <= ALLOWED or math.isnan(worst))


if __name__ == '__main__':
    sys.exit(main())
