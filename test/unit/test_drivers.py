"""What simulated drivers do with commands and measured efforts."""

from types import SimpleNamespace

from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
from robot_files import ROOT

pytest.importorskip('mujoco')
from accelerated_robot import AcceleratedRobot
from inverse_dynamics_node.simulation.drivers import (
    Actuation,
    Command,
    Driver,
    DRIVERS,
    Form,
    read_command,
    TORQUES,
)

ARM = ROOT / 'test' / 'robots' / 'seven_dof.urdf'
JOINTS = ('shoulder', 'elbow')


def behind(driver, held=()):
    """Return a robot at rest without brakes, behind a driver."""
    robot = load_urdf(ARM)
    middle = np.clip(0.4, robot.lower + 0.01, robot.upper - 0.01)
    hardware = AcceleratedRobot(ARM, robot, middle, friction=False, held=held)
    hardware.brakes_on = False
    return Actuation(hardware, driver), InverseDynamics(robot)


@pytest.mark.parametrize('load', [0.0, 1.5])
def test_a_driver_that_adds_gravity_holds_the_arm_without_commands(load):
    actuation, dynamics = behind(DRIVERS['franka_ros2'])
    robot = actuation.robot
    robot.world.set_payload('tool0', load)
    dynamics.set_payload('tool0', load)
    actuation.act()
    assert np.abs(robot.accelerations()).max() < 1e-9
    efforts = robot.state()[2][[robot.state_names.index(j) for j in robot.command_names]]
    assert efforts == pytest.approx(dynamics.gravity_efforts(robot.positions()), abs=1e-9)
    assert actuation.measured(robot.state()[2]) == pytest.approx(robot.state()[2])


def test_it_adds_gravity_and_nothing_else():
    actuation, dynamics = behind(DRIVERS['franka_ros2'])
    robot = actuation.robot
    actuation.command = Command(np.full(len(robot.command_names), 0.5))
    actuation.act()
    robot.advance(0.05)
    q, qd = robot.positions(), robot.velocities()
    assert np.abs(qd).max() > 0.01
    applied = actuation.with_gravity(np.zeros(len(q)))
    assert applied == pytest.approx(dynamics.gravity_efforts(q), abs=1e-9)


def test_measured_efforts_without_gravity_are_zero_at_rest_and_those_of_held_joints_stay():
    held = load_urdf(ARM).joint_names[-1]
    actuation, dynamics = behind(DRIVERS['ur_torques'], held=[held])
    actuation.act()
    measured = actuation.measured(actuation.robot.state()[2])
    assert np.abs(measured[:-1]).max() < 1e-9
    gravity = dynamics.gravity_efforts(actuation.robot.positions())[-1]
    assert abs(gravity) > 1e-4
    assert measured[-1] == pytest.approx(gravity, rel=0.05)


def test_commands_and_measured_efforts_have_the_unit_of_the_driver():
    driver = Driver(command_unit=500.0, measured_unit=-2.0)
    command = read_command(driver, JOINTS, SimpleNamespace(data=[1000.0, -500.0]))
    assert command.efforts.tolist() == [2.0, -1.0]
    actuation, _ = behind(driver)
    efforts = np.arange(len(actuation.robot.state_names), dtype=float)
    assert actuation.measured(efforts).tolist() == (-2.0 * efforts).tolist()


def test_gains_of_the_drives_pull_to_the_commanded_motion():
    stiffness, damping = 150.0, 10.0
    actuation, _ = behind(Driver(Form.MOTION, gains=(stiffness, damping)))
    robot, plain = actuation.robot, behind(TORQUES)[0]
    q = robot.positions()
    inertia = robot.mass_matrix().diagonal()
    efforts = 0.1 * np.ones(len(q))
    actuation.command = Command(efforts, q + 0.01, np.full(len(q), 0.02))
    plain.command = Command(efforts + inertia * (0.01 * stiffness + 0.02 * damping))
    for each in (actuation, plain):
        each.act()
    assert robot.state()[2] == pytest.approx(plain.robot.state()[2])


def joint_state(**fields):
    return SimpleNamespace(**{'position': (), 'velocity': (), 'effort': (), **fields})


def test_commands_by_name_come_in_any_order():
    message = joint_state(
        name=['wrist', 'elbow', 'shoulder'],
        position=[0.0, 0.2, 0.1],
        velocity=[0.0, 0.4, 0.3],
        effort=[0.0, 6.0, 5.0],
    )
    command = read_command(DRIVERS['isaac_sim'], JOINTS, message)
    assert command.efforts.tolist() == [5.0, 6.0]
    assert command.positions is command.velocities is None
    complete = read_command(DRIVERS['openarm'], JOINTS, message)
    assert [part.tolist() for part in complete] == [[5.0, 6.0], [0.1, 0.2], [0.3, 0.4]]


@pytest.mark.parametrize(
    ('driver', 'message', 'fault'),
    [
        (
            'ur',
            SimpleNamespace(data=[1.0]),
            'the message has 1 efforts, expected 2; use --held for joints without commands',
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
