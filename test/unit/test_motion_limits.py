"""An arm that runs away is noticed and stopped, and an arm that does not goes on."""

import math
import re

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Mode, Settings
from inverse_dynamics_node.control.supervisor import Phase
import numpy as np
import pytest
from robot_files import ROOT
from states import Arm, PERIOD, PLANAR, Q, reference, REST, store_state

NAMES, SPEED = PLANAR.joint_names, PLANAR.velocity_limits
FREE = Settings(start_ramp=0.0, stop_ramp=0.5, use_urdf_effort_limits=False)


def moving(**settings):
    return Arm(settings=FREE, **settings)


def test_a_joint_that_is_too_fast_stops_the_arm_and_is_named():
    arm = moving(mode=Mode.COMPUTED_TORQUE)
    before = arm.move((0.3, 0.0), 0.1, behind=0.0)[-1]
    assert np.abs(before).max() > 1.0
    after = arm.move((0.3, -1.3 * SPEED[1]), 0.05, behind=0.0)
    assert arm.loop.phase is Phase.LIMIT_STOP
    speed, limit = f'{1.3 * SPEED[1]:.3g}', f'{SPEED[1]:.3g}'
    assert arm.limit_stop == f'{NAMES[1]} moved at {speed} rad/s, limit {limit} rad/s'
    assert not after[-1].any()
    first = int(np.flatnonzero((after == after[-1]).all(axis=1))[0])
    assert first * PERIOD <= 3.0 * PERIOD + 0.01


def test_a_stop_lasts_until_the_node_is_enabled_and_then_efforts_rise():
    arm = moving(start_ramp=0.1)
    arm.move((2.2 * SPEED[0], 0.0), 0.05)
    assert arm.limit_stop
    assert not arm.move(REST, 1.0)[20:].any()
    arm.loop.resume()
    rising = arm.move(REST, 0.3)
    assert not arm.limit_stop
    assert rising[-1] == pytest.approx(InverseDynamics(PLANAR).gravity_efforts(arm.q))
    assert (np.abs(np.diff(rising, axis=0)) <= 1.01 * np.abs(rising[-1]) * PERIOD / 0.1).all()


def test_a_restart_ends_a_limit_stop_and_the_end_of_a_dry_run_does_not():
    arm = moving()
    arm.move((2.2 * SPEED[0], 0.0), 0.05)
    arm.loop.switch_dry_run(is_wanted=True)
    arm.move(REST, 2.0)
    arm.loop.switch_dry_run(is_wanted=False)
    assert not arm.move(REST, 0.1).any()
    assert arm.limit_stop
    arm.loop.start()
    assert arm.move(REST, 0.1)[-1].any()


@pytest.mark.parametrize('reported', [1.0, math.nan])
@pytest.mark.parametrize(('guiding', 'behind'), [(0.3, None), (0.5, None), (0.3, 0.0)])
def test_an_arm_that_is_pushed_becomes_heavy_and_is_not_stopped(guiding, behind, reported):
    """Or an arm that follows a reference, which may be faster."""
    arm = moving(guiding_speed=guiding)
    arm.q[0] = -2.4  # far from where its weight changes its sign
    limit = (guiding if behind is None else 1.0) * SPEED[0]
    upward = np.sign(arm.move(reported=reported, behind=behind)[-1][0])

    def move(share, duration):
        qd = (share * upward * limit, 0.0)
        return arm.move(qd, duration, reported=reported, behind=behind)[-1]

    free = move(0.85, 0.2)
    assert np.abs(free[0]) > 1.0
    heavy = move(1.05, 0.2)
    assert heavy[0] == 0.0
    assert heavy[1] != 0.0
    assert not arm.limit_stop


def test_efforts_fade_within_30_ms_and_return_within_200_ms_or_sooner_against_the_motion():
    arm = moving(guiding_speed=0.5)
    full = arm.move()[-1][0]
    fast = np.array([0.5 * np.sign(full) * SPEED[0], 0.0])

    def shares(qd, seconds):
        commands = arm.move(qd, seconds, period=0.01)[:, 0]
        q, rest = arm.q.copy(), np.zeros(2)
        return commands / InverseDynamics(PLANAR).efforts(q, qd, rest)[0]

    assert shares(fast, 0.04) == pytest.approx([2 / 3, 1 / 3, 0.0, 0.0], abs=0.05)
    assert shares(0.5 * fast, 0.03) == pytest.approx([0.05, 0.1, 0.15], abs=0.01)
    assert shares(0.97 * fast, 0.01) == pytest.approx([0.2], abs=0.02)
    assert shares(-0.5 * fast, 0.03) == pytest.approx([0.2 + 1 / 3, 0.2 + 2 / 3, 1.0], abs=0.05)


