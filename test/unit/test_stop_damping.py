"""An arm without brakes sinks slowly when it is stopped."""

import math

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.settings import Settings, StalePolicy
from inverse_dynamics_node.control.stop_damping import AT_REST, TIMEOUT
from inverse_dynamics_node.control.supervisor import Phase
import numpy as np
import pytest
from robot_files import ROOT
from simulated_arm import HORIZONTAL_ARMS, SoftStop, STOP
from states import Arm, PERIOD, PLANAR, Q, REST, store_state

DYNAMICS = InverseDynamics(PLANAR)
RAMP = 0.2
SLOW = Settings(start_ramp=0.0, use_urdf_effort_limits=False, stop_damping=50.0, stop_ramp=RAMP)
MOVING = np.array([0.3, -0.2])


class Stopped(Arm):
    """An arm that moves at constant speed, and is stopped; it keeps why the damping has ended."""

    def __init__(self, speed=MOVING, joints=(), robot=PLANAR, reported=1.0, **settings):
        super().__init__(robot, joints, settings=SLOW, **settings)
        self.speed, self.reported, self.report = np.array(speed), reported, ''
        self.run()

    def _step(self):
        efforts = super()._step()
        self.report = self.command.end_of_damping or self.report
        return efforts

    def run(self, duration=PERIOD, **options):
        return self.move(self.speed, duration, reported=self.reported, **options)

    def stop(self, duration, **options):
        self.loop.stop()
        return self.run(duration, **options)

    @property
    def is_damped(self):
        return self.loop.stop_damping.is_active

    def added(self, duration):
        """Return what the damping adds to the commands of a stop."""
        top = self.run()[-1]
        left = 1.0 - PERIOD * np.arange(round(duration / PERIOD)) / RAMP
        return self.stop(duration) - np.outer(np.maximum(0.0, left), top)


def expected(q, qd, damping=50.0):
    return -damping * DYNAMICS.mass_matrix(q) @ qd


def test_it_rises_as_the_command_fades_and_stays_while_the_arm_moves():
    arm = Stopped()
    added = arm.added(0.5)
    full = np.array([expected(Q + PERIOD * (k + 3) * MOVING, MOVING) for k in range(100)])
    share = np.minimum(1.0, PERIOD * np.arange(100) / RAMP)
    assert added == pytest.approx(share[:, np.newaxis] * full)
    assert arm.loop.has_effort
    assert arm.phase is Phase.STOPPED
    assert arm.loop.shaper.time_to_fall == RAMP


def second(q, qd):
    """Return the damping of the second joint alone."""
    return -50.0 * DYNAMICS.mass_matrix(q)[1, 1] * qd[1]


@pytest.mark.parametrize(
    ('settings', 'speed', 'damping'),
    [
        ({'stop_damping': 0.5}, MOVING, lambda q, qd: expected(q, qd, 0.5)),
        ({'stop_damping': 0.0}, MOVING, lambda q, qd: REST),
        ({'effort_scale': (-2.0, 0.5)}, MOVING, lambda q, qd: [-2.0, 0.5] * expected(q, qd)),
        # A joint without commands is not damped through others.
        ({'effort_scale': (0.0, 1.0)}, MOVING, lambda q, qd: [0.0, second(q, qd)]),
        ({'joints': PLANAR.joint_names[1:]}, MOVING, lambda q, qd: [second(q, qd)]),
        # Within the limits, it is reduced as a whole.
        (
            {'effort_limits': (100.0, 1.0)},
            (1.0, 0.5),
            lambda q, qd: expected(q, qd) / abs(expected(q, qd)[1]),
        ),
    ],
)
def test_commanded_joints_are_damped_within_the_limits(settings, speed, damping):
    arm = Stopped(speed, **settings)
    command = arm.stop(2.0 * RAMP)[-1]
    assert command == pytest.approx(np.array(damping(arm.q, arm.speed)), rel=1e-6)
    assert arm.loop.has_effort is bool(command.any())


def test_a_stop_ramp_of_zero_damps_at_once():
    arm = Stopped(stop_ramp=0.0)
    assert arm.stop(PERIOD)[0] == pytest.approx(expected(arm.q, MOVING))


def test_it_ends_when_the_arm_is_at_rest():
    arm = Stopped(speed=REST)
    arm.stop(RAMP + 0.45)
    assert arm.loop.has_effort
    assert arm.stop(0.1)[-1].tolist() == [0.0, 0.0]
    assert not arm.loop.has_effort
    assert arm.report == AT_REST
    arm.speed = MOVING
    assert not arm.run(0.5).any()


