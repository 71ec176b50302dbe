"""An arm without brakes sinks slowly when it is stopped."""

from dataclasses import replace
from functools import cache
import math

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.loop import Phase
from inverse_dynamics_node.control.settings import Settings, StalePolicy
from inverse_dynamics_node.control.stop_damping import AT_REST, TIMEOUT
import numpy as np
import pytest
from robot_files import ROOT
from soft_stops import ARMS, SoftStop, STOP
from states import Controller, joint_state

ROBOT = load_urdf(ROOT / 'test/robots/planar_2r.urdf')
DYNAMICS = InverseDynamics(ROBOT)
Q, RAMP = np.array([0.4, -0.7]), 0.2
SLOW = {'stop_damping': 50.0, 'stop_ramp': RAMP}
PERIOD = 0.005  # [s]
MOVING = np.array([0.3, -0.2])


class Arm:
    """A controller, and the joint states that it receives: of joints at a constant speed."""

    def __init__(self, speed=MOVING, joints=(), reported=1.0, **settings):
        settings = {'start_ramp': 0.0, 'use_urdf_effort_limits': False, **SLOW, **settings}
        self.controller = Controller(InverseDynamics(ROBOT), joints, Settings(**settings))
        self.time, self.q, self.qd = 0.0, Q.copy(), np.array(speed)
        self.reported = reported  # factor of the velocities
        self.lost_since = math.inf
        self.step()

    def step(self, period=PERIOD):
        """Return the next command."""
        self.time += period
        if self.time < self.lost_since:
            self.q = self.q + period * self.qd
        time = min(self.time, self.lost_since)
        state = joint_state(self.q, self.reported * self.qd, time)
        return self.controller.step(self.time, state, None).efforts.copy()

    def run(self, duration):
        """Return the commands of a duration [s]."""
        return np.array([self.step() for _ in range(round(duration / PERIOD))])

    def stop(self, duration):
        self.controller.stop()
        return self.run(duration)

    @property
    def report(self):
        return self.controller.end_of_damping


def damping_of(arm, duration):
    """Return what the damping adds to the commands of a stop."""
    settings = arm.controller.settings
    top = arm.step()
    left = 1.0 - PERIOD * np.arange(round(duration / PERIOD)) / settings.stop_ramp
    return arm.stop(duration) - np.outer(np.maximum(0.0, left), top)


@cache
def ordinary(**arguments):
    """Return the commands of a stop without damping."""
    return Arm(**arguments, stop_damping=0.0).stop(1.0)


def expected(q, qd, damping=50.0):
    return -damping * DYNAMICS.mass_matrix(q) @ qd


def test_without_it_a_stop_is_as_before():
    arm = Arm(stop_damping=0.0)
    arm.stop(1.0)
    assert arm.step().tolist() == [0.0, 0.0]
    assert not arm.controller.has_effort
    assert not arm.report


def test_it_rises_as_the_command_fades_and_stays_while_the_arm_moves():
    arm = Arm()
    added = damping_of(arm, 0.5)
    full = np.array([expected(Q + PERIOD * (k + 3) * MOVING, MOVING) for k in range(100)])
    share = np.minimum(1.0, PERIOD * np.arange(100) / RAMP)
    assert added == pytest.approx(share[:, np.newaxis] * full)
    assert arm.controller.has_effort
    assert arm.controller.phase is Phase.STOPPED


def test_a_weak_damping_acts_too():
    arm = Arm(stop_damping=0.5)
    command = arm.stop(2.0 * RAMP)[-1]
    assert command == pytest.approx(expected(arm.q, MOVING, 0.5), rel=0.02)


def test_it_ends_when_the_arm_is_at_rest():
    arm = Arm(speed=np.array([0.0, 0.0]))
    arm.stop(RAMP + 0.45)
    assert arm.controller.has_effort
    assert arm.stop(0.1)[-1].tolist() == [0.0, 0.0]
    assert not arm.controller.has_effort
    assert arm.report == AT_REST
    arm.qd = MOVING
    assert not arm.run(0.5).any()


def test_an_arm_that_sinks_slowly_is_not_at_rest():
    arm = Arm(speed=np.array([0.0, 0.006]))
    arm.stop(5.0)
    assert arm.controller.has_effort


def test_it_fades_when_its_time_has_passed():
    arm = Arm()
    added = damping_of(arm, TIMEOUT + 0.5)
    size = np.abs(added).max(axis=1)
    before = size[round((TIMEOUT - 0.1) / PERIOD)]
    assert size[round((TIMEOUT - 0.01) / PERIOD)] == pytest.approx(before, rel=0.05)
    assert 0.0 < np.abs(np.diff(size)).max() < 0.1 * size.max()
    assert not size[round((TIMEOUT + RAMP) / PERIOD) + 1 :].any()
    assert arm.report == 'the arm still moves after 20 s'