def test_positions_that_jump_to_and_fro_stop_the_arm_in_every_mode():
    for mode in Mode:
        arm = moving(mode=mode)
        arm.move(REST, 0.1)
        for k in range(5):
            arm.q = Q + np.array([0.0, 1.5 * (k % 2)])
            arm.move()
        assert f'{NAMES[1]} jumps to and fro by 1.5 rad' in arm.limit_stop


def test_an_arm_that_falls_is_held_at_every_speed():
    arm = moving(guiding_speed=0.5)
    falling = -np.sign(arm.move()[-1][0]) * 0.8 * SPEED[0]
    efforts = arm.move((falling, 0.0), 0.05)
    assert (efforts[:, 0] * falling < 0.0).all()
    expected = InverseDynamics(PLANAR).efforts(arm.q, np.array([falling, 0.0]), np.zeros(2))
    assert efforts[-1] == pytest.approx(expected)


@pytest.mark.parametrize('mode', Mode)
def test_an_arm_that_falls_behind_its_reference_is_stopped_in_modes_with_feedback(mode):
    arm = moving(mode=mode, max_tracking_error=0.3)
    target, velocities = arm.q.copy(), np.array([0.0, 1.0])
    for _ in range(100):  # the arm is blocked
        target = target + PERIOD * velocities
        arm.loop.reference = reference(arm.now, target, velocities)
        arm.move()
    is_closed = mode in (Mode.COMPUTED_TORQUE, Mode.JOINT_IMPEDANCE)
    assert bool(arm.limit_stop) is is_closed
    if is_closed:
        found = re.fullmatch(
            rf'{NAMES[1]} is (.*) rad from its reference, limit 0.3 rad', arm.limit_stop
        )
        assert 0.3 <= float(found[1]) < 0.31


def test_an_arm_that_was_far_from_the_reference_from_the_first_is_not_stopped():
    arm = moving(mode=Mode.JOINT_IMPEDANCE, max_tracking_error=0.3, stiffness=1.0)
    held = arm.q.copy()
    arm.move((0.5, 0.0))
    arm.move((0.5, 0.0), 0.8)  # pushed away from the position that is held
    arm.loop.reference = reference(arm.now, held, REST)
    arm.move(REST, 0.3)
    assert not arm.limit_stop


def test_limits_of_the_parameters_replace_those_of_the_urdf():
    fast = (1.5 * SPEED[0], 0.0)
    for limits, is_stopped in ((-1.0, True), (0.0, False), (2.0 * SPEED[0], False), (1.0, True)):
        arm = moving(velocity_limits=(limits, -1.0))
        arm.move(fast, 0.1)
        assert bool(arm.limit_stop) is is_stopped


def test_positions_without_velocities_show_the_speed_too():
    arm = moving()
    arm.move((2.0 * SPEED[0], 0.0), 0.2, reported=math.nan)
    assert f'{NAMES[0]} moved at' in arm.limit_stop


@pytest.mark.parametrize('reported', [-1.0, 0.0, 0.2, 57.3], ids=str)
@pytest.mark.parametrize('is_dry_run', [False, True])
def test_velocities_that_contradict_positions_are_named(reported, is_dry_run):
    arm = moving()
    if is_dry_run:
        arm.loop.start(is_dry_run=True)
    speed = 0.4
    arm.move((0.0, speed), 0.5, reported=np.array([1.0, reported]))
    problem = arm.loop.motion_problem[0] if is_dry_run else arm.limit_stop
    assert NAMES[1] in problem
    assert bool(arm.limit_stop) is not is_dry_run
    assert arm.loop.phase is (Phase.FLOATING if is_dry_run else Phase.LIMIT_STOP)


def test_a_simulation_that_falls_behind_for_a_moment_contradicts_nothing():
    """Joint states arrive 10 % more slowly than they were simulated while a joint moves back."""
    arm = moving(velocity_limits=2.0)
    for t in np.arange(0.0, 10.0, PERIOD):
        qd = 1.2 * np.cos(2.4 * t)
        arm.now += 0.1 * PERIOD if qd < 0.0 else 0.0
        arm.move((0.0, qd))
        assert not arm.limit_stop


@pytest.mark.parametrize('delay', [0.04, 0.06])
def test_gains_that_are_too_large_for_the_delay_of_the_states_stop_the_arm(delay):
    arm = moving(mode=Mode.COMPUTED_TORQUE, kd=20.0)
    arm.loop.collector.delay = delay
    arm.move((0.1, 0.1), 0.1, behind=0.0)
    is_stopped = 20.0 * delay > 1.0
    assert bool(arm.limit_stop) is is_stopped
    assert f'{NAMES[0]} may oscillate' in arm.limit_stop or not is_stopped


