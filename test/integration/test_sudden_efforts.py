"""Nothing but motion makes a command differ much from the last one, with the node as a process."""

import re
import signal
import time

from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
from robot_files import ROOT
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

FILE = ROOT / 'test/robots/seven_dof.urdf'
MODEL = load_urdf(FILE)
NAMES, ZERO = list(MODEL.joint_names), np.zeros(7)
Q = np.array([0.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0])
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
SPEED = 1.0  # [rad/s]; of the arm between its turning points


def move(robot):
    """Let the second joint, which carries the arm, swing from now on; return the commands."""
    began = time.monotonic()
    commands = []
    robot.node.create_subscription(JointState, TOPIC, commands.append, 1000)

    def state():
        """Return the position and the velocity of the second joint: a triangle of 2 rad."""
        phase = (time.monotonic() - began) * SPEED % 4.0
        return (phase - 1.0, SPEED) if phase < 2.0 else (3.0 - phase, -SPEED)

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


@pytest.mark.real_time
@pytest.mark.parametrize(
    ('rate', 'durations'),
    [
        (200, (0.5, 1.0)),
        *(
            pytest.param(rate, np.geomspace(0.5, 5.0, 10), marks=pytest.mark.long)
            for rate in (0, 200)
        ),
    ],
)
def test_no_effort_jumps_after_a_suspension_while_the_arm_moves(run_node, robot, rate, durations):
    node = run_node(**PARAMETERS, update_rate=rate)
    commands = move(robot)
    robot.wait_until(lambda: len(commands) > 100, 'the end of the start ramp')
    for duration in durations:
        assert largest_step(robot, node, commands, duration) <= ALLOWED


def test_a_stop_without_joint_states_begins_at_once_and_does_not_catch_up(run_node, robot):
    """The dry run that begins during the stop continues it."""
    node = run_node(robot_description_file=FILE, state_timeout=60.0, start_ramp=0.0, stop_ramp=0.5)
    robot.publish_state(NAMES, Q, ZERO)
    robot.wait_until(lambda: robot.commands and np.any(robot.commands[-1]), 'commands')
    top, count = np.array(robot.commands[-1]), len(robot.commands)
    robot.state = None  # as at an emergency stop
    assert robot.call(SetBool, 'enable', SetBool.Request(data=False)).success
    robot.wait_until(lambda: abs(robot.commands[-1][1]) < abs(top[1]), 'a fall')
    assert robot.set_parameter('dry_run', True).successful
    robot.wait_for_command(ZERO, tolerance=0.0)
    robot.wait_for_text(node, 'dry run: the commands end')
    (left,) = re.findall(r'the commands end after the stop ramp \((.*) s\)', node.output)
    assert float(left) < 0.5
    assert time.monotonic() < robot.last_state + 60.0  # before the states are lost
    commands = np.array(robot.commands[count - 1 :])
    steps = np.abs(np.diff(commands, axis=0))
    # A ramp advances by 2 % at a time; not every command arrives.
    assert (steps <= 0.15 * np.abs(top) + 1e-9).all()
    assert (steps.max(axis=0) < 0.05 * MODEL.effort_limits).all()
