"""The results of the benchmarked code, not their speed."""

from benchmarks import growth, operations, timing
from benchmarks.robots import random_states, stanford
from inverse_dynamics_node import InverseDynamics, load_urdf
import numpy as np
from numpy.testing import assert_allclose
from parity.test_paper_recursion import paper_efforts, STANDARD_GRAVITY
import pytest
from robot_files import ROOT

RELATIVE = 1e-10  # to the largest effort; the order of summation differs


@pytest.fixture(scope='module')
def arm():
    return stanford()


@pytest.mark.long
def test_lagrangian_form_gives_the_same_efforts(arm):
    q, qd, qdd = states = random_states(arm.n, 3)
    efforts = InverseDynamics(arm.model).efforts(*states)
    paper = [paper_efforts(*state, STANDARD_GRAVITY) for state in zip(q, qd, qdd, strict=True)]
    tolerance = RELATIVE * np.abs(efforts).max()
    assert tolerance > 0.0
    for sweep in (growth.kept_sweep, growth.multiplied_sweep):
        tau = np.zeros_like(q)
        sweep(*states, tau, growth.chain_of(arm.model), 1)
        assert_allclose(tau, efforts, rtol=0, atol=tolerance)
        assert_allclose(tau, paper, rtol=0, atol=tolerance)


def test_operations_of_a_pendulum_are_those_counted_by_hand():
    # A rod of 1 kg and 1 m, with c = 0.5 m to its centre of mass and I about that:
    # a = -sin(q) g - c qdd, then tau = I qdd - c a.
    pendulum = load_urdf(ROOT / 'test' / 'robots' / 'pendulum.urdf')
    folded = operations.count_newton_euler(pendulum, folds=True)
    assert folded == operations.Operations(multiplications=4, additions=2, sines=1)
    assert operations.count_newton_euler(pendulum, folds=False).total > folded.total


@pytest.mark.long
def test_straight_line_code_gives_the_same_efforts(arm):
    states = random_states(arm.n, 3)
    efforts = InverseDynamics(arm.model).efforts(*states)
    tau = np.zeros_like(efforts)
    operations.compiled_straight_line(arm.model)(*states, tau, 1)
    # Folding takes numbers within 1e-9 of an integer as that integer.
    assert_allclose(tau, efforts, rtol=0, atol=1e-8 * np.abs(efforts).max())


def test_lagrangian_form_takes_more_operations_the_more_it_multiplies_out(arm):
    recursion = operations.count_newton_euler(arm.model, folds=False).total
    kept = operations.count_lagrange(arm.model, keep=True).total
    multiplied = operations.count_lagrange(arm.model, keep=False).total
    assert 10 * recursion < kept < multiplied


def test_periods_without_an_event_in_their_first_half_are_missed():
    on_time = [1000 * k + 7 for k in range(50)]
    assert timing.missed(on_time, 1000) == 0
    late = [t + (k % 7 == 3) * 300 for k, t in enumerate(on_time)]
    assert timing.missed(late, 1000) == 0
    too_late = [t + (k == 20) * 600 for k, t in enumerate(on_time)]
    assert timing.missed(too_late, 1000) == 1
    assert timing.missed(on_time[:20] + on_time[22:], 1000) == 2
