"""Findings on simulated recordings with the flaws of real ones: credible ones, and no others."""

from dataclasses import replace
import math

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.analysis.diagnosis import diagnose_recording
from inverse_dynamics_node.report.compare_report import (
    comparison_table,
    verdict,
)
from inverse_dynamics_node.report.diagnosis_text import diagnosis_warning
from inverse_dynamics_node.report.tables import motion_notes
import numpy as np
import pytest
from runs import EVERY_ROBOT, LONG, run, samples_of
from scipy.signal import butter, sosfiltfilt


def kinds(result):
    return [diagnosis.kind.value for diagnosis in result.faults]


def states(recording):
    q, qd = recording.positions, recording.velocities
    return q, qd, np.gradient(qd, recording.times, axis=0)


# ---- Credible causes -----------------------------------------------------------------------


def test_lack_of_gravity_is_not_reported_for_efforts_that_it_does_not_explain(rng):
    dynamics, recording = run('seven_dof')
    t = recording.times[:, None]
    q = recording.positions[:1] + 0.1 * np.sin(0.2 * t + np.arange(7))
    qd = 0.02 * np.cos(0.2 * t + np.arange(7))
    # A tenth of gravity, as if in another unit, and something else that is not in the model.
    efforts = 0.1 * dynamics.gravity_efforts(q) + 2.0 * np.sin(0.7 * t + 2.0 * np.arange(7))
    result = diagnose_recording(
        dynamics, recording._replace(positions=q, velocities=qd, efforts=efforts)
    )
    assert result.explained < -1.0
    assert kinds(result) == ['unexplained']


def test_friction_and_offset_are_told_apart():
    dynamics, recording = run('seven_dof', friction=(6.0, 6.0))
    efforts = recording.efforts.copy()
    efforts[:, 3] += 5.0
    result = diagnose_recording(dynamics, recording._replace(efforts=efforts))
    (diagnosis,) = result.faults
    assert (diagnosis.kind.value, diagnosis.joints) == ('offset', ('elbow',))
    elbow = result.joints[3]
    assert elbow.friction.coulomb.value == pytest.approx(6.0, rel=0.1)
    assert elbow.friction.offset.value == pytest.approx(5.0, rel=0.05)
    assert elbow.rms_corrected < 0.1 * elbow.rms_residual
    words = str(diagnosis_warning(diagnosis))
    assert f': elbow {diagnosis.values[0]:.3g} N m' in words


@pytest.mark.parametrize('quantum', [0.0, 0.1])
def test_noise_floor_is_reported_and_explained(quantum, rng):
    dynamics, recording = run('seven_dof', rate=500.0, effort_noise=0.0, encoder_noise=0.0)
    noise = np.array([0.1, 0.2, 0.3, 0.1, 0.2, 0.5, 5.0])
    efforts = recording.efforts + noise * rng.standard_normal(recording.efforts.shape)
    if quantum:
        efforts = quantum * np.round(efforts / quantum)
    result = diagnose_recording(dynamics, recording._replace(efforts=efforts))
    # The effort of the last joint is noise, of which the model explains nothing.
    assert result.joints[6].explained_corrected < 0.3
    assert kinds(result) == []
    for joint in result.joints:
        assert joint.noise == pytest.approx(joint.rms_corrected, rel=0.4)
    last = comparison_table(result, ()).splitlines()[8]
    assert last.endswith('(noise)')


def test_residuals_are_beside_percentages_and_the_same_everywhere():
    result = diagnose_recording(*run('seven_dof', friction=(2.0, 2.0)))
    squares = [(j.rms_measured**2, j.rms_residual**2, j.rms_corrected**2) for j in result.joints]
    measured, residual, corrected = np.sum(squares, axis=0)
    assert result.explained == pytest.approx(1.0 - residual / measured)
    assert result.explained_corrected == pytest.approx(1.0 - corrected / measured)
    text = verdict(result)
    for value in (measured, residual, corrected):
        assert f'{math.sqrt(value / 7):.3g} N m' in text
    rows = comparison_table(result, ()).splitlines()[2:9]
    for joint, row in zip(result.joints, rows, strict=True):
        assert row.split()[7] == f'{joint.rms_corrected:.3g}'
        assert joint.explained_corrected == pytest.approx(
            1.0 - (joint.rms_corrected / joint.rms_measured) ** 2
        )


def test_no_payload_is_reported_far_from_its_link():
    recording = run('seven_dof', act=lambda real: real.set_payload('tool0', 3.0, (0.2, 0.0, 0.8)))
    result = diagnose_recording(*recording)
    assert result.explained < 0.5
    assert result.faults
    for diagnosis in result.faults:
        assert diagnosis.kind.value != 'payload' or np.linalg.norm(diagnosis.values[1:]) < 0.5


