"""Positions that change faster than a joint can move are told from motion, however it arrives."""

from dataclasses import replace

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.motion_limits import MotionLimits
import numpy as np
import pytest
from robot_files import ROOT
from states import joint_state

ROBOT = load_urdf(ROOT / 'test/robots/seven_dof.urdf')
NAMES, N = ROBOT.joint_names, len(ROBOT.joint_names)
SPEEDS = ROBOT.velocity_limits
SLIDER = load_urdf(ROOT / 'test/robots/cartesian.urdf')


def jumps(times, positions, robot=ROBOT):
    """Report positions; return for each message whether it was a jump."""
    limits = MotionLimits(InverseDynamics(robot), [0, 1])
    return [
        limits.observe(joint_state(q, 0.0 * q, float(now)), is_following=True).has_jumped
        for now, q in zip(times, positions, strict=True)
    ]


@pytest.mark.parametrize('rate', [10, 20, 100, 500, 1000])
@pytest.mark.parametrize('speed', [1.0, 1.5])
@pytest.mark.parametrize('lateness', [0.0, 0.01, 0.02])
def test_fast_motion_is_no_jump_although_messages_are_late(rate, speed, lateness):
    pick = np.random.default_rng(1)
    for robot in (ROBOT, SLIDER):
        v = np.where(np.isfinite(robot.velocity_limits), robot.velocity_limits, 1.0)
        measured = np.arange(1.0, 4.0, 1.0 / rate)
        arrival = np.maximum.accumulate(measured + pick.uniform(0.0, lateness, len(measured)))
        swing = np.abs((measured % 1.0) - 0.5)
        assert not any(jumps(arrival, speed * swing[:, None] * v, robot=robot))


def test_noise_and_encoders_are_no_jumps():
    pick = np.random.default_rng(1)
    times = np.arange(0.0, 2.0, 0.001)
    noise = pick.choice([-0.01, 0.01], (len(times), N))
    assert not any(jumps(times, noise))
    assert not any(jumps(times, 0.05 * np.round(np.outer(times, SPEEDS) / 0.05)))


def test_full_turns_are_no_jumps_of_continuous_joints_only():
    times = np.arange(0.0, 4.0, 0.008)
    turning = np.outer(times, SPEEDS)
    wrapped = (turning + np.pi) % (2.0 * np.pi) - np.pi
    text = (ROOT / 'test/robots/seven_dof.urdf').read_text()
    wheels = load_urdf(text.replace('"revolute"', '"continuous"'))
    assert not any(jumps(times, wrapped, robot=wheels))
    turned = 2.0 * np.pi * np.outer([0, 2, -1], np.ones(N))
    assert not any(jumps([0.0, 0.005, 0.01], turned, robot=wheels))
    wraps = (np.abs(np.diff(wrapped, axis=0)) > np.pi).any(axis=1)
    assert wraps.any()
    assert jumps(times, wrapped) == [False, *wraps]


@pytest.mark.parametrize('step', [0.3, -0.3])
def test_a_sudden_step_is_a_jump_once(step):
    q = np.zeros((100, N))
    q[50:, 2] = step
    assert np.flatnonzero(jumps(0.005 * np.arange(100), q)).tolist() == [50]


@pytest.mark.parametrize('pause', [0.15, 0.5, 5.0])
@pytest.mark.parametrize('between', [0.0, 1e-4, 5e-4])
def test_a_motion_that_arrives_after_its_end_is_a_jump_all_along(pause, between):
    # Messages of the pause waited, 5 ms apart; joints moved at a third of their limit.
    live = np.arange(0.0, 1.0, 0.005)
    old = 1.0 + np.arange(0.0, pause, 0.005)
    arrival = np.concatenate([live, 1.0 + pause + between * np.arange(len(old))])
    q = np.outer(np.concatenate([live, old]), SPEEDS / 3.0)
    found = jumps(arrival, q)
    assert not any(found[: len(live) + 1])
    assert all(found[len(live) + 1 :])


def test_positions_that_move_in_a_pause_are_a_jump():
    q = np.zeros((3, N))
    q[2, 1] = 0.3 * SPEEDS[1]
    assert jumps([0.0, 0.005, 0.5], q) == [False, False, True]
    assert jumps([0.0, 0.005, 0.09], 0.5 * q) == [False, False, False]


def test_a_joint_that_rests_through_a_pause_has_not_jumped():
    assert jumps([0.0, 0.5, 0.5, 0.51], np.zeros((4, N))) == [False] * 4


def test_an_absurd_position_is_a_jump_and_not_full_turns():
    q = np.zeros((2, N))
    q[1] = 1e300
    assert jumps([0.0, 0.09], q) == [False, True]


def test_a_clock_that_is_set_back_leaves_no_time_for_motion():
    q = np.zeros((3, N))
    q[2, 1] = 0.01
    assert jumps([9.0, 9.005, 1.0], q) == [False, False, True]


@pytest.mark.parametrize('robot', [ROBOT, SLIDER])
def test_a_joint_without_a_speed_limit_has_the_default(robot):
    n = len(robot.joint_names)
    free = replace(robot, velocity_limits=np.full(n, np.inf))
    q = np.zeros((2, n))
    q[1, 0] = 1.0
    assert jumps([0.0, 0.005], q, robot=free) == [False, True]