def test_a_moving_arm_is_not_hit_by_a_step():
    arm = Arm(speed=np.array([3.0, -4.0]))
    last = arm.step()
    commands = arm.stop(2.0 * PERIOD)
    assert commands[0].tolist() == last.tolist()
    most = PERIOD / RAMP * (np.abs(last) + np.abs(expected(arm.q, arm.qd)))
    assert (np.abs(commands[1] - last) <= 1.1 * most).all()


def test_a_stop_ramp_of_zero_damps_at_once():
    arm = Arm(stop_ramp=0.0)
    assert arm.stop(PERIOD)[0] == pytest.approx(expected(arm.q, MOVING))


def test_states_that_are_lost_leave_the_ordinary_stop():
    plain = ordinary()
    arm = Arm()
    arm.stop(0.1)
    arm.lost_since = arm.time
    late = arm.run(0.2)
    # state_timeout is 0.1 s
    assert late[21:].tolist() == plain[41:60].tolist()
    assert arm.report == 'the joint states are lost'
    arm.lost_since = math.inf
    assert not arm.run(1.0).any()


@pytest.mark.parametrize('reported', [-1.0, 0.0, 57.3], ids=['sign', 'none', 'degrees'])
def test_velocities_that_contradict_positions_end_it_in_a_limit_stop(reported):
    arm = Arm(reported=reported)
    commands = arm.stop(1.0)
    assert arm.controller.phase is Phase.LIMIT_STOP
    assert arm.report == arm.controller.supervisor.limit_stop != ''
    assert not commands[round(0.15 / PERIOD) :].any()


def test_a_small_constant_error_of_the_velocities_does_not_add_up():
    arm = Arm(speed=np.array([0.0, 0.006]), reported=3.5)  # 0.015 rad/s too much
    arm.controller.stop()
    for _ in range(120):
        arm.step(0.05)
    assert arm.controller.stop_damping.is_active


def test_joints_that_are_reported_at_different_rates_are_followed_at_their_own():
    """Two drivers: one reports its fast joint all the time, the other at 20 Hz."""
    settings = Settings(start_ramp=0.0, use_urdf_effort_limits=False, **SLOW)
    arm = Controller(DYNAMICS, (), settings)
    q, qd, times = Q.copy(), np.array([3.0, -0.2]), np.zeros(2)
    for k in range(101):
        now = PERIOD * k
        q[0], times[0] = Q[0] + now * qd[0], now
        if k % 10 == 0:
            q[1], times[1] = Q[1] + now * qd[1], now
        arm.step(now, joint_state(q.copy(), qd, times.min(), times.copy()), None)
        if k == 1:
            arm.stop()
    assert arm.stop_damping.is_active
    assert not arm.end_of_damping


PAUSE = 12  # periods


def stop_with_pause(begins, reported):
    """Return the report of a stop after five periods, and the number of periods until its end."""
    settings = Settings(start_ramp=0.0, use_urdf_effort_limits=False, **SLOW)
    arm = Controller(DYNAMICS, (), settings)
    qd = np.array([2.0, -1.0])
    for k in range(100):
        sent = PERIOD * k
        end = begins + PAUSE
        now = PERIOD * end - 1e-5 * (end - k) if begins <= k < end else sent
        if k == 5:
            arm.stop()
        arm.step(now, joint_state(Q + sent * qd, reported(k) * qd, now), None)
        if arm.end_of_damping:
            return arm.end_of_damping, k - 5
    return '', 95


pauses = pytest.mark.parametrize('begins', [5, 7], ids=['with the stop', 'later'])


@pauses
def test_joint_states_that_arrive_together_after_a_pause_do_not_end_it(begins):
    """The first state after the pause is old: the joint has moved less than its velocity says."""
    assert stop_with_pause(begins, lambda k: 1.0) == ('', 95)


@pauses
def test_a_wrong_sign_during_a_pause_ends_it_soon_after(begins):
    report, periods = stop_with_pause(begins, lambda k: -1.0 if k >= begins else 1.0)
    assert 'contradict its positions' in report
    assert periods < 3 * PAUSE


def test_one_wrong_velocity_ends_it():
    report, periods = stop_with_pause(40, lambda k: 100.0 if k == 30 else 1.0)
    assert 'contradict its positions' in report
    assert periods == 26


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('value', ['positions', 'velocities'])
def test_a_state_that_cannot_be_computed_with_leaves_the_ordinary_stop(value):
    arm = Arm(stop_ramp=1.0)
    plain = Arm(stop_ramp=1.0, stop_damping=0.0)
    if value == 'positions':
        arm.q = np.array([0.4, math.nan])
    else:
        arm.reported = math.inf
    assert arm.stop(PERIOD).tolist() == plain.stop(PERIOD).tolist()


