"""An arm under position control, with and without the efforts of the control loop beside it."""

import pytest

pytest.importorskip('mujoco')

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Settings
from inverse_dynamics_node.simulation.drivers import Actuation, Command, DRIVERS
from inverse_dynamics_node.simulation.hand_over import PositionLoop
from inverse_dynamics_node.simulation.mujoco import MujocoRobot
import numpy as np
from runaways import ARMS
from states import store_state

PERIOD = 0.005  # [s]
REST, DURATION = 4.0, 9.0  # [s]
FREQUENCY = 0.4  # [Hz]


def follow(arm, *, with_loop):
    """Return the sag at rest, and the largest error in motion [rad], of an arm that is moved."""
    path, start = ARMS[arm]
    robot = load_urdf(path)
    joints = [name for name in robot.joint_names if 'finger' not in name]
    index = robot.joint_indices(joints)
    hardware = MujocoRobot(robot, start, friction=False, joints=joints)
    mover = PositionLoop(Actuation(hardware, DRIVERS['beside_a_position_controller']))
    loop = ControlLoop(robot, joints, Settings(start_ramp=0.5, guiding_speed=1.0))
    loop.start()
    rate, swing = 2.0 * np.pi * FREQUENCY, 0.2
    errors = []
    for k in range(round(DURATION / PERIOD)):
        now = k * PERIOD
        t = max(0.0, now - REST)
        target = np.array(start)[index] + swing * (1.0 - np.cos(rate * t))
        velocity = np.full(len(index), swing * rate * np.sin(rate * t))
        acceleration = (t > 0.0) * swing * rate**2 * np.cos(rate * t)
        store_state(
            loop.collector, now, robot.joint_names, hardware.positions(), hardware.velocities()
        )
        loop.reference = Reference(np.full(len(index), acceleration), np.zeros(len(index)), now)
        command = loop.step(now)
        if with_loop:
            mover.command(Command(command.efforts), now)
        mover.follow(target, velocity)
        errors.append(np.abs(target - hardware.positions()[index]).max())
        mover.advance(now, PERIOD)
    assert not loop.supervisor.limit_stop
    first = round(REST / PERIOD)
    return errors[first - 1], max(errors[first:])


@pytest.mark.parametrize('arm', [name for name, (path, _) in ARMS.items() if path])
def test_sag_and_following_error_fall_to_a_twentieth(arm):
    sag, error = follow(arm, with_loop=False)
    assert sag > 0.02
    assert error > 0.02
    sag_with_loop, error_with_loop = follow(arm, with_loop=True)
    assert sag_with_loop < sag / 20.0
    assert error_with_loop < error / 20.0
