"""Robots identified from simulated recordings."""

from dataclasses import replace

from calibration_runs import exciting_motion, real_robot, record
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.calibration import calibrate
from inverse_dynamics_node.analysis.calibration.export import calibrated_urdf
from inverse_dynamics_node.dynamics.jit import IS_COMPILED
import numpy as np
import pytest
from robot_files import STANFORD

# Without compiled functions these tests take minutes.
pytestmark = pytest.mark.skipif(not IS_COMPILED, reason='numba is not here, or off')


@pytest.fixture(scope='module')
def stanford():
    """Return a robot that differs from its description, and its calibration."""
    robot, rng = load_urdf(STANFORD), np.random.default_rng(0)
    real = real_robot(robot, rng)
    recording = record(real, exciting_motion(robot, rng, 30.0, 100.0), rng)
    return real, calibrate(robot, [recording])


def test_the_identified_model_predicts_unseen_data_to_the_noise(stanford):
    _, calibration = stanford
    assert calibration.accepted
    for joint in calibration.joints:
        assert joint.unseen.identified < 1.5 * joint.noise
        assert joint.unseen.identified < 0.5 * joint.unseen.urdf


def test_the_calibrated_urdf_has_the_fitted_efforts(stanford):
    real, calibration = stanford
    text = calibrated_urdf(calibration, STANFORD).decode()
    written = load_urdf(text)
    assert len(written.warnings) <= len(calibration.robot.warnings)
    rng = np.random.default_rng(1)
    states = rng.uniform(-1.0, 1.0, (3, 50, 6))
    expected = InverseDynamics(calibration.calibrated).efforts(*states)
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(InverseDynamics(written).efforts(*states), expected, atol=1e-9)
    true = InverseDynamics(real.robot).efforts(*states)
    wrong = InverseDynamics(calibration.robot).efforts(*states)
    assert np.linalg.norm(expected - true) < 0.3 * np.linalg.norm(wrong - true)


def test_a_model_that_predicts_no_better_than_friction_is_not_accepted():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(2)
    real = replace(real_robot(robot, rng, armature=0.0), robot=robot)
    recording = record(real, exciting_motion(robot, rng, 15.0, 50.0), rng, noise=0.2)
    calibration = calibrate(robot, [recording])
    assert not calibration.accepted
    assert calibration.inertials == {}
    assert calibration.calibrated is robot
    assert '<mass value="9.29"/>' in calibrated_urdf(calibration, STANFORD).decode()


def test_a_delay_of_the_efforts_is_found():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(3)
    real = real_robot(robot, rng)
    motion = exciting_motion(robot, rng, 20.0, 100.0)
    calibration = calibrate(robot, [record(real, motion, rng, delay=0.008)])
    assert calibration.delay == pytest.approx(0.008, abs=5e-4)
    assert calibration.accepted
