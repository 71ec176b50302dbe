"""Steps of the whole control loop, and its continuation with another robot description."""

import math

from inverse_dynamics_node import (
    ConfigurationError,
    InverseDynamics,
    load_urdf,
)
from inverse_dynamics_node.control.contact import ExternalEffortEstimator
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop, Phase
from inverse_dynamics_node.control.settings import MeasuredGravity, Mode, Settings
from inverse_dynamics_node.node.status_text import describe_implausible, missing_inputs
import numpy as np
import pytest
from robot_files import ROOT, STANFORD
from states import store_state

MODEL = load_urdf(STANFORD)
NAMES = MODEL.joint_names
TIP = MODEL.link_names[-1]
Q = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
AT_ONCE = Settings(start_ramp=0.0)


def report_all(loop, now=0.0):
    store_state(loop.collector, now, loop.robot.joint_names, Q, np.zeros(6))
    return loop


def test_a_payload_affects_the_next_command():
    loop = report_all(ControlLoop(MODEL, settings=AT_ONCE, period=0.5))
    loop.step(0.0)
    loop.loads.set_payload(TIP, 2.0, np.zeros(3), np.zeros((3, 3)))
    store_state(loop.collector, 0.5, NAMES, Q, np.zeros(6))
    expected = InverseDynamics(MODEL)
    expected.set_payload(TIP, 2.0)
    assert loop.step(0.5).efforts == pytest.approx(expected.gravity_efforts(Q))


def test_without_the_motion_of_the_base_there_is_no_command():
    loop = report_all(ControlLoop(MODEL, settings=AT_ONCE, has_imu=True))
    assert loop.step(0.0) is None
    assert missing_inputs(loop) == ['the motion of the base on imu']
    loop.loads.set_base_motion(0.0, (0.0, 0.0, 9.80665), np.zeros(3))
    assert loop.step(0.0).efforts == pytest.approx(InverseDynamics(MODEL).gravity_efforts(Q))
    assert missing_inputs(loop) == []


def test_a_dry_run_ends_what_is_sent_and_its_end_lets_it_rise_from_zero():
    loop = report_all(ControlLoop(MODEL, settings=Settings(start_ramp=0.5, stop_ramp=0.5)))

    def step(k):
        return report_all(loop, 0.01 * k).step(0.01 * k)

    for k in range(100):
        command = step(k)
        assert command.sent is command.efforts
    hold = command.efforts.copy()
    assert not loop.switch_dry_run(is_wanted=False)
    assert loop.switch_dry_run(is_wanted=True)
    assert not loop.switch_dry_run(is_wanted=True)
    sent = [step(100 + k).sent for k in range(110)]
    assert sent[24] == pytest.approx(0.5 * hold)
    assert not loop.dry_run.has_sent
    assert sent[-1] is None
    assert loop.shaper.gain == 1.0  # the computed efforts go on
    loop.stop()
    step(210)
    assert loop.switch_dry_run(is_wanted=False)
    assert not step(211).sent.any()  # it is still disabled
    loop.resume()
    assert step(212).sent == pytest.approx(0.0 * hold)
    for k in range(25):
        command = step(213 + k)
    assert command.sent == pytest.approx(0.5 * hold, rel=0.1)


def test_a_start_drops_the_earlier_reference():
    loop = report_all(ControlLoop(MODEL, settings=AT_ONCE))
    loop.reference = Reference(np.ones(6), np.zeros(6), 0.0)
    loop.start()
    loop.step(0.0)
    assert loop.phase is Phase.FLOATING


