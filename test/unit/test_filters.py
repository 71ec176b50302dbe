"""The low-pass filter, on steps whose response is known."""

import math

from inverse_dynamics_node.control.filters import LowPass
import numpy as np
import pytest

CUTOFF = 5.0
TIME_CONSTANT = 1.0 / (2.0 * math.pi * CUTOFF)
STEP = np.array([1.0, -2.0, 4.0])


@pytest.fixture
def low_pass():
    low_pass = LowPass(np.zeros(3), CUTOFF)
    low_pass.update(0.0, np.zeros(3))
    return low_pass


def test_the_first_sample_is_not_filtered():
    assert (LowPass(np.zeros(3), CUTOFF).update(1.0, STEP) == STEP).all()


@pytest.mark.parametrize('parts', [1, 2, 7])
def test_a_step_rises_exponentially_at_any_sampling_rate(low_pass, parts):
    for time in np.linspace(0.0, TIME_CONSTANT, parts + 1)[1:]:
        value = low_pass.update(float(time), STEP)
    assert value == pytest.approx((1.0 - math.exp(-1.0)) * STEP)


def test_elements_with_times_of_their_own_are_filtered_by_them(low_pass):
    times = np.array([0.0, TIME_CONSTANT, 2.0 * TIME_CONSTANT])
    expected = (1.0 - np.exp(-times / TIME_CONSTANT)) * STEP
    assert low_pass.update(times, STEP) == pytest.approx(expected)
    assert low_pass.update(times, 9.0 * STEP) == pytest.approx(expected)


@pytest.mark.parametrize('time', [-0.1, 0.5001])
def test_restarts_after_a_gap_and_a_step_back_in_time(low_pass, time):
    assert (low_pass.update(time, STEP, longest_gap=0.5) == STEP).all()


def test_a_gap_of_the_longest_length_does_not_restart():
    low_pass = LowPass(np.zeros(3), 0.1)
    low_pass.update(0.0, np.zeros(3))
    assert np.abs(low_pass.update(0.5, STEP, longest_gap=0.5)).max() < 2.0


def test_each_element_restarts_on_its_own(low_pass):
    restarts = np.array([False, True, False])
    value = low_pass.update(np.full(3, 0.01), STEP, np.array([1.0, 1.0, 0.001]), restarts)
    assert value[0] == pytest.approx(1.0 - math.exp(-0.01 / TIME_CONSTANT))
    assert (value[1:] == STEP[1:]).all()


@pytest.mark.parametrize('absurd', [math.nan, math.inf, 1.7e308])
def test_absurd_samples_do_not_stay(low_pass, absurd):
    low_pass.update(0.01, np.array([absurd, -2.0, 4.0]))
    value = low_pass.update(0.02, np.array([-1e308, -2.0, 4.0]))
    assert np.isfinite(value).all()


def test_without_a_cutoff_samples_pass_unchanged():
    low_pass = LowPass(np.zeros(3))
    sample = STEP.copy()
    value = low_pass.update(0.0, sample)
    sample[:] = 9.0
    assert (value == STEP).all()


def test_continues_from_a_value_that_was_set(low_pass):
    low_pass.value = -STEP
    assert low_pass.update(TIME_CONSTANT, STEP) == pytest.approx((1.0 - 2.0 / math.e) * STEP)


def test_reset_restarts(low_pass):
    low_pass.reset()
    assert (low_pass.update(0.001, STEP) == STEP).all()