def test_an_arm_that_sinks_slowly_is_not_at_rest():
    arm = Stopped(speed=(0.0, 0.006))
    arm.stop(5.0)
    assert arm.loop.has_effort


def test_it_fades_when_its_time_has_passed():
    arm = Stopped()
    size = np.abs(arm.added(TIMEOUT + 0.5)).max(axis=1)
    before = size[round((TIMEOUT - 0.1) / PERIOD)]
    assert size[round((TIMEOUT - 0.01) / PERIOD)] == pytest.approx(before, rel=0.05)
    assert 0.0 < np.abs(np.diff(size)).max() < 0.1 * size.max()
    assert not size[round((TIMEOUT + RAMP) / PERIOD) + 1 :].any()
    assert arm.report == 'the arm still moves after 20 s'


def test_states_that_are_lost_leave_the_ordinary_stop():
    plain, arm = Stopped(stop_damping=0.0).stop(1.0), Stopped()
    arm.stop(0.1)
    arm.speed = REST
    late = arm.run(0.2, has_states=False)
    # state_timeout is 0.1 s
    assert late[21:].tolist() == plain[41:60].tolist()
    assert arm.report == 'the joint states are lost'
    arm.speed = MOVING
    assert not arm.run(1.0).any()


@pytest.mark.parametrize('reported', [-1.0, 0.0, 57.3], ids=['sign', 'none', 'degrees'])
def test_velocities_that_contradict_positions_end_it_in_a_limit_stop(reported):
    arm = Stopped(reported=reported)
    commands = arm.stop(1.0)
    assert arm.phase is Phase.LIMIT_STOP
    assert arm.report == arm.limit_stop != ''
    assert not commands[round(0.16 / PERIOD) :].any()


def test_a_small_constant_error_of_the_velocities_does_not_add_up():
    arm = Stopped(speed=(0.0, 0.006), reported=3.5)  # 0.015 rad/s too much
    arm.stop(6.0, period=0.05)
    assert arm.is_damped


@pytest.mark.parametrize(('period', 'largest'), [(0.05, 8.0), (0.1, 4.0), (0.2, 2.0), (0.3, 50.0)])
def test_a_joint_that_turns_to_and_fro_is_damped_less(period, largest):
    """States that are always late make a damped arm shake, at twice their delay."""
    arm = Stopped(speed=REST, state_timeout=0.5)
    arm.loop.stop()
    for k in range(round(8 * period / PERIOD)):
        swing = 0.16 if (k * PERIOD) // period % 2 else -0.16
        command = arm.move((0.0, swing))[-1]
    rate = command[1] / expected(arm.q, np.array([0.0, swing]), 1.0)[1]
    assert rate == pytest.approx(largest, rel=0.1)