def test_the_first_report_of_a_locked_joint_does_not_cause_a_jump():
    others = [k for k in range(6) if k != 2]
    names = [NAMES[k] for k in others]
    settings = Settings(start_ramp=0.5)
    loop = ControlLoop(MODEL, names, settings, 0.05, locked={NAMES[2]: 0.2})
    for now in np.arange(0.0, 1.0, 0.05):
        store_state(loop.collector, now, names, Q[others], np.zeros(5))
        last = loop.step(now).efforts.copy()
    report_all(loop, now)
    assert loop.step(now).efforts == pytest.approx(last)
    for later in np.arange(now, now + 1.0, 0.05):
        report_all(loop, later)
        loop.step(later)
    expected = InverseDynamics(MODEL).gravity_efforts(Q)[others]
    assert loop.step(later).efforts == pytest.approx(expected)
    assert np.abs(expected - last).max() > 1.0


def step_with_slow_joint(loop, period, seconds, velocity=0.0, start=0.0):
    """Step at 100 Hz with states of five joints, and one of the last joint every period."""
    efforts, last = [], -math.inf
    for now in start + np.arange(0.0, seconds, 0.01):
        store_state(loop.collector, now, NAMES[:5], Q[:5], np.zeros(5))
        if now - last >= period - 1e-6:
            store_state(loop.collector, now, NAMES[5:], Q[5:], [velocity])
            last = now
        command = loop.step(now)
        efforts.append(command.efforts.copy())
    return np.array(efforts)


@pytest.mark.parametrize('period', [0.2, 0.9, 1.3, 1e9])
def test_a_slow_joint_that_is_not_commanded_does_not_stop_the_arm(period):
    loop = ControlLoop(MODEL, NAMES[:5], Settings(start_ramp=0.0))
    efforts = step_with_slow_joint(loop, period, 4.0)
    hold = InverseDynamics(MODEL).gravity_efforts(Q)[:5]
    assert efforts == pytest.approx(np.tile(hold, (len(efforts), 1)))


def test_a_late_joint_that_is_not_commanded_is_named():
    loop = ControlLoop(MODEL, NAMES[:4], locked={NAMES[4]: 0.1})
    report_all(loop)
    store_state(loop.collector, 1.1, NAMES[:4], Q[:4], np.zeros(4))
    assert loop.step(1.1) is not None
    assert loop.collector.late(1.1) == {NAMES[5]: 1.1}
    report_all(loop, 1.2)
    loop.step(1.2)
    assert loop.collector.late(1.2) == {}


@pytest.mark.parametrize('cutoff', [0.0, 1.0])
@pytest.mark.parametrize('locked', [{}, {NAMES[5]: 0.2}])
def test_a_late_joint_keeps_its_position_but_not_its_velocity(locked, cutoff):
    settings = Settings(start_ramp=0.0, velocity_filter_cutoff=cutoff)
    loop = ControlLoop(MODEL, NAMES[:5], settings, locked=locked)
    # A fast wrist causes Coriolis efforts at the other joints.
    for k in range(5):
        step_with_slow_joint(loop, 1e9, 0.11, 30.0, 0.1 * k)
    moving = loop.law.velocities[5]
    assert moving > 10.0
    store_state(loop.collector, 1.3, NAMES[:5], Q[:5], np.zeros(5))
    loop.step(1.3)
    assert loop.law.velocities[5] == moving
    store_state(loop.collector, 1.6, NAMES[:5], Q[:5], np.zeros(5))
    efforts = loop.step(1.6).efforts
    assert loop.law.velocities[5] == 0.0
    assert efforts == pytest.approx(InverseDynamics(MODEL).gravity_efforts(Q)[:5])
    store_state(loop.collector, 1.7, NAMES[5:], Q[5:], [2.0])
    loop.step(1.7)
    assert loop.law.velocities[5] == 2.0


def test_a_late_joint_that_has_moved_does_not_cause_a_jump():
    loop = ControlLoop(MODEL, NAMES[:5], Settings(start_ramp=0.5))
    last = step_with_slow_joint(loop, 1e9, 2.0)[-1].copy()
    store_state(loop.collector, 2.0, NAMES[5:], Q[5:] + 2.0, [0.0])
    store_state(loop.collector, 2.0, NAMES[:5], Q[:5], np.zeros(5))
    assert loop.step(2.0).efforts == pytest.approx(last)


