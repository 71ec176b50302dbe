"""What simulated drivers do with commands and measured efforts."""

from types import SimpleNamespace

from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
from robot_files import ROOT

pytest.importorskip('mujoco')
from inverse_dynamics_node.simulation.drivers import (
    Actuation,
    Command,
    DRIVERS,
    Form,
    read_command,
)
from inverse_dynamics_node.simulation.mujoco import MujocoRobot
from simulated_arm import accelerations

ROBOT = load_urdf(ROOT / 'test' / 'robots' / 'seven_dof.urdf')
JOINTS = ('shoulder', 'elbow')
AMPERE, MILLIAMPERE = 0.1, 1000.0 / 1.793
# Which share of gravity the driver compensates, and which one it measures; values for 1 N m as
# command and as measurement; gains of the drives.
CONVENTIONS = {
    'franka_ros2': (1.0, 1.0, 1.0, 1.0, (0.0, 0.0)),
    'ur': (1.0, 1.0, 1.0, AMPERE, (0.0, 0.0)),
    'ur_torques': (1.0, 0.0, 1.0, 1.0, (0.0, 0.0)),
    'lbr_fri': (1.0, 1.0, 1.0, 1.0, (150.0, 0.0)),
    'ros2_kortex': (0.0, 1.0, None, -1.0, None),
    'openarm': (0.0, 1.0, 1.0, 1.0, (150.0, 10.0)),
    'dynamixel_current': (0.0, 1.0, MILLIAMPERE, MILLIAMPERE, (0.0, 0.0)),
    'mujoco_ros2_control': (0.0, 1.0, 1.0, 1.0, (0.0, 0.0)),
    'gz_ros2_control': (0.0, 1.0, 1.0, 1.0, (0.0, 0.0)),
    'isaac_sim': (0.0, 1.0, 1.0, 1.0, (0.0, 0.0)),
    # Its gains belong to positions on another topic; see test_position_loop.py.
    'beside_a_position_controller': (0.0, 1.0, 1.0, 1.0, (0.0, 0.0)),
}


def behind(driver, joints=()):
    """Return a robot at rest, behind a driver."""
    q = np.clip(0.4, ROBOT.lower + 0.01, ROBOT.upper - 0.01)
    return Actuation(MujocoRobot(ROBOT, q, friction=False, joints=joints), driver)


def joint_state(**fields):
    return SimpleNamespace(**{'position': (), 'velocity': (), 'effort': (), **fields})


@pytest.mark.parametrize('load', [0.0, 1.5])
@pytest.mark.parametrize('name', DRIVERS)
def test_commands_and_measured_efforts_follow_the_conventions(name, load, rng):
    compensated, measured, command_unit, measured_unit, gains = CONVENTIONS[name]
    actuation = behind(DRIVERS[name])
    robot, dynamics = actuation.robot, InverseDynamics(ROBOT)
    for side in (robot, dynamics):
        side.set_payload('tool0', load)
    q, inertia = robot.positions(), robot.mass_matrix().diagonal()
    gravity = dynamics.gravity_efforts(q)
    assert abs(gravity).max() > 1.0
    efforts, off, speed = 0.1 * rng.uniform(-1.0, 1.0, (3, 7))
    if DRIVERS[name].form is not Form.NONE:
        message = joint_state(
            data=efforts * command_unit,
            name=ROBOT.joint_names[::-1],
            effort=efforts[::-1] * command_unit,
            position=(q + off)[::-1],
            velocity=speed[::-1],
        )
        actuation.command = read_command(DRIVERS[name], ROBOT.joint_names, message)
        efforts += inertia * (gains[0] * off + gains[1] * speed)
    else:
        efforts *= 0.0
    actuation.act()
    applied = efforts + compensated * gravity
    order = [robot.state_names.index(joint) for joint in ROBOT.joint_names]
    states = robot.state()[2]
    assert states[order] == pytest.approx(applied, abs=1e-9)
    expected = measured_unit * (applied - (1.0 - measured) * gravity)
    assert actuation.measured(states)[order] == pytest.approx(expected, abs=1e-9)
    resting = dynamics.efforts(q, 0.0 * q, accelerations(robot))
    assert resting == pytest.approx(applied, abs=1e-6)


def test_the_robot_compensates_gravity_and_nothing_else():
    actuation = behind(DRIVERS['franka_ros2'])
    robot = actuation.robot
    actuation.command = Command(np.full(7, 0.5))
    actuation.act()
    robot.advance(0.05)
    assert np.abs(robot.velocities()).max() > 0.01
    gravity = InverseDynamics(ROBOT).gravity_efforts(robot.positions())
    assert actuation.with_gravity(np.zeros(7)) == pytest.approx(gravity, abs=1e-9)


def test_joints_without_commands_measure_gravity_behind_every_driver():
    actuation = behind(DRIVERS['ur_torques'], ROBOT.joint_names[:-1])
    actuation.act()
    measured = actuation.measured(actuation.robot.state()[2])
    assert np.abs(measured[:-1]).max() < 1e-9
    gravity = InverseDynamics(ROBOT).gravity_efforts(actuation.robot.positions())[-1]
    assert abs(gravity) > 1e-4
    assert measured[-1] == pytest.approx(gravity, rel=0.05)


@pytest.mark.parametrize(
    ('driver', 'message', 'fault'),
    [
        (
            'ur',
            SimpleNamespace(data=[1.0]),
            'the message has 1 efforts, expected 2; to command some joints only, set the '
            'parameter joints of the simulated robot',
        ),
        ('ur', SimpleNamespace(data=[1.0, np.nan]), 'an effort in the message is not finite'),
        (
            'isaac_sim',
            joint_state(name=['elbow'], effort=[1.0]),
            'the message has no effort for shoulder',
        ),
        (
            'openarm',
            joint_state(name=JOINTS, effort=[1.0, 2.0], position=[0.0, np.inf]),
            'a position in the message is not finite',
        ),
        (
            'openarm',
            joint_state(name=JOINTS, effort=[1.0, 2.0], position=[0.0, 0.0]),
            'the message has no velocity for shoulder, elbow',
        ),
    ],
)
def test_incomplete_commands_are_refused(driver, message, fault):
    with pytest.raises(ValueError, match=f'^{fault}$'):
        read_command(DRIVERS[driver], JOINTS, message)
