"""
The diagnosis of a few seconds of measured and modelled efforts.

Faults and their sentences are in test_one_diagnosis.py.
"""

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.diagnosis.fault import FaultKind, GravityConvention
from inverse_dynamics_node.analysis.diagnosis.gate import Gate
from inverse_dynamics_node.analysis.diagnosis.live import (
    Check,
    check_agreement,
    LiveSamples,
    LiveWindow,
    Obstacle,
    Outcome,
    StateRate,
)
from inverse_dynamics_node.report.diagnosis_text import agreement_sentence
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


def reversing(joint):
    return lambda samples: flipped(samples, joint)


@BOTH
@pytest.mark.parametrize('name', ROBOTS)
def test_robot_like_the_model_agrees(name, moves):
    robot, samples = samples_of(name, moves)
    agreement = check_agreement(samples, robot, GRAVITY)
    assert agreement.outcome is Outcome.AGREE
    assert agreement.is_moving == moves
    assert all(0.0 < size.residual < 0.05 * size.measured for size in agreement.sizes)


@pytest.mark.parametrize('joint', JOINTS)
def test_sign_that_is_not_found_is_listed_as_not_checked(joint):
    robot, samples = samples_of(moves=False)
    agreement = check_agreement(flipped(samples, joint), robot, GRAVITY)
    found = [name for fault in agreement.faults for name in fault.joints]
    assert joint in (*found, *agreement.unchecked)


def test_payload_and_swapped_sign_are_both_reported():
    robot, samples = samples_of(act=lambda real: real.set_payload('tool0', 2.0))
    agreement = check_agreement(flipped(samples, 'joint_2'), robot, GRAVITY)
    sign, payload = agreement.faults
    assert (sign.kind, sign.joints) == (FaultKind.SIGN, ('joint_2',))
    assert (payload.kind, payload.link) == (FaultKind.PAYLOAD, 'tool0')
    text = agreement_sentence(agreement)
    assert text.startswith("joint_2 reports efforts with the wrong sign; link 'tool0' carries ")
    assert payload.values[0] == pytest.approx(2.0, rel=0.03)
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
    return check_agreement(samples, robot, GRAVITY, convention=convention, payloads=payloads)


CONVENTIONS = [GravityConvention(*each) for each in np.ndindex(2, 2)]
EACH_CONVENTION = pytest.mark.parametrize('convention', CONVENTIONS, ids=repr)


CONTRADICTIONS = {
    (False, False): ('contain gravity, but the commands do not', 'measured_gravity to incl'),
    (False, True): ('lack gravity, although measured_', 'measured_gravity to excluded'),
    (True, False): ('contain gravity, although measured_', 'measured_gravity to as_commanded'),
    (True, True): ('lack gravity', 'include_gravity to false'),
}


@BOTH
@EACH_CONVENTION
@EVERY_ROBOT
def test_gravity_is_a_fault_only_if_it_contradicts_the_convention(name, convention, moves):
    is_in = convention.in_measured
    agreement = samples_with_gravity(name, moves, convention, is_in)
    assert not agreement.faults
    if moves or is_in:
        assert agreement.outcome is Outcome.AGREE
    else:
        assert agreement.cause is Obstacle.SMALL_EFFORTS
        assert 'modelled and measured efforts are too small' in agreement_sentence(agreement)
    agreement = samples_with_gravity(name, moves, convention, not is_in)
    assert agreement.outcome is Outcome.DIFFER
    kind = FaultKind.GRAVITY_COMPENSATED if is_in else FaultKind.GRAVITY_MEASURED
    assert [fault.kind for fault in agreement.faults] == [kind]
    headline, advice = CONTRADICTIONS[convention]
    assert agreement_sentence(agreement).startswith(f'the measured efforts {headline}')
    assert advice in agreement_sentence(agreement)


def test_unknown_payload_beside_gravity_that_is_measured_is_weighed():
    robot, samples = samples_of('stanford', True, lambda real: real.set_payload('tool0', 2.0))
    model = InverseDynamics(robot, np.zeros(3))
    qdd = np.gradient(samples.qd, samples.times, axis=0)
    samples = samples._replace(modelled=model.efforts(samples.q, samples.qd, qdd))
    agreement = check_agreement(
        samples, robot, GRAVITY, convention=GravityConvention(False, False)
    )
    gravity, payload = agreement.faults
    assert gravity.kind is FaultKind.GRAVITY_MEASURED
    assert payload.values[0] == pytest.approx(2.0, rel=0.2)