def test_the_first_command_needs_a_slow_joint_once():
    loop = ControlLoop(MODEL, NAMES[:5], AT_ONCE)
    store_state(loop.collector, 0.0, NAMES[:5], Q[:5], np.zeros(5))
    assert loop.step(0.0) is None
    assert loop.collector.late(0.0) == {}
    store_state(loop.collector, 0.0, NAMES[5:], Q[5:], [0.0])
    assert loop.step(0.0) is not None


def test_a_misnamed_joint_is_mentioned():
    loop = ControlLoop(MODEL)
    names = [name.replace('joint_', 'joint') for name in NAMES[:1]] + list(NAMES[1:])
    store_state(loop.collector, 0.0, names, Q, np.zeros(6))
    text = f"the position of {NAMES[0]} on joint_states (received similar names: '{names[0]}')"
    assert missing_inputs(loop) == [text]


def test_positions_of_joints_that_were_never_reported_are_not_judged():
    loop = ControlLoop(MODEL, NAMES[:5], locked={NAMES[5]: 500.0})
    bounded = next(k for k in range(5) if np.isfinite(MODEL.upper[k]))
    assert list(describe_implausible(loop)) in ([], [NAMES[5]])
    store_state(loop.collector, 0.0, [NAMES[bounded]], [1000.0], [0.0])
    assert NAMES[bounded] in describe_implausible(loop)


def step_with_two_publishers(loop, start, seconds, joint, offset, rate=200.0):
    """Step with states by two publishers in turn, of which the second differs in one joint."""
    efforts = []
    other = Q.copy()
    other[joint] += offset
    for k, now in enumerate(start + np.arange(0.0, seconds, 1.0 / rate)):
        store_state(loop.collector, now, NAMES, other if k % 2 else Q, np.zeros(6))
        efforts.append(loop.step(now).efforts.copy())
    return np.array(efforts)


def test_contradictory_positions_of_a_commanded_joint_stop_the_arm():
    loop = ControlLoop(MODEL, settings=Settings(start_ramp=0.0, stop_ramp=0.2))
    step_with_two_publishers(loop, 0.0, 1.0, 1, 0.0)
    efforts = step_with_two_publishers(loop, 1.0, 1.0, 1, 0.7)
    is_changing = np.abs(np.diff(efforts[:, 1])) > 1.0
    assert np.count_nonzero(is_changing) <= 6
    assert (efforts[20:] == 0.0).all()
    reason = loop.supervisor.limit_stop
    assert reason.startswith(f'{NAMES[1]} jumps to and fro by 0.7 rad: ')


def test_contradictory_positions_of_another_joint_do_not_stop_the_arm():
    joints = [name for k, name in enumerate(NAMES) if k != 4]
    loop = ControlLoop(MODEL, joints, Settings())
    efforts = step_with_two_publishers(loop, 0.0, 2.0, 4, 1.5)
    largest = np.abs(efforts).max()
    assert largest > 1.0
    assert np.abs(np.diff(efforts, axis=0)).max() <= 2.0 * largest * 0.005 / 0.5
    assert loop.phase is Phase.FLOATING


def test_a_joint_cannot_be_both_commanded_and_locked():
    with pytest.raises(ConfigurationError, match=f"joint '{NAMES[2]}' is both commanded and lock"):
        ControlLoop(MODEL, NAMES, locked={NAMES[2]: 0.0})


def test_the_base_link_is_the_root_unless_another_one_is_set():
    assert ControlLoop(MODEL).base_link == MODEL.body_names[0]
    fixed = '<link name="mount"/><joint name="f" type="fixed"><parent link="mount"/>'
    fixed += f'<child link="{MODEL.body_names[0]}"/></joint></robot>'
    robot = load_urdf(STANFORD.read_text().replace('</robot>', fixed))
    assert ControlLoop(robot).base_link == 'mount'
    assert ControlLoop(robot, base_link=MODEL.body_names[0]).base_link == MODEL.body_names[0]