def test_a_stop_while_states_are_lost_is_not_damped():
    arm = Arm()
    arm.lost_since = arm.time
    arm.run(0.15)
    assert arm.controller.phase is Phase.STATE_LOST
    arm.lost_since = math.inf
    last = np.abs(arm.step())
    for command in np.abs(arm.stop(0.5)):
        assert (command <= last).all()
        last = command
    assert not last.any()


def test_a_gap_in_the_states_ends_it_even_if_the_next_one_is_fresh():
    arm = Arm()
    arm.stop(RAMP)
    arm.step(0.15)
    assert not arm.run(0.1).any()
    assert arm.report == 'the joint states were lost'


def test_a_full_turn_of_a_continuous_joint_is_no_motion():
    robot = load_urdf(ROOT / 'test/robots/continuous.urdf')
    joint = int(np.flatnonzero(robot.is_continuous)[0])
    settings = Settings(start_ramp=0.0, use_urdf_effort_limits=False, **SLOW)
    arm = Controller(InverseDynamics(robot), (), settings)
    q, qd = np.zeros((2, len(robot.joint_names)))
    q[joint], qd[joint] = math.pi - 0.01, 0.2
    arm.step(0.0, joint_state(q.copy(), qd, 0.0), None)
    arm.stop()
    for k in range(1, 101):
        q[joint] += PERIOD * qd[joint]
        wrapped = q - 2.0 * math.pi * (q > math.pi)
        arm.step(PERIOD * k, joint_state(wrapped, qd, PERIOD * k), None)
    assert wrapped[joint] < 0.0
    assert arm.stop_damping.is_active


def test_the_damping_is_reduced_as_a_whole_to_stay_within_the_limits():
    arm = Arm(speed=np.array([1.0, 0.5]), effort_limits=(100.0, 1.0))
    command = arm.stop(2.0 * RAMP)[-1]
    wanted = expected(arm.q, arm.qd)
    assert np.abs(command[1]) == pytest.approx(1.0)
    assert command == pytest.approx(wanted * (command[1] / wanted[1]))


def test_the_scale_applies():
    arm = Arm(effort_scale=(-2.0, 0.5))
    command = arm.stop(2.0 * RAMP)[-1]
    assert command == pytest.approx([-2.0, 0.5] * expected(arm.q, MOVING))


def test_a_joint_without_commands_is_not_damped_through_others():
    arm = Arm(effort_scale=(0.0, 1.0))
    command = arm.stop(2.0 * RAMP)[-1]
    block = DYNAMICS.mass_matrix(arm.q)[1, 1]
    assert command == pytest.approx([0.0, -50.0 * block * MOVING[1]])


def test_only_commanded_joints_are_damped():
    name = ROBOT.joint_names[1]
    arm = Arm(joints=(name,))
    block = DYNAMICS.mass_matrix(arm.q)[1, 1]
    assert arm.stop(2.0 * RAMP)[-1] == pytest.approx([-50.0 * block * MOVING[1]], rel=1e-6)


@pytest.mark.parametrize('period', [0.001, 0.005, 0.01, 0.02, 0.05, 0.09])
@pytest.mark.parametrize('pause', [0, 1, 8])
@pytest.mark.parametrize('damping', [20.0, 200.0])
def test_one_joint_state_takes_away_less_than_the_velocity(period, pause, damping):
    """Otherwise, the damping would drive a joint whose states are late."""
    arm = Arm(stop_damping=damping, stop_ramp=0.0)
    arm.controller.stop()
    for _ in range(3):
        arm.step(period)
    arm.lost_since = arm.time
    commands = [arm.step(period) for _ in range(1 + pause)]
    lost = -np.linalg.solve(DYNAMICS.mass_matrix(arm.q), np.sum(commands, axis=0)) * period
    assert (lost / MOVING <= 0.83).all()
    assert (lost / MOVING >= 0.0).all()


def test_efforts_rise_again_from_the_last_command():
    arm = Arm(start_ramp=1.0)
    arm.run(1.5)
    last = arm.stop(0.5)[-1]
    assert np.abs(last).max() > 1.0
    arm.controller.resume()
    assert arm.step() == pytest.approx(last)
    assert not arm.controller.stop_damping.is_active
    gravity = DYNAMICS.efforts(arm.q, arm.qd, np.zeros(2))
    assert np.abs(arm.step() - last).max() < 1.5 * PERIOD * np.abs(gravity - last).max()


def test_efforts_that_are_held_do_not_contain_damping():
    arm = Arm(on_stale_state=StalePolicy.HOLD)
    arm.stop(0.1)
    arm.controller.resume()
    arm.lost_since = arm.time - 1.0
    assert arm.step() == pytest.approx(ordinary()[19])
    assert arm.controller.phase is Phase.STATE_LOST