def test_no_payload_is_reported_at_a_tip_that_did_not_move():
    dynamics, recording = run('branched', effort_noise=0.0)
    robot = dynamics.robot
    real = InverseDynamics(robot)
    real.set_payload('right_forearm', 2.0, (0.0, 0.0, 0.1))
    q, qd = recording.positions.copy(), recording.velocities.copy()
    qdd = np.gradient(qd, recording.times, axis=0)
    held = [j for j, name in enumerate(robot.joint_names) if 'right' not in name]
    q[:, held], qd[:, held], qdd[:, held] = q[0, held], 0.0, 0.0
    result = diagnose_recording(
        dynamics, recording._replace(positions=q, velocities=qd, efforts=real.efforts(q, qd, qdd))
    )
    (diagnosis,) = result.faults
    assert (diagnosis.kind.value, diagnosis.link) == ('payload', 'right_forearm')
    left = diagnose_recording(dynamics, recording._replace(positions=q, velocities=qd,
                    efforts=real.efforts(q, qd, qdd)), link='left_arm')  # fmt: skip
    assert 'payload' not in kinds(left)


@pytest.mark.parametrize('factor', [1000.0, 0.102])
def test_finds_a_unit_of_all_joints_even_if_some_hardly_moved(factor, rng):
    dynamics, recording = run('seven_dof')
    q, qd = recording.positions.copy(), recording.velocities.copy()
    qdd = np.gradient(qd, recording.times, axis=0)
    for j in (0, 2, 4, 5, 6):
        q[:, j], qd[:, j], qdd[:, j] = q[0, j], 0.0, 0.0
    real = InverseDynamics(dynamics.robot)
    real.set_friction(1.0, 1.0)
    efforts = real.efforts(q, qd, qdd)
    efforts += 0.2 * np.sin(0.5 * recording.times)[:, None]  # dry friction at rest
    efforts += 0.02 * rng.standard_normal(efforts.shape)
    still = recording._replace(positions=q, velocities=qd, efforts=factor * efforts)
    (diagnosis,) = diagnose_recording(dynamics, still).faults
    assert (diagnosis.kind.value, diagnosis.joints) == ('unit', dynamics.robot.joint_names)
    assert diagnosis.values[0] == pytest.approx(factor, rel=0.05)


@EVERY_ROBOT
@pytest.mark.parametrize('begin', [0.0, 10.0])
def test_nothing_is_found_in_a_short_recording(name, begin):
    dynamics, recording = run(name, friction=(1.0, 1.0))
    efforts = recording.efforts.copy()
    efforts[:, [1, 2]] = efforts[:, [2, 1]]
    used = (recording.times >= begin) & (recording.times < begin + 2.5)
    result = diagnose_recording(dynamics, samples_of(recording._replace(efforts=efforts), used))
    assert kinds(result) == []
    assert 'too short' in verdict(result)


def test_friction_that_grows_with_the_load_is_fitted():
    per_load = np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    dynamics, recording = run(
        'seven_dof', act=lambda real: real.set_friction(1.0, 3.0, load_friction=per_load)
    )
    fits = [joint.friction for joint in diagnose_recording(dynamics, recording).joints]
    assert fits[1].load_friction.value == pytest.approx(0.2, rel=0.15)
    assert fits[1].coulomb.value == pytest.approx(3.0, rel=0.15)
    assert not any(fit.load_friction.value for fit in fits[2:])


# ---- Flaws of recordings -------------------------------------------------------------------


@EVERY_ROBOT
@pytest.mark.parametrize('lag', [0.02, 0.2])
def test_velocities_that_lag_the_positions_are_not_used(name, lag):
    rate = 200.0
    dynamics, recording = run(name, friction=(1.0, 1.0), rate=rate)
    shift = round(lag * rate)
    late = np.vstack([np.tile(recording.velocities[:1], (shift, 1)), recording.velocities])
    result = diagnose_recording(
        dynamics, recording._replace(velocities=late[: len(recording.times)])
    )
    assert kinds(result) == []
    assert result.explained_corrected > 0.995
    (note,) = result.motion.notes
    assert f'recorded velocities of {", ".join(recording.joint_names)} do not match' in note
    assert diagnose_recording(dynamics, recording).motion.notes == ()


