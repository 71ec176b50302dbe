"""The parameter files are complete, and the node uses their values."""

import os
import re

import pytest
from robot_files import ROOT, STANFORD
import yaml

CONFIG = ROOT / 'config'


def parameters(path):
    return next(iter(yaml.safe_load(path.read_text()).values()))['ros__parameters']


def test_the_file_of_all_parameters_has_their_defaults():
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    from inverse_dynamics_node.node.parameters import PARAMETERS

    given = parameters(CONFIG / 'inverse_dynamics.yaml')
    assert given == {
        name: parameter.default
        for name, parameter in PARAMETERS.items()
        if not parameter.default_note
    }
    text = (CONFIG / 'inverse_dynamics.yaml').read_text()
    for name, parameter in PARAMETERS.items():
        comment = re.split(rf'    (?:# )?{name}: ', text)[0].split('\n\n')[-1]
        words = ' '.join(comment.replace('#', ' ').split())
        assert ' '.join(parameter.description.split()) in words, name


@pytest.mark.parametrize('path', sorted(CONFIG.glob('*.yaml')), ids=lambda path: path.stem)
def test_every_value_is_used_under_any_node_name(run_node, robot, path, tmp_path):
    given = parameters(path)
    urdf = STANFORD.read_text()
    for number, name in enumerate(filter(None, given.get('joints', ())), 1):
        urdf = urdf.replace(f'"joint_{number}"', f'"{name}"')
    (tmp_path / 'arm.urdf').write_text(urdf)
    given['robot_description_file'] = str(tmp_path / 'arm.urdf')
    node = run_node(
        *('--params-file', str(path), '-r', '__ns:=/left', '-r', '__node:=dynamics'),
        robot_description_file=tmp_path / 'arm.urdf',
    )
    robot.peer = '/left/dynamics'
    robot.wait_for_text(node, "robot 'stanford'")
    robot.wait_until(lambda: robot.get_state() == 'active', 'active')
    assert {name: robot.get_parameter(name) for name in given} == given
