"""The report of ~/check_model."""

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Settings
import numpy as np
import pytest
from robot_files import STANFORD

pytest.importorskip('rclpy')

from inverse_dynamics_node.node.services import describe_robot
from states import store_state

MODEL = load_urdf(STANFORD)


def test_joints_that_have_not_been_reported_are_named():
    loop = ControlLoop(MODEL)
    store_state(loop.collector, 1.0, MODEL.joint_names[1:], np.zeros(5), np.zeros(5))
    text = f'not known yet: waiting for the position of {MODEL.joint_names[0]}'
    assert text in describe_robot(loop)


def test_the_report_shows_the_efforts_to_hold_the_arm_and_the_tightened_limits():
    loop = ControlLoop(MODEL, settings=Settings(effort_limits=12.625))
    store_state(loop.collector, 0.0, MODEL.joint_names, np.zeros(6), np.zeros(6))
    assert '12.62' in describe_robot(loop)
    assert 'not known' not in describe_robot(loop)
