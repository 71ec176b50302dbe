"""`compare` and `watch` name the same fault of the same data, in the same words."""

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.analysis.diagnosis import diagnose_recording, FaultKind
from inverse_dynamics_node.analysis.diagnosis.live import (
    diagnose_samples,
    LiveSamples,
    Outcome,
)
from inverse_dynamics_node.analysis.recordings.signals import Recording
from inverse_dynamics_node.dynamics.jit import IS_COMPILED
from inverse_dynamics_node.report.agreement_text import sentence
from inverse_dynamics_node.report.compare_report import verdict
from inverse_dynamics_node.report.diagnosis_text import headline
import numpy as np
import pytest
from runs import exciting, ROBOTS

# Without compiled functions these tests take minutes.
pytestmark = pytest.mark.skipif(not IS_COMPILED, reason='numba is not here, or off')

TILTED = 9.80665 * np.array([0.0, np.sin(0.3), -np.cos(0.3)])


def no_change(efforts):
    return efforts


def with_swapped(*columns):
    def change(efforts):
        efforts[:, columns] *= -1.0
        return efforts

    return change


def with_factor_of_elbow(efforts):
    efforts[:, 3] *= 0.1
    return efforts


def with_silent_elbow(efforts):
    efforts[:, 3] = 0.0
    return efforts


def with_other_order(efforts):
    return efforts[:, [0, 2, 1, 3, 4, 5, 6]]


def with_noise_at_elbow(efforts):
    noise = np.random.default_rng(0).standard_normal(len(efforts))
    efforts[:, 3] = np.convolve(20.0 * noise, np.ones(25), 'same')
    return efforts


FAULTS = {
    'none': (None, no_change, None),
    'friction': (lambda real: real.set_friction(1.0, 1.5), no_change, None),
    'sign of one joint': (None, with_swapped(1), FaultKind.SIGN),
    'sign of all joints': (None, with_swapped(*range(7)), FaultKind.SIGN),
    'unit': (None, lambda efforts: 1000.0 * efforts, FaultKind.UNIT),
    'unit of one joint': (None, with_factor_of_elbow, FaultKind.SCALE),
    'order': (None, with_other_order, FaultKind.ORDER),
    'not measured': (None, with_silent_elbow, FaultKind.NOT_MEASURED),
    'payload': (lambda real: real.set_payload('tool0', 4.0), no_change, FaultKind.PAYLOAD),
    'mounting': (lambda real: real.set_gravity(TILTED), no_change, FaultKind.MOUNTING),
    'no gravity': (
        lambda real: real.set_gravity(np.zeros(3)),
        no_change,
        FaultKind.GRAVITY_COMPENSATED,
    ),
    'unexplained': (None, with_noise_at_elbow, FaultKind.UNEXPLAINED),
}


@pytest.fixture(scope='module')
def motion():
    """Return a robot, and 10 s of an excitation motion at 100 Hz."""
    from inverse_dynamics_node import load_urdf

    robot = load_urdf(ROBOTS['seven_dof'])
    times = np.arange(0.0, 10.0, 0.01)
    return robot, times, exciting(robot, times, np.random.default_rng(0))


@pytest.mark.parametrize(('act', 'change', 'kind'), FAULTS.values(), ids=FAULTS)
def test_compare_and_watch_say_the_same(motion, act, change, kind):
    robot, times, (q, qd, qdd) = motion
    model, real = InverseDynamics(robot), InverseDynamics(robot)
    if act is not None:
        act(real)
    measured = change(real.efforts(q, qd, qdd))
    recording = Recording(robot.joint_names, times, q, qd, measured)
    live = LiveSamples(robot.joint_names, times, q, qd, measured, model.efforts(q, qd, qdd))
    result = diagnose_recording(model, recording)
    agreement = diagnose_samples(live, robot, model.gravity)
    kinds = [] if kind is None else [kind]
    assert [fault.kind for fault in result.faults] == kinds
    assert [fault.kind for fault in agreement.faults] == kinds
    assert agreement.outcome is (Outcome.AGREE if kind is None else Outcome.DIFFER)
    for recorded, watched in zip(result.faults, agreement.faults, strict=True):
        words = headline(recorded)
        assert headline(watched) == words
        assert words[1:] in verdict(result)
        assert sentence(agreement).startswith(words)


def distorted(joint_names, times, states, modelled_by, efforts):
    """Return what `compare` and `watch` say of recorded positions, velocities and efforts."""
    recording = Recording(joint_names, times, *states, efforts)
    modelled = modelled_by.efforts(*states, np.gradient(states[1], times, axis=0))
    live = LiveSamples(joint_names, times, *states, efforts, modelled)
    result = diagnose_recording(modelled_by, recording)
    return result, diagnose_samples(live, modelled_by.robot, modelled_by.gravity)


def test_compare_and_watch_find_a_reversed_axis(motion):
    robot, times, (q, qd, qdd) = motion
    model, signs = InverseDynamics(robot), np.ones(7)
    signs[2] = -1.0
    efforts = signs * model.efforts(q, qd, qdd)
    said = distorted(robot.joint_names, times, (signs * q, signs * qd), model, efforts)
    for each in said:
        (fault,) = each.faults
        assert (fault.kind, fault.joints) == (FaultKind.REVERSED_AXIS, ('arm_roll',))
    assert said[0].explained < 0.98
    assert said[0].explained_corrected > 0.998
    assert headline(said[0].faults[0]) == headline(said[1].faults[0])
    assert said[1].outcome is Outcome.DIFFER


def test_compare_finds_two_reversed_axes(motion):
    robot, times, (q, qd, qdd) = motion
    model, signs = InverseDynamics(robot), np.ones(7)
    signs[[1, 4]] = -1.0
    efforts = signs * model.efforts(q, qd, qdd)
    result = diagnose_recording(
        model, Recording(robot.joint_names, times, signs * q, signs * qd, efforts)
    )
    (fault,) = result.faults
    assert fault.joints == ('shoulder_lift', 'forearm_roll')


def test_positions_in_degrees_end_the_diagnosis(motion):
    robot, times, (q, qd, qdd) = motion
    model = InverseDynamics(robot)
    said = distorted(
        robot.joint_names, times, (np.degrees(q), np.degrees(qd)), model, model.efforts(q, qd, qdd)
    )
    for each in said:
        (fault,) = each.faults
        assert fault.kind is FaultKind.POSITIONS
        assert 'in degrees, so nothing else can be diagnosed' in headline(fault)
    assert said[1].outcome is Outcome.DIFFER
