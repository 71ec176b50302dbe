"""
Commands keep their promises whatever happens, and ramps end where they should.

`python test/random_driver.py` plays more.
"""

import pytest
from random_driver import play

SEQUENCES, PARTS, SEED = 48, 4, 2_000_000
DAMPED = SEED + 1  # a sequence with a damped stop


@pytest.mark.parametrize('part', range(PARTS))
def test_promises_are_kept_in_random_events(part):
    commands = sum(play(SEED + k, actions=4)[1] for k in range(part, SEQUENCES, PARTS))
    assert commands > 100 * SEQUENCES


def test_promises_are_kept_while_a_stop_is_damped():
    _, _, damped = play(DAMPED, actions=4)
    assert damped > 100
