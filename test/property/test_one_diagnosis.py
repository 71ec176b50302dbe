"""
Known faults of simulated robots are named, and nothing false is said.

`compare` (of a recording) and `watch` (of a few seconds) name the same fault in the same words.
"""

from collections.abc import Callable
import math
from typing import NamedTuple

from benchmarks import confusion
from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.diagnosis import diagnose_recording, FaultKind
from inverse_dynamics_node.analysis.diagnosis.live import (
    check_agreement,
    LiveSamples,
    Outcome,
)
from inverse_dynamics_node.analysis.recordings.signals import Recording
from inverse_dynamics_node.report.compare_report import verdict
from inverse_dynamics_node.report.diagnosis_text import agreement_sentence, headline
import numpy as np
import pytest
from robot_files import real_robots
from runs import exciting, ROBOTS

SEED = 1979
LONG = pytest.mark.long

# ---- Robots that differ from their description, as in doc/evidence/confusion.md -------------

QUICK = 'none', 'payload of 2 kg', 'missing gravity', 'external force', 'base tilted by 10 degrees'
CASES = [
    pytest.param(fault, name, marks=[] if (fault in QUICK and name == 'seven_dof') else LONG)
    for fault in confusion.FAULTS
    for name in ('seven_dof', 'Stanford')
]


@pytest.mark.parametrize(('fault', 'name'), CASES)
def test_a_fault_is_named_beside_wrong_links(fault, name):
    result = confusion.run(fault, name, SEED)
    assert result.is_named
    assert [text for text, is_true in result.statements if not is_true] == []


@pytest.mark.long
@pytest.mark.skipif(not real_robots(), reason='example-robot-data is not installed')
def test_the_table_names_the_faults_and_says_little_that_is_false():
    results = [confusion.run(fault, name, SEED) for fault in confusion.FAULTS
               for name in confusion.ROBOTS]  # fmt: skip
    faulty = [each.is_named for each in results if each.fault != 'none']
    said = [is_true for each in results for _, is_true in each.statements]
    assert np.mean(faulty) >= 0.95
    assert np.mean(said) >= 0.98


@pytest.fixture
def case():
    return confusion.Case('seven_dof', np.random.default_rng(SEED))


def kinds(case):
    return {fault.kind for fault in case.run().faults}


def test_the_delay_is_estimated_within_2_ms(case):
    confusion.delay(case)
    (late,) = [fault for fault in case.run().faults if fault.kind is FaultKind.DELAY]
    assert late.values == pytest.approx((0.02,), abs=0.002)


def test_a_delay_of_5_ms_is_not_reported(case):
    case.delay = 0.005
    assert FaultKind.DELAY not in kinds(case)


