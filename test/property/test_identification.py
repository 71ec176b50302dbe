"""Robots identified from simulated recordings."""

from dataclasses import replace

from identification_runs import exciting_motion, real_robot, record
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.columns import base_parameters
from inverse_dynamics_node.analysis.identification import identify_parameters
from inverse_dynamics_node.analysis.identification.problem import (
    IdentificationProblem,
    identified_bodies,
)
from inverse_dynamics_node.analysis.identification.result import calibrated_urdf
from inverse_dynamics_node.dynamics.inverse_dynamics import STANDARD_GRAVITY
from inverse_dynamics_node.dynamics.jit import IS_COMPILED
from inverse_dynamics_node.robot.rigid_body import RigidBody
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
    return real, identify_parameters(robot, [recording])


def test_the_identified_model_predicts_unseen_data_to_the_noise(stanford):
    _, result = stanford
    assert result.accepted
    for joint in result.joints:
        assert joint.unseen.identified < 1.5 * joint.noise
        assert joint.unseen.identified < 0.5 * joint.unseen.urdf


def test_the_calibrated_urdf_has_the_fitted_efforts(stanford):
    real, result = stanford
    text = calibrated_urdf(result, STANFORD).decode()
    written = load_urdf(text)
    assert len(written.warnings) <= len(result.robot.warnings)
    rng = np.random.default_rng(1)
    states = rng.uniform(-1.0, 1.0, (3, 50, 6))
    expected = InverseDynamics(result.calibrated).efforts(*states)
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(InverseDynamics(written).efforts(*states), expected, atol=1e-9)
    true = InverseDynamics(real.robot).efforts(*states)
    wrong = InverseDynamics(result.robot).efforts(*states)
    assert np.linalg.norm(expected - true) < 0.3 * np.linalg.norm(wrong - true)


def normalized_errors(result, real):
    """Return the errors of the base parameters, divided by their standard errors."""
    free = identified_bodies(result.robot, ())
    joints = np.arange(len(result.joints))
    problem = IdentificationProblem(free, joints, np.array(STANDARD_GRAVITY), None, False)
    base = base_parameters(problem.at_random_states())
    bodies = zip(real.robot.mass, real.robot.com, real.robot.inertia, strict=True)
    parameters = np.array([RigidBody(*body).parameters() for body in bodies])
    true = base.combinations @ parameters[list(free.bodies)].ravel()
    _, values, errors = zip(*result.base_parameters, strict=True)
    return (np.array(values) - true) / np.array(errors)


def test_standard_errors_of_the_base_parameters_are_honest():
    robot, z = load_urdf(STANFORD), []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        real = real_robot(robot, rng)
        recording = record(real, exciting_motion(robot, rng, 12.0, 50.0), rng)
        z += normalized_errors(identify_parameters(robot, [recording]), real).tolist()
    assert len(z) > 190
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.mean(np.abs(z) < 2.0) > 0.9


def test_a_model_that_predicts_no_better_than_friction_is_not_accepted():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(2)
    real = replace(real_robot(robot, rng, armature=0.0), robot=robot)
    recording = record(real, exciting_motion(robot, rng, 15.0, 50.0), rng, noise=0.2)
    result = identify_parameters(robot, [recording])
    assert not result.accepted
    assert result.inertials == {}
    assert result.calibrated is robot
    assert '<mass value="9.29"/>' in calibrated_urdf(result, STANFORD).decode()


def test_efforts_that_are_not_related_to_the_motion_are_not_accepted():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(0)
    recording = record(real_robot(robot, rng), exciting_motion(robot, rng, 12.0, 50.0), rng)
    noise = rng.normal(0.0, 10.0, recording.efforts.shape)
    result = identify_parameters(robot, [recording._replace(efforts=noise)])
    assert not result.accepted
    assert result.inertials == {}
    assert 'hardly related to the motion: they vary by' in result.verdict


def test_a_delay_of_the_efforts_is_found():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(3)
    real = real_robot(robot, rng)
    motion = exciting_motion(robot, rng, 20.0, 100.0)
    result = identify_parameters(robot, [record(real, motion, rng, delay=0.008)])
    assert result.delay == pytest.approx(0.008, abs=5e-4)
    assert result.accepted


def test_a_gripper_that_is_not_on_the_robot_does_no_harm():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(4)
    real = real_robot(robot, rng)
    recording = record(real, exciting_motion(robot, rng, 20.0, 50.0), rng)
    unseen = record(real, exciting_motion(robot, rng, 10.0, 50.0), rng)
    text = STANFORD.read_text()
    load = (
        '<link name="tool0"><inertial><origin xyz="0 0.05 0.1"/><mass value="1.0"/>'
        '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    assert '<link name="tool0"/>' in text
    wrong = load_urdf(text.replace('<link name="tool0"/>', load))
    left = []
    for description in (robot, wrong):
        found = identify_parameters(description, [recording], [unseen]).unseen
        left.append(float(np.linalg.norm(found.measured - found.identified)))
    assert left[1] == pytest.approx(left[0], rel=0.03)


def test_gains_of_currents_are_found_up_to_a_common_factor():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(0)
    real = real_robot(robot, rng)
    recording = record(real, exciting_motion(robot, rng, 20.0, 100.0), rng)
    gains = np.array([2.0, 5.0, -40.0, 3.0, 8.0, 1.5])
    currents = recording._replace(efforts=recording.efforts / gains)
    result = identify_parameters(robot, [currents], currents=True)
    ratios = np.array([joint.gain for joint in result.joints])[:5] / gains[:5]
    np.testing.assert_allclose(ratios / np.mean(ratios), 1.0, atol=0.2)
    assert 0.7 < np.mean(ratios) < 1.4
    assert 'up to one common factor' in result.warnings[0][0]


def test_a_coupled_wrist_is_named_and_does_not_pass_for_friction():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(5)
    real = real_robot(robot, rng)
    motion = exciting_motion(robot, rng, 20.0, 100.0)
    recording = record(real, motion, rng)
    _, _, qd, qdd = motion
    coupling = np.zeros_like(qd)
    coupling[:, 4] = 3.0 * real.damping[4] * qd[:, 5] + real.armature[4] * qdd[:, 5]
    coupling[:, 4] += 2.0 * real.coulomb[4] * np.tanh(qd[:, 5] / real.width[5])
    result = identify_parameters(robot, [recording._replace(efforts=recording.efforts + coupling)])
    assert [joint.coupled_with for joint in result.joints] == [
        (),
        (),
        (),
        (),
        ('joint_6',),
        (),
    ]
    assert result.joints[4].terms.coulomb == pytest.approx(real.coulomb[4], rel=0.2)
