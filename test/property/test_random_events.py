"""Commands keep their promises whatever happens; `python test/random_driver.py` plays more."""

import pytest
from random_driver import play

SEQUENCES = 100


@pytest.mark.parametrize('part', range(4))
def test_promises_are_kept_in_random_events(part):
    commands = damped = 0
    for k in range(SEQUENCES // 4):
        _, more, more_damped = play(2 * 10**6 + 4 * k + part, actions=4)
        commands, damped = commands + more, damped + more_damped
    assert commands > 10 * SEQUENCES
    assert damped > SEQUENCES // 10
