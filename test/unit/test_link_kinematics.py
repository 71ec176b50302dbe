"""Poses and Jacobians of links by hand, and errors; test_quantities.py has batches and `out`."""

import pickle

from inverse_dynamics_node import ConfigurationError, InverseDynamics, JointStateError, load_urdf
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robot_files import NOTHING_MOVES, STANFORD

# A slide along y carries a crank about z, and a tool 0.5 m along x; a second slide is beside it.
SLIDER_CRANK = """
<robot name="slider_crank">
<link name="base"/><link name="slide"/><link name="crank"/><link name="tool"/><link name="beside"/>
<joint name="s" type="prismatic"><parent link="base"/><child link="slide"/>
<origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="c" type="continuous"><parent link="slide"/><child link="crank"/>
<axis xyz="0 0 1"/></joint>
<joint name="f" type="fixed"><parent link="crank"/><child link="tool"/>
<origin xyz="0.5 0 0" rpy="0 0 1.5707963267948966"/></joint>
<joint name="b" type="prismatic"><parent link="base"/><child link="beside"/><axis xyz="1 0 0"/>
<mimic joint="s" multiplier="2"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
</robot>
"""


@pytest.fixture(scope='module')
def dynamics():
    return InverseDynamics(load_urdf(SLIDER_CRANK))


def test_a_slider_crank_by_hand(dynamics):
    quarter = 0.5 * np.pi
    tool = [[-1, 0, 0, 0], [0, -1, 0, 0.3 + 0.5], [0, 0, 1, 0.2], [0, 0, 0, 1]]
    assert_allclose(dynamics.pose([0.3, quarter], 'tool'), tool, atol=1e-15)
    expected = [[0, -0.5], [1, 0], [0, 0], [0, 0], [0, 0], [0, 1]]
    assert_allclose(dynamics.jacobian([0.3, quarter], 'tool'), expected, atol=1e-15)
    expected = [[0, 0], [1, 0], [0, 0], [0, 0], [0, 0], [0, 1]]
    assert_allclose(dynamics.jacobian([0.3, quarter], 'crank'), expected, atol=1e-15)
    expected = [[2, 0], *np.zeros((5, 2))]  # moved by the mimic joint
    assert_allclose(dynamics.jacobian([0.3, quarter], 'beside'), expected, atol=1e-15)


def test_the_base_does_not_move(dynamics):
    assert (dynamics.pose([0.3, 0.1], 'base') == np.eye(4)).all()
    assert not dynamics.jacobian([0.3, 0.1], 'base').any()


def test_links_of_a_robot_without_joints_have_a_pose():
    rock = InverseDynamics(load_urdf(NOTHING_MOVES))
    assert (rock.pose([], 'moss') == np.eye(4)).all()
    assert rock.jacobian([], 'moss').shape == (6, 0)
    assert rock.pose(np.zeros((3, 0)), 'moss').shape == (3, 4, 4)


@pytest.mark.parametrize('name', ['pose', 'jacobian'])
def test_errors_name_the_cause(dynamics, name):
    method = getattr(dynamics, name)
    message = "link 'toll' does not exist; links are base, slide, crank, tool, beside"
    with pytest.raises(ConfigurationError, match=message):
        method([0.0, 0.0], 'toll')
    with pytest.raises(JointStateError, match="q of joint 'c' is nan"):
        method([0.0, np.nan], 'base')  # which depends on no joint
    with pytest.raises(JointStateError, match=r"q of joint 's' is inf \(sample \(1,\)\)"):
        method([[0.0, 0.0], [np.inf, 0.0]], 'tool')
    with pytest.raises(JointStateError, match=r'q has shape \(3,\), but the robot has 2 joints'):
        method([0.0, 0.0, 0.0], 'tool')


def test_positions_that_are_too_large_are_an_error(dynamics):
    with pytest.raises(JointStateError, match='too large'):
        dynamics.pose([1.5e308, 0.0], 'beside')


def test_loads_and_motion_of_the_base_change_neither():
    q, dynamics = np.linspace(0.1, 0.6, 6), InverseDynamics(load_urdf(STANFORD))
    before = dynamics.pose(q, 'tool0'), dynamics.jacobian(q, 'tool0')
    dynamics.set_base_motion((1.0, 2.0, 3.0))
    dynamics.set_payload('tool0', 1.0)
    again = pickle.loads(pickle.dumps(dynamics))
    for of in dynamics, again:
        assert (of.pose(q, 'tool0') == before[0]).all()
        assert (of.jacobian(q, 'tool0') == before[1]).all()