def test_a_start_does_not_continue_the_damping():
    arm = Arm()
    arm.stop(0.1)
    arm.controller.start()
    arm.controller.stop()
    assert not arm.run(0.1).any()
    assert not arm.controller.stop_damping.is_active


def test_settings_that_change_under_way_apply_to_the_next_stop():
    arm, other = Arm(), Arm()
    arm.stop(0.1)
    other.stop(0.1)
    settings = {**SLOW, 'stop_damping': 10.0}
    other.controller.apply(Settings(start_ramp=0.0, use_urdf_effort_limits=False, **settings))
    assert other.run(0.5) == pytest.approx(arm.run(0.5))


@pytest.mark.parametrize('change', [{'effort_limits': 0.1}, {'effort_scale': 3.0}])
def test_scale_and_limits_that_change_under_way_cause_no_step(change):
    arm = Arm()
    before = arm.stop(1.0)[-1]
    assert np.abs(before).max() > 1.0
    arm.controller.apply(replace(arm.controller.settings, **change))
    assert arm.step() == pytest.approx(before, rel=0.05)


def test_bursts_of_joint_states_do_not_weaken_the_protection():
    """Two messages in a row, as of two drivers, and then a pause: the pause counts."""
    arm = Arm(stop_damping=200.0)
    arm.controller.stop()
    for _ in range(60):
        arm.step(0.0198)
        last = arm.step(0.0002)
    rates = -np.linalg.solve(DYNAMICS.mass_matrix(arm.q), last) / MOVING
    assert (rates > 1.0).all()
    assert (rates * 0.0198 <= 0.6).all()


def test_the_time_to_fall_while_the_motion_is_damped_is_a_stop_ramp():
    arm = Arm()
    arm.stop(1.0)
    assert arm.controller.shaper.time_to_fall == RAMP


# In simulation, with 5 ms of delay and 0.01 rad/s of noise

arms = pytest.mark.parametrize(
    'arm',
    [
        pytest.param(name, marks=[] if name == 'gripper_arm' else pytest.mark.long)
        for name, (path, *_) in ARMS.items()
        if path
    ],
)
rates = pytest.mark.parametrize('rate', [200, pytest.param(1000, marks=pytest.mark.long)])


def simulated(*arguments, **options):
    pytest.importorskip('mujoco')
    return SoftStop(*arguments, **{'stop_damping': 50.0, 'stop_ramp': 0.5, **options})


@arms
@rates
def test_the_tip_of_a_horizontal_arm_sinks_slowly(arm, rate):
    assert max(simulated(arm, rate, stop_damping=0.0).run(STOP + 0.7).speeds) > 0.9
    stop = simulated(arm, rate).run(STOP + 1.5)
    assert 0.1 < max(stop.speeds) < 0.3
    assert not stop.report


@arms
@pytest.mark.parametrize('pause', [0.012, 0.03, 0.06])
def test_damping_returns_slowly_after_pauses_of_the_states(arm, pause):
    stop = simulated(arm, 200, pause=pause).run(STOP + 1.5)
    rises = np.diff(np.abs(stop.commands), axis=0).max(axis=0)
    assert (rises <= 0.1 * stop.robot.effort_limits).all()


@pytest.mark.long
@arms
@rates
def test_the_tip_never_becomes_fast_until_it_hangs(arm, rate):
    stop = simulated(arm, rate).run(30.0)
    assert max(stop.speeds) < 0.3
    assert stop.report in (AT_REST, 'the arm still moves after 20 s')
    assert not stop.commands[-1].any()


@arms
@rates
@pytest.mark.parametrize('speeds', [0.0, 2.0], ids=['at rest', 'moving'])
def test_noise_and_delay_do_not_end_the_damping_and_a_wrong_sign_does(arm, rate, speeds):
    assert not simulated(arm, rate, speeds=speeds).run(STOP + 0.8).report
    wrong = simulated(arm, rate, speeds=speeds, sign=-1.0).run(STOP + 0.13)
    assert wrong.loop.supervisor.limit_stop


@arms
@rates
def test_without_states_the_arm_moves_as_after_an_ordinary_stop(arm, rate):
    plain = simulated(arm, rate, stop_damping=0.0).run(STOP + 0.6)
    faulty = simulated(arm, rate, lost_at=STOP + 0.1).run(STOP + 0.6)
    assert max(faulty.speeds) == pytest.approx(max(plain.speeds), rel=0.15)
    end = round((STOP + 0.25) * rate)
    expected = np.array(plain.commands)[end:]
    assert np.array(faulty.commands)[end:] == pytest.approx(expected, abs=1e-3)
