"""What the benchmarks count, not their speed."""

from benchmarks import timing


def test_periods_without_an_event_in_their_first_half_are_missed():
    on_time = [1000 * k + 7 for k in range(50)]
    assert timing.missed(on_time, 1000) == 0
    late = [t + (k % 7 == 3) * 300 for k, t in enumerate(on_time)]
    assert timing.missed(late, 1000) == 0
    too_late = [t + (k == 20) * 600 for k, t in enumerate(on_time)]
    assert timing.missed(too_late, 1000) == 1
    assert timing.missed(on_time[:20] + on_time[22:], 1000) == 2