def test_external_efforts_are_measured_minus_modelled_efforts():
    loop = ControlLoop(MODEL)
    hold, push = InverseDynamics(MODEL).gravity_efforts(Q), np.arange(6.0)
    store_state(loop.collector, 0.0, NAMES, Q, np.zeros(6), hold + push)
    assert loop.external_efforts() == pytest.approx(push)
    time_constant = 1.0 / (2.0 * math.pi * 10.0)
    qd = np.full(6, 0.01)
    store_state(loop.collector, time_constant, NAMES, Q, qd, hold)
    found, alike = loop.external_efforts(), ExternalEffortEstimator(InverseDynamics(MODEL))
    alike.update(0.0, Q, np.zeros(6), hold + push)
    assert found == pytest.approx(alike.update(time_constant, Q, qd, hold))


def external_efforts_of(contained, measured_gravity, include_gravity, scale=1.0):
    """Return the estimate at rest, with a payload and with gravity from a topic."""
    loop = ControlLoop(MODEL, settings=AT_ONCE)
    loop.loads.include(gravity=include_gravity)
    loop.loads.set_payload(TIP, 2.0, (0.0, 0.0, 0.1), np.zeros((3, 3)))
    loop.loads.set_gravity((1.0, 0.0, -9.6))
    loop.measured_gravity = measured_gravity
    loop.external_effort_estimator.scale[:] = scale
    store_state(loop.collector, 0.0, NAMES, Q, np.zeros(6), contained / scale)
    command = loop.step(0.0).efforts.copy()
    found = loop.external_efforts()
    assert loop.step(0.0).efforts == pytest.approx(command)
    assert command.any() == include_gravity
    return found


@pytest.mark.parametrize('include_gravity', [False, True])
def test_external_efforts_are_zero_if_the_measured_efforts_are_as_described(include_gravity):
    hold = InverseDynamics(MODEL, (1.0, 0.0, -9.6))
    hold.set_payload(TIP, 2.0, (0.0, 0.0, 0.1))
    gravity = hold.gravity_efforts(Q)
    included, excluded = MeasuredGravity.INCLUDED, MeasuredGravity.EXCLUDED
    for contained, right, wrong in (
        (gravity, included, excluded),
        (np.zeros(6), excluded, included),
    ):
        efforts = external_efforts_of(contained, right, include_gravity)
        assert efforts == pytest.approx(np.zeros(6), abs=1e-9)
        efforts = external_efforts_of(contained, wrong, include_gravity)
        assert np.abs(efforts) == pytest.approx(np.abs(gravity), abs=1e-9)
    contained = gravity if include_gravity else np.zeros(6)
    efforts = external_efforts_of(contained, MeasuredGravity.AS_COMMANDED, include_gravity)
    assert efforts == pytest.approx(np.zeros(6), abs=1e-9)


def test_a_joint_whose_values_are_always_nan_has_no_external_effort_and_no_influence():
    loop = ControlLoop(MODEL, NAMES[:5], AT_ONCE, locked={NAMES[5]: Q[5]})
    gravity = InverseDynamics(MODEL).gravity_efforts(Q)
    for k in range(300):
        positions, zeros = [*Q[:5], math.nan], [*np.zeros(5), math.nan]
        efforts = [*gravity[:5] + 1.0, math.nan]
        store_state(loop.collector, 0.01 * k, NAMES, positions, zeros, efforts)
        assert loop.step(0.01 * k).efforts == pytest.approx(gravity[:5])
        external = loop.external_efforts()
    assert external[:5] == pytest.approx(np.ones(5))
    assert math.isnan(external[5])


