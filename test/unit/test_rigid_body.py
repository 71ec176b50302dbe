"""Rigid bodies keep their momentum when they are moved to another frame or combined."""

from inverse_dynamics_node.robot.rigid_body import combine, RigidBody
import kinematics
from loads import box_inertia, random_box
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal


def momentum(body, omega):
    """Return linear and angular momentum about the origin, for a rotation about the origin."""
    velocity = np.cross(omega, body.com)
    angular = body.inertia @ omega + body.mass * np.cross(body.com, velocity)
    return body.mass * velocity, angular


def random_bodies(rng, count=3):
    boxes = [random_box(rng) for _ in range(count)]
    return [RigidBody(mass, com, box_inertia(mass, box, rpy)) for mass, com, box, rpy in boxes]


def test_momentum_of_combined_bodies_is_the_sum(rng):
    bodies = random_bodies(rng)
    omega = rng.normal(size=3)
    expected = np.sum([momentum(body, omega) for body in bodies], axis=0)
    assert_allclose(momentum(combine(bodies), omega), expected, atol=1e-12)


def test_rotated_body_has_rotated_momentum(rng):
    (body,) = random_bodies(rng, 1)
    rotation = kinematics.rotation_of_rpy(rng.uniform(-3.0, 3.0, 3))
    omega = rng.normal(size=3)
    expected = [rotation @ each for each in momentum(body, omega)]
    assert_allclose(momentum(body.rotate(rotation), rotation @ omega), expected, atol=1e-12)


def test_shift_moves_only_the_centre_of_mass(rng):
    (body,) = random_bodies(rng, 1)
    shifted = body.shift(np.array([0.1, -0.2, 0.3]))
    assert_allclose(shifted.com - body.com, [0.1, -0.2, 0.3])
    assert shifted.mass == body.mass
    assert_array_equal(shifted.inertia, body.inertia)


def test_massless_bodies_keep_their_inertia():
    rotor = RigidBody(0.0, np.ones(3), np.diag([1e-3, 2e-3, 3e-3]))
    mass, com, inertia = combine([rotor, rotor])
    assert mass == 0.0
    assert_array_equal(com, np.zeros(3))
    assert_array_equal(inertia, np.diag([2e-3, 4e-3, 6e-3]))
