"""The parameter files: every parameter is in one, and the node starts with each of them."""

import os

import pytest
from robot_files import ROOT, STANFORD
import yaml

CONFIG = ROOT / 'config'
NAMES = [f'joint_{k}' for k in range(1, 7)]


def parameters(path):
    return next(iter(yaml.safe_load(path.read_text()).values()))['ros__parameters']


def test_every_parameter_is_there_with_its_default():
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    from inverse_dynamics_node.node.parameters import PARAMETERS

    given = parameters(CONFIG / 'inverse_dynamics.yaml')
    assert given == {name: parameter.default for name, parameter in PARAMETERS.items()}
    text = (CONFIG / 'inverse_dynamics.yaml').read_text()
    for name, parameter in PARAMETERS.items():
        comment = text.split(f'    {name}: ')[0].split('\n\n')[-1]
        words = ' '.join(comment.replace('#', ' ').split())
        assert ' '.join(parameter.description.split()) in words, name


@pytest.mark.parametrize('path', sorted(CONFIG.glob('*.yaml')), ids=lambda path: path.stem)
def test_the_node_starts_with_it(run_node, robot, path):
    joints = parameters(path).get('joints', [''])
    own = {'joints': '[joint_2, joint_3, joint_4]'} if joints != [''] else {}
    own['robot_description_file'] = STANFORD
    node = run_node('--params-file', str(path), **own)
    robot.wait_for_text(node, "robot 'stanford'")
    assert robot.get_state() == 'active'
    assert 'none such' not in node.output
    for name, value in parameters(path).items():
        if name not in own:
            assert robot.get_parameter(name) == value, name
