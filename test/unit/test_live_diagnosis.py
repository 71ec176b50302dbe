"""
The diagnosis of a few seconds of measured and modelled efforts.

Faults and their sentences are in test_one_diagnosis.py.
"""

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.diagnosis.fault import FaultKind, GravityConvention
from inverse_dynamics_node.analysis.diagnosis.live import (
    check_agreement,
    diagnose_samples,
    LiveSamples,
    LiveWindow,
    Obstacle,
    Outcome,
    StateRate,
)
from inverse_dynamics_node.report.agreement_text import sentence
import numpy as np
import pytest
from runs import EVERY_ROBOT, exciting, ROBOTS

GRAVITY = np.array([0.0, 0.0, -9.80665])
JOINTS = ('joint_1', 'joint_2', 'joint_3', 'joint_4', 'joint_5', 'joint_6')
BOTH = pytest.mark.parametrize('moves', [True, False], ids=['moving', 'at rest'])


def samples_of(name='stanford', moves=True, act=None, seed=0):
    """Return a robot and 10 s of it; `act` changes the real robot."""
    robot = load_urdf(ROBOTS[name])
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, 10.0, 0.02)
    q, qd, qdd = exciting(robot, times, rng)
    if not moves:
        q[:] = q[0]
        qd, qdd = np.zeros_like(q), np.zeros_like(q)
    model, real = InverseDynamics(robot), InverseDynamics(robot)
    if act is not None:
        act(real)
    modelled, measured = model.efforts(q, qd, qdd), real.efforts(q, qd, qdd)
    measured += 0.01 * np.abs(measured).max(axis=0) * rng.standard_normal(measured.shape)
    return robot, LiveSamples(robot.joint_names, times, q, qd, measured, modelled)


def flipped(samples, *joints):
    measured = samples.measured.copy()
    measured[:, [samples.joint_names.index(joint) for joint in joints]] *= -1.0
    return samples._replace(measured=measured)


@BOTH
@pytest.mark.parametrize('name', ROBOTS)
def test_robot_like_the_model_agrees(name, moves):
    robot, samples = samples_of(name, moves)
    agreement = diagnose_samples(samples, robot, GRAVITY)
    assert agreement.outcome is Outcome.AGREE
    assert agreement.is_moving == moves
    assert all(0.0 < size.residual < 0.05 * size.measured for size in agreement.sizes)


def test_sentence_of_an_agreement_has_residual_and_effort():
    robot, samples = samples_of()
    text = sentence(diagnose_samples(samples, robot, GRAVITY))
    assert text == (
        'model and robot agree: RMS residual 0.13 of 4.8 N m and 0.75 of 57 N; '
        'not checked because of small efforts: joint_6'
    )


def test_swapped_sign_forbids_to_go_live():
    robot, samples = samples_of()
    agreement = diagnose_samples(flipped(samples, 'joint_3'), robot, GRAVITY)
    assert (agreement.outcome, agreement.cause) == (Outcome.DIFFER, FaultKind.SIGN)
    assert sentence(agreement).startswith('joint_3 reports efforts with the wrong sign; ')
    assert sentence(agreement).endswith(
        ' N; do not go live. Change the sign in the driver. If positions have the wrong sign too, '
        'change the sign of the <axis> in the URDF instead. Until then, do not send efforts of '
        'the node to this joint: they would drive the joint in the wrong direction'
    )


@pytest.mark.parametrize('joint', JOINTS)
def test_sign_that_is_not_found_is_listed_as_not_checked(joint):
    robot, samples = samples_of(moves=False)
    agreement = diagnose_samples(flipped(samples, joint), robot, GRAVITY)
    found = [name for fault in agreement.faults for name in fault.joints]
    assert joint in (*found, *agreement.unchecked)


def test_payload_and_swapped_sign_are_both_reported():
    robot, samples = samples_of(act=lambda real: real.set_payload('tool0', 2.0))
    agreement = diagnose_samples(flipped(samples, 'joint_2'), robot, GRAVITY)
    sign, payload = agreement.faults
    assert (sign.kind, sign.joints) == (FaultKind.SIGN, ('joint_2',))
    assert (payload.kind, payload.link) == (FaultKind.PAYLOAD, 'tool0')
    text = sentence(agreement)
    assert text.startswith("joint_2 reports efforts with the wrong sign; link 'tool0' carries 2.")
    assert '; do not go live. Change the sign' in text