def test_measured_efforts_are_scaled():
    hold = InverseDynamics(MODEL, (1.0, 0.0, -9.6))
    hold.set_payload(TIP, 2.0, (0.0, 0.0, 0.1))
    scale = np.array([-1.0, 0.02, 1.0, 3.0, -0.5, 1000.0])
    measured = hold.gravity_efforts(Q) + np.arange(6.0)
    found = external_efforts_of(measured, MeasuredGravity.INCLUDED, False, scale)
    assert found == pytest.approx(np.arange(6.0), abs=1e-9)


def test_the_first_motion_of_the_base_does_not_cause_a_jump():
    loop = ControlLoop(MODEL, settings=Settings(start_ramp=0.5))
    for now in np.arange(0.0, 1.0, 0.05):
        last = report_all(loop, now).step(now).efforts.copy()
    loop.loads.set_base_motion(1.0, (3.0, 0.0, 5.0), np.zeros(3))
    assert report_all(loop, 1.0).step(1.0).efforts == pytest.approx(last)


def test_missing_joints_are_listed():
    loop = ControlLoop(MODEL)
    store_state(loop.collector, 0.0, NAMES[2:], Q[2:], np.zeros(4))
    missing = f'the positions of {NAMES[0]}, {NAMES[1]} on joint_states'
    assert missing_inputs(loop) == [missing]


def test_old_joint_states_are_listed_as_missing():
    loop = report_all(ControlLoop(MODEL))
    assert missing_inputs(loop, now=0.1) == []
    assert missing_inputs(loop, '/joint_states', now=9.0) == [
        f'new joint states of {", ".join(NAMES)} on /joint_states'
    ]


def test_states_without_velocities_are_used_again_before_the_state_is_lost():
    loop = report_all(ControlLoop(MODEL, settings=Settings(start_ramp=0.0, state_timeout=0.1)))
    lost = ()
    for k in range(1, 200):
        now = 0.01 * k
        store_state(loop.collector, now, NAMES, Q, [])
        command = loop.step(now)
        lost += command.lost_velocities
        assert command.efforts.any()
        assert loop.phase is Phase.FLOATING
    assert lost == NAMES


ARM = load_urdf(ROOT / 'test/robots/seven_dof.urdf')
LEVEL = np.array([0.0, 0.9, 0.0, 0.3, 0.0, 0.2, 0.0])
HOLD = InverseDynamics(ARM).gravity_efforts(LEVEL)
HAND = ARM.link_names[-1]


def held(**arguments):
    """Return the loop of an arm that has been held for a second, at 200 Hz, and the time."""
    loop, now = ControlLoop(ARM, **arguments), 10.0
    report_arm(loop, now)
    efforts = play_arm(loop, now, 1.5)
    assert efforts[-1] == pytest.approx(HOLD)
    return loop, now + 1.5


def report_arm(loop, now, q=LEVEL):
    store_state(loop.collector, now, ARM.joint_names, q, np.zeros(7))


def play_arm(loop, now, seconds, q=LEVEL, period=0.005):
    """Step with new joint states from one time on; return the efforts."""
    efforts = []
    for k in range(1, round(seconds / period) + 1):
        report_arm(loop, now + period * k, q)
        efforts.append(loop.step(now + period * k).efforts.copy())
    return np.array(efforts)


def largest_step(*efforts):
    """Return the largest step between commands [N m]."""
    return np.abs(np.diff(np.vstack(efforts), axis=0)).max()


def test_a_full_turn_of_a_joint_that_is_not_continuous_is_a_limit_stop():
    settings = Settings(mode=Mode.COMPUTED_TORQUE, reference_timeout=0.0, kp=20.0)
    loop, now = held(settings=settings)
    loop.reference = Reference(np.zeros(7), np.zeros(7), now, LEVEL, np.zeros(7))
    last = play_arm(loop, now, 1.0)[-1]
    turned = LEVEL + 2.0 * np.pi * np.eye(7)[1]
    efforts = np.vstack([last, play_arm(loop, now + 1.0, 0.5, turned)])
    assert (np.diff(np.abs(efforts), axis=0) <= 0.0).all()
    assert not efforts[-1].any()
    assert 'jumped by 6.28 rad' in loop.supervisor.limit_stop


