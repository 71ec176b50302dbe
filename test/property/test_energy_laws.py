"""The recursion compared with Lagrange's equations, and the power of friction."""

from hypothesis import given, settings
from inverse_dynamics_node import InverseDynamics
from kinematics import assert_close, gradient, Tree
import numpy as np
from numpy.testing import assert_allclose
import pytest
from random_trees import robots_with_states

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


@given(robots_with_states(mimics=False))
@settings(max_examples=30)
def test_power_of_viscous_friction_follows_from_its_coefficients(case):
    """As in the authors' journal version of 1980; in the text of 1979, it does not."""
    links, robot, (q, qd, qdd) = case
    damping = np.linspace(0.5, 2.0, len(q))
    dynamics = InverseDynamics(robot, GRAVITY)
    scale = np.abs(qd * dynamics.efforts(q, qd, qdd)).sum()
    dynamics.set_friction(damping, coulomb=0.0)
    power = qd @ dynamics.efforts(q, qd, qdd)
    lost = power - Tree(links, robot.joint_names).energy_growth(q, qd, qdd, GRAVITY)
    expected = qd @ (damping * qd)
    assert expected > 0.0
    assert lost == pytest.approx(expected, abs=1e-10 * (scale + expected))