def measuring(factor, offset=0.0):
    return lambda it: it._replace(measured=factor * it.measured + offset)


def is_joint(k):
    return np.eye(6)[k - 1]


UNDECIDED = [
    (measuring(1.0, 0.8 * is_joint(5)), Obstacle.AT_REST, 'move the arm to find out'),
    (measuring(np.nan), Obstacle.NO_EFFORTS, ''),
    (measuring(0.0), Obstacle.ZERO_EFFORTS, 'measured_gravity to excluded'),
    (measuring(0.0), Obstacle.ZERO_EFFORTS, 'brakes hold the arm'),
    (lambda it: LiveSamples(it[0], *(x[:25] for x in it[1:])), Obstacle.TOO_FEW_SAMPLES, ''),
    (lambda it: LiveWindow(it[0]).samples(), Obstacle.TOO_FEW_SAMPLES, ''),
    (lambda it: LiveSamples(*it[:4], *(1e-3 * x for x in it[4:])), Obstacle.SMALL_EFFORTS, ''),
]


@pytest.mark.parametrize(('change', 'obstacle', 'words'), UNDECIDED)
def test_some_samples_cannot_be_compared(change, obstacle, words):
    robot, samples = samples_of(moves=False)
    agreement = check_agreement(change(samples), robot, GRAVITY)
    assert (agreement.outcome, agreement.cause) == (Outcome.UNDECIDED, obstacle)
    assert words in agreement_sentence(agreement)


def test_a_joint_whose_position_was_never_reported_rests_at_zero():
    robot = load_urdf(ROBOTS['stanford'])
    _, samples = samples_of()
    dynamics, q, qd = InverseDynamics(robot), samples.q.copy(), samples.qd.copy()
    q[:, 5] = qd[:, 5] = 0.0
    modelled = dynamics.efforts(q, qd, np.zeros_like(q))
    measured = modelled.copy()
    q[:, 5] = qd[:, 5] = measured[:, 5] = np.nan
    samples = LiveSamples(samples.joint_names, samples.times, q, qd, measured, modelled)
    assert check_agreement(samples, robot, GRAVITY).outcome is Outcome.AGREE
    fault = check_agreement(flipped(samples, 'joint_2'), robot, GRAVITY).faults[0]
    assert (fault.kind, fault.joints) == (FaultKind.SIGN, ('joint_2',))


def test_window_keeps_its_duration():
    window = LiveWindow(('a', 'b'), 1.0)
    for k in range(100):
        window.add(0.1 * k, *np.full((4, 2), float(k)))
    samples = window.samples()
    assert samples.times[0] == pytest.approx(8.9)
    assert len(samples.times) == 11
    assert samples.modelled[-1].tolist() == [99.0, 99.0]


def judged(samples, robot, commanded=JOINTS, saturated=(), rate=500.0):
    agreement = check_agreement(
        samples,
        robot,
        GRAVITY,
        commanded=commanded,
        saturated=saturated,
        rate=StateRate(rate),
    )
    return Gate().add(agreement)


def same(samples):
    return samples


SATURATED = {'saturated': ['joint_2']}
CUT = Outcome.SATURATED, Obstacle.SATURATED
UNCHECKED = Outcome.NOT_CHECKED, Obstacle.NOT_CHECKED
WRONG_SIGN = Outcome.DIFFER, FaultKind.SIGN
AGREE = Outcome.AGREE, None
SLOW = Outcome.DIFFER, Obstacle.SLOW_STATES
ONLY_ONE = measuring(np.where(is_joint(2), 1.0, np.nan))
SILENT = measuring(1.0 - is_joint(3))
JUDGED = [
    # change of the samples, arguments of `judged`, outcome and cause, words
    (same, SATURATED, CUT, 'joint_2: the effort is cut to its limit, so the arm'),
    (same, SATURATED, CUT, '; do not go live'),
    (measuring(np.nan), SATURATED, CUT, ''),
    (measuring(0.0), SATURATED, CUT, ''),
    (same, {**SATURATED, 'rate': 50.0}, CUT, ''),
    (reversing('joint_3'), SATURATED, WRONG_SIGN, '; the effort of joint_2 is cut to its limit. '),
    (
        ONLY_ONE,
        {},
        UNCHECKED,
        'not checked: accept joint_1, joint_3, joint_4, joint_5 and joint_6 with',
    ),
    (ONLY_ONE, {'commanded': ['joint_2']}, AGREE, ''),
    (
        ONLY_ONE,
        {'commanded': ['joint_2', 'joint_3']},
        UNCHECKED,
        'not checked: accept joint_3 with --unchecked: no effort is',
    ),
    (SILENT, {}, (Outcome.DIFFER, FaultKind.NOT_MEASURED), 'joint_3'),
    (SILENT, {'commanded': ['joint_1', 'joint_2', 'joint_4', 'joint_5']}, AGREE, ''),
    (same, {'rate': 50.0}, SLOW, 'joint states arrive at 50 Hz, expected at least 80 Hz'),
    (reversing('joint_3'), {'rate': 50.0}, WRONG_SIGN, ''),
]


