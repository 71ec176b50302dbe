"""Joints, loads, the base and external efforts in the steps of the whole control loop."""

import math

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.contact import ExternalEffortEstimator
from inverse_dynamics_node.control.laws import Reference
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import MeasuredGravity, Mode, Settings
from inverse_dynamics_node.control.supervisor import Phase
from inverse_dynamics_node.node.status_text import describe_implausible, missing_inputs
import numpy as np
import pytest
from robot_files import ROOT, STANFORD
from states import Arm, reference, store_state

MODEL = load_urdf(STANFORD)
NAMES = MODEL.joint_names
TIP = MODEL.link_names[-1]
Q = np.array([0.3, 0.8, 0.5, -0.4, 0.6, 0.2])
AT_ONCE = Settings(start_ramp=0.0)


def report(loop, now=0.0, of=slice(None), shift=0.0, velocities=0.0, efforts=()):
    """Report some of the joints."""
    names, q = [NAMES[k] for k in np.arange(6)[of]], Q[of] + shift
    store_state(loop.collector, now, names, q, np.full(len(q), velocities), efforts)
    return loop


def hold(robot=MODEL, gravity=(0.0, 0.0, -9.80665), q=Q):
    return InverseDynamics(robot, gravity).gravity_efforts(q)


def test_without_the_motion_of_the_base_there_is_no_command():
    loop = report(ControlLoop(MODEL, settings=AT_ONCE, has_imu=True))
    assert loop.step(0.0) is None
    assert missing_inputs(loop) == ['the motion of the base on imu']
    loop.loads.set_base_motion(0.0, (0.0, 0.0, 9.80665), np.zeros(3))
    assert loop.step(0.0).efforts == pytest.approx(hold())
    assert missing_inputs(loop) == []


def test_a_dry_run_ends_what_is_sent_and_its_end_lets_it_rise_from_zero():
    loop = report(ControlLoop(MODEL, settings=Settings(start_ramp=0.5, stop_ramp=0.5)))

    def step(k):
        return report(loop, 0.01 * k).step(0.01 * k)

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
    loop = report(ControlLoop(MODEL, settings=AT_ONCE))
    loop.reference = Reference(np.ones(6), np.zeros(6), 0.0)
    loop.start()
    loop.step(0.0)
    assert loop.phase is Phase.FLOATING


SLOW = 4  # joint of a slow driver, which is not commanded
OTHERS = [k for k in range(6) if k != SLOW]
COMMANDED = [NAMES[k] for k in OTHERS]


def step_with_slow_joint(loop, period, seconds, velocity=0.0, start=0.0):
    """Step at 100 Hz with states of the others, and one of the slow joint every period."""
    efforts, last = [], -math.inf
    for now in start + np.arange(0.0, seconds, 0.01):
        report(loop, now, OTHERS)
        if now - last >= period - 1e-6:
            report(loop, now, [SLOW], velocities=velocity)
            last = now
        efforts.append(loop.step(now).efforts.copy())
    return np.array(efforts)


@pytest.mark.parametrize('period', [0.2, 1.3, 1e9])
def test_a_slow_joint_that_is_not_commanded_does_not_stop_the_arm(period):
    loop = ControlLoop(MODEL, COMMANDED, AT_ONCE)
    efforts = step_with_slow_joint(loop, period, 4.0)
    assert efforts == pytest.approx(np.tile(hold()[OTHERS], (len(efforts), 1)))


def test_a_late_joint_that_is_not_commanded_is_named():
    loop = ControlLoop(MODEL, COMMANDED[:4], locked={NAMES[5]: 0.1})
    report(report(loop), 1.1, OTHERS)
    assert loop.step(1.1) is not None
    assert loop.collector.late(1.1) == {NAMES[SLOW]: 1.1}
    report(loop, 1.2).step(1.2)
    assert loop.collector.late(1.2) == {}


