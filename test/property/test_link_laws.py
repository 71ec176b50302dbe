"""Laws of poses and Jacobians of links and bodies on random trees, with every kind of joint."""

from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.robot.kinematics import body_frames, rotation_about, rotation_of_rpy
from kinematics import Tree
import numpy as np
from numpy.testing import assert_allclose
from random_trees import robots_with_states
from scipy.spatial.transform import Rotation

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@given(robots_with_states(vectors=1))
def test_poses_and_jacobians_are_those_of_an_independent_tree(case):
    links, robot, (q,) = case
    dynamics = InverseDynamics(robot)
    placed = Tree(links, robot.joint_names).placed(q)
    for i, at in enumerate(placed):
        pose = np.block([[at.R, at.p[:, np.newaxis]], [np.zeros(3), 1.0]])
        assert_allclose(dynamics.pose(q, f'link{i}'), pose, rtol=0, atol=1e-12)
        jacobian = np.concatenate([at.linear, at.angular])
        assert_allclose(dynamics.jacobian(q, f'link{i}'), jacobian, rtol=0, atol=1e-12)


@given(robots_with_states(vectors=6))
@settings(max_examples=50)
def test_frames_of_bodies_in_many_poses_are_those_of_an_independent_tree(case):
    links, robot, q = case
    q = q.reshape(2, 3, -1)
    rotations, positions = body_frames(robot, q)
    assert positions.shape == (2, 3, len(robot.parent), 3)
    tree = Tree(links, robot.joint_names)
    for index in np.ndindex(2, 3):
        placed = tree.placed(q[index])
        for k, name in enumerate(robot.body_names):
            at = placed[int(name.removeprefix('link').removeprefix('joint'))]
            assert_allclose(rotations[index][k], at.R, rtol=0, atol=1e-12)
            assert_allclose(positions[index][k], at.p, rtol=0, atol=1e-12)


@given(seeds)
def test_rotations_are_about_their_axis_and_about_fixed_axes(rng):
    axis, rpy = rng.normal(size=3), rng.uniform(-3.0, 3.0, 3)
    axis /= np.linalg.norm(axis)
    expected = Rotation.from_rotvec(rpy[0] * axis).as_matrix()
    assert_allclose(rotation_about(axis, rpy[0]), expected, rtol=0, atol=1e-12)
    expected = Rotation.from_euler('xyz', rpy).as_matrix()
    assert_allclose(rotation_of_rpy(*rpy), expected, rtol=0, atol=1e-12)
