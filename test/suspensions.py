"""
Suspends the node while the arm moves, and measures the steps of its commands.

Usage: python test/suspensions.py: 20 suspensions of 0.5 to 5 s, at update_rate 0 and 200.

"""

import math
import os
import signal
import sys
import time

from inverse_dynamics_node import load_urdf
from node_process import heed_signals, MAIN, NodeProcess
import numpy as np
from rclpy.context import Context
from robot_files import ROOT
from robot_side import RobotSide
from sensor_msgs.msg import JointState

FILE = ROOT / 'test/robots/seven_dof.urdf'
MODEL = load_urdf(FILE)
NAMES = list(MODEL.joint_names)
ALLOWED = 0.05  # of the effort limit, between two commands
_SPEED = 1.0  # [rad/s]; of the arm between its turning points


def move(robot):
    """Let the second joint, which carries the arm, swing from now on."""
    began = time.monotonic()

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


def largest_step(robot, node, duration):
    """Suspend the node; return the largest step afterwards, as a fraction of the limit."""
    node.interrupt(signal.SIGSTOP)
    end = time.monotonic() + duration
    robot.wait_until(lambda: time.monotonic() > end, 'end of the suspension')
    count = len(robot.commands)
    node.interrupt(signal.SIGCONT)
    end = time.monotonic() + 1.5
    robot.wait_until(lambda: time.monotonic() > end, 'commands after it')
    commands = np.array(robot.commands[count - 1 :])
    assert len(commands) > 20
    return float((np.abs(np.diff(commands, axis=0)) / MODEL.effort_limits).max())


def main():
    domain = 100 + os.getpid() % 100
    worst = 0.0
    for rate in (0, 200):
        context = Context()
        context.init(args=[], domain_id=domain)
        robot = RobotSide(context)
        parameters = {'robot_description_file': FILE, 'update_rate': rate}
        node = NodeProcess(domain, (), parameters, ('-m', MAIN), heed_signals, may_crash=False)
        try:
            move(robot)
            robot.wait_until(lambda r=robot: len(r.commands) > 200, 'commands')
            for k in range(10):
                duration = 0.5 * 10.0 ** (k / 9.0)
                step = largest_step(robot, node, duration)
                worst = max(worst, step)
                print(f'update_rate {rate}, {duration:.2f} s: largest step {100.0 * step:.2f} %')
        finally:
            node.kill()
            robot.close()
    print(f'largest step of all: {100.0 * worst:.2f} % of the effort limit')
    return int(not worst <= ALLOWED or math.isnan(worst))


if __name__ == '__main__':
    sys.exit(main())