def test_a_jump_of_the_position_is_a_stop_only_with_feedback():
    for mode in Mode:
        arm = moving(mode=mode)
        arm.move((0.1, 0.1), 0.1, behind=0.0)
        arm.q = arm.q + np.array([0.0, 1.5])
        last = arm.move((0.1, 0.1))[-1]
        is_closed = mode in (Mode.COMPUTED_TORQUE, Mode.JOINT_IMPEDANCE)
        assert bool(arm.limit_stop) is is_closed
        if is_closed:
            assert arm.limit_stop == f'{NAMES[1]} jumped by 1.5 rad, which no motion explains'
            assert (np.abs(arm.move((0.1, 0.1))[-1]) <= np.abs(last)).all()


@pytest.mark.parametrize('period', [0.001, 0.005, 0.02])
def test_motion_within_the_limits_goes_on(period):
    """Noise of 0.05 rad/s, encoder steps of 0.5 mrad, pauses of 60 ms, and states in bursts."""
    random = np.random.default_rng(1979)
    loop = ControlLoop(PLANAR, settings=FREE)
    loop.start()
    waiting, resumed = [], 0.0
    for k in range(round(20.0 / period)):
        now = 1.0 + k * period
        q = Q + 0.5 * SPEED * np.sin(0.8 * now)
        qd = 0.4 * SPEED * np.cos(0.8 * now) + 0.05 * random.standard_normal(2)
        waiting.append((np.round(q / 5e-4) * 5e-4, qd))
        if random.random() < 2.0 * period:
            resumed = now + 0.06
        if now < resumed:
            continue
        kept = waiting if random.random() < 0.5 else waiting[-1:]
        for i, state in enumerate(kept):
            late = now + 2e-5 * i
            store_state(loop.collector, late, NAMES, *state)
            loop.step(late)
        waiting = []
        assert not loop.supervisor.limit_stop


def test_springs_push_back_from_the_position_limits_and_never_pull():
    robot = load_urdf(ROOT / 'test/robots/seven_dof.urdf')
    dynamics, n = InverseDynamics(robot), len(robot.joint_names)
    settings = Settings(start_ramp=0.0, limit_margin=0.2, limit_stiffness=50.0)
    loop = ControlLoop(robot, settings=settings)
    random, now, has_pushed = np.random.default_rng(7), 0.0, 0
    for _ in range(200):
        q = robot.lower + random.uniform(0.0, 1.0, n) * (robot.upper - robot.lower)
        qd = 0.3 * random.uniform(-1.0, 1.0, n) * robot.velocity_limits
        loop.start()
        now += 10.0
        store_state(loop.collector, now, robot.joint_names, q, qd)
        springs = loop.step(now).efforts - np.clip(
            dynamics.efforts(q, qd, np.zeros(n)), -robot.effort_limits, robot.effort_limits
        )
        is_low, is_high = q < robot.lower + 0.2, q > robot.upper - 0.2
        has_pushed += np.count_nonzero(np.abs(springs) > 0.1)
        tolerance = 1e-9 * robot.effort_limits
        assert (springs[is_high] <= tolerance[is_high]).all()
        assert (springs[is_low] >= -tolerance[is_low]).all()
        assert springs[~is_low & ~is_high] == pytest.approx(0.0, abs=1e-9)
    assert has_pushed > 50


def test_a_spring_takes_energy_out_of_the_motion():
    """A joint that runs into its limit returns with less speed, and never passes the limit."""
    pytest.importorskip('mujoco')
    from inverse_dynamics_node.simulation.mujoco import MujocoRobot

    robot = PLANAR
    settings = Settings(start_ramp=0.0, limit_margin=0.3, limit_stiffness=100.0)
    start = np.array([0.0, robot.upper[1] - 0.5])
    hardware = MujocoRobot(robot, start, friction=False)
    hardware._data.qvel[hardware._order] = 0.0, 0.8
    loop = ControlLoop(robot, settings=settings)
    loop.start()
    speeds, positions = [], []
    for k in range(400):
        q, qd = hardware.positions(), hardware.velocities()
        store_state(loop.collector, k * PERIOD, robot.joint_names, q, qd)
        hardware.command(loop.step(k * PERIOD).efforts)
        hardware.advance(PERIOD)
        speeds.append(qd[1])
        positions.append(q[1])
    assert max(positions) > robot.upper[1] - 0.3
    assert max(positions) < robot.upper[1]
    assert -0.6 < min(speeds) < 0.0
