"""The closed loop of node and simulated arm; `test_demo.py` has a run with a load."""

from contextlib import contextmanager

from fork_server import SERVER
from lxml import etree
import numpy as np
import pytest
from robot_files import ROOT, STANFORD

pytest.importorskip('rclpy')
pytest.importorskip('mujoco')

from inverse_dynamics_node import load_urdf
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

pytestmark = pytest.mark.real_time
GRIPPER_ARM = ROOT / 'test' / 'robots' / 'gripper_arm.urdf'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RATE = 200  # [Hz]
PATIENCE = 180.0  # [s]


@contextmanager
def simulated(domain_id, path, held):
    """Run a simulated robot with some joints held by springs."""
    program = ('-m', 'inverse_dynamics_node.simulation.robot', path)
    options = (
        '--held',
        *held,
        '--rate',
        RATE,
        '--ros-args',
        '-r',
        'commands:=inverse_dynamics/commands',
    )
    process = SERVER.run([*program, *options], {'ROS_DOMAIN_ID': str(domain_id)})
    try:
        yield
    finally:
        process.terminate()
        process.wait(PATIENCE)


def without_mass(path, joints):
    """Return a robot description without the masses that some joints move."""
    root = etree.parse(str(path)).getroot()
    children = {j.get('name'): j.find('child').get('link') for j in root.iter('joint')}
    mimics = {
        j.get('name') for j in root.iter('joint')
        if j.find('mimic') is not None and j.find('mimic').get('joint') in joints
    }  # fmt: skip
    light = {children[name] for name in {*joints, *mimics}}
    for link in root.iter('link'):
        if link.get('name') in light:
            link.remove(link.find('inertial'))
    return etree.tostring(root, encoding='unicode')


@pytest.mark.parametrize('has_mass', [True, False], ids=['with mass', 'without mass'])
@pytest.mark.parametrize(
    ('path', 'held'),
    [
        pytest.param(
            STANFORD,
            ['joint_4', 'joint_5', 'joint_6'],
            id='stanford',
            marks=pytest.mark.long,
        ),
        pytest.param(GRIPPER_ARM, ['finger_left'], id='gripper_arm'),
    ],
)
def test_gravity_compensation_includes_the_mass_of_uncommanded_joints(
    domain_id, run_node, robot, tmp_path, path, held, has_mass
):
    """The arm stays in place if the node's description has this mass, and falls without it."""
    description = tmp_path / 'description.urdf'
    description.write_text(path.read_text() if has_mass else without_mass(path, held))
    arm = [name for name in load_urdf(path).joint_names if name not in held]
    states, brakes = [], []
    robot.node.create_subscription(JointState, 'joint_states', states.append, 10)
    robot.node.create_subscription(Bool, 'brakes', lambda m: brakes.append(m.data), LATCHED)
    with simulated(domain_id, path, held):
        node = run_node(
            robot_description_file=f"'{description}'",
            mode='gravity_compensation',
            joints=f'[{", ".join(arm)}]',
            state_timeout=5.0,
        )
        robot.wait_until(lambda: len(brakes) and not brakes[-1], 'open brakes')
        open_at = len(states)
        robot.wait_until(lambda: len(states) > open_at + 2 * RATE, 'two seconds')
        assert node.process.poll() is None
    before, after = (
        np.array([dict(zip(state.name, state.position, strict=True))[name] for name in arm])
        for state in (states[open_at], states[-1])
    )
    moved = abs(after - before).max()
    assert (moved < 0.01) if has_mass else (moved > 0.03), moved