def test_weaker_gravity_is_not_a_tilt(case):
    angle = np.radians(10.0)
    case.real.set_gravity(8.86 * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
    for fault in case.run().faults:
        if fault.kind is FaultKind.MOUNTING:
            assert np.linalg.norm(fault.values) == pytest.approx(confusion.STANDARD, rel=0.02)


def test_a_counterweight_is_not_an_external_force(case):
    shoulder = case.names.index('shoulder_lift')

    def counterweight(times, q):
        efforts = np.zeros_like(q)
        efforts[:, shoulder] = -20.0 * np.sin(q[:, shoulder])
        return efforts

    case.added = counterweight
    assert FaultKind.EXTERNAL_FORCE not in kinds(case)


# ---- Robots like their description, but for the fault ---------------------------------------


class Planted(NamedTuple):
    """A fault, and what is said about it."""

    kind: FaultKind | None
    act: Callable = lambda real, model: None
    """Changes the dynamics of the real robot, or those of its model."""
    change: Callable = lambda efforts: efforts
    """Changes the measured efforts like a faulty driver."""
    states: Callable = lambda states: states
    """Changes the measured positions and velocities."""
    joints: tuple = ()
    """Columns of the named joints."""
    values: tuple = ()
    words: str = ''
    advice: str = ''


def scaled(column, factor, count=7):
    return np.where(np.arange(count) == column, factor, 1.0)


def noise(efforts):
    filtered = np.convolve(20.0 * np.random.default_rng(0).standard_normal(len(efforts)),
                           np.ones(25), 'same')  # fmt: skip
    return efforts * scaled(3, 0.0) + np.outer(filtered, np.eye(7)[3])


TILTED = 9.80665 * np.array([0.0, math.sin(0.3), -math.cos(0.3)])
ALL = tuple(range(7))
K = FaultKind
FAULTS = {
    'none': Planted(None),
    'friction': Planted(None, lambda real, _: real.set_friction(1.0, 1.5)),
    'sign': Planted(
        K.SIGN,
        change=lambda tau: tau * scaled(1, -1.0),
        joints=(1,),
        words='the wrong sign',
        advice='Change the sign in the driver',
    ),
    'sign of all joints': Planted(K.SIGN, change=np.negative, joints=ALL, words='all joints'),
    'reversed axis': Planted(
        K.REVERSED_AXIS,
        change=lambda tau: tau * scaled(2, -1.0),
        states=lambda states: states * scaled(2, -1.0),
        joints=(2,),
    ),
    'unit': Planted(
        K.UNIT, change=lambda tau: 1000.0 * tau, values=(1000.0,), words='1000 times too large'
    ),
    'scale': Planted(K.SCALE, change=lambda tau: tau * scaled(3, 0.1), joints=(3,), values=(0.1,)),
    'order': Planted(K.ORDER, change=lambda tau: tau[:, [0, 2, 1, 3, 4, 5, 6]], joints=(1, 2)),
    'offset': Planted(
        K.OFFSET, change=lambda tau: tau + 5.0 * np.eye(7)[3], joints=(3,), values=(5.0,)
    ),
    'not measured': Planted(K.NOT_MEASURED, change=lambda tau: tau * scaled(3, 0.0), joints=(3,)),
    'constant': Planted(
        K.NOT_MEASURED, change=lambda tau: tau * scaled(3, 0.0) + 3.5 * np.eye(7)[3], joints=(3,)
    ),
    'unexplained': Planted(K.UNEXPLAINED, change=noise, joints=(3,)),
    'payload': Planted(
        K.PAYLOAD,
        lambda real, _: real.set_payload('tool0', 4.0, (0.02, 0.0, 0.1)),
        values=(4.0, 0.02, 0.0, 0.1),
    ),
    'no tool': Planted(
        K.PAYLOAD,
        lambda _, model: model.set_payload('tool0', 2.0),
        values=(-2.0,),
        words="link 'tool0' lacks 2",
    ),
    'mounting': Planted(
        K.MOUNTING,
        lambda real, _: real.set_gravity(TILTED),
        values=tuple(TILTED),
        words='17 degrees',
        advice='Set gravity to [',
    ),
    'gravity': Planted(
        K.GRAVITY_COMPENSATED,
        lambda real, _: real.set_gravity(np.zeros(3)),
        advice='include_gravity to false',
    ),
    'rotors': Planted(
        K.ROTOR_INERTIA, lambda real, _: real.set_armature(1.0), joints=ALL, values=7 * (1.0,)
    ),
    'degrees': Planted(
        K.POSITIONS, states=np.degrees, words='in degrees, so nothing else can be diagnosed'
    ),
}


@pytest.fixture(scope='module')
def motion():
    """Return a robot, and 10 s of an excitation motion at 100 Hz."""
    robot = load_urdf(ROBOTS['seven_dof'])
    times = np.arange(0.0, 10.0, 0.01)
    return robot, times, np.array(exciting(robot, times, np.random.default_rng(0)))


@pytest.mark.parametrize('fault', FAULTS.values(), ids=FAULTS)
def test_compare_and_watch_say_the_same(motion, fault):
    robot, times, (q, qd, qdd) = motion
    model, real = InverseDynamics(robot), InverseDynamics(robot)
    fault.act(real, model)
    measured = fault.change(real.efforts(q, qd, qdd))
    states = fault.states(np.array([q, qd]))
    modelled = model.efforts(*states, np.gradient(states[1], times, axis=0))
    result = diagnose_recording(model, Recording(robot.joint_names, times, *states, measured))
    live = LiveSamples(robot.joint_names, times, *states, measured, modelled)
    agreement = check_agreement(live, robot, model.gravity)
    if fault.kind is None:
        assert result.faults == agreement.faults == ()
        assert agreement.outcome is Outcome.AGREE
        return
    assert agreement.outcome is Outcome.DIFFER
    (recorded,), (watched,) = result.faults, agreement.faults
    assert recorded.kind is watched.kind is fault.kind
    if fault.joints:
        assert recorded.joints == tuple(robot.joint_names[j] for j in fault.joints)
    assert recorded.values[: len(fault.values)] == pytest.approx(fault.values, rel=0.03, abs=0.01)
    words = headline(recorded)
    assert fault.words in words
    assert headline(watched) == words
    assert words[1:] in verdict(result)
    assert agreement_sentence(agreement).startswith(words)
    assert fault.advice in agreement_sentence(agreement)


@pytest.mark.parametrize(
    'name', ['none', 'sign', 'sign of all joints', 'unit', 'payload', 'mounting']
)
def test_watch_names_a_fault_of_an_arm_at_rest(motion, name):
    fault, (robot, times, (poses, *_)) = FAULTS[name], motion
    model, real = InverseDynamics(robot), InverseDynamics(robot)
    fault.act(real, model)
    # The sign of the shoulder shows where it carries weight.
    weight = np.abs(model.gravity_efforts(poses)[:, 1])
    pose = poses[np.argmax(weight)] if fault.kind is K.SIGN else poses[0]
    q = np.tile(pose, (len(times), 1))
    efforts = real.gravity_efforts(q)
    efforts += 0.01 * np.abs(efforts) * np.random.default_rng(0).standard_normal(q.shape)
    measured, modelled = fault.change(efforts), model.gravity_efforts(q)
    live = LiveSamples(robot.joint_names, times, q, 0.0 * q, measured, modelled)
    agreement = check_agreement(live, robot, model.gravity)
    assert not agreement.is_moving
    assert [found.kind for found in agreement.faults] == ([fault.kind] if fault.kind else [])
    for found in agreement.faults:
        assert headline(found) in agreement_sentence(agreement)
        assert fault.advice in agreement_sentence(agreement)
        joints = {robot.joint_names[j] for j in fault.joints}
        assert joints - {*agreement.unchecked} <= {*found.joints} <= joints or not joints
        if found.kind is K.PAYLOAD:
            assert found.values[0] == pytest.approx(fault.values[0], rel=0.2)
            is_known = np.isfinite(found.values[1:]).any()
            assert (' m in the frame of the link; ' in agreement_sentence(agreement)) == is_known
        elif fault.values:
            assert found.values == pytest.approx(fault.values, rel=0.02, abs=0.3)


def test_compare_finds_two_reversed_axes(motion):
    robot, times, (q, qd, qdd) = motion
    model, signs = InverseDynamics(robot), scaled(1, -1.0) * scaled(4, -1.0)
    efforts = signs * model.efforts(q, qd, qdd)
    result = diagnose_recording(
        model, Recording(robot.joint_names, times, signs * q, signs * qd, efforts)
    )
    (fault,) = result.faults
    assert fault.joints == ('shoulder_lift', 'forearm_roll')
    assert result.explained < 0.98 < result.explained_corrected
