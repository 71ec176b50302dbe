"""Parameters that do not fit the robot are refused before anything changes."""

from dataclasses import replace

from inverse_dynamics_node import ConfigurationError, load_urdf
from inverse_dynamics_node.node.configure import check_configuration, make_loop
from inverse_dynamics_node.node.parameters import Configuration, PARAMETERS
import pytest
from robot_files import STANFORD

DEFAULTS = Configuration(**{name: each.check(each.default) for name, each in PARAMETERS.items()})


def test_a_continuous_joint_has_no_spring_whose_effort_would_jump_after_a_turn():
    urdf = STANFORD.read_text().replace('type="revolute"', 'type="continuous"', 1)
    robot = load_urdf(urdf)
    (joint,) = (i for i, is_continuous in enumerate(robot.is_continuous) if is_continuous)
    loop = make_loop(DEFAULTS, robot, urdf)
    springs = tuple(0.0 if i == joint else 5.0 for i in range(6))
    for given in (springs, 0.0):
        check_configuration(loop, replace(DEFAULTS, spring_stiffness=given))
    words = f"spring_stiffness of joint '{robot.joint_names[joint]}' is 5, expected 0"
    impossible = replace(DEFAULTS, spring_stiffness=5.0)
    with pytest.raises(ConfigurationError, match=words):
        check_configuration(loop, impossible)
    with pytest.raises(ConfigurationError, match=words):
        make_loop(impossible, robot, urdf)
