"""The position controller of the simulated robot: it holds the arm, and its efforts are real."""

from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
import pytest
from robot_files import STANFORD

pytest.importorskip('mujoco')
from inverse_dynamics_node.simulation.drive import BRAKING, PositionDrive
from inverse_dynamics_node.simulation.mujoco.hardware import MujocoRobot

ROBOT = load_urdf(STANFORD)
START = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
PERIOD = 0.002
PAYLOAD = ('link_6', 2.0, [0.0, 0.0, 0.1], np.eye(3) * 1e-3)


def robot_and_drive(sways=False):
    robot = MujocoRobot(STANFORD, ROBOT, START)
    robot.brakes_on = False
    return robot, PositionDrive(robot, sways)


def run(robot, drive, start, end):
    """Advance; return the positions and efforts of all steps, in the order of the joints."""
    order = [robot.state_names.index(name) for name in ROBOT.joint_names]
    rows = []
    for now in np.arange(start, end, PERIOD):
        drive.act(now)
        robot.advance(PERIOD)
        positions, _, efforts = robot.state()
        rows.append((positions[order], efforts[order]))
    return (np.array(part) for part in zip(*rows, strict=True))


def test_it_holds_the_arm_with_the_efforts_of_gravity():
    positions, efforts = run(*robot_and_drive(), 0.0, 0.5)
    assert np.abs(positions - START).max() < 1e-3
    expected = InverseDynamics(ROBOT).gravity_efforts(START)
    assert np.abs(expected).max() > 10.0
    assert efforts[-1] == pytest.approx(expected, abs=0.01)


def test_its_efforts_carry_a_load_that_the_model_does_not_know():
    robot, drive = robot_and_drive()
    robot.world.set_payload(*PAYLOAD)
    _, efforts = run(robot, drive, 0.0, 0.5)
    dynamics = InverseDynamics(ROBOT)
    unloaded = dynamics.gravity_efforts(START)
    dynamics.set_payload(*PAYLOAD)
    loaded = dynamics.gravity_efforts(START)
    assert np.abs(loaded - unloaded).max() > 5.0
    assert efforts[-1] == pytest.approx(loaded, abs=0.05)


def test_every_joint_sways_within_its_limits():
    positions, _ = run(*robot_and_drive(sways=True), 0.0, 8.0)
    assert (np.ptp(positions, axis=0) > [0.2] * 2 + [0.05] + [0.2] * 3).all()
    assert (positions > ROBOT.lower).all()
    assert (positions < ROBOT.upper).all()
    assert np.abs(np.diff(positions, axis=0)).max() < 1e-3


def test_it_stops_swaying_before_it_releases_the_robot():
    robot, drive = robot_and_drive(sways=True)
    run(robot, drive, 0.0, 2.0)
    drive.stand_still(2.0)
    positions, _ = run(robot, drive, 2.0, 3.0)
    assert np.ptp(positions[-100:], axis=0).max() < 1e-6


def test_it_brakes_a_falling_robot_smoothly():
    robot, drive = robot_and_drive()
    run(robot, drive, 0.0, 0.1)
    robot.command(np.zeros(6))
    for _ in range(50):
        robot.advance(PERIOD)
    fallen, speed = robot.positions(), robot.velocities()
    assert np.abs(fallen - START).max() > 0.01
    assert np.abs(speed).max() > 1.0
    drive.take_over(0.2)
    positions, _ = run(robot, drive, 0.2, 1.2)
    assert positions[-1] == pytest.approx(fallen + 0.5 * BRAKING * speed, abs=1e-3)
    decelerations = np.abs(np.diff(positions, 2, axis=0)).max(axis=0) / PERIOD**2
    assert (decelerations < 1.0 + 2.0 * np.abs(speed) / BRAKING).all()


def test_it_does_not_brake_beyond_a_limit():
    start = np.where(np.isfinite(ROBOT.upper), ROBOT.upper - 0.01, START)
    robot = MujocoRobot(STANFORD, ROBOT, start)
    robot.brakes_on = False
    push = InverseDynamics(ROBOT).mass_matrix(start).diagonal() * [1, 5, 1, 1, 1, 1]
    robot.command(InverseDynamics(ROBOT).gravity_efforts(start) + push)
    for _ in range(20):
        robot.advance(PERIOD)
    assert robot.velocities()[1] * BRAKING / 2 > ROBOT.upper[1] - robot.positions()[1] > 0.0
    positions, _ = run(robot, PositionDrive(robot, False), 0.0, 1.0)
    assert positions[-1][1] == pytest.approx(ROBOT.upper[1], abs=1e-3)
    assert positions[:, 1].max() < ROBOT.upper[1] + 2e-3
