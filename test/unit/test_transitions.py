"""Events between two steps of the control loop cause no step, and end nothing that must go on."""

from inverse_dynamics_node.control.settings import Mode, StalePolicy
from inverse_dynamics_node.control.supervisor import Phase
import numpy as np
import pytest
from states import Arm, PLANAR, Q, reference, REST, store_state

NAMES, TIP, SPEED = PLANAR.joint_names, PLANAR.link_names[-1], PLANAR.velocity_limits
DT = 0.01
NOTHING = np.zeros((3, 3))


def load(arm, mass=2.0):
    arm.loop.loads.set_payload(TIP, mass, np.zeros(3), np.zeros((3, 3)))


def largest_step(before, *commands):
    return np.abs(np.diff(np.vstack([before, *commands]), axis=0)).max()


@pytest.mark.parametrize('event', [load, lambda arm: arm.change(effort_scale=2.0)])
@pytest.mark.parametrize('policy', StalePolicy)
@pytest.mark.parametrize('lost', [1, 2, 3])
def test_an_event_while_states_are_lost_briefly_is_blended_in(policy, lost, event):
    arm = Arm(on_stale_state=policy, start_ramp=0.5, stop_ramp=0.5, state_timeout=0.015)
    arm.move(REST, 1.0, DT)
    arm.move(REST, DT * (1 + lost), DT, has_states=False)
    event(arm)
    last = arm.move(REST, DT, DT, has_states=False)
    bound = 2.1 * DT / 0.5 * 2.0 * np.abs(last).max()
    assert largest_step(last, arm.move(REST, 0.2, DT)) <= bound


@pytest.mark.parametrize(
    ('before', 'after', 'behind'),
    [
        ({'max_tracking_error': 0.2}, {'max_tracking_error': 0.5}, 0.3),
        ({'velocity_filter_cutoff': 0.2}, {'velocity_filter_cutoff': 0.0}, 0.0),
        ({'guiding_speed': 0.5}, {'guiding_speed': 0.35}, None),
    ],
)
def test_a_change_of_what_is_computed_repeats_the_last_command(before, after, behind):
    arm = Arm(mode=Mode.COMPUTED_TORQUE, start_ramp=0.5, **before)
    qd = 0.4 * SPEED * np.array([1.0, 0.0])
    arm.move(REST, 1.0, DT, behind=behind)
    last = arm.move(qd, 0.2, DT, behind=behind)[-1]
    arm.change(**after)
    first, second = arm.move(qd, 2.0 * DT, DT, behind=behind)
    assert first == pytest.approx(last)
    # The restraint near a speed limit acts within 0.03 s.
    assert largest_step(first, second) < (2.0 if behind is not None else 6.0)


def test_a_spring_at_a_position_limit_does_not_act_twice_after_an_event():
    arm = Arm(limit_stiffness=200.0, start_ramp=0.5)
    arm.loop.motion_limits._upper = arm.q - 0.08
    last = arm.move(REST, 1.0, DT)[-1]
    load(arm, 1e-3)
    commands = arm.move(REST, 0.6, DT)
    assert commands[0] == pytest.approx(last, abs=1e-6)
    assert largest_step(last, commands) < 0.1


def test_enable_between_two_steps_does_not_end_the_damping():
    arm = Arm(stop_damping=50.0, stop_ramp=0.5)
    arm.move((0.2, 0.1), 0.1, DT)
    arm.loop.stop()
    arm.move((0.2, 0.1), 0.1, DT)
    arm.loop.resume()
    arm.loop.stop()
    arm.move((0.2, 0.1), DT, DT)
    assert arm.loop.stop_damping.is_active
    arm.loop.resume()
    arm.move((0.2, 0.1), DT, DT)
    assert not arm.loop.stop_damping.is_active


def test_efforts_fade_when_a_reference_ends_above_the_speed_of_guiding():
    arm = Arm(reference_timeout=0.05)
    qd = np.array([0.7 * SPEED[0], 0.0])
    arm.q = np.array([-2.5, 0.0])
    last = arm.move(qd, 0.3, DT, behind=0.0)[-1]
    assert largest_step(last, arm.move(qd, 0.12, DT)) < 0.5 * np.abs(last).max()
    assert arm.phase is Phase.FLOATING


def test_a_fast_motion_during_a_pause_is_no_jump():
    arm = Arm(mode=Mode.COMPUTED_TORQUE, state_timeout=0.3, max_tracking_error=1.0)
    arm.q = np.array([-2.0, -0.7])
    for seconds, has_states in ((0.4, True), (0.14, False), (0.1, True)):
        arm.move((0.9 * SPEED[0], 0.0), seconds, DT, has_states=has_states, behind=0.0)
    assert not arm.limit_stop


def test_velocity_limits_above_those_of_the_urdf_permit_faster_motion():
    arm = Arm(velocity_limits=10.0 * SPEED[0], start_ramp=0.5)
    arm.q = np.array([-2.5, 0.0])
    arm.move(REST, 1.0, DT)
    commands = arm.move((2.5 * SPEED[0], 0.0), 0.3, DT, behind=0.0)
    assert np.count_nonzero(np.diff(commands[:, 0])) >= 28


def test_an_arm_that_was_pushed_away_is_not_pulled_back_by_a_reference():
    arm = Arm(mode=Mode.JOINT_IMPEDANCE, max_tracking_error=0.3)
    held = arm.q.copy()
    arm.move(REST, 0.2, DT, behind=0.0)
    arm.loop.reference = None
    arm.move((2.0, 0.0), 0.25, DT)
    for _ in range(10):
        arm.loop.follow(reference(arm.now, held, REST))
        arm.move(REST, DT, DT)
        assert arm.phase is Phase.HOLDING_TOO_FAR


def test_a_dry_run_reports_an_arm_that_falls_behind():
    arm = Arm(mode=Mode.COMPUTED_TORQUE)
    arm.loop.start(is_dry_run=True)
    arm.move(REST, 0.2, DT, behind=0.45)
    arm.move((0.5, 0.0), 0.1, DT, behind=0.55)
    assert 'from its reference' in arm.loop.motion_problem[0]
    assert not arm.limit_stop


def test_velocities_that_are_lost_again_and_again_are_named_once():
    arm = Arm()
    for now in arm.now + 0.2 * np.arange(20):
        store_state(arm.loop.collector, now, NAMES, Q, REST)
        store_state(arm.loop.collector, now + 0.1, NAMES, Q, [])
    assert arm.loop.step(arm.now + 4.0).lost_velocities == NAMES


def test_a_limit_stop_during_a_stop_has_no_gain_left():
    arm = Arm(stop_ramp=0.2, start_ramp=0.1)
    arm.move(REST, 0.6, DT)
    arm.loop.stop()
    arm.move(REST, 0.11, DT)
    gain = arm.loop.shaper.gain
    arm.loop.limit_stop('a reason')
    arm.move(REST, DT, DT)
    assert arm.loop.shaper.gain <= gain
