"""Errors of poses and Jacobians; their values are in test_link_laws.py."""

import pickle

from inverse_dynamics_node import ConfigurationError, InverseDynamics, JointStateError, load_urdf
import numpy as np
import pytest
from robot_files import NOTHING_MOVES, ROOT, STANFORD


@pytest.fixture(scope='module')
def dynamics():
    return InverseDynamics(load_urdf(ROOT / 'test' / 'robots' / 'mimic_gripper.urdf'))


def test_links_of_a_robot_without_joints_have_a_pose():
    rock = InverseDynamics(load_urdf(NOTHING_MOVES))
    assert (rock.pose([], 'moss') == np.eye(4)).all()
    assert rock.jacobian([], 'moss').shape == (6, 0)
    assert rock.pose(np.zeros((3, 0)), 'moss').shape == (3, 4, 4)


@pytest.mark.parametrize('name', ['pose', 'jacobian'])
def test_errors_name_the_cause(dynamics, name):
    method = getattr(dynamics, name)
    message = "link 'toll' does not exist; links are base, palm, left, left_pad, right"
    with pytest.raises(ConfigurationError, match=message):
        method([0.0, 0.0], 'toll')
    with pytest.raises(JointStateError, match="q of joint 'right_finger' is nan"):
        method([0.0, np.nan], 'base')  # which depends on no joint
    with pytest.raises(JointStateError, match=r"q of joint 'lift' is inf \(sample \(1,\)\)"):
        method([[0.0, 0.0], [np.inf, 0.0]], 'left_pad')
    with pytest.raises(JointStateError, match=r'q has shape \(3,\), but the robot has 2 joints'):
        method([0.0, 0.0, 0.0], 'left_pad')


def test_positions_that_are_too_large_are_an_error(dynamics):
    with pytest.raises(JointStateError, match='too large'):
        dynamics.pose([0.0, 1.5e308], 'left')


def test_loads_and_motion_of_the_base_change_neither():
    q, dynamics = np.linspace(0.1, 0.6, 6), InverseDynamics(load_urdf(STANFORD))
    before = dynamics.pose(q, 'tool0'), dynamics.jacobian(q, 'tool0')
    dynamics.set_base_motion((1.0, 2.0, 3.0))
    dynamics.set_payload('tool0', 1.0)
    again = pickle.loads(pickle.dumps(dynamics))
    for of in dynamics, again:
        assert (of.pose(q, 'tool0') == before[0]).all()
        assert (of.jacobian(q, 'tool0') == before[1]).all()
