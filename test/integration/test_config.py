"""The node uses every value of the parameter files."""

from inverse_dynamics_node import load_urdf
import pytest
from robot_files import ROOT, STANFORD
import yaml

CONFIG = ROOT / 'config'
MOVEIT = CONFIG / 'moveit_controllers.yaml'
PRESETS = sorted((CONFIG / 'robots').glob('*.yaml'))
SEVEN_DOF = ROOT / 'test' / 'robots' / 'seven_dof.urdf'


def parameters(path):
    return next(iter(yaml.safe_load(path.read_text()).values()))['ros__parameters']


@pytest.mark.parametrize(
    'path',
    [
        *sorted(set(CONFIG.glob('*.yaml')) - {MOVEIT}),
        *(pytest.param(path, marks=pytest.mark.long) for path in PRESETS),
    ],
    ids=lambda path: path.stem,
)
def test_every_value_is_used_under_any_node_name(run_node, robot, path, tmp_path):
    given = parameters(path)
    source = SEVEN_DOF if len(given.get('joints', ())) == 7 else STANFORD
    urdf, arm = source.read_text(), load_urdf(source)
    for joint, name in zip(arm.joint_names, filter(None, given.get('joints', ())), strict=False):
        urdf = urdf.replace(f'"{joint}"', f'"{name}"')
    (tmp_path / 'arm.urdf').write_text(urdf)
    given['robot_description_file'] = str(tmp_path / 'arm.urdf')
    node = run_node(
        *('--params-file', str(path), '-r', '__ns:=/left', '-r', '__node:=dynamics'),
        robot_description_file=tmp_path / 'arm.urdf',
    )
    robot.peer = '/left/dynamics'
    robot.wait_for_text(node, f"robot '{arm.name}'")
    robot.wait_until(lambda: robot.get_state() == 'active', 'active')
    assert {name: robot.get_parameter(name) for name in given} == given


def test_moveit_finds_the_action_of_the_node():
    from inverse_dynamics_node.node.follow_action import NAME

    manager = yaml.safe_load(MOVEIT.read_text())
    controllers = manager['moveit_simple_controller_manager']
    (name,) = controllers['controller_names']
    assert name == 'inverse_dynamics'  # the default name of the node
    assert f'~/{controllers[name]["action_ns"]}' == NAME
    assert controllers[name]['joints'] == list(load_urdf(STANFORD).joint_names)
