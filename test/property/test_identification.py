"""Robots identified from simulated recordings."""

from dataclasses import replace

from benchmarks.identified_terms import counted
from identification_runs import exciting_motion, real_robot, record
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.identification import DriveTerms, identify_parameters
from inverse_dynamics_node.analysis.identification.fit import body_covariance, minimise, Prior
from inverse_dynamics_node.analysis.identification.regression import (
    ARMATURE,
    COULOMB,
    DAMPING,
    IdentificationProblem,
    IdentifiedBodies,
    LOAD,
    Model,
    OFFSET,
    regression_of,
    SPRING,
    TERMS,
)
from inverse_dynamics_node.analysis.identification.result import (
    calibrated_urdf,
    identified_parameters,
)
from inverse_dynamics_node.analysis.recordings.signals import Motion
from inverse_dynamics_node.dynamics.inverse_dynamics import STANDARD_GRAVITY
from inverse_dynamics_node.node.configure import make_loop
from inverse_dynamics_node.node.parameters import Configuration, PARAMETERS
from inverse_dynamics_node.report.identification_report import friction_table
from inverse_dynamics_node.robot.rigid_body import RigidBody
import numpy as np
import pytest
from robot_files import STANFORD
import yaml


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


def test_a_mass_that_influences_no_effort_has_a_large_error(stanford):
    _, result = stanford
    errors = [body.mass_error / body.mass for body in result.bodies]
    assert errors[0] > 0.2  # the first link only turns about a vertical axis
    assert min(errors) < 0.1


def normalized_errors(fit, real):
    """Return the errors of what the efforts determine of the bodies, in standard errors."""
    problem, count = fit.equations.regression.problem, fit.model.bodies.size
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 60, 6))
    states *= np.array([np.pi, 3.0, 10.0])[:, None, None]
    columns = problem.columns(Motion(np.arange(60.0), *states, np.zeros((60, 6)), 1, 4))
    _, sizes, directions = np.linalg.svd(columns.reshape(-1, count), full_matrices=False)
    base = directions[sizes > 1e-8 * sizes[0]]
    bodies = zip(real.robot.mass, real.robot.com, real.robot.inertia, strict=True)
    true = np.array([RigidBody(*body).parameters() for body in bodies])[problem.identified.bodies]
    covariance = np.linalg.inv(fit.hessian)[:count, :count]
    errors = base @ (fit.model.bodies - true).ravel()
    return errors / np.sqrt(np.einsum('ri,ij,rj->r', base, covariance, base))


@pytest.mark.long
def test_standard_errors_of_the_bodies_are_honest(monkeypatch):
    robot, fits, z = load_urdf(STANFORD), [], []
    name = 'inverse_dynamics_node.analysis.identification.evaluation.body_covariance'
    monkeypatch.setattr(name, lambda fit: fits.append(fit) or body_covariance(fit))
    for seed in range(6):
        rng = np.random.default_rng(seed)
        real = real_robot(robot, rng)
        recording = record(real, exciting_motion(robot, rng, 12.0, 50.0), rng)
        identify_parameters(robot, [recording])
        z += normalized_errors(fits[-1], real).tolist()
    assert len(z) > 190
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.mean(np.abs(z) < 2.0) > 0.9


