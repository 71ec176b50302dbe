"""Ramps, limits and lost inputs, with time as an argument."""

import math

from inverse_dynamics_node import ConfigurationError, InverseDynamics, load_urdf
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import Phase, recovery_time
from inverse_dynamics_node.control.settings import Mode, Settings, StalePolicy
import numpy as np
import pytest
from robot_files import NOTHING_MOVES
from states import joint_state, UnobservedController

# Two point-like masses on two sliding joints, one above the other: efforts are sums of weights.
LIFT = """
<robot name="lift">
  <link name="base"/>
  <link name="lower"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <link name="upper"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <joint name="low" type="prismatic"><parent link="base"/><child link="lower"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="50" velocity="1"/></joint>
  <joint name="high" type="prismatic"><parent link="lower"/><child link="upper"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="15" velocity="1"/></joint>
</robot>"""
HOLD = np.array([30.0, 10.0])  # with gravity 10


def controller(joints=(), period=0.1, **settings):
    dynamics = InverseDynamics(load_urdf(LIFT), gravity=(0.0, 0.0, -10.0))
    no_ramps = {'start_ramp': 0.0, 'stop_ramp': 0.0}
    return UnobservedController(dynamics, joints, Settings(**{**no_ramps, **settings}), period)


def state(time):
    return joint_state(np.zeros(2), np.zeros(2), time)


def reference(time, accelerations, efforts=(0.0, 0.0)):
    return Reference(np.array(accelerations), np.array(efforts), time)


def test_gives_no_command_before_the_first_state():
    lift = controller()
    assert lift.step(0.0, None, reference(0.0, [1.0, 1.0])) is None
    assert lift.phase is Phase.WAITING
    assert lift.has_effort is False
    assert lift.end_of_damping == ''


def test_holds_gravity_without_a_reference():
    lift = controller()
    assert lift.step(0.0, state(0.0), None).efforts == pytest.approx(HOLD)
    assert lift.phase is Phase.FLOATING


def test_produces_the_reference_accelerations_and_adds_its_efforts():
    lift = controller()
    command = lift.step(0.0, state(0.0), reference(0.0, [1.0, 2.0], [0.5, 0.25]))
    assert command.efforts == pytest.approx([30.0 + 3.0 + 2.0 + 0.5, 10.0 + 3.0 + 0.25])
    assert lift.phase is Phase.RUNNING


def test_commands_joints_in_the_requested_order():
    lift = controller(['high', 'low'])
    command = lift.step(0.0, state(0.0), reference(0.0, [2.0, 1.0]))
    assert command.efforts == pytest.approx([13.0, 35.0])


def test_dynamics_include_joints_that_are_not_commanded():
    assert controller(['low']).step(0.0, state(0.0), None).efforts == pytest.approx([30.0])


def test_cuts_efforts_to_the_limits_of_the_urdf_and_flags_them():
    command = controller().step(0.0, state(0.0), reference(0.0, [-9.0, 60.0]))
    assert command.efforts.tolist() == [50.0, 15.0]
    assert command.is_saturated.tolist() == [True, True]
    command = controller().step(0.0, state(0.0), reference(0.0, [-60.0, 0.0]))
    assert command.efforts.tolist() == [-50.0, -15.0]
    command = controller().step(0.0, state(0.0), None)
    assert command.is_saturated.tolist() == [False, False]


def test_limits_of_the_urdf_can_be_switched_off():
    lift = controller(use_urdf_effort_limits=False)
    command = lift.step(0.0, state(0.0), reference(0.0, [0.0, 90.0]))
    assert command.efforts == pytest.approx([120.0, 100.0])
    assert not command.is_saturated.any()


def test_a_lost_reference_leaves_the_arm_floating():
    lift = controller()
    old = reference(0.0, [1.0, 0.0], [1.0, 1.0])
    assert lift.step(0.5, state(0.5), old).efforts == pytest.approx([34.0, 12.0])
    assert lift.step(0.51, state(0.51), old).efforts == pytest.approx(HOLD)
    assert lift.phase is Phase.FLOATING


def test_a_reference_can_hold_forever():
    lift = controller(reference_timeout=0.0)
    command = lift.step(1e6, state(1e6), reference(0.0, [1.0, 0.0]))
    assert command.efforts == pytest.approx([33.0, 11.0])


def test_efforts_rise_along_the_start_ramp():
    lift = controller(start_ramp=0.4)
    shares = [lift.step(t, state(t), None).efforts / HOLD for t in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)]
    assert np.array(shares) == pytest.approx(np.outer([0.0, 0.25, 0.5, 0.75, 1.0, 1.0], [1, 1]))


