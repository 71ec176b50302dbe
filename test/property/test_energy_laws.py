"""The recursion compared with Lagrange's equations, and the power of friction."""

from hypothesis import given, settings
from inverse_dynamics_node import InverseDynamics, load_urdf
from kinematics import assert_close, derivative, gradient, Tree
import numpy as np
from numpy.testing import assert_allclose
import pytest
from random_trees import random_chain, robots_with_states, urdf_of

GRAVITY = (0.6, -1.5, -9.0)


@given(robots_with_states(vectors=1))
def test_mass_matrix_follows_from_the_kinetic_energy(case):
    links, robot, (q,) = case
    expected = Tree(links, robot.joint_names).mass_matrix(q)
    assert_close(InverseDynamics(robot).mass_matrix(q), expected)


@given(robots_with_states())
@settings(max_examples=30)
def test_efforts_follow_from_lagranges_equations(case):
    links, robot, (q, qd, qdd) = case
    expected = Tree(links, robot.joint_names).efforts(q, qd, qdd, GRAVITY)
    assert_close(InverseDynamics(robot, GRAVITY).efforts(q, qd, qdd), expected)


@given(robots_with_states())
@settings(max_examples=30)
def test_effort_terms_follow_from_lagranges_equations(case):
    links, robot, (q, qd, qdd) = case
    tree = Tree(links, robot.joint_names)
    dynamics = InverseDynamics(robot, GRAVITY)
    terms = dynamics.effort_terms(q, qd, qdd)
    assert_close(terms.inertial, tree.mass_matrix(q) @ qdd)
    # Without gravity and accelerations; zero for a single prismatic joint, hence the scale.
    scale = np.abs(dynamics.efforts(q, qd, qdd)).max()
    expected = tree.efforts(q, qd, 0.0 * qdd, np.zeros(3))
    assert_allclose(terms.coriolis, expected, rtol=0, atol=1e-10 * scale)
    assert_allclose(dynamics.coriolis_efforts(q, qd), expected, rtol=0, atol=1e-10 * scale)
    expected = gradient(lambda x: tree.potential_energy(x, GRAVITY), q)
    assert_allclose(terms.gravity, expected, rtol=0, atol=1e-10 * scale)
    assert_allclose(dynamics.gravity_efforts(q), expected, rtol=0, atol=1e-10 * scale)
    assert not terms.friction.any()
    assert not terms.external.any()


@given(robots_with_states(vectors=2))
@settings(max_examples=30)
def test_power_of_coriolis_efforts_is_half_that_of_the_changing_mass_matrix(case):
    links, robot, (q, qd) = case
    # qd (Mdot - 2 C) qd = 0, with Mdot from the kinetic energy
    tree = Tree(links, robot.joint_names)
    growth = qd @ derivative(lambda t: tree.mass_matrix(q + t * qd)) @ qd
    velocity = InverseDynamics(robot).coriolis_efforts(q, qd)
    scale = np.abs(qd * velocity).sum() + qd @ tree.mass_matrix(q) @ qd
    assert scale > 0.0
    assert_allclose(2.0 * qd @ velocity, growth, rtol=0, atol=1e-10 * scale)


def test_coriolis_efforts_of_these_trees_are_not_zero():
    """The comparisons above are relative to other terms; this one is not."""
    for seed in range(10):
        links = random_chain(np.random.default_rng(seed), 4)
        robot = load_urdf(urdf_of(links))
        q, qd = np.random.default_rng(seed).uniform(-3.0, 3.0, (2, 4))
        expected = Tree(links, robot.joint_names).efforts(q, qd, np.zeros(4), np.zeros(3))
        assert_close(InverseDynamics(robot).coriolis_efforts(q, qd), expected)


# Friction: where the 1979 text and the authors' journal version of 1980 differ


def power_lost(links, efforts_of, q, qd, qdd):
    """Return the joint power in excess of the energy rate, and the expected friction power."""
    robot = load_urdf(urdf_of(links))
    damping = np.linspace(0.5, 2.0, len(q))
    tree = Tree(links, robot.joint_names)
    power = qd @ efforts_of(links, robot, damping, q, qd, qdd)
    return power - tree.energy_growth(q, qd, qdd, GRAVITY), qd @ (damping * qd)


def efforts_of_1980(links, robot, damping, q, qd, qdd):
    """Return the core's efforts: tau = n . z + b qd."""
    dynamics = InverseDynamics(robot, GRAVITY)
    dynamics.set_friction(damping, coulomb=0.0)
    return dynamics.efforts(q, qd, qdd)


def efforts_of_1979(links, robot, damping, q, qd, qdd):
    """
        Add b qd z to the net force or moment of each link, as LWP (22) and (23) have it.

    The inward pass propagates a net force and moment to every joint below, as does a
    transposed Jacobian.

    """
    tree = Tree(links, robot.joint_names)
    efforts = InverseDynamics(robot, GRAVITY).efforts(q, qd, qdd)
    for i, (link, at) in enumerate(zip(links, tree.placed(q), strict=True)):
        k = tree.column[i]
        if k < 0:
            continue
        axis = at.R @ np.array(link.axis) / np.linalg.norm(link.axis)
        friction = damping[k] * qd[k] * axis
        if link.kind == 'prismatic':
            _, jacobian = at.point(np.array(link.com))  # a net force acts at the centre of mass
        else:
            jacobian = at.angular
        efforts = efforts + jacobian.T @ friction
    return efforts


@given(robots_with_states(mimics=False))
@settings(max_examples=30)
def test_power_of_viscous_friction_follows_from_its_coefficients(case):
    links, _, state = case
    lost, expected = power_lost(links, efforts_of_1980, *state)
    assert expected > 0.0
    robot = load_urdf(urdf_of(links))
    scale = np.abs(state[1] * InverseDynamics(robot, GRAVITY).efforts(*state)).sum()
    assert lost == pytest.approx(expected, abs=1e-10 * (scale + expected))


@pytest.mark.parametrize('seed', range(5))
def test_friction_placed_as_in_1979_breaks_the_balance_of_power(seed):
    links = random_chain(np.random.default_rng(seed), 6)
    state = np.random.default_rng(seed).uniform(-3.0, 3.0, (3, 6))
    lost, expected = power_lost(links, efforts_of_1979, *state)
    assert abs(lost - expected) > 0.05 * expected
    lost, expected = power_lost(links, efforts_of_1980, *state)
    assert lost == pytest.approx(expected, rel=1e-9)


def test_friction_placed_as_in_1979_omits_a_joint_whose_link_does_not_rotate():
    """Two parallel hinges with friction, the second undoing the rotation of the first."""
    first, second = random_chain(np.random.default_rng(1979), 2)[1:]
    base = random_chain(np.random.default_rng(1979), 1)[0]
    straight = {'axis': (0.0, 0.0, 1.0), 'rpy': (0.0, 0.0, 0.0), 'kind': 'revolute'}
    links = [base, first.moved(**straight), second.moved(**straight)]
    q, qd, qdd = np.array([[0.3, -0.8], [1.5, -1.5], [0.2, 0.7]])
    d1, d2 = 0.5, 2.0  # as in power_lost
    lost, _ = power_lost(links, efforts_of_1980, q, qd, qdd)
    assert lost == pytest.approx((d1 + d2) * 1.5**2, rel=1e-9)
    # The second link does not rotate, so the friction at its joint is omitted.
    lost, _ = power_lost(links, efforts_of_1979, q, qd, qdd)
    assert lost == pytest.approx(d1 * 1.5**2, rel=1e-9)
