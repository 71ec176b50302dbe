"""Ramps advance by at most one nominal step in one command, and interruptions are blended."""

from inverse_dynamics_node.control.shaping import add_within, RampClock
import numpy as np
import pytest


def steps(clock, intervals, start=100.0):
    """Advance a clock; return the steps by which ramps advance."""
    clock.start()
    clock.advance(start)
    advanced = []
    for now in start + np.cumsum(intervals):
        clock.advance(float(now))
        advanced.append(clock.step)
    return advanced


@pytest.mark.parametrize(
    ('period', 'intervals', 'expected'),
    [
        (0.0, [0.001, 0.005, 0.02], [0.001, 0.005, 0.02]),
        (0.002, [0.005, 0.9, 0.005], [0.005, 0.02, 0.005]),
        (0.05, [0.05, 0.9, 0.01], [0.05, 0.05, 0.01]),
    ],
)
def test_ramps_advance_with_time_but_do_not_catch_up(period, intervals, expected):
    assert steps(RampClock(period), intervals) == pytest.approx(expected)


def test_a_clock_that_is_set_back_does_not_advance_ramps():
    clock = RampClock()
    clock.advance(100.0)
    assert clock.advance(50.0)
    assert (clock.step, clock.since) == (0.0, 0.0)
    assert clock.advance(50.005)
    assert clock.step == pytest.approx(0.005)


@pytest.mark.parametrize('jump', [-3.0, 0.11, 60.0])
def test_commands_are_blended_for_a_while_after_an_interruption(jump):
    clock, now = RampClock(), 100.0
    assert clock.advance(now)  # a start
    assert not clock.advance(now + 0.01)
    now += 0.01 + jump
    assert clock.advance(now)
    interrupted = [clock.advance(now + 0.01 * k) for k in range(1, 31)]
    assert interrupted == sorted(interrupted, reverse=True)
    assert interrupted[:19] == [True] * 19
    assert interrupted[21:] == [False] * 9


@pytest.mark.parametrize('interval', [0.11, 0.2, 1.0])
def test_the_intervals_of_a_slow_driver_are_no_interruptions(interval):
    clock = RampClock()
    steps(clock, [interval] * 4)
    now = 100.0 + 4 * interval
    assert not any(clock.advance(now + interval * k) for k in range(1, 20))
    assert not clock.advance(now + 21 * interval - 0.01)  # one message is lost
    assert clock.advance(now + 25 * interval)


def test_nothing_has_passed_at_a_start():
    clock = RampClock()
    clock.advance(5.0)
    clock.advance(500.0)
    clock.start()
    assert clock.advance(7.0)
    assert clock.step == 0.0
    assert not clock.advance(7.01)


def test_two_commands_at_one_time_are_no_interruption():
    clock = RampClock()
    clock.advance(5.0)
    assert not clock.advance(5.0)
    assert (clock.step, clock.since) == (0.0, 0.0)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(
    ('command', 'damping', 'total'),
    [
        ((3.0, -1.0), (1.0, 2.0), (4.0, 1.0)),  # there is room for all of it
        ((3.0, -1.0), (4.0, 2.0), (5.0, 0.0)),  # for half, because of the first joint
        ((-3.0, 1.0), (9.0, 2.0), (5.0, 1.0 + 16.0 / 9.0)),  # from the other side: for 8 of 9
        ((6.0, 1.0), (1.0, 1.0), (6.0, 1.0)),  # a limit was tightened: for none of it
        ((6.0, 1.0), (-2.0, 0.0), (4.0, 1.0)),
    ],
)
def test_as_much_damping_is_added_as_the_limits_allow(command, damping, total):
    found = add_within(np.array(command), np.array(damping), np.array([5.0, 5.0]))
    assert found == pytest.approx(total)
