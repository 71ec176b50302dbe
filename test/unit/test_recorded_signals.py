"""Samples that a recorder repeats, because it is faster than the hardware."""

from inverse_dynamics_node.analysis.recordings.signals import derive, Recording
import numpy as np
import pytest


def moves(t):
    """Return positions, velocities and accelerations of two joints."""
    w = 2.0 * np.pi * np.array([0.3, 0.7])
    angle = w * t[:, None] + np.array([0.0, 1.0])
    return np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)


def recorded(rate, source_rate, duration=20.0, has_velocities=True, jitter=0.0):
    """Record a source; each sample is the newest of the source, with the stamp of the recorder."""
    stamps = np.arange(round(duration * rate)) / rate
    taken = np.floor(stamps * source_rate + 1e-9) / source_rate
    q, qd, qdd = moves(taken)
    rng = np.random.default_rng(0)
    stamps = stamps + jitter / rate * rng.uniform(-1.0, 1.0, len(stamps))
    return Recording(('a', 'b'), stamps, q, qd if has_velocities else None, qdd + 2.0 * q)


def errors_of(motion):
    """Return the relative error of the velocities and accelerations, whatever the time shift."""
    best = []
    for shift in np.linspace(-0.05, 0.05, 201):
        _, qd, qdd = moves(motion.times + shift)
        errors = (rms(motion.qd - qd) / rms(qd), rms(motion.qdd - qdd) / rms(qdd))
        best.append((errors[1], errors[0]))
    return min(best)


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize('has_velocities', [True, False])
@pytest.mark.parametrize(
    ('rate', 'source_rate', 'note'),
    [
        (30.0, 29.4, '30 samples/s were recorded of a source with 29.4 samples/s'),
        (500.0, 480.0, '500 samples/s were recorded of a source with 480 samples/s'),
        (1000.0, 500.0, '1000 samples/s were recorded of a source with 500 samples/s'),
        (1000.0, 100.0, '1000 samples/s were recorded of a source with 100 samples/s'),
    ],
)
def test_repeated_samples_are_removed_and_the_others_spread(
    rate, source_rate, note, has_velocities
):
    motion = derive(recorded(rate, source_rate, has_velocities=has_velocities))
    clean = derive(recorded(source_rate, source_rate, has_velocities=has_velocities))
    assert note in motion.notes[0]
    assert motion.period == pytest.approx(1.0 / source_rate, rel=1e-3)
    for found, expected in zip(errors_of(motion), errors_of(clean), strict=True):
        assert found < expected + 0.002


def test_irregular_repeats_are_removed_but_the_times_of_the_others_are_kept():
    recording = recorded(100.0, 100.0)
    rng = np.random.default_rng(0)
    for k in np.sort(rng.choice(np.arange(2, 1999, 3), 60, replace=False)):
        for values in (recording.positions, recording.velocities, recording.efforts):
            values[k] = values[k - 1]
    motion = derive(recording)
    assert motion.notes[0] == 'removed 60 samples that repeat the one before while the robot moves'
    assert max(errors_of(motion)) < 0.01


def test_recordings_without_repeats_are_unchanged():
    for recording in (recorded(100.0, 500.0), recorded(100.0, 100.0, jitter=0.2)):
        assert derive(recording).notes == ()


def test_a_rest_is_not_a_repeat():
    recording = recorded(100.0, 100.0)
    for values in (recording.positions, recording.velocities, recording.efforts):
        values[500:900] = values[500]
        values[:200] = values[0]
        values[200:260] += 1e-9 * np.arange(60)[:, None]
    motion = derive(recording)
    assert not [note for note in motion.notes if 'repeat' in note]


def test_samples_with_one_time_stamp_are_one_sample():
    recording = recorded(100.0, 100.0)
    rows = np.sort(np.append(np.arange(2000), np.arange(5, 2000, 10)))
    doubled = [each[rows] for each in recording[1:]]
    doubled[3] = doubled[3] + 1e-6 * np.arange(len(rows))[:, None]  # not a repetition
    motion = derive(Recording(recording.joint_names, *doubled))
    assert motion.notes == ('ignored 200 samples with duplicate time stamps',)
    assert max(errors_of(motion)) < 0.01


def test_the_rate_of_smoothed_signals_can_be_limited():
    fast = derive(recorded(500.0, 500.0))
    slow = derive(recorded(500.0, 500.0), 100.0)
    assert slow.period == pytest.approx(0.01)
    assert (fast.window, slow.window) == (51, 11)
    for name in ('times', 'q', 'qd', 'qdd', 'efforts'):
        assert np.array_equal(getattr(slow, name), getattr(fast, name)[::5])