def samples_with_gravity(name, moves, convention, has_gravity):
    """Return the result for a driver that measures with or without gravity, and a payload."""
    link, payload = load_urdf(ROBOTS[name]).link_names[-1], 3.0

    def act(real):
        real.set_payload(link, payload, (0.0, 0.0, 0.1))
        real.set_gravity(GRAVITY if has_gravity else np.zeros(3))

    robot, samples = samples_of(name, moves, act)
    model = InverseDynamics(robot, GRAVITY if convention.in_measured else np.zeros(3))
    model.set_payload(link, payload, (0.0, 0.0, 0.1))
    qdd = np.gradient(samples.qd, samples.times, axis=0)
    noise = 0.05 * np.random.default_rng(1).standard_normal(samples.measured.shape)
    samples = samples._replace(
        measured=samples.measured + noise, modelled=model.efforts(samples.q, samples.qd, qdd)
    )
    payloads = [(link, payload, np.array([0.0, 0.0, 0.1]))]
    return diagnose_samples(samples, robot, GRAVITY, convention=convention, payloads=payloads)


CONVENTIONS = [GravityConvention(*each) for each in np.ndindex(2, 2)]
EACH_CONVENTION = pytest.mark.parametrize('convention', CONVENTIONS, ids=repr)


@BOTH
@EACH_CONVENTION
@EVERY_ROBOT
def test_gravity_that_is_measured_as_described_is_no_fault(name, convention, moves):
    has_gravity = convention.in_measured
    agreement = samples_with_gravity(name, moves, convention, has_gravity)
    assert not agreement.faults
    if moves or has_gravity:
        assert agreement.outcome is Outcome.AGREE
    else:
        assert agreement.cause is Obstacle.SMALL_EFFORTS
        assert 'without gravity, modelled and measured efforts are too' in sentence(agreement)


@BOTH
@EACH_CONVENTION
@EVERY_ROBOT
def test_gravity_that_contradicts_the_convention_is_named(name, convention, moves):
    has_gravity = not convention.in_measured
    agreement = samples_with_gravity(name, moves, convention, has_gravity)
    assert agreement.outcome is Outcome.DIFFER
    kind = FaultKind.GRAVITY_MEASURED if has_gravity else FaultKind.GRAVITY_COMPENSATED
    assert [fault.kind for fault in agreement.faults] == [kind]
    headline, advice = {
        (False, False): ('contain gravity, but the commands do not', 'measured_gravity to incl'),
        (False, True): ('lack gravity, although measured_', 'measured_gravity to excluded'),
        (True, False): ('contain gravity, although measured_', 'measured_gravity to as_commanded'),
        (True, True): ('lack gravity', 'include_gravity to false'),
    }[convention]
    assert sentence(agreement).startswith(f'the measured efforts {headline}')
    assert advice in sentence(agreement)


def test_unknown_payload_beside_gravity_that_is_measured_is_weighed():
    robot, samples = samples_of('stanford', True, lambda real: real.set_payload('tool0', 2.0))
    model = InverseDynamics(robot, np.zeros(3))
    qdd = np.gradient(samples.qd, samples.times, axis=0)
    samples = samples._replace(modelled=model.efforts(samples.q, samples.qd, qdd))
    agreement = diagnose_samples(
        samples, robot, GRAVITY, convention=GravityConvention(False, False)
    )
    gravity, payload = agreement.faults
    assert gravity.kind is FaultKind.GRAVITY_MEASURED
    assert payload.values[0] == pytest.approx(2.0, rel=0.2)


def test_small_difference_at_rest_may_be_friction():
    robot, samples = samples_of(moves=False)
    measured = samples.measured.copy()
    measured[:, 4] += 0.8
    agreement = diagnose_samples(samples._replace(measured=measured), robot, GRAVITY)
    assert (agreement.outcome, agreement.cause) == (Outcome.UNDECIDED, Obstacle.AT_REST)
    assert 'move the arm to find out' in sentence(agreement)


