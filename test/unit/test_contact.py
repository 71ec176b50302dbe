"""Estimates of external efforts: zero for a correct model, minus the efforts of a push."""

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.contact import (
    COMPONENTS,
    ExternalEffortEstimator,
    LEAST_LEVER,
    tool_wrench,
)
from inverse_dynamics_node.robot.kinematics import last_link
import numpy as np
import pytest
from robot_files import ROOT, STANFORD

DT = 0.002


def motion(time):
    """Six joints swinging: positions, velocities, accelerations."""
    w = np.array([3.0, 2.0, 2.5, 4.0, 5.0, 3.5])
    a = np.array([0.3, 0.2, 0.05, 0.4, 0.3, 0.5])
    middle = np.array([0.0, 1.3, 0.6, 0.0, 0.6, 0.0])
    return (
        middle + a * np.sin(w * time),
        a * w * np.cos(w * time),
        -a * w * w * np.sin(w * time),
    )


@pytest.fixture
def dynamics():
    return InverseDynamics(load_urdf(STANFORD))


def run(dynamics, measured_of, steps=1000):
    estimator = ExternalEffortEstimator(InverseDynamics(dynamics.robot))
    for k in range(steps):
        q, qd, qdd = motion(DT * k)
        found = estimator.update(DT * k, q, qd, measured_of(q, qd, qdd))
    return found


def test_a_motion_that_the_model_explains_causes_small_estimates(dynamics):
    found = run(dynamics, dynamics.efforts)
    size = np.abs(dynamics.effort_terms(*motion(2.0)).inertial)
    assert (np.abs(found) < 0.1 * size + 0.15).all()


def test_a_push_appears_with_the_sign_of_the_external_term(dynamics):
    pushed = InverseDynamics(dynamics.robot)
    pushed.set_external_wrench('link_6', (5.0, 20.0, -10.0), (0.1, 0.2, 0.3))
    found = run(dynamics, pushed.efforts) - run(dynamics, dynamics.efforts)
    expected = pushed.effort_terms(*motion(DT * 999)).external
    assert np.abs(expected).max() > 5.0
    # The estimate lags behind the moving arm by the time constant of the low-pass.
    assert found == pytest.approx(expected, rel=0.1, abs=0.3)


def test_the_estimate_is_nan_until_an_effort_is_measured(dynamics):
    estimator = ExternalEffortEstimator(dynamics)
    q, qd, _ = motion(0.0)
    measured = dynamics.gravity_efforts(q)
    partly = measured.copy()
    partly[2] = np.nan
    found = estimator.update(0.0, q, 0 * qd, partly)
    assert np.isnan(found[2])
    assert np.delete(found, 2) == pytest.approx(0.0)
    found = estimator.update(0.01, q, 0 * qd, measured)
    assert found == pytest.approx(0.0)


def test_repeated_states_and_a_clock_that_is_set_back_are_accepted(dynamics):
    estimator = ExternalEffortEstimator(dynamics)
    q, qd, _ = motion(0.3)
    for time in (5.0, 5.0, 5.002, 1.0, 1.002):
        assert np.isfinite(estimator.update(time, q, qd, np.zeros(6))).all()


def test_the_first_state_is_not_filtered(dynamics):
    q, qd, _ = motion(0.3)
    estimator = ExternalEffortEstimator(dynamics)
    push = np.arange(1.0, 7.0)
    measured = dynamics.efforts(q, qd, np.zeros(6)) + push
    assert estimator.update(7.0, q, qd, measured) == pytest.approx(push)
    # A velocity that is constant from the start is not an acceleration.
    assert estimator.update(7.01, q, qd, measured) == pytest.approx(push)
    # The same after a gap.
    measured += push
    assert estimator.update(9.0, q, qd, measured) == pytest.approx(2.0 * push)


def test_a_push_rises_with_the_time_constant_of_the_low_pass(dynamics):
    q = motion(0.0)[0]
    estimator = ExternalEffortEstimator(dynamics)
    hold, push = dynamics.gravity_efforts(q), np.arange(1.0, 7.0)
    estimator.update(0.0, q, np.zeros(6), hold)
    time_constant = 1.0 / (2.0 * np.pi * 10.0)
    found = estimator.update(time_constant, q, np.zeros(6), hold + push)
    assert found == pytest.approx((1.0 - np.exp(-1.0)) * push)
    # No time has passed, so the filter does not move.
    again = estimator.update(time_constant, q, np.zeros(6), hold + 5.0 * push)
    assert again == pytest.approx(found)


WRENCH = np.array([12.0, -20.0, 9.0, 1.5, -2.0, 0.7])
ARMS = STANFORD, ROOT / 'test/robots/seven_dof.urdf'


def explained(robot, q, wrench=WRENCH, unmeasured=()):
    """Return what a wrench of the world on the last link explains of itself, and what it shows."""
    dynamics, link, rest = InverseDynamics(robot), last_link(robot), np.zeros(len(q))
    pushed = InverseDynamics(robot)
    pushed.set_external_wrench(link, wrench[:3], wrench[3:])
    measured = pushed.efforts(q, rest, rest)
    measured[list(unmeasured)] = np.nan
    efforts = ExternalEffortEstimator(dynamics).update(0.0, q, rest, measured)
    found, is_shown = tool_wrench(dynamics, q, link, efforts)
    return found, [name for name, shown in zip(COMPONENTS, is_shown, strict=True) if shown]


@pytest.mark.parametrize('path', ARMS, ids=lambda path: path.stem)
def test_a_wrench_on_the_tool_is_found_in_ten_poses(path):
    robot, random, poses = load_urdf(path), np.random.default_rng(2), 0
    lower, upper = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
    while poses < 10:
        found, shown = explained(robot, random.uniform(lower, upper))
        if len(shown) == 6:
            poses += 1
            assert found == pytest.approx(WRENCH, rel=0.03, abs=0.5)


def test_a_stretched_arm_does_not_show_the_force_along_itself():
    robot = load_urdf(ROOT / 'test/robots/seven_dof.urdf')
    found, shown = explained(robot, np.zeros(7))
    assert len(shown) < 6
    # Nothing is multiplied by more than the inverse of the least lever.
    largest = np.abs(found / [1.0, 1.0, 1.0, 0.3, 0.3, 0.3]).max()
    assert largest < np.linalg.norm(WRENCH) / LEAST_LEVER
    assert np.isfinite(found).all()
    for k in (COMPONENTS.index(name) for name in shown):
        assert found[k] == pytest.approx(WRENCH[k], rel=0.05, abs=0.05 * np.abs(WRENCH).max())


def test_components_that_too_few_joints_measure_are_not_shown():
    robot = load_urdf(ARMS[1])
    q = np.array([0.3, 0.8, -0.5, 1.2, 0.6, 0.9, 0.2])
    assert explained(robot, q)[1] == list(COMPONENTS)
    found, shown = explained(robot, q, unmeasured=(1, 4))
    assert np.isfinite(found).all()
    assert len(shown) < 6