def test_the_solver_stays_physical_if_the_data_contradict_this():
    reference = IdentifiedBodies(load_urdf(STANFORD)).reference
    prior = Prior(reference, 1.0, np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
    start = reference.ravel()
    for seed in range(20):
        rng = np.random.default_rng(seed)
        rows = rng.normal(size=(rng.integers(5, 58), len(start)))
        rows *= 10 ** rng.uniform(-2.0, 2.0, len(start))
        matrix = 10 ** rng.uniform(4.0, 12.0) * rows.T @ rows
        x, _ = minimise(
            matrix, matrix @ (10.0 * start * rng.normal(size=len(start))), prior, start
        )
        assert np.isfinite(prior.value(x))
        assert not np.array_equal(x, start)


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
    assert 'explains 0% of the variation of the efforts, which is ' in result.verdict


@pytest.mark.long
def test_a_delay_of_the_efforts_is_found():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(3)
    real = real_robot(robot, rng)
    motion = exciting_motion(robot, rng, 20.0, 100.0)
    result = identify_parameters(robot, [record(real, motion, rng, delay=0.008)])
    assert result.delay == pytest.approx(0.008, abs=5e-4)
    assert result.accepted


@pytest.mark.long
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


@pytest.mark.long
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


def identified(seed=5, duration=20.0, **changes):
    """Identify a robot that differs from its description, and has other drives."""
    robot, rng = load_urdf(STANFORD), np.random.default_rng(seed)
    real = real_robot(robot, rng)
    real = replace(real, **{name: make(real) for name, make in changes.items()})
    motion = exciting_motion(robot, rng, duration, 50.0)
    return real, motion, identify_parameters(robot, [record(real, motion, rng)])


def of_joint(k, value):
    return np.where(np.arange(6) == k, value, 0.0)


def extras_of(result):
    """Return the names of the extras that were found, joint by joint."""
    names = 'coupling', 'stiffness'
    return [[name for name in names if getattr(j.terms, name)] for j in result.joints]


def exported_efforts(result, q, qd, qdd):
    """Compute the efforts of a result by the library."""
    terms = {name: [getattr(j.terms, name) for j in result.joints] for name in vars(DriveTerms())}
    dynamics = InverseDynamics(result.calibrated)
    dynamics.set_drive_coupling(terms['coupling'])
    dynamics.set_friction(
        terms['damping'],
        terms['coulomb'],
        terms['width'],
        terms['load_friction'],
    )
    dynamics.set_armature(terms['armature'])
    dynamics.set_springs(terms['stiffness'], terms['rest'])
    return dynamics.efforts(q, qd, qdd) + terms['offset']


def test_a_coupled_wrist_is_found():
    real, motion, result = identified(
        coupling=lambda real: of_joint(5, 0.8),
        damping=lambda real: real.damping * np.where(np.arange(6) == 5, 3.0, 1.0),
    )
    assert extras_of(result) == [[], [], [], [], [], ['coupling']]
    assert result.joints[5].terms.coupling == pytest.approx(0.8, rel=0.05)
    assert [joint.coupled_with for joint in result.joints][4:] == [('joint_6',), ('joint_5',)]
    assert result.joints[4].terms.coulomb == pytest.approx(real.coulomb[4], rel=0.2)
    table = ' '.join(friction_table(result).split())
    assert 'joint_6: the velocity of the drive is the velocity of this joint + 0.' in table
    check_exported(result, real, motion)


def test_a_counterweight_is_found():
    real, motion, result = identified(
        stiffness=lambda real: of_joint(1, 60.0), rest=lambda real: of_joint(1, -1.0)
    )
    assert extras_of(result) == [[], ['stiffness'], [], [], [], []]
    assert result.joints[1].terms.stiffness == pytest.approx(60.0, rel=0.1)
    assert result.joints[1].terms.rest == pytest.approx(-1.0, abs=0.2)
    assert result.joints[1].terms.offset == 0.0
    table = ' '.join(friction_table(result).split())
    assert (
        'an effort proportional to the position, as of a spring, a counterweight or cab' in table
    )
    check_exported(result, real, motion)


def test_a_weak_counterweight_is_found_in_a_short_recording_and_nothing_is_invented():
    for seed in (0, 1):
        springs, _, extras, _, armatures, existing, invented, _, _ = counted(
            load_urdf(STANFORD), seed, duration=10.0, stiffness=0.5
        )
        assert springs == 1
        assert extras == invented == 0
        assert armatures >= existing - 1


def test_the_regression_and_the_library_have_the_same_efforts():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(8)
    bodies = IdentifiedBodies(robot)
    problem = IdentificationProblem(bodies, list(range(6)), np.array(STANDARD_GRAVITY))
    times, q, qd, qdd = exciting_motion(robot, rng, 4.0, 50.0)
    motion = Motion(times, q, qd, qdd, np.zeros_like(q), 1, 4)  # without smoothing
    joints = rng.uniform(0.2, 2.0, (6, TERMS))
    joints[3:, SPRING] = 0.0
    couplings = np.array([0.0, 0.0, 0.0, 0.5, 0.0, -1.0])
    model = Model(bodies.before, joints, rng.uniform(0.05, 0.5, 6), couplings)
    dynamics = InverseDynamics(robot)
    damping, coulomb, per_load = joints[:, [DAMPING, COULOMB, LOAD]].T
    dynamics.set_friction(damping, coulomb, model.widths, per_load)
    dynamics.set_armature(joints[:, ARMATURE])
    dynamics.set_drive_coupling(couplings)
    offset, stiffness = joints[:, OFFSET], joints[:, SPRING]
    is_spring = stiffness > 0.0
    dynamics.set_springs(stiffness, np.where(is_spring, -offset, 0.0) / np.maximum(stiffness, 0.1))
    expected = dynamics.efforts(q, qd, qdd) + np.where(is_spring, 0.0, offset)
    actual = regression_of(problem, [motion], 0.0, 1).predict(model)
    assert len(actual) == len(expected)
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def check_exported(result, real, motion):
    """Compare the library with the robot, and the node with the library."""
    _, q, qd, qdd = motion
    assert result.accepted
    actual = exported_efforts(result, q, qd, qdd)
    expected = real.efforts(q, qd, qdd)
    error = np.sqrt(np.mean((actual - expected) ** 2, axis=0))
    assert (error < 0.05 * np.sqrt(np.mean(expected**2, axis=0))).all()
    values = yaml.safe_load(identified_parameters(result))['/**']['ros__parameters']
    values = {
        name: each.check(values.get(name, each.default)) for name, each in PARAMETERS.items()
    }
    configuration = Configuration(**values)
    loop = make_loop(configuration, load_urdf(calibrated_urdf(result, STANFORD).decode()), '')
    offset = np.array([joint.terms.offset for joint in result.joints])
    tolerance = 1e-9 * np.abs(expected).max()
    of_node = loop.dynamics.efforts(q, qd, qdd) + offset
    np.testing.assert_allclose(of_node, actual, rtol=0, atol=tolerance)


def test_nothing_is_invented_if_joints_moved_in_a_fixed_ratio():
    robot, rng = load_urdf(STANFORD), np.random.default_rng(6)
    motion = exciting_motion(robot, rng, 20.0, 50.0)
    for signal in motion[1:]:
        signal[:, 5] = -0.5 * signal[:, 4]
    recording = record(real_robot(robot, rng), motion, rng)
    result = identify_parameters(robot, [recording])
    assert result.accepted
    assert extras_of(result) == [[]] * 6


@pytest.mark.long  # minutes
def test_nothing_is_invented_on_robots_without_extras():
    found = []
    for seed in range(40):
        per_load = np.full(6, 0.03 * (seed % 3))
        _, _, result = identified(seed, load_friction=lambda real, value=per_load: value)
        found += [(seed, names) for names in extras_of(result) if names]
    assert not found
