"""Arms with friction in MuJoCo: guided by hand, let go, and held by joint impedance."""

import numpy as np
import pytest
from robot_files import ROOT

pytest.importorskip('mujoco')

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.settings import Mode, Settings
from simulated_arm import PERIOD, SimulatedArm

ARMS = {'seven_dof': 'tool0', 'gripper_arm': 'flange'}  # with the links that are pushed
GUIDED = Settings(mode=Mode.GRAVITY_COMPENSATION, friction_scale=0.8, start_ramp=0.0)
SPEED = 0.1  # [rad/s]
ERROR = 0.05  # of the identified friction, relative


def poses(path, count):
    robot = load_urdf(path)
    share = np.random.default_rng(1).uniform(0.25, 0.75, (count, len(robot.joint_names)))
    return robot.lower + share * (robot.upper - robot.lower)


def guided(name, q, joint=None, share=1.0 - ERROR):
    """Return an arm of which one joint is free, and the node knows a share of the friction."""
    path = ROOT / 'test/robots' / f'{name}.urdf'
    robot = load_urdf(path)
    arm = SimulatedArm(path, q, GUIDED, joints=() if joint is None else (joint,))
    arm.dynamics.set_friction(share * robot.damping, share * robot.friction)
    arm.tip, arm.noise = ARMS[name], 0.003
    return arm


def forces_at_the_tip(name, q, joint, share):
    """Return the forces that set a joint in motion, and that keep it going [N]."""
    arm = guided(name, q, joint, share)
    k = arm.robot.joint_names.index(joint)
    inertia = arm.dynamics.mass_matrix(arm.q)[k, k]
    wanted, breakaway, forces = 0.0, None, []  # wanted: effort of the hand [N m]
    while len(forces) < 200:
        lever = arm.dynamics.jacobian(arm.q, arm.tip)[:3, k]
        arm_length = np.linalg.norm(lever)
        if breakaway is None:
            effort = wanted = wanted + 2.0 * PERIOD
            if arm.qd[k] > 0.1 * SPEED:
                breakaway = effort / arm_length
        else:
            error = inertia * (SPEED - arm.qd[k])
            wanted += 100.0 * error * PERIOD
            effort = wanted + 20.0 * error
            forces.append(effort / arm_length)
        arm.push(effort / arm_length**2 * lever)
        arm.step()
    assert arm.qd[k] == pytest.approx(SPEED, rel=0.02)
    return breakaway, np.mean(forces[-50:])


@pytest.mark.parametrize(
    ('name', 'joint'),
    [
        pytest.param('seven_dof', 'elbow', marks=pytest.mark.long),
        ('gripper_arm', 'arm_2'),
        pytest.param('seven_dof', 'shoulder_lift', marks=pytest.mark.long),
        pytest.param('gripper_arm', 'arm_4', marks=pytest.mark.long),
    ],
)
def test_a_guided_arm_needs_less_than_a_third_of_the_force(name, joint):
    q = poses(ROOT / 'test/robots' / f'{name}.urdf', 1)[0]
    breakaway, moving = forces_at_the_tip(name, q, joint, share=1.0 - ERROR)
    full_breakaway, full = forces_at_the_tip(name, q, joint, share=0.0)
    assert full > 0.5
    assert 0.0 < moving < full / 3.0
    # A velocity of zero cannot say in which direction the hand pulls.
    assert 0.6 * full_breakaway < breakaway < 1.1 * full_breakaway


@pytest.mark.parametrize('name', ARMS)
@pytest.mark.parametrize(
    ('count', 'duration'), [(1, 1.0), pytest.param(10, 10.0, marks=pytest.mark.long)]
)
def test_an_arm_that_is_let_go_stays(name, count, duration):
    for q in poses(ROOT / 'test/robots' / f'{name}.urdf', count):
        arm = guided(name, q, share=1.0 + ERROR)
        arm.run(duration)
        moved = np.abs(arm.q - q)
        assert moved.max() < 1e-3, moved


@pytest.mark.parametrize('name', ARMS)
def test_an_arm_that_is_touched_slows_down_although_friction_is_given_too_large(name):
    """With friction given 50 % too large, and the default share."""
    arm = guided(name, poses(ROOT / 'test/robots' / f'{name}.urdf', 1)[0], share=1.5)
    arm.loop.apply(Settings(mode=Mode.GRAVITY_COMPENSATION, start_ramp=0.0))
    arm.hardware._data.qvel[arm.hardware._order] = SPEED
    arm.run(4.0)
    assert np.abs(arm.qd).max() < 0.5 * SPEED


@pytest.mark.parametrize('name', ARMS)
def test_the_deflection_of_joint_impedance_is_force_over_stiffness(name):
    path = ROOT / 'test/robots' / f'{name}.urdf'
    q, force = poses(path, 1)[0], np.array([3.0, -4.0, 5.0])
    inertia = np.diag(guided(name, q).dynamics.mass_matrix(q))
    stiffness, damping = 100.0 * inertia, 20.0 * inertia
    held = Settings(
        mode=Mode.JOINT_IMPEDANCE,
        stiffness=tuple(stiffness),
        impedance_damping=tuple(damping),
        start_ramp=0.0,
    )
    arm = SimulatedArm(path, q, held, friction=False)
    arm.tip = ARMS[name]
    arm.run(0.1)
    assert np.abs(arm.q - q).max() < 1e-4
    for _ in range(300):
        arm.push(force)
        arm.step()
    deflection = arm.q - q
    expected = arm.dynamics.jacobian(arm.q, arm.tip)[:3].T @ force / stiffness
    assert np.abs(expected).max() > 0.01
    assert deflection == pytest.approx(expected, abs=0.01 * np.abs(expected).max())
