"""Gravity efforts over the workspace, and the payload capacity."""

from dataclasses import replace
import math

from inverse_dynamics_node.analysis import sizing
from inverse_dynamics_node.analysis.sizing import (
    explore,
    joint_ranges,
    payload_capacity,
)
from inverse_dynamics_node.dynamics.inverse_dynamics import InverseDynamics
from inverse_dynamics_node.errors import ConfigurationError
from inverse_dynamics_node.robot.kinematics import last_link
from inverse_dynamics_node.robot.urdf import load_urdf
import numpy as np
import pytest
from robot_files import NOTHING_MOVES, OUR_ROBOTS, real_robots, ROOT, STANFORD

ROBOTS = ROOT / 'test' / 'robots'
ARM = InverseDynamics(load_urdf(STANFORD))
MOVING = [path for path in OUR_ROBOTS if load_urdf(path).joint_names]
STANDARD = 9.80665


def test_pendulum_is_worst_when_level():
    robot = load_urdf(ROBOTS / 'pendulum.urdf')
    workspace = explore(InverseDynamics(robot))
    level = float(np.linalg.norm(robot.com[1])) * robot.mass[1] * STANDARD
    assert np.abs(workspace.worst) == pytest.approx([level], rel=1e-9)
    assert np.abs(workspace.poses[0]) == pytest.approx([0.5 * math.pi], rel=1e-9)


def test_finds_the_extended_arm():
    workspace = explore(ARM)
    assert workspace.robot.joint_names[workspace.hardest] == 'joint_2'
    pose = workspace.poses[1]
    assert abs(pose[1]) == pytest.approx(0.5 * math.pi, abs=0.01)
    assert pose[2] == pytest.approx(workspace.robot.upper[2])
    assert pose[3:] == pytest.approx(np.zeros(3), abs=0.01)
    samples = np.max(np.abs(ARM.gravity_efforts(workspace.samples)), axis=0)
    assert np.abs(workspace.worst[1]) > 1.001 * samples[1]


@pytest.mark.parametrize('path', MOVING, ids=lambda path: path.stem)
def test_no_pose_in_the_ranges_needs_more(path, rng):
    dynamics = InverseDynamics(load_urdf(path))
    workspace = explore(dynamics)
    lower, upper = joint_ranges(dynamics.robot)
    for poses in (workspace.poses, workspace.samples):
        assert np.all(poses >= lower - 1e-12)
        assert np.all(poses <= upper + 1e-12)
    n = len(lower)
    efforts = dynamics.gravity_efforts(workspace.poses)
    assert workspace.worst == pytest.approx(efforts[range(n), range(n)])
    corners = np.where(rng.random((2000, n)) < 0.5, lower, upper)
    poses = np.vstack([workspace.samples, corners, rng.uniform(lower, upper, (2000, n))])
    most = np.max(np.abs(dynamics.gravity_efforts(poses)), axis=0)
    assert np.all(np.abs(workspace.worst) >= most * (1.0 - 1e-9) - 1e-9)


def test_many_joints_are_not_searched(monkeypatch):
    monkeypatch.setattr(sizing, '_MOST_JOINTS', 5)
    workspace = explore(ARM)
    best = np.max(np.abs(ARM.gravity_efforts(workspace.samples)), axis=0)
    # Other joints than those that matter are at zero, which changes no effort.
    assert np.abs(workspace.worst) == pytest.approx(best, rel=1e-9, abs=1e-9)


def test_wide_ranges_are_one_turn():
    text = STANFORD.read_text().replace('2.6179938779914944', '100.0')
    lower, upper = joint_ranges(load_urdf(text))
    assert (lower[0], upper[0]) == (-math.pi, math.pi)
    text = text.replace('lower="-100.0"', 'lower="5.0"')
    lower, upper = joint_ranges(load_urdf(text))
    assert (lower[0], upper[0]) == (5.0, 5.0 + 2.0 * math.pi)


