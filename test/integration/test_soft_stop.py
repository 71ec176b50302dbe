"""Stops of a node that damps the motion of the arm: all four ways, and what ends the damping."""

import math
import signal
import subprocess
import time

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import numpy as np
import pytest
from robot_files import ROOT, STANFORD
from robot_side import DYNAMICS, LATCHED, NAMES, Q, ZERO
from sensor_msgs.msg import JointState
from simulated_arm import HORIZONTAL_ARMS
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

PATIENCE = 60.0  # [s]
SPEED = np.array([0.2, -0.15, 0.02, 0.3, -0.2, 0.4])
RATE, RAMP, DAMPING = 200, 0.3, 50.0
MOVING = {
    'robot_description_file': STANFORD,
    'start_ramp': 0.0,
    'mode': 'gravity_compensation',
    'stop_ramp': RAMP,
    'stop_damping': DAMPING,
    # Longer than a busy machine pauses.
    'state_timeout': 0.5,
}
DEACTIVATE = Transition(id=Transition.TRANSITION_DEACTIVATE)
WAYS = ['disable', 'deactivate', 'SIGINT', 'SIGTERM']


def stop(robot, node, way):
    """Stop the node in one of the ways, without waiting for the end of the stop."""
    if way == 'disable':
        assert robot.call(SetBool, 'enable', SetBool.Request(data=False)).success
    elif way == 'deactivate':
        client = robot.node.create_client(ChangeState, 'inverse_dynamics/change_state')
        robot.wait_until(client.service_is_ready, 'service change_state')
        client.call_async(ChangeState.Request(transition=DEACTIVATE))
    else:
        node.interrupt(getattr(signal, way))


def wait_for_end_of_stop(robot, node, way):
    """Wait for the zeros at the end of a stop."""
    if way.startswith('SIG'):
        assert robot.wait_for_end(node) == 0
    else:
        robot.wait_for_text(node, 'stopped, zeros sent: ')
    robot.wait_for_command(np.zeros(len(robot.commands[-1])), tolerance=0.0)


class Motion:
    """Publishes the joint states of joints that move at a constant speed, and then rest."""

    def __init__(self, robot, sign=1.0, rate=RATE):
        self.robot, self.sign, self.is_lost = robot, sign, False
        self.began, self.rests_at = time.monotonic(), None
        self._publisher = robot.node.create_publisher(JointState, 'joint_states', 10)
        robot.node.create_timer(1.0 / rate, self._publish)

    def q(self):
        """Return the present positions."""
        until = time.monotonic() if self.rests_at is None else self.rests_at
        return Q + (until - self.began) * SPEED

    def rest(self):
        self.rests_at = time.monotonic()

    def _publish(self):
        if not self.is_lost:
            qd = self.sign * SPEED if self.rests_at is None else ZERO
            self._publisher.publish(JointState(name=NAMES, position=self.q(), velocity=qd))

    def is_damped(self):
        """Return whether the last command is that of the damping alone."""
        rates = -np.linalg.solve(DYNAMICS.mass_matrix(self.q()), self.robot.commands[-1]) / SPEED
        return rates == pytest.approx(np.full(6, DAMPING), rel=0.1)

    def wait_until_damped(self):
        self.robot.wait_until(self.is_damped, 'damping')


def run_moving_arm(run_node, robot, sign=1.0, rate=RATE, **parameters):
    """Return the node, and the motion that it receives, as soon as it commands."""
    node, motion = run_node(**{**MOVING, **parameters}), Motion(robot, sign, rate)
    robot.wait_until(lambda: robot.commands and np.any(robot.commands[-1]), 'commands')
    return node, motion


@pytest.mark.parametrize(
    ('way', 'rate'),
    [
        ('disable', 200),
        ('SIGTERM', 1000),
        *(pytest.param(way, 1000, marks=pytest.mark.long) for way in WAYS if way != 'SIGTERM'),
    ],
)
def test_the_motion_is_damped_until_the_arm_is_at_rest(run_node, robot, way, rate):
    node, motion = run_moving_arm(run_node, robot, rate=rate)
    stop(robot, node, way)
    motion.wait_until_damped()
    motion.rest()
    wait_for_end_of_stop(robot, node, way)
    assert 'stop damping ended: the arm is at rest' in node.output
    assert 'stop_ramp plus the time for stop_damping is 20.3 s, but ros2 launch' in node.output


def test_a_damped_deactivation_answers_services_and_hears_a_signal(run_node, robot):
    node, motion = run_moving_arm(run_node, robot)
    stop(robot, node, 'deactivate')
    motion.wait_until_damped()
    assert robot.set_parameter('start_ramp', 0.25).successful
    assert not robot.call(SetBool, 'enable', SetBool.Request(data=True)).success
    assert 'stop damping ended' not in node.output
    node.interrupt()
    robot.wait_for_text(node, 'signal received: the process ends after the stop')
    motion.rest()
    assert robot.wait_for_end(node) == 0
    assert 'stop damping ended: the arm is at rest' in node.output


def test_a_second_signal_ends_the_damping(run_node, robot):
    node, motion = run_moving_arm(run_node, robot)
    node.interrupt()
    motion.wait_until_damped()
    began = time.monotonic()
    robot.wait_until(lambda: time.monotonic() > began + 1.0, 'a second')
    node.interrupt()
    assert robot.wait_for_end(node) == 0
    robot.wait_for_command(ZERO, tolerance=0.0)
    assert 'stop damping ended' not in node.output


def test_an_arm_is_parked(run_program, run_node, robot):
    path, _, start = HORIZONTAL_ARMS['gripper_arm']
    states, brakes = [], []
    robot.node.create_subscription(JointState, 'joint_states', states.append, 1000)
    robot.node.create_subscription(Bool, 'brakes', lambda m: brakes.append(m.data), LATCHED)
    remap = ['--ros-args', '-r', 'commands:=inverse_dynamics/commands']
    arguments = f'{str(path)!r}, IDEAL, {RATE}, {remap}, start={list(start)}, release=0.3'
    code = (
        'from inverse_dynamics_node.simulation.drivers import IDEAL\n'
        'from inverse_dynamics_node.simulation.robot import simulate\n'
        f'simulate({arguments})'
    )
    run_program('-c', code)  # a robot that is held at first
    node = run_node(
        robot_description_file=f"'{path}'",
        mode='computed_torque',
        start_ramp=0.1,
        state_timeout=1.0,
        stop_damping=DAMPING,
        stop_ramp=2.0,
    )
    robot.wait_until(lambda: brakes and not brakes[-1], 'a robot that follows')
    example = [ROOT / 'examples' / 'park.py', 0.4, 'arm_2=1.2', 'arm_4=-0.6']
    parking = run_program(*example, stdout=subprocess.PIPE)
    robot.wait_until(lambda: parking.poll() is not None, 'end of the example')
    output, _ = parking.communicate(PATIENCE)
    assert parking.wait() == 0, output
    assert 'parked: efforts ramp down to zero' in output
    robot.wait_for_text(node, 'ramping efforts down: disabled by ~/enable')
    poses = [dict(zip(state.name, state.position, strict=True)) for state in states]
    # The arm sinks while this test waits, so its last pose is not the one in which it was parked.
    at = min(poses, key=lambda q: math.hypot(q['arm_2'] - 1.2, q['arm_4'] + 0.6))
    assert (at['arm_2'], at['arm_4']) == pytest.approx((1.2, -0.6), abs=0.2)
    assert at['arm_1'] == pytest.approx(start[0], abs=0.2)
