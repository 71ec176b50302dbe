"""Velocities compared with positions: sign, size, zeros, lags, and the motion that they need."""

from inverse_dynamics_node.analysis.diagnosis import FaultKind
from inverse_dynamics_node.analysis.diagnosis.velocities import check_velocities
from inverse_dynamics_node.report.diagnosis_text import headline
import numpy as np
import pytest

TIMES = np.arange(0.0, 10.0, 0.02)
RATE = 2.0  # [rad/s] of the sine


def moving(amplitude, lag=0.0):
    """Return positions and velocities of a joint, with velocities late by ``lag`` [s]."""
    return (
        amplitude * np.sin(RATE * TIMES)[:, None],
        amplitude * RATE * np.cos(RATE * (TIMES - lag))[:, None],
    )


def checked(q, qd, times=TIMES):
    return check_velocities(('a',), times, q, qd)


WRONG = [
    (-1.0, -1.0, 'the velocity of a has the wrong sign'),
    (57.3, 57.3, 'the velocity of a is 57.3 times that of its position'),
    (0.0, 0.0, 'the velocity of a is zero while the joint moves'),
]


@pytest.mark.parametrize('amplitude', [0.05, 1.0])
@pytest.mark.parametrize(('factor', 'value', 'words'), WRONG)
def test_wrong_velocities_are_named(amplitude, factor, value, words, rng):
    q, qd = moving(amplitude)
    noise = 1e-4 * rng.standard_normal((2, *q.shape))
    (fault,) = checked(q + noise[0], factor * qd + noise[1]).faults
    assert (fault.kind, fault.joints) == (FaultKind.VELOCITY, ('a',))
    assert fault.values == pytest.approx((value,), abs=0.05, rel=0.05)
    assert words.partition(' 57')[0] in headline(fault)


def test_velocities_of_another_motion_are_named():
    q, _ = moving(0.5)
    (fault,) = checked(q, np.sin(3.1 * TIMES)[:, None]).faults
    assert np.isnan(fault.values[0])
    assert 'contradicts its position' in headline(fault)


@pytest.mark.parametrize('lag', [0.1, 0.2])
def test_a_lag_is_named_and_measured(lag):
    (fault,) = checked(*moving(0.5, lag)).faults
    assert fault.kind is FaultKind.VELOCITY_LAG
    assert fault.values == pytest.approx((lag,), abs=0.02)
    assert f'by {1e3 * lag:.0f} ms' in headline(fault)


@pytest.mark.parametrize('amplitude', [0.05, 1.0])
def test_right_velocities_agree_at_irregular_times_and_beside_gaps(amplitude, rng):
    q, qd = moving(amplitude)
    times = TIMES + rng.uniform(-0.009, 0.009, len(TIMES))
    keep = (TIMES < 4.0) | (TIMES > 6.5)
    for chosen in (np.ones(len(TIMES), dtype=bool), keep):
        found = check_velocities(('a',), times[chosen], q[chosen], qd[chosen])
        assert found.compared.all()
        assert found.faults == ()


def test_a_joint_at_rest_is_not_compared_and_one_without_velocity_needs_no_check(rng):
    rest = 1e-4 * rng.standard_normal((len(TIMES), 1))
    found = checked(rest, 0.05 * rng.standard_normal(rest.shape))
    assert not found.compared.any()
    assert found.faults == ()
    q, qd = moving(0.5)
    assert checked(q, np.full_like(qd, np.nan)).compared.all()