@pytest.mark.parametrize('cutoff', [0.0, 1.0])
@pytest.mark.parametrize('locked', [{}, {NAMES[SLOW]: 0.2}])
def test_a_late_joint_keeps_its_position_but_not_its_velocity(locked, cutoff):
    settings = Settings(start_ramp=0.0, velocity_filter_cutoff=cutoff)
    loop = ControlLoop(MODEL, COMMANDED, settings, locked=locked)
    # A fast wrist causes Coriolis efforts at the other joints.
    for k in range(5):
        step_with_slow_joint(loop, 1e9, 0.11, 30.0, 0.1 * k)
    moving = loop.law.velocities[SLOW]
    assert moving > 10.0
    report(loop, 1.3, OTHERS).step(1.3)
    assert loop.law.velocities[SLOW] == moving
    assert report(loop, 1.6, OTHERS).step(1.6).efforts == pytest.approx(hold()[OTHERS])
    assert loop.law.velocities[SLOW] == 0.0
    report(loop, 1.7, [SLOW], velocities=2.0).step(1.7)
    assert loop.law.velocities[SLOW] == 2.0


@pytest.mark.parametrize('locked', [{}, {NAMES[SLOW]: 0.2}], ids=['late', 'locked'])
def test_a_joint_that_was_late_or_locked_does_not_cause_a_jump(locked):
    loop = ControlLoop(MODEL, COMMANDED, Settings(start_ramp=0.5), locked=locked)
    if not locked:
        report(loop, -1.0, [SLOW])
    last = step_with_slow_joint(loop, math.nan, 2.0)[-1]
    report(loop, 2.0, [SLOW], shift=2.0)
    assert report(loop, 2.0, OTHERS).step(2.0).efforts == pytest.approx(last)
    for now in np.arange(2.01, 3.0, 0.01):
        report(loop, now, [SLOW], shift=2.0)
        report(loop, now, OTHERS).step(now)
    found = loop.shaper.command
    assert found == pytest.approx(hold(q=Q + 2.0 * np.eye(6)[SLOW])[OTHERS])
    assert np.abs(found - last).max() > 0.1


def test_the_first_motion_of_the_base_does_not_cause_a_jump():
    loop = ControlLoop(MODEL, settings=Settings(start_ramp=0.5))
    for now in np.arange(0.0, 1.0, 0.05):
        last = report(loop, now).step(now).efforts.copy()
    loop.loads.set_base_motion(1.0, (3.0, 0.0, 5.0), np.zeros(3))
    assert report(loop, 1.0).step(1.0).efforts == pytest.approx(last)


def test_the_first_command_needs_a_slow_joint_once():
    loop = report(ControlLoop(MODEL, COMMANDED, AT_ONCE), of=OTHERS)
    assert loop.step(0.0) is None
    assert loop.collector.late(0.0) == {}
    assert report(loop, of=[SLOW]).step(0.0) is not None


@pytest.mark.parametrize(
    ('reported', 'hint'),
    [
        (
            lambda name: name.removeprefix('joint_'),
            "without the prefix 'joint_' of the URDF",
        ),
        (lambda name: f'lbr_{name}', "with the prefix 'lbr_', unlike the URDF"),
        (lambda name: f'{name}_arm', "with the suffix '_arm', unlike the URDF"),
        (lambda name: 'wheel' + name[-1], 'received other names: gripper, wheel1, wheel2'),
    ],
)
def test_names_that_arrive_in_place_of_the_missing_ones_are_shown(reported, hint):
    loop = ControlLoop(MODEL)
    names = [reported(name) for name in NAMES]
    store_state(loop.collector, 0.0, ['gripper', *names], np.zeros(7), np.zeros(7))
    (missing,) = missing_inputs(loop)
    assert hint in missing


def test_a_reference_and_its_end_act_at_once():
    loop = report(ControlLoop(MODEL, settings=Settings(start_ramp=0.2, reference_timeout=0.1)))
    dynamics, qdd = InverseDynamics(MODEL), np.full(6, 0.2)
    for k in range(80):
        now = 0.01 * k
        if k == 50:
            loop.follow(Reference(qdd, np.zeros(6), now))
        efforts = report(loop, now).step(now).efforts
        if k >= 40:
            is_followed = 50 <= k <= 60
            assert efforts == pytest.approx(dynamics.efforts(Q, 0.0 * Q, qdd * is_followed))