@pytest.mark.parametrize('link', ['tool0', 'link_3'])
def test_at_capacity_one_joint_reaches_its_limit_and_none_exceeds_it(link):
    assert last_link(ARM.robot) == 'tool0'  # the default
    workspace = explore(ARM)
    payload = payload_capacity(ARM, workspace, link)
    laden = InverseDynamics(ARM.robot)
    laden.set_payload(link, payload.mass)
    poses = np.vstack([workspace.poses, workspace.samples, payload.pose])
    ratios = np.abs(laden.gravity_efforts(poses)) / ARM.robot.effort_limits
    assert np.max(ratios) == pytest.approx(1.0, rel=1e-9)
    assert ARM.robot.joint_names[int(np.argmax(np.max(ratios, axis=0)))] == payload.joint


def test_a_present_payload_reduces_the_capacity():
    loaded = InverseDynamics(ARM.robot)
    loaded.set_payload('tool0', 1.0)
    before = payload_capacity(ARM, explore(ARM), 'tool0')
    after = payload_capacity(loaded, explore(loaded), 'tool0')
    assert after.mass == pytest.approx(before.mass - 1.0, rel=1e-3)


def with_limits(limits):
    return InverseDynamics(replace(ARM.robot, effort_limits=np.array(limits)))


def test_capacity_is_zero_if_gravity_alone_exceeds_a_limit():
    weak = with_limits([60.0, 10.0, 200.0, 10.0, 10.0, 5.0])
    payload = payload_capacity(weak, explore(weak), 'tool0')
    assert (payload.mass, payload.joint) == (0.0, 'joint_2')


def test_capacity_is_infinite_without_limits_or_on_an_axis():
    free = with_limits([math.inf] * 6)
    workspace = explore(free)
    assert payload_capacity(free, workspace, 'tool0')[1:3] == (math.inf, None)
    assert workspace.robot.joint_names[workspace.hardest] == 'joint_3'
    pendulum = InverseDynamics(load_urdf(ROBOTS / 'pendulum.urdf'))
    for link, arm in (('tool0', free), ('rod', pendulum)):  # the rod begins on its axis
        payload = payload_capacity(arm, explore(arm), link)
        assert (payload.mass, payload.joint) == (math.inf, None)
        assert payload.loads_joints == (arm is free)


def test_invalid_arguments_are_explained():
    with pytest.raises(ConfigurationError, match="link 'tool9' does not exist"):
        payload_capacity(ARM, explore(ARM), 'tool9')
    bolt = InverseDynamics(load_urdf(NOTHING_MOVES))
    with pytest.raises(ConfigurationError, match='no movable joint'):
        explore(bolt)


@pytest.mark.parametrize(
    ('robot', 'body'),
    [
        ('panda', 'panda_joint7'),
        ('z1', 'joint6'),  # not the jaw
        ('kinova', 'j2s6s200_joint_6'),
        ('allegro_right_hand', 'joint_3.0'),  # a hand without an arm: a fingertip
        ('finger_edu', 'finger_middle_to_lower_joint'),
        ('tiago', 'arm_7_joint'),  # fingers of several joints
        ('g1_29dof_with_hand_rev_1_0', 'left_wrist_yaw_joint'),  # the arms branch at the torso
        ('a1', 'FR_calf_joint'),
    ],
)
def test_default_link_is_not_a_finger_or_a_base(robot, body):
    path = next((path for path in real_robots() if path.stem == robot), None)
    if path is None:
        pytest.skip('example-robot-data is not installed')
    model = load_urdf(path)
    link = last_link(model)
    assert model.body_names[model.link_body[model.link_names.index(link)]] == body
    assert 'finger' not in link or robot == 'finger_edu'


@pytest.mark.parametrize(
    ('links', 'expected'),
    [
        (['camera_link', 'ee_gripper_link', 'camera_optical_frame'], 'ee_gripper_link'),
        (['imu', 'lidar'], 'arm'),
        (['plate', 'tcp', 'depth_frame'], 'tcp'),
    ],
)
def test_default_link_is_a_tool_and_not_a_sensor(links, expected):
    fixed = ''.join(
        f'<link name="{name}"/><joint name="{name}_joint" type="fixed"><parent link="arm"/>'
        f'<child link="{name}"/></joint>'
        for name in links
    )
    joint = '<joint name="j" type="continuous"><parent link="base"/><child link="arm"/></joint>'
    urdf = f'<robot name="r"><link name="base"/><link name="arm"/>{joint}{fixed}</robot>'
    assert last_link(load_urdf(urdf)) == expected