@pytest.mark.parametrize(('change', 'arguments', 'expected', 'words'), JUDGED)
def test_judgement_names_what_matters_most(change, arguments, expected, words):
    robot, samples = samples_of()
    agreement = judged(change(samples), robot, **arguments)
    assert (agreement.outcome, agreement.cause) == expected
    assert words in agreement_sentence(agreement)


# ---- The gate ------------------------------------------------------------------------------


def checked(samples, robot):
    return check_agreement(samples, robot, GRAVITY, commanded=JOINTS)


def rubbing(real):
    real.set_friction(1.0, 1.0)


def test_an_arm_at_rest_is_not_checked_until_every_joint_has_moved():
    gate = Gate()
    robot, still = samples_of(moves=False, act=rubbing)
    agreement = gate.add(checked(still, robot))
    assert agreement.cause is Obstacle.NOT_CHECKED
    assert set(agreement.unchecked) == set(JOINTS)
    assert agreement.checks['joint_3'] is Check.NOT_MOVED  # it carries the most weight
    assert agreement.checks['joint_1'] is agreement.checks['joint_6'] is Check.NO_WEIGHT
    text = agreement_sentence(agreement)
    assert text.startswith('not checked: move joint_1')
    assert 'without weight, the sign of an effort shows only in motion' in text
    robot, moving = samples_of(act=rubbing)
    assert gate.add(checked(moving, robot)).outcome is Outcome.AGREE
    assert gate.add(checked(still, robot)).outcome is Outcome.AGREE


def test_accepted_joints_need_no_check():
    robot, still = samples_of(moves=False)
    assert Gate(JOINTS).add(checked(still, robot)).outcome is Outcome.AGREE
    some = Gate(JOINTS[1:]).add(checked(still, robot))
    assert some.unchecked == ('joint_1',)


def test_a_difference_stays_a_difference():
    gate = Gate()
    robot, moving = samples_of(act=rubbing)
    found = gate.add(checked(flipped(moving, 'joint_2'), robot))
    assert found.cause is FaultKind.SIGN
    later = gate.add(checked(moving, robot))
    assert (later.outcome, later.cause) == (Outcome.DIFFER, FaultKind.SIGN)
    assert 'found earlier in this run' in agreement_sentence(later)


@pytest.mark.parametrize('factor', [-1.0, 0.0, 57.3])
@pytest.mark.parametrize('joint', range(6))
def test_wrong_velocities_of_any_joint_are_a_difference(joint, factor):
    robot, moving = samples_of(act=rubbing)
    factors = np.where(np.arange(6) == joint, factor, 1.0)
    agreement = checked(moving._replace(qd=factors * moving.qd), robot)
    assert agreement.outcome is Outcome.DIFFER
    fault = agreement.faults[0]
    assert (fault.kind, fault.joints) == (FaultKind.VELOCITY, (JOINTS[joint],))
    assert fault.values == pytest.approx((factor,), rel=0.1, abs=0.05)


@pytest.mark.parametrize('joint', JOINTS)
def test_friction_shows_the_sign_of_a_joint_without_weight(joint):
    robot, moving = samples_of(act=rubbing)
    agreement = Gate().add(checked(flipped(moving, joint), robot))
    assert agreement.outcome is not Outcome.AGREE
    assert joint in {*agreement.unchecked, *(x for y in agreement.faults for x in y.joints)}


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
def test_expected_rate_is_that_of_user_loop_or_ros2_control(rate, is_slow):
    assert rate.is_slow is is_slow
