"""
The values of loaded robots are those of their files.

Origins, axes, bodies and merged links are compared with an independent tree in test_link_laws.py
and test_energy_laws.py.
"""

import dataclasses
import math

from inverse_dynamics_node.errors import ConfigurationError
from inverse_dynamics_node.robot.model import RobotModel
from inverse_dynamics_node.robot.urdf import load_urdf
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import ROOT


def robot(name):
    return load_urdf(ROOT / 'test' / 'robots' / f'{name}.urdf')


def arrays(model):
    fields = {field.name: getattr(model, field.name) for field in dataclasses.fields(model)}
    return {name: value for name, value in fields.items() if isinstance(value, np.ndarray)}


# ---- Look-ups ------------------------------------------------------------------------------


def test_joints_and_links_are_found_by_name():
    planar = robot('planar_2r')
    assert planar.joint_indices(planar.joint_names[::-1]) == [1, 0]
    assert [planar.link_index(name) for name in planar.link_names] == list(
        range(len(planar.link_names))
    )


def test_unknown_names_are_reported_with_the_valid_ones():
    planar = robot('planar_2r')
    joints, links = ', '.join(planar.joint_names), ', '.join(planar.link_names)
    with pytest.raises(ConfigurationError, match=f"joint 'x' does not exist; joints are {joints}"):
        planar.joint_indices([planar.joint_names[0], 'x'])
    with pytest.raises(ConfigurationError, match=f"link 'x' does not exist; links are {links}"):
        planar.link_index('x')


# ---- Every robot ---------------------------------------------------------------------------


def test_arrays_are_read_only(urdf_path):
    model = load_urdf(urdf_path)
    for value in arrays(model).values():
        with pytest.raises(ValueError, match='read-only'):
            value[...] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        model.mass = None


def test_base_comes_first_and_parents_before_children(urdf_path):
    model = load_urdf(urdf_path)
    assert (model.parent[0], model.joint_index[0], model.multiplier[0]) == (-1, -1, 0.0)
    np.testing.assert_array_equal(model.axis[0], np.zeros(3))
    np.testing.assert_array_equal(model.R_PL[0], np.eye(3))
    np.testing.assert_array_equal(model.p_PL[0], np.zeros(3))
    assert (model.parent[1:] < np.arange(1, len(model.parent))).all()
    assert (model.joint_index[1:] >= 0).all()
    assert sorted(set(model.joint_index[1:])) == list(range(len(model.joint_names)))


# ---- One robot each ------------------------------------------------------------------------


def test_pendulum():
    model = robot('pendulum')
    assert model.name == 'pendulum'
    assert model.joint_names == ('swing',)
    assert model.body_names == ('base', 'swing')
    assert model.link_names == ('base', 'rod')
    assert model.link_body.tolist() == [0, 1]
    assert (model.lower[0], model.upper[0]) == (-3.0, 3.0)
    assert (model.effort_limits[0], model.velocity_limits[0]) == (10.0, 6.0)
    assert (model.damping[0], model.friction[0]) == (0.1, 0.05)
    assert not model.is_continuous[0]
    assert model.mass.tolist() == [0.0, 1.0]
    assert model.com[1].tolist() == [0.0, 0.0, -0.5]
    np.testing.assert_array_equal(model.inertia[1], np.diag([1 / 12, 1 / 12, 0.0002]))
    assert model.axis[1].tolist() == [0.0, 1.0, 0.0]
    assert repr(model) == "RobotModel('pendulum', joints=swing)"


def test_depth_first_and_file_order_among_siblings():
    model = robot('branched')
    assert model.joint_names == ('waist', 'right_shoulder', 'right_elbow', 'neck', 'left_shoulder')
    assert model.body_names == ('pelvis', *model.joint_names)
    assert model.parent.tolist() == [-1, 0, 1, 2, 1, 1]
    assert model.link_names[:3] == ('left_arm', 'pelvis', 'torso')
    assert model.link_body.tolist() == [5, 0, 1, 4, 2, 3]


def test_file_order_at_the_root():
    text = (ROOT / 'test' / 'robots' / 'branched.urdf').read_text()
    model = load_urdf(text.replace('<parent link="torso"/>', '<parent link="pelvis"/>'))
    assert model.joint_names == ('waist', 'right_shoulder', 'right_elbow', 'neck', 'left_shoulder')
    assert model.parent.tolist() == [-1, 0, 0, 2, 0, 0]


def test_continuous_joints_have_no_position_limits():
    model = robot('continuous')
    assert model.is_continuous.tolist() == [True, True]
    assert model.lower.tolist() == [-math.inf, -math.inf]
    assert model.upper.tolist() == [math.inf, math.inf]
    assert model.effort_limits.tolist() == [15.0, math.inf]
    assert model.velocity_limits.tolist() == [6.0, math.inf]


def test_mimicking_joints_follow_their_last_master():
    model = robot('mimic_gripper')
    assert model.joint_names == ('lift', 'right_finger')
    assert model.body_names == ('base', 'lift', 'left_finger', 'left_tip', 'right_finger')
    assert model.joint_index.tolist() == [-1, 0, 1, 1, 1]
    # left_tip: -0.5 (-2 q + 0.01) + 0.02
    assert_allclose(model.multiplier, [0.0, 1.0, -2.0, 1.0, 1.0])
    assert_allclose(model.offset, [0.0, 0.0, 0.01, 0.015, 0.0])
    assert model.effort_limits.tolist() == [50.0, 10.0]
    assert model.is_prismatic_joint.tolist() == [True, False]


def test_friction_of_mimicking_joints_is_added_to_the_master():
    model = robot('mimic_gripper')
    # Power at the master's speed w: d_m (m w)^2 = (m^2 d_m) w^2, and c_m |m w| = (|m| c_m) |w|.
    assert_allclose(model.damping, [5.0, 0.04 + 4 * 0.02 + 1 * 0.01])
    assert_allclose(model.friction, [2.0, 0.06 + 2 * 0.03 + 1 * 0.005])


@pytest.mark.parametrize(
    ('written', 'expected'),
    [('', (0.0, 0.0)), ('upper="2"', (0.0, 2.0)), ('lower="-2"', (-2.0, 0.0))],
)
def test_position_limits_default_to_zero(written, expected):
    text = (ROOT / 'test' / 'robots' / 'pendulum.urdf').read_text()
    model = load_urdf(text.replace('lower="-3.0" upper="3.0"', written))
    assert (model.lower[0], model.upper[0]) == expected


def test_models_are_compared_by_identity():
    first, second = robot('pendulum'), robot('pendulum')
    assert isinstance(first, RobotModel)
    assert first != second
    assert len({first, second}) == 2
