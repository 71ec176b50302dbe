"""Diagnoses of simulated recordings, healthy or with the flaws of real ones."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.diagnosis import (
    diagnose_recording,
    Friction,
    friction_parameters,
    GravityConvention,
)
from inverse_dynamics_node.analysis.diagnosis.friction import Value
from inverse_dynamics_node.analysis.diagnosis.loads import tip_links
from inverse_dynamics_node.analysis.recordings.signals import derive, Recording
from inverse_dynamics_node.errors import ConfigurationError, RecordingError
from inverse_dynamics_node.report.diagnosis_text import headline
import numpy as np
import pytest
from robot_files import ROOT
from runs import CHAIN_AND_TREE, EVERY_ROBOT, exciting, LONG, ROBOTS, run, samples_of

TIP = {'stanford': 'tool0', 'seven_dof': 'tool0', 'branched': 'right_forearm'}
GRIPPER_ARM = ROOT / 'test' / 'robots' / 'gripper_arm.urdf'


def friction_of(name):
    n = len(load_urdf(ROBOTS[name]).joint_names)
    return np.linspace(2.0, 0.3, n), np.linspace(3.0, 0.4, n)


def kinds(result):
    return [diagnosis.kind.value for diagnosis in result.faults]


# ---- A healthy robot -----------------------------------------------------------------------


@CHAIN_AND_TREE
@pytest.mark.parametrize('has_velocities', [True, False])
def test_a_healthy_recording_is_explained_and_nothing_is_found(name, has_velocities):
    result = diagnose_recording(*run(name, has_velocities=has_velocities))
    assert kinds(result) == []
    assert result.explained > 0.998
    for joint in result.joints:
        assert joint.rms_residual < 0.3 * joint.rms_measured


@EVERY_ROBOT
@pytest.mark.parametrize(
    ('rate', 'has_velocities'),
    [(40.0, False), (200.0, False), (200.0, True), pytest.param(1000.0, False, marks=LONG)],
)
def test_friction_is_found_within_its_errors_at_any_rate(name, rate, has_velocities):
    friction = damping, coulomb = friction_of(name)
    recording = run(name, rate=rate, has_velocities=has_velocities, friction=friction)
    result = diagnose_recording(*recording)
    assert kinds(result) == []
    assert result.explained < 0.97
    assert result.explained_corrected > 0.995
    for joint, d, c in zip(result.joints, damping, coulomb, strict=True):
        fit = joint.friction
        assert fit.unknown_because == ''
        for (value, error), real in ((fit.damping, d), (fit.coulomb, c)):
            assert abs(value - real) < 5.0 * error
            if rate > 100.0:
                assert value == pytest.approx(real, rel=0.05)


def test_an_arm_at_rest_gives_no_diagnosis():
    dynamics = InverseDynamics(load_urdf(ROBOTS['stanford']))
    times = np.arange(0.0, 15.0, 0.002)
    q = np.array([0.3, -0.9, 0.5, 0.7, -0.6, 0.2])
    rounding = 1e-12 * np.random.default_rng(0).standard_normal((2, len(times), 6))
    efforts = dynamics.gravity_efforts(q)
    efforts[[0, 5]] = 0.0
    still = Recording(
        dynamics.robot.joint_names, times, q + rounding[0], None, efforts + rounding[1]
    )
    result = diagnose_recording(dynamics, still)
    assert kinds(result) == []
    assert math.isnan(result.explained)
    for joint in result.joints:
        assert math.isnan(joint.explained)
        reasons = 'this joint rested', 'the measured effort of this joint never changes'
        assert joint.friction.unknown_because in reasons
        assert joint.friction.damping.value == joint.friction.coulomb.value == 0.0


def test_a_joint_held_by_friction_does_not_spoil_the_rest():
    dynamics = InverseDynamics(load_urdf(ROBOTS['stanford']))
    rng = np.random.default_rng(0)
    times = np.arange(0.0, 20.0, 0.002)
    q, qd, qdd = exciting(dynamics.robot, times, rng)
    q[:, 2], qd[:, 2], qdd[:, 2] = q[0, 2], 0.0, 0.0  # joint 3 is the only prismatic joint
    efforts = dynamics.efforts(q, qd, qdd)
    efforts[:, 2] = 5.0 * np.sin(times)
    result = diagnose_recording(
        dynamics, Recording(dynamics.robot.joint_names, times, q, qd, efforts)
    )
    held = next(joint for joint in result.joints if joint.name == 'joint_3')
    assert held.friction.unknown_because == 'this joint rested'
    assert held.explained < 0.1
    assert result.explained_corrected > 0.998


def test_friction_of_the_model_is_included_in_the_fit():
    dynamics, recording = run('seven_dof', friction=(1.0, 2.0))
    dynamics.set_friction(1.0, 2.0)
    result = diagnose_recording(dynamics, recording)
    assert result.explained > 0.998
    found = [joint.friction.damping.value for joint in result.joints]
    assert found == pytest.approx([1.0] * 7, 0.1)


# ---- Faults --------------------------------------------------------------------------------


def test_finds_currents_with_their_factors():
    dynamics, recording = run('seven_dof', friction=(2.0, 2.0), rate=500.0)
    factors = np.array([0.05, 0.08, 0.1, 0.2, 0.4, 0.6, 0.7])
    result = diagnose_recording(dynamics, recording._replace(efforts=recording.efforts * factors))
    (diagnosis,) = result.faults
    assert diagnosis.kind.value == 'scale'
    assert 'proportional' in headline(diagnosis)
    found = dict(zip(diagnosis.joints, diagnosis.values, strict=True))
    # The last joint moves hardly any mass, so that its effort does not show its unit.
    assert set(recording.joint_names) - set(found) <= {'wrist_roll'}
    for joint, factor in zip(recording.joint_names, factors, strict=True):
        assert found.get(joint, factor) == pytest.approx(factor, rel=0.05)
    # Friction is reported in N m, not in the unit of the recording.
    assert result.joints[1].friction.coulomb.value == pytest.approx(2.0, rel=0.1)
    if 'wrist_roll' not in found:
        assert 'unit' in result.joints[-1].friction.unknown_because


@EVERY_ROBOT
@pytest.mark.parametrize('in_commands', [False, True])
def test_gravity_may_be_left_out_of_what_is_measured(name, in_commands):
    dynamics, recording = run(name, friction=friction_of(name))
    convention = GravityConvention(in_commands, in_measured=False)
    result = diagnose_recording(dynamics, recording, convention=convention)
    assert kinds(result) == ['gravity_measured']
    assert result.faults[0].is_commanded == in_commands
    assert result.explained_corrected > 0.99
    lacking = recording.efforts - dynamics.gravity_efforts(recording.positions)
    recording = recording._replace(efforts=lacking)
    result = diagnose_recording(dynamics, recording, convention=convention)
    assert kinds(result) == []
    assert result.explained_corrected > 0.99


def test_finds_a_payload_on_a_given_link():
    recording = run('seven_dof', act=lambda real: real.set_payload('link_4', 2.0, (0.0, -0.1, 0)))
    result = diagnose_recording(*recording, link='link_4')
    assert result.faults[0].values == pytest.approx((2.0, 0.0, -0.1, 0.0), abs=0.05)


def test_friction_of_a_joint_that_is_not_measured_or_explained_is_unknown(rng):
    dynamics, recording = run('seven_dof')
    efforts = recording.efforts.copy()
    efforts[:, 1] = 3.5
    efforts[:, 3] = 0.1 * np.cumsum(rng.standard_normal(len(efforts)))
    result = diagnose_recording(dynamics, recording._replace(efforts=efforts))
    assert [(d.kind.value, d.joints) for d in result.faults] == [
        ('not_measured', ('shoulder_lift',)),
        ('unexplained', ('elbow',)),
    ]
    reasons = [joint.friction.unknown_because for joint in result.joints]
    assert reasons[1] == 'the measured effort of this joint never changes'
    assert reasons[3] == 'the model does not explain the effort of this joint'
    all_zero = diagnose_recording(dynamics, recording._replace(efforts=np.zeros_like(efforts)))
    assert kinds(all_zero) == ['not_measured']
    assert math.isnan(all_zero.explained)


def test_finds_several_faults_at_once():
    dynamics, recording = run(
        'seven_dof',
        friction=(1.0, 1.0),
        act=lambda real: real.set_payload('tool0', 1.5, (0.0, 0.05, 0.05)),
    )
    efforts = recording.efforts - dynamics.gravity_efforts(recording.positions)
    efforts[:, 2] *= -1.0
    result = diagnose_recording(dynamics, recording._replace(efforts=efforts))
    assert kinds(result) == ['gravity_compensated', 'sign', 'payload']
    assert result.faults[1].joints == ('arm_roll',)
    assert result.faults[2].values[0] == pytest.approx(1.5, rel=0.03)


def test_small_model_errors_are_not_faults():
    dynamics, recording = run('seven_dof', friction=(1.0, 1.0))
    efforts = recording.efforts * np.linspace(0.93, 1.07, 7)
    assert kinds(diagnose_recording(dynamics, recording._replace(efforts=efforts))) == []


@settings(max_examples=2)
@given(
    name=st.sampled_from(sorted(ROBOTS)),
    seed=st.integers(0, 10_000),
    mass=st.floats(1.0, 4.0),
    com=st.tuples(*3 * [st.floats(-0.1, 0.1)]),
    friction=st.tuples(st.floats(0.0, 2.0), st.floats(0.0, 2.0)),
)
def test_faults_are_found_on_any_motion(name, seed, mass, com, friction):
    dynamics, healthy = run(name, seed, friction=friction)
    assert kinds(diagnose_recording(dynamics, healthy)) == []
    j = seed % len(healthy.joint_names)
    efforts = healthy.efforts.copy()
    efforts[:, j] *= -1.0
    assert kinds(diagnose_recording(dynamics, healthy._replace(efforts=efforts))) == ['sign']
    _, loaded = run(
        name,
        seed,
        friction=friction,
        rate=200.0,
        act=lambda real: real.set_payload(TIP[name], mass, com),
    )
    (diagnosis,) = diagnose_recording(dynamics, loaded, link=TIP[name]).faults
    assert diagnosis.kind.value == 'payload'
    assert diagnosis.values[0] == pytest.approx(mass, rel=0.05)


# ---- Unknown friction ----------------------------------------------------------------------


def swinging(positions, velocities, accelerations):
    """Return a recording of a pendulum with friction on a given motion at 500 Hz."""
    dynamics = InverseDynamics(load_urdf(ROOT / 'test' / 'robots' / 'pendulum.urdf'))
    dynamics.set_friction(0.5, 0.3)
    states = [np.asarray(x, dtype=float)[:, None] for x in (positions, velocities, accelerations)]
    times = 0.002 * np.arange(len(positions))
    recording = Recording(('swing',), times, *states[:2], dynamics.efforts(*states))
    return InverseDynamics(dynamics.robot), recording


T = 0.002 * np.arange(5000)
SIGN = np.where(T % 4.0 < 2.0, 1.0, -1.0)
ONE_WAY = 0.3 * T - 0.05 * np.cos(T), 0.3 + 0.05 * np.sin(T), 0.05 * np.cos(T)
ONE_SPEED = 0.3 * np.abs(T % 4.0 - 2.0), -0.3 * SIGN, 0.0 * T


@pytest.mark.parametrize('motion', [ONE_WAY, ONE_SPEED], ids=['one direction', 'one speed'])
def test_friction_is_unknown_for_such_motion(motion):
    result = diagnose_recording(*swinging(*motion))
    assert 'do not distinguish' in result.joints[0].friction.unknown_because


# ---- Imperfect recordings ------------------------------------------------------------------


def jittery(recording):
    rng, count = np.random.default_rng(0), len(recording.times)
    times = recording.times + 0.0003 * rng.standard_normal(count)
    times[1::50] = times[:-1:50]
    return samples_of(recording._replace(times=times), rng.random(count) > 0.1)


def in_separate_messages(recording):
    q, tau = recording.positions.copy(), recording.efforts.copy()
    q[::2, :3] = tau[::2, :3] = np.nan
    q[1::2, 3:] = tau[1::2, 3:] = np.nan
    return recording._replace(positions=q, efforts=tau)


def shuffled(recording):
    order = np.random.default_rng(0).permutation(len(recording.joint_names))
    return recording._replace(
        joint_names=tuple(recording.joint_names[i] for i in order),
        positions=recording.positions[:, order],
        efforts=recording.efforts[:, order],
    )


def without_one_effort(recording):
    efforts = recording.efforts.copy()
    efforts[:, 0] = np.nan
    return recording._replace(efforts=efforts)


def with_a_gap(recording):
    return samples_of(recording, (recording.times < 8.0) | (recording.times > 9.0))


MANGLED = [
    (jittery, 'duplicate'),
    (in_separate_messages, ''),
    (shuffled, ''),
    (without_one_effort, ''),
    (with_a_gap, 'differentiated in 2 pieces'),
]


@pytest.mark.parametrize(('mangle', 'note'), MANGLED)
def test_mangled_recordings_are_compared(mangle, note):
    dynamics, recording = run('branched', has_velocities=False, friction=(1.0, 1.0))
    recording = mangle(recording)
    result = diagnose_recording(dynamics, recording)
    assert kinds(result) == []
    assert result.explained_corrected > 0.99
    assert note in ' '.join(result.motion.notes)
    has_effort = np.isfinite(recording.efforts).any(axis=0)
    names = [name for name, has in zip(recording.joint_names, has_effort, strict=True) if has]
    assert [joint.name for joint in result.joints] == names
    for joint in result.joints:
        assert joint.friction.damping.value == pytest.approx(1.0, rel=0.15)
    inside = (result.motion.times > 7.95) & (result.motion.times < 9.05)
    assert inside.any() == (mangle is not with_a_gap)


@pytest.mark.parametrize('wrong', [0.0, -1.0])
def test_inconsistent_velocities_are_not_used(wrong):
    dynamics, recording = run('seven_dof')
    velocities = recording.velocities.copy()
    velocities[:, 2] *= wrong
    result = diagnose_recording(dynamics, recording._replace(velocities=velocities))
    assert result.explained > 0.998
    assert 'arm_roll' in result.motion.notes[0]


def test_positions_of_continuous_joints_are_unwrapped():
    dynamics = InverseDynamics(load_urdf(ROOT / 'test' / 'robots' / 'continuous.urdf'))
    t = 0.002 * np.arange(6000)
    q = np.column_stack([1.5 * t + np.sin(3.0 * t)] * 2)
    qd = np.column_stack([1.5 + 3.0 * np.cos(3.0 * t)] * 2)
    qdd = np.column_stack([-9.0 * np.sin(3.0 * t)] * 2)
    rolled = (q + np.pi) % (2.0 * np.pi) - np.pi
    recording = Recording(
        dynamics.robot.joint_names, t, rolled, None, dynamics.efforts(q, qd, qdd)
    )
    assert diagnose_recording(dynamics, recording).explained > 0.999


def test_derivatives_are_accurate_and_described():
    _, recording = run('branched', encoder_noise=0.0, has_velocities=False, rate=500.0)
    t = recording.times
    positions = np.column_stack([np.sin(2.0 * np.pi * f * t) for f in (0.2, 0.5, 1.0, 1.5, 2.0)])
    motion = derive(recording._replace(positions=positions))
    for j, f in enumerate((0.2, 0.5, 1.0, 1.5, 2.0)):
        w = 2.0 * np.pi * f
        assert motion.qd[:, j] == pytest.approx(w * np.cos(w * motion.times), abs=1e-3 * w)
        assert motion.qdd[:, j] == pytest.approx(
            -w * w * np.sin(w * motion.times), abs=2e-3 * w * w
        )
    assert 'Savitzky-Golay' in motion.method
    assert '500 Hz' in motion.method
    assert 0.05 < motion.times[0] < 0.1


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'joint_names': tuple('abcde')}, "joint 'a', which robot 'branched' does not have"),
        ({'positions': np.zeros((3, 5))}, 'positions have shape'),
        ({'efforts': np.full((2000, 5), np.nan)}, 'no joint has a measured effort'),
        ({'times': np.arange(2000.0)}, '1 samples/s, expected at least 20'),
        ({'times': 1e-4 * np.arange(2000.0)}, 'too short to be differentiated'),
        ({'times': np.full(2000, np.nan)}, 'one of the times is nan'),
        ({'times': np.tile(0.01 * np.arange(1000), 2)}, 'time goes back by 9.99 s, 9.99 s after'),
    ],
)
def test_invalid_recordings_are_explained(change, words):
    dynamics, recording = run('branched')
    with pytest.raises(RecordingError, match=words):
        diagnose_recording(dynamics, recording._replace(**change))


def test_an_unknown_link_is_an_error():
    with pytest.raises(ConfigurationError, match="link 'tool9' does not exist"):
        diagnose_recording(*run('branched', rate=100.0), link='tool9')


def test_a_load_in_the_palm_is_found_while_friction_holds_the_fingers():
    real = InverseDynamics(load_urdf(GRIPPER_ARM))
    names = real.robot.joint_names
    real.set_payload('palm', 0.5, (0.0, 0.02, 0.05))
    times = np.arange(0.0, 20.0, 0.002)
    q, qd, qdd = exciting(real.robot, times, np.random.default_rng(0))
    finger = names.index('finger_left')
    q[:, finger], qd[:, finger], qdd[:, finger] = q[0, finger], 0.0, 0.0
    efforts = real.efforts(q, qd, qdd)
    efforts[:, finger] = 0.3 * np.sin(times)
    result = diagnose_recording(
        InverseDynamics(real.robot), Recording(names, times, q, qd, efforts)
    )
    assert kinds(result) == ['payload']
    (diagnosis,) = result.faults
    assert diagnosis.link == 'palm'
    assert diagnosis.values[0] == pytest.approx(0.5, rel=0.05)


# ---- Links and parameters ------------------------------------------------------------------


def test_tip_links_are_the_default_for_loads():
    assert tip_links(load_urdf(ROBOTS['stanford'])) == ('tool0',)
    assert tip_links(load_urdf(ROBOTS['seven_dof'])) == ('tool0',)
    assert 'right_forearm' in tip_links(load_urdf(ROBOTS['branched']))
    palm, *fingers = tip_links(load_urdf(GRIPPER_ARM))
    assert (palm, len(fingers)) == ('palm', 2)


def test_parameters_are_decimals_in_yaml():
    yaml = pytest.importorskip('yaml')
    known = [Friction(Value(1.0), Value(2.5), Value(0.1)), Friction(Value(3e-7))]
    fits = {'a': known[0], 'it"s': Friction(unknown_because='it rested'), 'c': known[1]}
    text = friction_parameters(fits, [0.5, 0.0, 0.0])
    parameters = yaml.safe_load(text)['/**']['ros__parameters']
    assert parameters == {
        'joints': ['a', 'it"s', 'c'],
        'include_friction': True,
        'damping': [1.0, -1.0, 3e-7],
        'coulomb': [2.5, -1.0, 0.0],
        'load_friction': [0.1, 0.0, 0.0],
        'armature': [0.5, 0.0, 0.0],
    }
    assert all(isinstance(x, float) for x in parameters['damping'] + parameters['coulomb'])
    assert 'it"s: friction unknown, because it rested' in text
