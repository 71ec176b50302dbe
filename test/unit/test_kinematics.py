"""The poses of the bodies are consistent with gravity: efforts are the slope of the height."""

from inverse_dynamics_node.dynamics.inverse_dynamics import InverseDynamics
from inverse_dynamics_node.robot.kinematics import body_frames, rotation_about, rotation_of_rpy
from inverse_dynamics_node.robot.urdf import load_urdf
import kinematics
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import ROOT

GRAVITY = np.array([0.4, -1.2, -9.5])


def test_gravity_efforts_are_the_slope_of_the_potential_energy(urdf_path, rng):
    robot = load_urdf(urdf_path)
    dynamics = InverseDynamics(robot, GRAVITY)

    def energy(q):
        rotations, positions = body_frames(robot, q)
        centres = positions + np.einsum('bij,bj->bi', rotations, robot.com)
        return -robot.mass @ centres @ GRAVITY

    q = rng.uniform(-1.0, 1.0, len(robot.joint_names))
    steps = 1e-6 * np.eye(len(q))
    slope = [(energy(q + step) - energy(q - step)) / 2e-6 for step in steps]
    assert slope == pytest.approx(dynamics.gravity_efforts(q), abs=1e-6)


def test_frames_are_right_handed_and_on_the_axes(urdf_path, rng):
    robot = load_urdf(urdf_path)
    q = rng.uniform(-1.0, 1.0, len(robot.joint_names))
    rotations, positions = body_frames(robot, q)
    assert rotations @ rotations.transpose(0, 2, 1) == pytest.approx(
        np.tile(np.eye(3), (len(rotations), 1, 1)), abs=1e-12
    )
    assert np.linalg.det(rotations) == pytest.approx(np.ones(len(rotations)))
    moved = q + 0.3
    again, elsewhere = body_frames(robot, moved)
    for body in np.flatnonzero(robot.parent == 0):
        turned = robot.R_PL[body] @ robot.axis[body]
        # The axis of a joint on the base does not move with the joint.
        assert rotations[body] @ robot.axis[body] == pytest.approx(turned)
        assert again[body] @ robot.axis[body] == pytest.approx(turned)
        if not robot.is_prismatic[body]:
            assert positions[body] == pytest.approx(elsewhere[body])


def test_a_planar_arm_by_hand():
    robot = load_urdf(ROOT / 'test' / 'robots' / 'planar_2r.urdf')
    _, straight = body_frames(robot, np.zeros(2))
    _, folded = body_frames(robot, np.array([0.0, np.pi]))
    assert straight[-1] == pytest.approx(folded[-1])
    _, lifted = body_frames(robot, np.array([0.5 * np.pi, 0.0]))
    arm = straight[2] - straight[1]
    turned = lifted[2] - lifted[1]
    assert np.linalg.norm(arm) == pytest.approx(np.linalg.norm(turned))
    assert arm @ turned == pytest.approx(0.0, abs=1e-12)


def test_rotation_keeps_its_axis():
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    assert rotation_about(axis, 0.7) @ axis == pytest.approx(axis)
    assert np.trace(rotation_about(axis, 0.7)) == pytest.approx(1.0 + 2.0 * np.cos(0.7))
    assert rotation_about(axis, 0.3) @ rotation_about(axis, 0.4) == pytest.approx(
        rotation_about(axis, 0.7)
    )
    assert rotation_about(np.array([0.0, 0.0, 1.0]), 0.5 * np.pi)[1, 0] == pytest.approx(1.0)


def test_roll_pitch_yaw_are_about_fixed_axes(rng):
    rpy = rng.uniform(-3.0, 3.0, 3)
    assert rotation_of_rpy(*rpy) == pytest.approx(kinematics.rotation_of_rpy(rpy), abs=1e-12)


def test_roll_pitch_yaw_are_those_of_a_urdf():
    text = (ROOT / 'test' / 'robots' / 'pendulum.urdf').read_text()
    sensor = (
        '<link name="s"/><joint name="f" type="fixed"><parent link="base"/><child link="s"/>'
        '<origin rpy="0.3 -0.5 2.0"/></joint></robot>'
    )
    robot = load_urdf(text.replace('</robot>', sensor))
    expected = robot.link_rotation[robot.link_index('s')]
    assert rotation_of_rpy(0.3, -0.5, 2.0) == pytest.approx(expected)


def test_frames_of_many_poses_are_those_of_each(urdf_path, rng):
    robot = load_urdf(urdf_path)
    q = rng.uniform(-1.0, 1.0, (2, 3, len(robot.joint_names)))
    rotations, positions = body_frames(robot, q)
    assert positions.shape == (2, 3, len(robot.parent), 3)
    one = body_frames(robot, q[1, 2])
    assert_allclose(rotations[1, 2], one[0], atol=1e-15)
    assert_allclose(positions[1, 2], one[1], atol=1e-15)