def test_a_small_swing_is_damped_in_full():
    arm = Stopped(speed=REST)
    arm.loop.stop()
    for k in range(160):
        command = arm.move((0.0, 0.14 if k // 20 % 2 else -0.14))[-1]
    assert np.abs(command[1]) == pytest.approx(np.abs(second(arm.q, (0.0, 0.14))), rel=0.05)


def test_joints_that_are_reported_at_different_rates_are_followed_at_their_own():
    """Two drivers: one reports its fast joint all the time, the other at 20 Hz."""
    arm = Arm(settings=SLOW)
    qd = np.array([3.0, -0.2])
    for k in range(101):
        now = PERIOD * k
        for joint in (0, 1) if k % 10 == 0 else (0,):
            values = [Q[joint] + now * qd[joint]], [qd[joint]]
            store_state(arm.loop.collector, now, PLANAR.joint_names[joint : joint + 1], *values)
        arm.loop.step(now)
        if k == 1:
            arm.loop.stop()
    assert arm.loop.stop_damping.is_active


PAUSE = 12  # periods


def stop_with_pause(begins, reported):
    """Return the report of a stop after five periods, and the number of periods until its end."""
    arm, qd = Arm(settings=SLOW), np.array([2.0, -1.0])
    for k in range(100):
        sent, end = PERIOD * k, begins + PAUSE
        now = PERIOD * end - 1e-5 * (end - k) if begins <= k < end else sent
        if k == 5:
            arm.loop.stop()
        arm.at(now, Q + sent * qd, reported(k) * qd)
        if arm.command.end_of_damping:
            return arm.command.end_of_damping, k - 5
    return '', 95


@pytest.mark.parametrize(
    ('begins', 'reported', 'ends'),
    [
        # The first state after a pause is old: the joint has moved less than its velocity says.
        (5, lambda k: 1.0, (95, 95)),
        (7, lambda k: 1.0, (95, 95)),
        (5, lambda k: -1.0 if k >= 5 else 1.0, (1, 3 * PAUSE)),
        (7, lambda k: -1.0 if k >= 7 else 1.0, (1, 3 * PAUSE)),
        (40, lambda k: 100.0 if k == 30 else 1.0, (26, 26)),  # one wrong velocity
    ],
)
def test_a_wrong_velocity_ends_it_and_a_pause_does_not(begins, reported, ends):
    report, periods = stop_with_pause(begins, reported)
    assert ends[0] <= periods <= ends[1]
    assert ('contradict its positions' in report) is (periods < 95)


def test_a_stop_while_states_are_lost_is_not_damped():
    arm = Stopped()
    arm.run(0.15, has_states=False)
    assert arm.phase is Phase.STATE_LOST
    commands = np.abs(np.vstack([arm.run(), arm.stop(0.5)]))
    assert (np.diff(commands, axis=0) <= 0.0).all()
    assert not commands[-1].any()


def test_a_gap_in_the_states_ends_it_even_if_the_next_one_is_fresh():
    arm = Stopped()
    arm.stop(RAMP)
    arm.run(0.15, period=0.15)
    assert not arm.run(0.1).any()
    assert arm.report == 'the joint states were lost'


def test_a_full_turn_of_a_continuous_joint_is_no_motion():
    robot = load_urdf(ROOT / 'test/robots/continuous.urdf')
    joint = int(np.flatnonzero(robot.is_continuous)[0])
    arm = Stopped(0.2 * np.eye(len(robot.joint_names))[joint], robot=robot)
    arm.q[joint] = math.pi - 0.01
    arm.run()
    arm.loop.stop()
    for _ in range(100):
        arm.run()
        arm.q[joint] -= 2.0 * math.pi * (arm.q[joint] > math.pi)
    assert arm.q[joint] < 0.0
    assert arm.is_damped


@pytest.mark.parametrize('period', [0.001, 0.01, 0.02, 0.09])
@pytest.mark.parametrize('pause', [0, 1, 8])
@pytest.mark.parametrize('damping', [20.0, 200.0])
def test_one_joint_state_takes_away_less_than_the_velocity(period, pause, damping):
    """Otherwise, the damping would drive a joint whose states are late."""
    arm = Stopped(stop_damping=damping, stop_ramp=0.0)
    arm.stop(3.0 * period, period=period)
    q = arm.q.copy()
    commands = arm.run((1 + pause) * period, period=period, has_states=False)
    lost = -np.linalg.solve(DYNAMICS.mass_matrix(q), commands.sum(axis=0)) * period
    assert (lost / MOVING <= 0.83).all()
    assert (lost / MOVING >= 0.0).all()


def test_bursts_of_joint_states_do_not_weaken_the_protection():
    """Two messages in a row, as of two drivers, and then a pause: the pause counts."""
    arm = Stopped(stop_damping=200.0)
    arm.loop.stop()
    for _ in range(60):
        arm.run(0.0198, period=0.0198)
        last = arm.run(0.0002, period=0.0002)[-1]
    rates = -np.linalg.solve(DYNAMICS.mass_matrix(arm.q), last) / MOVING
    assert (rates > 1.0).all()
    assert (rates * 0.0198 <= 0.6).all()


def test_efforts_that_are_held_do_not_contain_damping():
    arm, plain = Stopped(on_stale_state=StalePolicy.HOLD), Stopped(stop_damping=0.0)
    arm.stop(0.1)
    arm.loop.resume()
    arm.now += 1.0
    assert arm.run(has_states=False)[-1] == pytest.approx(plain.stop(0.1)[-1])
    assert arm.phase is Phase.STATE_LOST


def test_a_start_does_not_continue_the_damping():
    arm = Stopped()
    arm.stop(0.1)
    arm.loop.start()
    assert not arm.stop(0.1).any()
    assert not arm.is_damped


def test_settings_that_change_under_way_apply_to_the_next_stop():
    arm, other = Stopped(), Stopped()
    for each in (arm, other):
        each.stop(0.1)
    other.change(stop_damping=10.0, effort_scale=3.0, effort_limits=0.1)
    assert other.run(0.5) == pytest.approx(arm.run(0.5))


# In simulation, with 5 ms of delay and 0.01 rad/s of noise

arms = pytest.mark.parametrize(
    'arm',
    [
        pytest.param(name, marks=[] if name == 'gripper_arm' else pytest.mark.long)
        for name, (path, *_) in HORIZONTAL_ARMS.items()
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