def test_efforts_that_are_not_measured_cannot_be_compared():
    robot, samples = samples_of()
    nothing = samples._replace(measured=np.full_like(samples.measured, np.nan))
    agreement = diagnose_samples(nothing, robot, GRAVITY)
    assert (agreement.outcome, agreement.cause) == (Outcome.UNDECIDED, Obstacle.NO_EFFORTS)


def test_zero_efforts_of_an_arm_held_by_brakes_cannot_be_compared():
    robot, samples = samples_of(moves=False)
    zero = samples._replace(measured=np.zeros_like(samples.measured))
    agreement = diagnose_samples(zero, robot, GRAVITY)
    assert (agreement.outcome, agreement.cause) == (Outcome.UNDECIDED, Obstacle.ZERO_EFFORTS)
    assert 'measured_gravity to excluded' in sentence(agreement)
    assert 'brakes hold the arm' in sentence(agreement)


def test_joints_without_effort_are_left_out():
    robot, samples = samples_of()
    measured = flipped(samples, 'joint_2').measured
    measured[:, 0] = np.nan
    agreement = diagnose_samples(samples._replace(measured=measured), robot, GRAVITY)
    assert agreement.faults[0].joints == ('joint_2',)


def test_efforts_of_an_unloaded_arm_are_too_small_to_compare():
    robot, samples = samples_of(moves=False)
    small = samples._replace(measured=1e-3 * samples.measured, modelled=1e-3 * samples.modelled)
    agreement = diagnose_samples(small, robot, GRAVITY)
    assert (agreement.outcome, agreement.cause) == (Outcome.UNDECIDED, Obstacle.SMALL_EFFORTS)


def test_half_a_second_or_nothing_is_not_enough():
    robot, samples = samples_of()
    short = LiveSamples(samples.joint_names, *(signal[:25] for signal in samples[1:]))
    for samples in short, LiveWindow(robot.joint_names).samples():
        agreement = diagnose_samples(samples, robot, GRAVITY)
        assert agreement.cause is Obstacle.TOO_FEW_SAMPLES


def test_window_keeps_its_duration():
    window = LiveWindow(('a', 'b'), 1.0)
    for k in range(100):
        window.add(0.1 * k, *np.full((4, 2), float(k)))
    samples = window.samples()
    assert samples.times[0] == pytest.approx(8.9)
    assert len(samples.times) == 11
    assert samples.modelled[-1].tolist() == [99.0, 99.0]


def test_window_drops_samples_with_another_convention():
    window = LiveWindow(('a', 'b'), 1.0)
    for k, has_gravity in enumerate([False, False, True, True, True]):
        window.restart_after_change(has_gravity, (1.0, -1.0))
        window.add(0.1 * k, *np.full((4, 2), float(k)))
    assert window.samples().times.tolist() == pytest.approx([0.2, 0.3, 0.4])


def judged(samples, robot, commanded=JOINTS, saturated=(), rate=500.0):
    return check_agreement(
        '', StateRate(rate), samples, robot, GRAVITY, None, commanded, saturated
    )


class TestSaturation:
    """An arm whose efforts are cut to their limits cannot hold itself, whatever is measured."""

    def test_it_is_an_outcome_of_its_own(self):
        robot, samples = samples_of()
        agreement = judged(samples, robot, saturated=['joint_2'])
        assert (agreement.outcome, agreement.cause) == (Outcome.SATURATED, Obstacle.SATURATED)
        assert sentence(agreement).startswith(
            'joint_2: the effort is cut to its limit, so the arm'
        )
        assert sentence(agreement).endswith('; do not go live')

    @pytest.mark.parametrize('measured', [np.nan, 0.0])
    def test_no_measured_efforts_are_needed(self, measured):
        robot, samples = samples_of(moves=False)
        nothing = samples._replace(measured=np.full_like(samples.measured, measured))
        assert judged(nothing, robot, saturated=['joint_2']).outcome is Outcome.SATURATED

    def test_it_is_more_important_than_slow_states(self):
        robot, samples = samples_of()
        agreement = judged(samples, robot, saturated=['joint_2'], rate=50.0)
        assert agreement.outcome is Outcome.SATURATED

    def test_a_difference_is_more_important_but_both_are_reported(self):
        robot, samples = samples_of()
        agreement = judged(flipped(samples, 'joint_3'), robot, saturated=['joint_2'])
        assert agreement.cause is FaultKind.SIGN
        assert '; the effort of joint_2 is cut to its limit. ' in sentence(agreement)


