"""The parameter files are complete, and agree with the simulated drivers."""

import re

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.node.parameters import PARAMETERS
from inverse_dynamics_node.simulation.drivers import DRIVERS, Form
import pytest
from robot_files import real_robots, ROOT
import yaml

CONFIG = ROOT / 'config'
PRESETS = sorted((CONFIG / 'robots').glob('*.yaml'))


def parameters(path):
    return next(iter(yaml.safe_load(path.read_text()).values()))['ros__parameters']


def test_the_file_of_all_parameters_has_their_defaults():
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


@pytest.mark.parametrize('path', PRESETS, ids=lambda path: path.stem)
def test_files_of_drivers_name_their_source_and_the_topics_of_the_simulated_driver(path):
    driver, text = DRIVERS[path.stem], path.read_text()
    head = ' '.join(text[: text.index('/**:')].replace('#', ' ').split())
    assert 'Not tried' in head
    if not driver.has_position_loop:  # drives of several makers
        assert re.search(r'source code\b.*?\([^)]*[0-9a-f]{7}', head)
        assert re.search(r'\bSources?: https://', head)
    assert f'--params-file {path.name}' in head
    if driver.joint_states != 'joint_states':
        assert f'joint_states:=/{driver.joint_states}' in head
    if driver.form is not Form.NONE:
        assert f'/{driver.commands}' in head
    given = parameters(path)
    assert driver.has_clock is given.get('use_sim_time', False)
    assert driver.compensates_gravity is not given['include_gravity']
    includes = driver.measures_gravity or driver.compensates_gravity
    assert includes is (given.get('measured_gravity') != 'excluded')
    if driver.measured_unit < 0.0:
        assert given['measured_effort_scale'] == 1.0 / driver.measured_unit


def test_joints_of_a_driver_are_those_of_the_robot():
    (ur5,) = (path for path in real_robots() if path.stem == 'ur5_robot')
    assert parameters(CONFIG / 'robots' / 'ur.yaml')['joints'] == list(load_urdf(ur5).joint_names)
    for path in PRESETS:
        joints = parameters(path).get('joints', [])
        assert len(set(joints)) == len(joints)
        assert len(joints) in (0, 6, 7)
        if path.stem != 'ur':
            assert joints == [f'{joints[0][:-1]}{k}' for k in range(1, len(joints) + 1)]


def test_every_driver_that_can_be_simulated_has_a_file():
    assert {path.stem for path in PRESETS} == set(DRIVERS) - {'ur_torques'}