def test_missing_misnamed_and_old_joint_states_are_listed():
    loop = ControlLoop(MODEL)
    similar = NAMES[0].replace('joint_', 'joint')
    store_state(loop.collector, 0.0, [similar, *NAMES[1:]], Q, np.zeros(6))
    text = f"the position of {NAMES[0]} on joint_states (received similar names: '{similar}')"
    assert missing_inputs(loop) == [text]
    loop = report(ControlLoop(MODEL), of=slice(2, 6))
    missing = f'the positions of {NAMES[0]}, {NAMES[1]} on joint_states'
    assert missing_inputs(loop) == [missing]
    report(loop)
    assert missing_inputs(loop, now=0.1) == []
    old = f'new joint states of {", ".join(NAMES)} on /joint_states'
    assert missing_inputs(loop, '/joint_states', now=9.0) == [old]


def test_positions_of_joints_that_were_never_reported_are_not_judged():
    loop = ControlLoop(MODEL, COMMANDED, locked={NAMES[SLOW]: 500.0})
    bounded = next(k for k in range(5) if np.isfinite(MODEL.upper[k]))
    assert list(describe_implausible(loop)) in ([], [NAMES[SLOW]])
    store_state(loop.collector, 0.0, [NAMES[bounded]], [1000.0], [0.0])
    assert NAMES[bounded] in describe_implausible(loop)


def test_contradictory_positions_of_another_joint_do_not_stop_the_arm():
    loop = ControlLoop(MODEL, [name for k, name in enumerate(NAMES) if k != 4], Settings())
    efforts = []
    for k, now in enumerate(np.arange(0.0, 2.0, 0.005)):  # by two publishers in turn
        report(loop, now, shift=1.5 * (k % 2) * np.eye(6)[4])
        efforts.append(loop.step(now).efforts.copy())
    largest = np.abs(efforts).max()
    assert largest > 1.0
    assert np.abs(np.diff(efforts, axis=0)).max() <= 2.0 * largest * 0.005 / 0.5
    assert loop.phase is Phase.FLOATING


def test_the_base_link_is_the_root_unless_another_one_is_set():
    assert ControlLoop(MODEL).base_link == MODEL.body_names[0]
    fixed = '<link name="mount"/><joint name="f" type="fixed"><parent link="mount"/>'
    fixed += f'<child link="{MODEL.body_names[0]}"/></joint></robot>'
    robot = load_urdf(STANFORD.read_text().replace('</robot>', fixed))
    assert ControlLoop(robot).base_link == 'mount'
    assert ControlLoop(robot, base_link=MODEL.body_names[0]).base_link == MODEL.body_names[0]


def test_external_efforts_are_measured_minus_modelled_efforts():
    push = np.arange(6.0)
    loop = report(ControlLoop(MODEL), efforts=hold() + push)
    assert loop.external_efforts() == pytest.approx(push)
    time_constant = 1.0 / (2.0 * math.pi * 10.0)
    report(loop, time_constant, velocities=0.01, efforts=hold())
    found, alike = loop.external_efforts(), ExternalEffortEstimator(InverseDynamics(MODEL))
    alike.update(0.0, Q, np.zeros(6), hold() + push)
    assert found == pytest.approx(alike.update(time_constant, Q, np.full(6, 0.01), hold()))


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
    held = InverseDynamics(MODEL, (1.0, 0.0, -9.6))
    held.set_payload(TIP, 2.0, (0.0, 0.0, 0.1))
    gravity = held.gravity_efforts(Q)
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
    gravity = hold()
    for k in range(300):
        positions, zeros = [*Q[:5], math.nan], [*np.zeros(5), math.nan]
        efforts = [*gravity[:5] + 1.0, math.nan]
        store_state(loop.collector, 0.01 * k, NAMES, positions, zeros, efforts)
        assert loop.step(0.01 * k).efforts == pytest.approx(gravity[:5])
        external = loop.external_efforts()
    assert external[:5] == pytest.approx(np.ones(5))
    assert math.isnan(external[5])


def test_measured_efforts_are_scaled():
    held = InverseDynamics(MODEL, (1.0, 0.0, -9.6))
    held.set_payload(TIP, 2.0, (0.0, 0.0, 0.1))
    scale = np.array([-1.0, 0.02, 1.0, 3.0, -0.5, 1000.0])
    measured = held.gravity_efforts(Q) + np.arange(6.0)
    found = external_efforts_of(measured, MeasuredGravity.INCLUDED, False, scale)
    assert found == pytest.approx(np.arange(6.0), abs=1e-9)