class TestFewJoints:
    """An agreement rests on a quarter of the commanded joints."""

    def test_the_others_are_too_little_loaded(self):
        robot, samples = samples_of('seven_dof', moves=False)
        for signal in samples[4:]:
            signal[:, 2:] *= 1e-3
        checked = check_agreement('', StateRate(500.0), samples, robot, GRAVITY).checked
        assert len(checked) == 1
        agreement = judged(samples, robot, robot.joint_names)
        assert (agreement.outcome, agreement.cause) == (Outcome.FEW_JOINTS, Obstacle.FEW_JOINTS)
        assert sentence(agreement).startswith(
            'model and robot agree, but only 1 of 7 joints could be checked: '
        )
        assert sentence(agreement).endswith('; move the arm to check more joints')

    def test_the_others_are_not_measured(self):
        robot, samples = samples_of()
        measured = samples.measured.copy()
        measured[:, [0, 2, 3, 4, 5]] = np.nan
        some = samples._replace(measured=measured)
        agreement = judged(some, robot)
        assert agreement.outcome is Outcome.FEW_JOINTS
        assert 'because no effort is measured: joint_1, joint_3, joint_4, joint_5 and' in sentence(
            agreement
        )
        assert judged(some, robot, ['joint_2', 'joint_3']).outcome is Outcome.AGREE

    def test_constant_efforts_of_a_joint_that_is_not_commanded_are_ignored(self):
        robot, samples = samples_of()
        measured = samples.measured.copy()
        measured[:, 2] = 0.0
        silent = samples._replace(measured=measured)
        assert judged(silent, robot).cause is FaultKind.NOT_MEASURED
        others = [name for name in JOINTS if name != 'joint_3']
        assert judged(silent, robot, others).outcome is Outcome.AGREE

    def test_joints_that_are_not_commanded_do_not_count(self):
        robot, samples = samples_of()
        agreement = judged(samples, robot, ['joint_6'])
        assert 'joint_6' in agreement.unchecked
        assert agreement.numbers == (0.0, 1.0)
        assert judged(samples, robot).outcome is Outcome.AGREE


class TestStateRate:
    """Joint states that arrive at a tenth of the rate are reported."""

    @pytest.mark.parametrize(
        ('rate', 'is_slow'),
        [
            (StateRate(50.0), True),
            (StateRate(99.0), False),
            (StateRate(100.0, update_rate=1000.0), True),
            (StateRate(500.0, update_rate=1000.0), False),
            (StateRate(30.0, update_rate=50.0), False),
            (StateRate(100.0, given=1000.0), True),
            (StateRate(50.0, given=50.0), False),
            (StateRate(50.0, is_simulated=True), False),
            (StateRate(None), False),
        ],
    )
    def test_expectation_is_that_of_user_loop_or_ros2_control(self, rate, is_slow):
        assert rate.is_slow is is_slow

    def test_slow_states_are_a_difference_even_if_efforts_agree(self):
        robot, samples = samples_of()
        agreement = check_agreement('', StateRate(50.0), samples, robot, GRAVITY)
        assert (agreement.outcome, agreement.cause) == (Outcome.DIFFER, Obstacle.SLOW_STATES)
        assert 'joint states arrive at 50 Hz, expected at least 80 Hz' in sentence(agreement)

    def test_swapped_sign_is_more_important_than_slow_states(self):
        robot, samples = samples_of()
        agreement = check_agreement(
            '', StateRate(50.0), flipped(samples, 'joint_3'), robot, GRAVITY
        )
        assert agreement.cause is FaultKind.SIGN

    def test_node_that_does_not_compute_is_not_judged(self):
        robot, samples = samples_of()
        agreement = check_agreement(
            'the node is inactive', StateRate(50.0), samples, robot, GRAVITY
        )
        assert agreement.outcome is Outcome.UNDECIDED
        assert sentence(agreement) == 'not compared: the node is inactive'
