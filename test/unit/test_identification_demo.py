"""The simulated robot of the scenario `calibrate`, and its verdict."""

import pytest

pytest.importorskip('mujoco')
pytest.importorskip('rclpy')

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.simulation.demo.demo_setup import DemoSetup
from inverse_dynamics_node.simulation.demo.identification import (
    check_identification,
    MASS,
    unknown_robot,
)
from inverse_dynamics_node.simulation.mujoco.hardware import MujocoRobot
import numpy as np
from numpy.testing import assert_allclose
from robot_files import ROOT, STANFORD

ROBOTS = STANFORD, ROOT / 'test' / 'robots' / 'gripper_arm.urdf'


def stage_of(path):
    robot = load_urdf(path)
    return DemoSetup(str(path), robot, 0.5 * (robot.lower + robot.upper), 10.0)


@pytest.mark.parametrize('path', ROBOTS, ids=lambda path: path.stem)
def test_the_simulated_robot_differs_from_its_urdf_as_stated(path):
    setup = stage_of(path)
    truth = unknown_robot(setup)
    robot, actual = setup.robot, load_urdf(truth.urdf.decode())
    assert actual.joint_names == robot.joint_names
    ratios = actual.link_mass[robot.link_mass > 0.0] / robot.link_mass[robot.link_mass > 0.0]
    assert (ratios >= MASS[0]).all()
    assert (ratios <= MASS[1]).all()
    assert np.abs(ratios - 1.0).max() > 0.1
    assert_allclose(actual.friction, truth.coulomb)
    assert_allclose(actual.damping, truth.damping)
    assert (truth.coulomb > 0.0).all()
    assert (truth.coulomb <= 0.05 * robot.effort_limits).all()
    assert (truth.armature > 0.0).all()
    assert unknown_robot(setup).urdf == truth.urdf
    MujocoRobot(truth.urdf.decode(), actual, setup.start, True, (), truth.armature)


@pytest.mark.parametrize(
    ('after', 'accepted', 'words'),
    [
        (0.002, True, 'fell from 50 to 2 mrad (mm) (RMS): 25 times better'),
        (
            0.020,
            True,
            'changed from 50 to 20 mrad (mm) (RMS): 2.5 times better, expected at least 5',
        ),
        (0.002, False, 'the identified model is not better than the URDF on unseen data'),
    ],
)
def test_the_verdict_compares_the_errors_of_both_runs(after, accepted, words):
    setup = stage_of(STANFORD)
    outcome = check_identification(setup, np.full(6, 0.05), np.full(6, after), accepted)
    assert words in str(outcome)
    assert bool(outcome.failures) == (not accepted or after > 0.01)