def test_efforts_ramp_down_when_the_state_is_lost_and_rise_when_it_returns():
    lift = controller(start_ramp=0.2, stop_ramp=0.2)
    for t in (0.0, 0.05, 0.1, 0.15, 0.2):
        lift.step(t, state(t), None)
    lift.step(0.29, state(0.2), None)
    lost = [lift.step(t, state(0.2), None).efforts[0] for t in (0.34, 0.39, 0.44, 0.49, 0.54)]
    assert lost == pytest.approx([30.0, 22.5, 15.0, 7.5, 0.0], abs=1e-12)
    assert lift.phase is Phase.STATE_LOST
    zero = lift.step(0.55, state(0.2), None)
    assert zero.efforts.tolist() == [0.0, 0.0]
    assert not zero.is_saturated.any()
    back = [lift.step(t, state(t), None).efforts[0] for t in (0.6, 0.65, 0.7, 0.75, 0.8)]
    assert back == [0.0] * 5
    assert lift.step(0.85, state(0.85), None).efforts == pytest.approx(HOLD / 4)


@pytest.mark.parametrize('gap', [0.12, 0.15, 0.4])
def test_intermittent_states_do_not_raise_and_lower_the_efforts_repeatedly(gap):
    lift = controller(start_ramp=0.2, stop_ramp=0.2, state_timeout=0.08)
    commands = []
    for k in range(400):
        now = 0.01 * k
        last = now if now < 1.0 else 1.0 + gap * ((now - 1.0) // gap)
        commands.append(lift.step(now, state(last), None).efforts[0])
    assert commands[100] == pytest.approx(30.0)
    assert (np.diff(commands[100:]) <= 0.0).all()
    assert commands[-1] == 0.0


@pytest.mark.parametrize('gap', [0.12, 0.125, 0.13])
@pytest.mark.parametrize('stop_ramp', [0.1, 0.5, 2.0])
def test_short_losses_in_quick_succession_add_up(gap, stop_ramp):
    lift = controller(start_ramp=0.5, stop_ramp=stop_ramp)
    commands = []
    for k in range(1200):
        now = 0.01 * k
        last = now if now < 1.0 else 1.0 + gap * ((now - 1.0) // gap)
        commands.append(lift.step(now, state(last), None).efforts[0])
    assert commands[100] == pytest.approx(30.0)
    assert min(commands[-300:]) == max(commands[-300:])  # they neither sag nor shake


@pytest.mark.parametrize('pause', [0, 1, 10, 25, 40])  # steps
def test_efforts_continue_from_the_last_command_after_a_stop_without_the_reference(pause):
    lift = controller(start_ramp=0.5, stop_ramp=0.5)
    for k in range(1000):
        last = lift.step(0.001 * k, state(0.001 * k), reference(0.001 * k, [5.0, 5.0]))
    efforts = [last.efforts.copy()]
    lift.stop()
    for k in range(1000, 1100):
        if k == 1000 + pause:
            lift.resume()
        efforts.append(lift.step(0.001 * k, state(0.001 * k), None).efforts.copy())
    assert np.abs(np.diff(efforts, axis=0)).max() < 0.2


def test_a_loss_ends_after_states_without_a_gap_for_twice_the_timeout():
    lift = controller(state_timeout=0.5)
    for now, last, is_well in (
        (0.0, 0.0, True),
        (0.6, 0.0, False),
        (0.7, 0.7, False),
        (1.3, 0.7, False),  # another gap
        (1.4, 1.4, False),
        (1.8, 1.8, False),
        (2.2, 2.2, False),
        (2.4, 2.2, False),  # the same state as before
        (2.5, 2.5, True),
    ):
        lift.step(now, state(last), None)
        assert (lift.phase is Phase.FLOATING) == is_well, now
    assert recovery_time(lift.settings.state_timeout) == 1.0


@pytest.mark.parametrize('policy', StalePolicy)
def test_a_loss_that_hardly_lowered_the_efforts_ends_with_the_next_state(policy):
    lift = controller(stop_ramp=1.0, on_stale_state=policy)
    for now in np.arange(0.0, 1.0, 0.01):
        lift.step(now, state(min(now, 0.85)), None)
    assert lift.phase is Phase.STATE_LOST
    lift.step(1.0, state(1.0), None)
    assert lift.phase is Phase.FLOATING


def test_efforts_reach_zero_within_timeout_and_ramp_at_any_rate():
    for period in (0.001, 0.007, 0.03, 0.2, 2.0):
        for timeout in (0.01, 0.1):
            lift = controller(stop_ramp=0.25, state_timeout=timeout, period=period)
            time = 0.0
            while lift.step(time, state(0.0), None).efforts.any():
                time += period
            # One period until the loss is noticed, and one until the ramp is over.
            assert time <= timeout + 0.25 + 2.0 * period


def test_a_clock_that_jumps_back_means_a_lost_state():
    lift = controller(stop_ramp=1.0)
    lift.step(100.0, state(100.0), reference(100.0, [1.0, 1.0]))
    command = lift.step(1.0, state(100.0), reference(100.0, [1.0, 1.0]))
    assert lift.phase is Phase.STATE_LOST
    assert np.isfinite(command.efforts).all()
    lift.step(1.1, state(1.1), reference(100.0, [1.0, 1.0]))
    assert lift.phase is Phase.FLOATING


def test_absurd_numbers_lead_to_zero_not_to_infinity():
    lift = controller(stop_ramp=0.1, use_urdf_effort_limits=False)
    lift.step(0.0, state(0.0), None)
    for now, fraction in ((0.05, 1.0), (0.1, 0.5), (0.151, 0.0)):
        command = lift.step(now, state(now), reference(now, [1e308, 1e308]))
        assert lift.phase is Phase.NO_SOLUTION
        assert command.efforts == pytest.approx(fraction * HOLD)


@pytest.mark.parametrize('efforts', [[1e308, 0.0], [math.inf, 0.0], [math.nan, 0.0]])
def test_never_commands_efforts_that_are_not_finite(efforts):
    lift = controller(use_urdf_effort_limits=False)
    lift.step(0.0, state(0.0), None)
    accelerations = [5e307, 0.0]
    command = lift.step(0.05, state(0.05), reference(0.05, accelerations, efforts))
    assert np.isfinite(command.efforts).all()


@pytest.mark.parametrize(
    ('joints', 'words'),
    [
        (
            ['low', 'middle'],
            "'middle', expected only movable joints of robot 'lift' that mimic no other joint",
        ),
        (['low', 'low'], 'lists a joint twice: low, low'),
    ],
)
def test_names_the_joint_that_cannot_be_commanded(joints, words):
    with pytest.raises(ConfigurationError, match=words):
        controller(joints)


def test_rejects_a_robot_without_joints():
    rock = load_urdf(NOTHING_MOVES)
    with pytest.raises(ConfigurationError, match="'rock' has no movable joints"):
        UnobservedController(InverseDynamics(rock))


def tracking(time, positions, velocities=(0.0, 0.0), accelerations=(0.0, 0.0)):
    return Reference(
        np.array(accelerations), np.zeros(2), time, np.array(positions), np.array(velocities)
    )


def test_computed_torque_drives_back_to_the_reference():
    lift = controller(mode=Mode.COMPUTED_TORQUE, kp=(100.0, 50.0), kd=10.0)
    command = lift.step(0.0, state(0.0), tracking(0.0, [0.02, 0.01], [0.1, -0.1], [0.5, 0.0]))
    low, high = 0.5 + 10.0 * 0.1 + 100.0 * 0.02, 10.0 * -0.1 + 50.0 * 0.01
    assert command.efforts == pytest.approx([30.0 + 3.0 * low + high, 10.0 + low + high])


def test_inverse_dynamics_ignores_position_errors():
    lift = controller()
    command = lift.step(0.0, state(0.0), tracking(0.0, [0.02, 0.01], [0.1, -0.1], [0.5, 0.0]))
    assert command.efforts == pytest.approx([31.5, 10.5])


def test_gravity_compensation_ignores_reference_and_velocity():
    lift = controller(mode=Mode.GRAVITY_COMPENSATION)
    lift.dynamics.set_armature(1.0)
    moving = joint_state(np.zeros(2), np.ones(2), 0.0)
    assert lift.step(0.0, moving, tracking(0.0, [0.3, 0.3])).efforts == pytest.approx(HOLD)


def test_reference_that_starts_too_far_away_is_not_followed():
    lift = controller(mode=Mode.COMPUTED_TORQUE, max_tracking_error=0.1)
    assert lift.step(0.0, state(0.0), tracking(0.0, [0.2, 0.0])).efforts == pytest.approx(HOLD)
    assert lift.phase is Phase.TOO_FAR
    lift.step(0.01, state(0.01), tracking(0.01, [0.05, 0.0]))
    assert lift.phase is Phase.RUNNING
    lift.step(0.02, state(0.02), tracking(0.02, [0.3, 0.0]))  # it must not jump
    assert lift.phase is Phase.TOO_FAR
    lift.step(0.03, state(0.03), tracking(0.03, [0.05, 0.0]))
    lift.step(0.04, state(0.04), tracking(0.04, [0.14, 0.0]))  # the arm must not fall behind
    assert lift.phase is Phase.LIMIT_STOP


def test_feedback_that_starts_during_motion_does_not_start_with_a_jump():
    lift = controller(mode=Mode.COMPUTED_TORQUE, max_tracking_error=0.1)
    lift.step(0.0, state(0.0), reference(0.0, [1.0, 0.0]))  # no positions, so no distance
    assert lift.phase is Phase.RUNNING
    lift.step(0.01, state(0.01), tracking(0.01, [3.0, 0.0]))
    assert lift.phase is Phase.TOO_FAR
    open_loop = controller(max_tracking_error=0.1)
    open_loop.step(0.0, state(0.0), tracking(0.0, [3.0, 0.0]))
    assert open_loop.phase is Phase.RUNNING
    closed = Settings(mode=Mode.COMPUTED_TORQUE, max_tracking_error=0.1, start_ramp=0.0)
    open_loop.apply(closed)
    open_loop.step(0.01, state(0.01), tracking(0.01, [3.0, 0.0]))
    assert open_loop.phase is Phase.TOO_FAR


def test_a_tightened_limit_is_reached_along_the_ramp_and_the_rate_limits():
    lift = controller()
    lift.step(0.0, state(0.0), None)

    def efforts_at(now):
        return lift.step(now, state(now), None).efforts.tolist()

    lift.apply(Settings(start_ramp=0.1, effort_limits=5.0))
    efforts = [efforts_at(now) for now in (0.15, 0.2, 0.251)]
    assert lift.phase is Phase.FLOATING
    assert efforts == [pytest.approx(wanted) for wanted in ([30.0, 10.0], [17.5, 7.5], [5.0, 5.0])]
    lift.apply(Settings(start_ramp=0.0, effort_rate_limits=10.0, effort_limits=3.0))
    efforts = [efforts_at(now) for now in (0.351, 0.451, 0.551)]
    assert efforts == [pytest.approx([wanted, wanted]) for wanted in (4.0, 3.0, 3.0)]


def swinging(**settings):
    """Return a controller whose lower effort moves from -21 to 42 N, and the time."""
    lift = controller(effort_rate_limits=40.0, stop_ramp=0.2, **settings)
    for k in range(100):
        now = 0.05 * k
        accelerations = [-17.0, 0.0] if k < 90 else [4.0, 0.0]
        command = lift.step(now, state(now), reference(now, accelerations))
    assert -5.0 < command.efforts[0] < 0.0
    return lift, now, command.efforts.copy()


@pytest.mark.parametrize(
    'change',
    [
        {'effort_rate_limits': math.inf},
        {'effort_limits': 1.0},
        {'use_urdf_effort_limits': False, 'effort_scale': 3.0},
        {'mode': Mode.COMPUTED_TORQUE},
        {'effort_scale': (-3.0, 5.0), 'effort_rate_limits': 1e-3},
    ],
)
def test_a_live_change_continues_from_the_last_command(change):
    ours = {'start_ramp': 0.5, 'stop_ramp': 0.2, 'effort_rate_limits': 40.0}
    lift, now, last = swinging(start_ramp=0.5)
    lift.apply(Settings(**ours | change))
    now += 0.05
    efforts = lift.step(now, state(now), reference(now, [4.0, 0.0])).efforts
    assert efforts == pytest.approx(last)


def test_a_live_change_does_not_add_the_efforts_of_the_reference_twice():
    lift = controller(start_ramp=0.5)
    pushing = reference(0.0, [0.0, 0.0], [4.0, 2.0])
    for now in np.arange(0.0, 1.0, 0.05):
        last = lift.step(now, state(now), pushing._replace(time=now)).efforts.copy()
    assert last == pytest.approx([34.0, 12.0])
    lift.apply(Settings(start_ramp=0.5, effort_scale=0.5))
    now += 0.05
    assert lift.step(now, state(now), pushing._replace(time=now)).efforts == pytest.approx(last)


def test_a_start_ramp_of_zero_does_not_cut_off_a_blend_or_a_start():
    lift = controller(start_ramp=0.5)
    time = settled(lift)
    lift.apply(Settings(start_ramp=0.5, effort_scale=0.2))
    last = efforts_after(lift, time, 0.3)
    for _ in range(3):  # several calls between two steps
        lift.apply(Settings(start_ramp=0.0, effort_scale=0.2))
    assert efforts_after(lift, time + 0.3, 0.05) == pytest.approx(last)
    assert efforts_after(lift, time + 0.35, 0.125, 0.025) == pytest.approx(
        0.1 * HOLD + last / 2, rel=1e-6
    )
    assert efforts_after(lift, time + 0.475, 0.15) == pytest.approx(0.2 * HOLD)
    lift.start()
    lift.apply(Settings(start_ramp=0.5))
    low = efforts_after(lift, time + 0.625, 0.3)
    lift.apply(Settings(start_ramp=0.0))
    assert efforts_after(lift, time + 0.925, 0.05) == pytest.approx(low)
    assert efforts_after(lift, time + 0.975, 0.35) == pytest.approx(HOLD)
    lift.apply(Settings(start_ramp=0.0, effort_scale=0.5))  # no blend under way: applies at once
    assert efforts_after(lift, time + 1.325, 0.05) == pytest.approx(0.5 * HOLD)


@pytest.mark.parametrize('policy', StalePolicy)
def test_states_that_are_slightly_late_do_not_weaken_the_feedback(policy):
    lift = controller(
        mode=Mode.COMPUTED_TORQUE, start_ramp=0.5, stop_ramp=0.5, on_stale_state=policy
    )
    target = np.array([0.01, 0.0])
    for k in range(1, 130):
        now = 0.11 * k
        before = lift.step(now - 0.005, state(now - 0.11), tracking(now - 0.005, target))
        before = None if before is None else before.efforts.copy()
        efforts = lift.step(now, state(now), tracking(now, target)).efforts.copy()
        assert k < 2 or lift.phase is Phase.RUNNING
        assert before is None or np.abs(efforts - before).max() <= 40.0 * 0.02
    assert efforts == pytest.approx(HOLD + np.array([3.0, 1.0]))
    lift.step(now + 0.105, state(now), tracking(now, target))
    assert lift.phase is Phase.STATE_LOST
    # The joint came closer meanwhile: the next command follows at once.
    efforts = lift.step(now + 0.11, state(now + 0.11), tracking(now + 0.11, 0.5 * target)).efforts
    assert efforts == pytest.approx(HOLD + np.array([1.5, 0.5]))


def test_the_time_to_fall_is_what_is_left_of_a_stop_ramp():
    lift = controller(stop_ramp=0.5)
    lift.step(0.0, state(0.0), None)
    assert lift.shaper.time_to_fall == 0.5
    lift.stop()
    for now, left in ((0.1, 0.5), (0.2, 0.4), (0.25, 0.35), (0.9, 0.25)):
        lift.step(now, state(now), None)
        assert lift.shaper.time_to_fall == pytest.approx(left)
    lift.apply(Settings(start_ramp=0.0, stop_ramp=9.0))
    for now in (1.0, 1.1, 1.2, 1.3):
        lift.step(now, state(now), None)
    assert lift.shaper.time_to_fall == 0.0
    lift.resume()
    lift.step(1.4, state(1.4), None)
    assert lift.shaper.time_to_fall == 9.0


def test_the_velocity_filter_uses_the_arrival_times_of_each_joint():
    lift = controller(velocity_filter_cutoff=50.0, use_urdf_effort_limits=False)
    lift.dynamics.set_friction(damping=1.0, coulomb=0.0)
    for k, time in enumerate(np.arange(0.0, 0.08, 0.002)):
        qd = np.array([0.0, 1.0 if k else 0.0])
        seldom = joint_state(np.zeros(2), qd, 0.0, np.array([0.0, time]))
        command = lift.step(time, seldom, None)
    assert command.efforts[1] - 10.0 == pytest.approx(1.0, abs=1e-6)


def test_continuous_joints_take_the_shorter_way():
    wheel = load_urdf(LIFT.replace('type="prismatic"', 'type="continuous"').replace('50"', '500"'))
    settings = Settings(
        mode=Mode.COMPUTED_TORQUE, start_ramp=0.0, kp=1.0, kd=0.0, use_urdf_effort_limits=False
    )
    turning = UnobservedController(InverseDynamics(wheel, gravity=(0, 0, 0)), (), settings)
    position = joint_state(np.array([3.1, 0.0]), np.zeros(2), 0.0)
    command = turning.step(0.0, position, tracking(0.0, [-3.1, 0.0]))
    distance = 2.0 * math.pi - 6.2
    # Two bodies of inertia 1 about one axis: the first joint turns both.
    assert command.efforts == pytest.approx([2.0 * distance, distance])


def test_the_scale_comes_before_the_limits():
    lift = controller(effort_scale=(0.5, 2.0))
    assert lift.step(0.0, state(0.0), None).efforts == pytest.approx([15.0, 15.0])


def test_limits_of_the_urdf_are_tightened_never_loosened():
    lift = controller(effort_limits=(20.0, 500.0))
    assert lift.step(0.0, state(0.0), reference(0.0, [0.0, 90.0])).efforts.tolist() == [20.0, 15.0]


def test_efforts_change_no_faster_than_allowed():
    lift = controller(effort_rate_limits=(100.0, math.inf))
    steps = [lift.step(t, state(t), None).efforts.tolist() for t in (0.0, 0.05, 0.1, 0.2, 0.3)]
    assert np.array(steps)[:, 0] == pytest.approx([0.0, 5.0, 10.0, 20.0, 30.0])
    assert np.array(steps)[:, 1] == pytest.approx([0.0, 10.0, 10.0, 10.0, 10.0])


def test_efforts_can_be_held_when_the_state_is_lost():
    lift = controller(on_stale_state=StalePolicy.HOLD)
    lift.step(0.0, state(0.0), None)
    assert lift.step(5.0, state(0.0), None).efforts == pytest.approx(HOLD)
    assert lift.phase is Phase.STATE_LOST
    lift.stop()
    assert lift.step(5.1, state(0.0), None).efforts.tolist() == [0.0, 0.0]


@pytest.mark.parametrize('start', [0.0, 1e5])
def test_velocity_filter_starts_with_the_second_state(start):
    lift = controller(velocity_filter_cutoff=5.0, use_urdf_effort_limits=False)
    lift.dynamics.set_friction(damping=1.0, coulomb=0.0)
    for elapsed, velocity in ((0.0, 0.0), (0.03125, 1.0)):
        now = start + elapsed
        each = joint_state(np.zeros(2), np.full(2, velocity), now, np.full(2, now))
        efforts = lift.step(now, each, None).efforts
    assert efforts - HOLD == pytest.approx(1.0 - math.exp(-2.0 * math.pi * 5.0 * 0.03125))


def test_velocity_filter_smooths_noise_and_follows_change():
    lift = controller(velocity_filter_cutoff=5.0, use_urdf_effort_limits=False)
    lift.dynamics.set_friction(damping=1.0, coulomb=0.0)
    times = np.arange(0.0, 1.0, 0.01)
    noise = [joint_state(np.zeros(2), np.full(2, (-1.0) ** k), t) for k, t in enumerate(times)]
    felt = [lift.step(s.time, s, None).efforts[1] - 10.0 for s in noise]
    assert np.abs(felt[50:]).max() < 0.2
    steady = [joint_state(np.zeros(2), np.ones(2), t) for t in times + 1.0]
    felt = [lift.step(s.time, s, None).efforts[1] - 10.0 for s in steady]
    assert felt[-1] == pytest.approx(1.0)
    # First order: 63 % of the step after one time constant.
    assert felt[3] == pytest.approx(1.0 - math.exp(-2.0 * math.pi * 5.0 * 0.04), abs=0.1)


def test_settings_change_completely_or_not_at_all():
    lift = controller()
    with pytest.raises(
        ConfigurationError, match='kp has 3 numbers, expected one, or one for each'
    ):
        lift.apply(Settings(kp=(1.0, 2.0, 3.0), start_ramp=9.0))
    assert lift.settings.start_ramp == 0.0
    lift.apply(Settings(start_ramp=0.0, effort_scale=0.5))
    assert lift.step(0.0, state(0.0), None).efforts == pytest.approx(HOLD / 2)


def settled(lift):
    """Step a controller to the end of its start ramp; return the time."""
    for time in np.arange(0.0, 1.0, 0.05):
        lift.step(time, state(time), None)
    assert lift.shaper.gain == 1.0
    return time


def efforts_after(lift, time, seconds, period=0.05):
    for k in range(1, round(seconds / period) + 1):
        now = time + k * period
        efforts = lift.step(now, state(now), None).efforts
    return efforts.copy()


def test_the_first_command_after_a_stall_equals_the_last_one():
    lift = controller(start_ramp=0.5)
    time = settled(lift)
    lift.dynamics.set_gravity((0.0, 0.0, -4.0))  # as if the arm had moved meanwhile
    now = time + 20.0
    assert lift.step(now, state(now), None).efforts == pytest.approx(HOLD)
    low = efforts_after(lift, now, 0.2)  # old messages may still arrive
    assert (low > 0.6 * HOLD).all()
    assert efforts_after(lift, now + 0.2, 0.5) == pytest.approx(0.4 * HOLD)


@pytest.mark.parametrize('every', [1, 2, 10])
def test_feedback_acts_in_full_while_gains_change_all_the_time(every):
    ours = {'mode': Mode.COMPUTED_TORQUE, 'start_ramp': 0.5, 'kd': 0.0}
    lift = controller(kp=100.0, **ours)
    target, efforts = np.zeros(2), np.zeros(2)
    for k in range(3000):
        now = 0.001 * k
        if k > 1000:
            target = np.array([0.01 * math.sin(5.0 * now), 0.0])
            if k % every == 0:
                lift.apply(Settings(kp=100.0 + 0.01 * (k % 7), **ours))
        efforts = lift.step(now, state(now), tracking(now, target)).efforts
        # A change of kp by 0.06 makes a difference of 2 mN here.
        assert k < 1000 or efforts == pytest.approx(
            HOLD + 100.0 * target[0] * np.array([3.0, 1.0]), abs=0.01
        )


@pytest.mark.parametrize('every', [1, 2, 3, 50])
@pytest.mark.parametrize('kind', ['settings', 'filter', 'gravity'])
def test_a_blend_ends_although_changes_restart_it_all_the_time(every, kind):
    lift = controller(start_ramp=0.1)
    time = settled(lift)
    lift.apply(Settings(start_ramp=0.1, effort_scale=0.5))
    steps = []
    for k in range(1200):
        now = time + 0.001 * k
        before = lift.step(now, state(now), None).efforts.copy()
        if k % every == 0:
            if kind == 'gravity':
                lift.blend()
            cutoff = 10.0 + k if kind == 'filter' else 0.0
            settings = Settings(start_ramp=0.1, effort_scale=0.5, velocity_filter_cutoff=cutoff)
            lift.apply(settings)
        steps.append(before)
    assert before == pytest.approx(0.5 * HOLD, rel=0.01)
    # No faster than a blend that is not restarted.
    assert np.abs(np.diff(steps, axis=0)).max() <= 0.5 * HOLD[0] * 0.001 / 0.1 + 1e-9


def test_a_tightened_limit_applies_although_changes_restart_the_blend_all_the_time():
    ours = {'start_ramp': 0.1, 'effort_limits': 5.0}
    lift = controller(start_ramp=0.1)
    time = settled(lift)
    for k in range(1500):
        now = time + 0.001 * k
        lift.apply(Settings(effort_scale=1.0 + 1e-3 * (k % 2), **ours))
        efforts = lift.step(now, state(now), None).efforts
    assert (efforts < 5.1).all()


def test_flags_efforts_that_a_rate_limit_slows():
    lift = controller(effort_rate_limits=(1e6, 1.0))
    lift.step(0.0, state(0.0), None)
    command = lift.step(0.01, state(0.01), None)
    assert list(command.is_slowed) == [False, True]
    command = lift.step(0.3, state(0.0), None)  # lost
    assert not command.is_slowed.any()


def test_feedback_of_positions_without_velocities_is_damped():
    lift = controller(mode=Mode.COMPUTED_TORQUE, kp=0.0, kd=10.0)
    moving = joint_state(np.zeros(2), np.array([0.1, 0.0]), 0.0)
    positions = Reference(np.zeros(2), np.zeros(2), 0.0, np.zeros(2))
    assert lift.step(0.0, moving, positions).efforts == pytest.approx(HOLD - [3.0, 1.0])


def test_a_reference_without_positions_and_velocities_is_not_damped():
    lift = controller(mode=Mode.COMPUTED_TORQUE, kd=10.0)
    moving = joint_state(np.zeros(2), np.array([0.1, 0.0]), 0.0)
    command = lift.step(0.0, moving, reference(0.0, [1.0, 0.0]))
    assert command.efforts == pytest.approx([33.0, 11.0])


def test_the_velocity_filter_recovers_from_absurd_velocities():
    lift = controller(velocity_filter_cutoff=1000.0)
    lift.dynamics.set_friction(damping=1.0, coulomb=0.0)
    for now, speed in ((0.0, 1.7e308), (0.01, -1.7e308), (0.02, 0.1), (0.03, 0.1)):
        lift.step(now, joint_state(np.zeros(2), np.full(2, speed), now), None)
    assert lift.phase is Phase.FLOATING
    assert lift.step(0.04, joint_state(np.zeros(2), np.full(2, 0.1), 0.04), None).efforts == (
        pytest.approx(HOLD + 0.1)
    )


def test_a_stop_lasts_until_resume_or_start():
    lift = controller()
    assert lift.is_stopping is False
    for let_go in (lift.resume, lift.start):
        lift.stop()
        assert lift.is_stopping is True
        let_go()
        assert lift.is_stopping is False


def test_a_start_waits_for_a_fresh_state():
    lift = controller(start_ramp=0.1, state_timeout=0.1)
    for now in (0.101, 5.0):
        assert lift.step(now, state(0.0), None) is None
        assert lift.phase is Phase.WAITING
    lift.step(5.01, state(5.0), None)
    assert lift.step(5.06, state(5.06), None).efforts == pytest.approx(HOLD / 2)
    lift.start()
    assert lift.step(6.0, state(5.06), None) is None


def test_a_start_waits_for_a_state_even_after_earlier_ones():
    lift = controller()
    lift.step(0.0, state(0.0), None)
    lift.start()
    assert lift.phase is Phase.WAITING
    assert lift.step(0.01, None, None) is None


def test_held_efforts_are_not_reported_as_cut():
    lift = controller(on_stale_state=StalePolicy.HOLD)
    assert lift.step(0.0, state(0.0), reference(0.0, [9.0, 60.0])).is_saturated.any()
    command = lift.step(1.0, state(0.0), None)
    assert lift.phase is Phase.STATE_LOST
    assert not command.is_saturated.any()
    assert not command.is_slowed.any()


def test_a_start_restarts_the_velocity_filter():
    lift = controller(velocity_filter_cutoff=1.0, use_urdf_effort_limits=False)
    lift.dynamics.set_friction(damping=1.0, coulomb=0.0)
    lift.step(0.0, joint_state(np.zeros(2), np.full(2, 5.0), 0.0), None)
    lift.start()
    efforts = lift.step(0.01, joint_state(np.zeros(2), np.full(2, -1.0), 0.01), None).efforts
    assert efforts == pytest.approx(HOLD - 1.0)


def test_a_reference_that_starts_at_the_largest_distance_is_followed():
    lift = controller(mode=Mode.COMPUTED_TORQUE, max_tracking_error=0.5)
    lift.step(0.0, state(0.0), tracking(0.0, [0.5, -0.5]))
    assert lift.phase is Phase.RUNNING


def test_full_turns_of_a_continuous_joint_make_no_difference():
    wheel = load_urdf(LIFT.replace('type="prismatic"', 'type="continuous"').replace('50"', '500"'))
    settings = Settings(mode=Mode.COMPUTED_TORQUE, start_ramp=0.0, kp=1.0, kd=0.0)
    turning = UnobservedController(InverseDynamics(wheel, gravity=(0, 0, 0)), (), settings)
    position = joint_state(np.array([6.0 * math.pi, 0.0]), np.zeros(2), 0.0)
    command = turning.step(0.0, position, tracking(0.0, [0.1, 0.0]))
    assert command.efforts == pytest.approx([0.2, 0.1])


@pytest.mark.parametrize(
    ('received', 'wanted', 'settings'),
    [
        (state(0.01), reference(0.01, [0.0, -1.7e308]), {}),
        (joint_state(np.array([0.0, math.nan]), np.zeros(2), 0.01), None, {}),
        (state(0.01), None, {'effort_scale': (1.0, 1e300)}),
        (state(0.01), reference(0.01, [0.0, 0.0], [-math.inf, 0.0]), {}),
        (
            state(0.01),
            tracking(0.01, [1.7e308, 0.0], [-1.7e308, 0.0]),
            {'mode': Mode.COMPUTED_TORQUE, 'max_tracking_error': 0.0},
        ),
    ],
)
@pytest.mark.filterwarnings('error')
def test_efforts_that_are_not_finite_are_zero_instead(received, wanted, settings):
    lift = controller(**settings)
    lift.step(0.0, state(0.0), None)
    assert not lift.step(0.01, received, wanted).efforts.any()
    assert lift.phase is Phase.NO_SOLUTION


def test_efforts_cut_during_a_blend_are_reported():
    lift = controller(start_ramp=0.5)
    time = settled(lift)
    high, low = (reference(time, [0.0, 0.0], [0.0, effort]) for effort in (4.0, -10.0))
    lift.blend()
    for k in range(12):
        command = lift.step(time + 0.01 * k, state(time + 0.01 * k), high)
    now = time + 0.5
    lift.blend()
    for k, followed in enumerate([low, high, high]):
        command = lift.step(now + 0.01 * k, state(now + 0.01 * k), followed._replace(time=now))
    # The rest of the difference would take the effort beyond its limit.
    assert command.efforts[1] == 15.0
    assert list(command.is_saturated) == [False, True]
    assert not command.is_slowed.any()


def test_computed_efforts_beyond_a_limit_are_reported_during_a_blend_too():
    lift = controller(start_ramp=0.5)
    time = settled(lift)
    lift.blend()
    for k in range(5):
        now = time + 0.01 * k
        command = lift.step(now, state(now), reference(now, [0.0, 60.0]))
    assert list(command.is_saturated) == [True, True]
    command = lift.step(now, state(now), None)
    assert not command.is_saturated.any()


def test_nothing_is_slowed_without_rate_limits():
    lift = controller(start_ramp=0.5)
    for now in (0.0, 0.01, 0.02):
        assert not lift.step(now, state(now), None).is_slowed.any()


def test_the_velocity_filter_starts_anew_after_a_gap():
    lift = controller(
        velocity_filter_cutoff=0.5,
        use_urdf_effort_limits=False,
        on_stale_state=StalePolicy.HOLD,
    )
    lift.dynamics.set_friction(damping=1.0, coulomb=0.0)
    for now, speed in ((0.0, 5.0), (0.01, 5.0), (1.0, -1.0)):
        efforts = lift.step(now, joint_state(np.zeros(2), np.full(2, speed), now), None).efforts
    assert efforts == pytest.approx(HOLD - 1.0)


def test_the_velocity_filter_takes_each_state_once():
    lift = controller(velocity_filter_cutoff=1.0, use_urdf_effort_limits=False)
    lift.dynamics.set_friction(damping=1.0, coulomb=0.0)
    lift.step(0.0, state(0.0), None)
    moving = joint_state(np.zeros(2), np.full(2, 5.0), 0.01)
    efforts = lift.step(0.01, moving, None).efforts.copy()
    assert np.abs(efforts - HOLD).max() < 1.0
    assert lift.step(0.02, moving, None).efforts == pytest.approx(efforts)


@pytest.mark.filterwarnings('error')
def test_absurd_velocities_do_not_print_warnings_in_the_loop():
    lift = controller(velocity_filter_cutoff=10.0)
    for now, speed in ((0.0, 1.7e308), (0.01, -1.7e308), (0.02, 0.1)):
        lift.step(now, joint_state(np.zeros(2), np.full(2, speed), now), None)
    assert lift.phase is not Phase.WAITING


def test_a_state_is_fresh_until_the_end_of_its_timeout():
    lift = controller(state_timeout=0.125)
    lift.step(0.125, state(0.0), None)
    assert lift.phase is Phase.FLOATING


def test_same_inputs_give_the_same_commands():
    def run():
        lift = controller(start_ramp=0.3, stop_ramp=0.3)
        return [
            lift.step(t, state(min(t, 0.6)), reference(0.2, [1.0, 2.0])).efforts.tolist()
            for t in np.arange(0.0, 1.2, 0.01)
        ]

    assert run() == run()


def test_efforts_held_since_a_stop_ramp_began_stay_where_they_are():
    lift = controller(stop_ramp=0.2)
    lift.step(0.0, state(0.0), None)
    lift.step(0.11, state(0.0), None)
    assert lift.step(0.21, state(0.0), None).efforts == pytest.approx(0.5 * HOLD)
    lift.apply(Settings(stop_ramp=0.2, on_stale_state=StalePolicy.HOLD))
    for now in (0.3, 0.4, 1.0):
        assert lift.step(now, state(0.0), None).efforts == pytest.approx(0.5 * HOLD)
    lift.apply(Settings(stop_ramp=0.2))
    assert lift.step(1.1, state(0.0), None).efforts == pytest.approx(0.5 * HOLD)
    assert lift.step(1.2, state(0.0), None).efforts == pytest.approx(0.25 * HOLD)


@pytest.mark.parametrize('policy', StalePolicy)
def test_efforts_that_change_during_40_ms_without_states_are_blended_in(policy):
    lift = controller(start_ramp=0.5, stop_ramp=20.0, on_stale_state=policy)
    time = settled(lift)
    for lost in (0.11, 0.13):
        last = lift.step(time + lost, state(time), None).efforts.copy()
    assert lift.phase is Phase.STATE_LOST
    lift.dynamics.set_gravity((0.0, 0.0, -5.0))
    assert lift.step(time + 0.15, state(time + 0.15), None).efforts == pytest.approx(last)