@EVERY_ROBOT
@pytest.mark.parametrize('rate', [125.0, pytest.param(500.0, marks=LONG)])
def test_efforts_that_were_filtered_before_are_reported(name, rate):
    dynamics, recording = run(name, friction=(1.0, 3.0), rate=rate)
    sos = butter(4, 2.0, fs=rate, output='sos')
    filtered = sosfiltfilt(sos, recording.efforts, axis=0)
    result = diagnose_recording(dynamics, recording._replace(efforts=filtered))
    assert 1.0 < result.motion.cut_off < 5.0
    assert any('a low-pass filter' in note for note in motion_notes(result.motion))
    assert all(math.isnan(joint.noise) for joint in result.joints)
    for quantum in (1e-9, 0.05):
        raw = quantum * np.round(recording.efforts / quantum)
        assert (
            diagnose_recording(dynamics, recording._replace(efforts=raw)).motion.cut_off
            == math.inf
        )


# ---- Many wrong links ----------------------------------------------------------------------


def test_many_wrong_links_are_not_reported_as_a_payload():
    dynamics, recording = run('branched', rate=100.0, friction=(1.0, 1.0))
    robot, rng = dynamics.robot, np.random.default_rng(0)
    factor = np.exp(0.3 * rng.standard_normal(len(robot.mass)))
    shift = 0.03 * rng.standard_normal(robot.com.shape) * (robot.mass > 0.0)[:, None]
    inertia = robot.inertia * factor[:, None, None]
    real = replace(robot, mass=robot.mass * factor, com=robot.com + shift, inertia=inertia)
    change = InverseDynamics(real).efforts(*states(recording)) - dynamics.efforts(
        *states(recording)
    )
    result = diagnose_recording(dynamics, recording._replace(efforts=recording.efforts + change))
    assert 'payload' not in kinds(result)
    assert kinds(result)[-1] == 'bodies'
    diagnosis = result.faults[-1]
    assert all(joint.rms_corrected < 0.5 * joint.rms_residual for joint in result.joints)
    assert 'inverse_dynamics identify' in diagnosis_warning(diagnosis).hint


# ---- Causes that act during a part of the recording ----------------------------------------


def under_gravity(robot, q, gravity):
    """Return gravity efforts for positions and gravity vectors of shape (K, n) and (K, 3)."""
    parts = [InverseDynamics(robot, axis).gravity_efforts(q) for axis in np.eye(3)]
    return sum(gravity[:, [k]] * parts[k] for k in range(3))


@pytest.mark.parametrize(
    ('name', 'link', 'begin', 'end'),
    [
        ('branched', 'right_forearm', 3.0, 20.0),
        pytest.param('seven_dof', 'tool0', 6.0, 12.0, marks=LONG),
    ],
)
def test_a_load_that_was_picked_up_is_reported_with_its_times(name, link, begin, end):
    dynamics, recording = run(name, friction=(1.0, 1.0), rate=100.0)
    real = InverseDynamics(dynamics.robot)
    real.set_payload(link, 1.5, (0.0, 0.02, 0.05))
    load = real.efforts(*states(recording)) - dynamics.efforts(*states(recording))
    carried = (recording.times >= begin) & (recording.times < end)
    result = diagnose_recording(
        dynamics, recording._replace(efforts=recording.efforts + load * carried[:, None])
    )
    (diagnosis,) = result.faults
    assert (diagnosis.kind.value, diagnosis.link) == ('payload', link)
    assert diagnosis.interval == pytest.approx((begin, end), abs=0.15)
    assert diagnosis.values == pytest.approx((1.5, 0.0, 0.02, 0.05), abs=0.05)
    assert result.explained_corrected > 0.999
    assert f'From {begin:.1f} s to' in verdict(result)


@pytest.mark.parametrize(
    ('name', 'begin'),
    [('branched', 8.0), pytest.param('seven_dof', 4.0, marks=LONG)],
)
def test_a_base_that_tilts_is_reported_with_its_times(name, begin):
    dynamics, recording = run(name, friction=(1.0, 1.0), rate=100.0)
    times, q = recording.times, recording.positions
    angle = np.radians(19.0) * np.clip(times - begin, 0.0, 1.0)
    gravity = 9.80665 * np.column_stack([0.0 * angle, np.sin(angle), -np.cos(angle)])
    change = under_gravity(dynamics.robot, q, gravity) - dynamics.gravity_efforts(q)
    result = diagnose_recording(dynamics, recording._replace(efforts=recording.efforts + change))
    (diagnosis,) = result.faults
    assert diagnosis.kind.value == 'mounting'
    assert math.degrees(diagnosis.angle) == pytest.approx(19.0, abs=2.0)
    assert begin < diagnosis.interval[0] < begin + 1.0
    assert diagnosis.interval[1] > 19.0
    assert result.explained_corrected > 0.99
    assert result.explained_corrected > result.explained + 0.01
