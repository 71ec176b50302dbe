"""The time of a call relative to a lower bound: the time of its necessary arithmetic."""

from __future__ import annotations

from typing import NamedTuple

from inverse_dynamics_node import InverseDynamics

from . import peers
from .lagrange import newton_euler_sweep
from .operations import (
    compiled_straight_line,
    count_newton_euler,
    Operations,
    table_under_gravity,
)
from .robots import random_states, Robot
from .timing import difference, in_loop, race, Timing

FLOOR = 'folded, straight-line code'
LOOP = 'our passes, in a compiled loop'
CALL = 'our call from Python, `out=`'
TOLERANCE = 1e-8  # relative to the largest effort: folding rounds multiples of pi in a URDF


class Floor(NamedTuple):
    """Operation counts and times for one robot."""

    name: str
    written: Operations
    folded: Operations
    timings: dict[str, Timing]


def measure(robot: Robot, rounds: int) -> Floor:
    """Count the operations, and time the operations alone, both passes, and a call."""
    states = random_states(robot.n)
    contenders = [
        in_loop(FLOOR, compiled_straight_line(robot.model), states),
        in_loop(LOOP, newton_euler_sweep, states, table_under_gravity(robot.model)),
        peers.ours(robot, states, CALL),
        peers.pinocchio(robot, states),
    ]
    expected = InverseDynamics(robot.model).efforts(*states)
    for c in contenders:
        error = difference(c.results(), expected)
        if error > TOLERANCE:
            raise RuntimeError(f'{c.name}, {robot.name}: off by {error:.1e} of the largest')
    return Floor(
        robot.name,
        count_newton_euler(robot.model, folds=False),
        count_newton_euler(robot.model, folds=True),
        race(contenders, FLOOR, rounds),
    )