def test_states_without_velocities_are_used_again_before_the_state_is_lost():
    loop = report(ControlLoop(MODEL, settings=Settings(start_ramp=0.0, state_timeout=0.1)))
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
HOLD = hold(ARM, q=LEVEL)
HAND, NOTHING = ARM.link_names[-1], np.zeros(3)


def held(**settings):
    """Return an arm that has been held for 1.5 s."""
    arm = Arm(ARM, settings=Settings(**settings))
    arm.q, rest = LEVEL, np.zeros(7)
    assert arm.move(rest, 1.5)[-1] == pytest.approx(HOLD)
    return arm


def play(arm, seconds):
    return arm.move(np.zeros(7), seconds)


def push(arm, force, later=0.0):
    arm.loop.loads.set_external_wrench(arm.now + later, HAND, (force, 0.0, 0.0), NOTHING)


def test_a_full_turn_of_a_joint_that_is_not_continuous_is_a_limit_stop():
    arm = held(mode=Mode.COMPUTED_TORQUE, reference_timeout=0.0, kp=20.0)
    arm.loop.reference = reference(arm.now, LEVEL, np.zeros(7), np.zeros(7), np.zeros(7))
    last = play(arm, 1.0)[-1]
    arm.q = LEVEL + 2.0 * np.pi * np.eye(7)[1]
    efforts = np.vstack([last, play(arm, 0.5)])
    assert (np.diff(np.abs(efforts), axis=0) <= 0.0).all()
    assert not efforts[-1].any()
    assert 'jumped by 6.28 rad' in arm.limit_stop


def test_the_first_wrench_is_blended_in_and_a_renewed_one_acts_at_once():
    arm = held()
    efforts = [HOLD]
    for _ in range(100):
        push(arm, 40.0)
        efforts = [*efforts, *play(arm, 0.01)]
    pushed = efforts[-1]
    assert np.abs(pushed - HOLD).max() > 10.0
    assert np.abs(np.diff(efforts, axis=0)).max() <= 1.01 * 0.01 * np.abs(pushed - HOLD).max()
    push(arm, -40.0)
    assert play(arm, 0.005)[-1] == pytest.approx(2.0 * HOLD - pushed)
    last = play(arm, 0.3)[-1]  # it ends, and is blended out
    assert np.abs(last - (2.0 * HOLD - pushed)).max() > 1.0
    push(arm, 40.0)
    assert play(arm, 0.005)[-1] == pytest.approx(last)


def test_a_wrench_that_was_renewed_too_late_is_blended_in_even_without_a_step_between():
    arm = Arm(ARM, settings=Settings(start_ramp=10.0, state_timeout=1.0), period=0.5)
    arm.q = LEVEL
    for _ in range(60):
        push(arm, 40.0, 0.5)
        last = arm.move(np.zeros(7), 0.5, 0.5)[-1]
    assert np.abs(last - HOLD).max() > 10.0
    push(arm, -40.0, 0.4)
    assert arm.move(np.zeros(7), 0.5, 0.5)[-1] == pytest.approx(last, abs=3.0)


def test_gravity_that_turns_with_the_base_is_followed_at_once():
    arm = held()
    for k in range(100):
        gravity = 9.80665 * np.array([np.sin(0.01 * k), 0.0, -np.cos(0.01 * k)])
        arm.loop.loads.set_gravity(gravity, arm.now)
        efforts = play(arm, 0.01)
    expected = hold(ARM, gravity, LEVEL)
    assert np.abs(expected - HOLD).max() > 10.0
    assert efforts[-1] == pytest.approx(expected)


def test_a_wrench_from_before_the_start_does_not_act():
    arm = Arm(ARM, settings=Settings())
    push(arm, 40.0)
    arm.loop.start()
    arm.now, arm.q = 100.0, LEVEL
    assert play(arm, 1.5)[-1] == pytest.approx(HOLD)


def test_a_reference_does_not_return_after_the_clock_was_set_back():
    arm = held(reference_timeout=0.5)
    arm.loop.reference = Reference(np.full(7, 5.0), np.zeros(7), arm.now)
    assert np.abs(play(arm, 0.3)[-1] - HOLD).max() > 1.0
    arm.now -= 2.3
    efforts = play(arm, 3.0)
    assert np.abs(np.diff(efforts, axis=0)).max() < 1.0
    assert efforts[-1] == pytest.approx(HOLD)