def pushed(loop, now, force):
    """Renew a wrench for a second; return the efforts."""
    efforts = []
    for k in range(100):
        loop.loads.set_external_wrench(now + 0.01 * k, HAND, force, np.zeros(3))
        efforts.append(play_arm(loop, now + 0.01 * k, 0.01))
    return np.vstack(efforts)


def test_the_first_wrench_is_blended_in_and_a_renewed_one_acts_at_once():
    loop, now = held()
    last = loop.step(now).efforts.copy()
    efforts = pushed(loop, now, np.array([40.0, 0.0, 0.0]))
    assert np.abs(efforts[-1] - HOLD).max() > 10.0
    assert largest_step(last, efforts) <= 1.01 * 0.01 * np.abs(efforts[-1] - HOLD).max()
    loop.loads.set_external_wrench(now + 1.0, HAND, np.array([-40.0, 0.0, 0.0]), np.zeros(3))
    assert play_arm(loop, now + 1.0, 0.005)[-1] == pytest.approx(2.0 * HOLD - efforts[-1])
    play_arm(loop, now + 1.005, 0.3)  # it ends, and is blended out
    last = loop.step(now + 1.305).efforts.copy()
    loop.loads.set_external_wrench(now + 1.305, HAND, np.array([40.0, 0.0, 0.0]), np.zeros(3))
    assert play_arm(loop, now + 1.305, 0.005)[-1] == pytest.approx(last)


def test_a_wrench_that_was_renewed_too_late_is_blended_in_even_without_a_step_between():
    settings = Settings(start_ramp=10.0, state_timeout=1.0)
    loop = ControlLoop(ARM, settings=settings, period=0.5)
    push = np.array([40.0, 0.0, 0.0])
    for k in range(60):
        loop.loads.set_external_wrench(0.5 * k, HAND, push, np.zeros(3))
        report_arm(loop, 0.5 * k)
        last = loop.step(0.5 * k).efforts.copy()
    assert np.abs(last - HOLD).max() > 10.0
    loop.loads.set_external_wrench(29.9, HAND, -push, np.zeros(3))
    report_arm(loop, 30.0)
    assert loop.step(30.0).efforts == pytest.approx(last, abs=3.0)


def test_gravity_that_turns_with_the_base_is_followed_at_once():
    loop, now = held()
    for k in range(100):
        angle = 0.01 * k
        gravity = 9.80665 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
        loop.loads.set_gravity(gravity, now + 0.01 * k)
        efforts = play_arm(loop, now + 0.01 * k, 0.01)
    expected = InverseDynamics(ARM, gravity).gravity_efforts(LEVEL)
    assert np.abs(expected - HOLD).max() > 10.0
    assert efforts[-1] == pytest.approx(expected)


def test_a_wrench_from_before_the_start_does_not_act():
    loop = ControlLoop(ARM)
    loop.loads.set_external_wrench(0.0, HAND, np.array([40.0, 0.0, 0.0]), np.zeros(3))
    loop.start()
    assert play_arm(loop, 100.0, 1.5)[-1] == pytest.approx(HOLD)


def test_a_reference_does_not_return_after_the_clock_was_set_back():
    loop, now = held(settings=Settings(reference_timeout=0.5))
    loop.reference = Reference(np.full(7, 5.0), np.zeros(7), now)
    assert np.abs(play_arm(loop, now, 0.3)[-1] - HOLD).max() > 1.0
    efforts = play_arm(loop, now - 2.0, 3.0)
    assert largest_step(efforts) < 1.0
    assert efforts[-1] == pytest.approx(HOLD)
