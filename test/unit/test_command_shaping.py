"""The clock of the ramps, interruptions, dry runs, and damping within the limits."""

from inverse_dynamics_node.control.shaping import add_within, DryRun, RampClock
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
    assert clock.advance(now + 23.5 * interval)


def test_nothing_has_passed_at_a_start_and_between_two_commands_at_one_time():
    clock = RampClock()
    clock.advance(5.0)
    clock.advance(500.0)
    clock.start()
    assert clock.advance(7.0)
    assert clock.step == 0.0
    assert not clock.advance(7.0)
    assert (clock.step, clock.since) == (0.0, 0.0)
    assert not clock.advance(7.01)


EFFORTS = np.array([4.0, -2.0])
# What happens, and the fraction of the efforts that is sent then; None if nothing is sent.
DRY_RUNS = {
    'without one, the computed efforts are sent': [1.0, 1.0],
    'efforts fall to zero, zeros follow for half a second, then nothing': [
        *(1.0, {'begin': 0.4}, 0.75, 0.5, 0.25, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, None, None)
    ],
    'without a ramp, the next command is zero': [1.0, {'begin': 0.0}, 0.0],
    'zeros are sent even if the next step is very late': [
        *(1.0, {'begin': 0.4}, {'elapsed': 60.0}, 0.0, {'elapsed': 0.1}, None)
    ],
    'a second begin does not restart the ramp': [
        *(1.0, {'begin': 0.4}, 0.75, {'begin': 10.0}, 0.5)
    ],
    'its end lets the computed efforts through': [1.0, {'begin': 0.1}, 0.0, {'end': True}, 1.0],
    'it begins at once if nothing was sent': [{'begin': 1.0}, None, None],
}


@pytest.mark.parametrize('statement', DRY_RUNS)
def test_a_dry_run(statement):
    dry_run, efforts, elapsed, begun = DryRun(), EFFORTS.copy(), 0.1, False
    for event in DRY_RUNS[statement]:
        if isinstance(event, dict):
            elapsed = event.get('elapsed', elapsed)
            if 'begin' in event:
                dry_run.begin(event['begin'])
                efforts[:] = 100.0  # the array is used again, and the computed efforts grow
            if 'end' in event:
                dry_run.end()
                efforts[:] = EFFORTS
            begun = dry_run.is_active
            continue
        sent = dry_run.select(efforts, elapsed)
        if event is None:
            assert sent is None
        else:
            assert sent == pytest.approx(event * EFFORTS, abs=1e-12)
        assert dry_run.has_sent is (event is not None)
        assert dry_run.has_effort is bool(event)
        assert dry_run.is_active is begun


def test_a_dry_run_from_the_start_sends_nothing():
    dry_run = DryRun(is_active=True)
    assert dry_run.select(EFFORTS, 0.1) is None
    assert dry_run.is_active


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
