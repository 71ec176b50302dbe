"""Comparisons of all contenders on all robots, and the reasons for empty table cells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from inverse_dynamics_node.robot.model import Floats

from . import batch, peers, quantities
from .quantities import Quantity
from .robots import random_states, Robot
from .timing import Contender, difference, one_core, race, Timing

WRONG = 1e-6  # relative to the largest effort; correct results agree to 1e-13

Maker = Callable[[Robot, Floats], Contender]
NOT_INSTALLED = 'not installed'


class Entry(NamedTuple):
    """The result of a contender on a robot."""

    timing: Timing | None
    error: float | None
    """Largest difference from the reference, relative to the largest effort."""
    note: str = ''
    """Reason why the contender was not timed."""


Table = dict[str, dict[str, Entry]]
"""Results by contender, then by robot."""

CALLS: dict[str, Maker] = {
    peers.REFERENCE: peers.pinocchio,
    'ours, out=': peers.ours,
    'ours, new array': peers.ours_new_array,
    'MuJoCo mj_rne': peers.mujoco_rne,
    'MuJoCo mj_inverse': peers.mujoco_inverse,
    'Drake': peers.drake,
    'roboticstoolbox': peers.toolbox,
}

BATCHES: dict[str, Maker] = {
    batch.REFERENCE: batch.pinocchio,
    'ours': batch.ours,
    'pin.rnea in a loop': batch.pinocchio_loop,
}


def calls(robots: Sequence[Robot], rounds: int) -> Table:
    """Time calls for one state."""
    return _table(CALLS, robots, 16, rounds)


def batches(robots: Sequence[Robot], rounds: int) -> Table:
    """Time calls for many states."""
    return _table(BATCHES, robots, batch.COUNT, rounds)


Pairs = dict[Quantity, dict[str, dict[str, Entry]]]
"""Results by quantity, then by robot, then by `quantities.OURS` or `quantities.THEIRS`."""


def quantities_of_one_call(robots: Sequence[Robot], rounds: int) -> Pairs:
    """Time one call of every quantity, relative to Pinocchio's function."""
    return _pairs(quantities.QUANTITIES, quantities.one_call, robots, rounds)


def quantities_of_batches(robots: Sequence[Robot], rounds: int) -> Pairs:
    """Time batches of every quantity, relative to a loop over Pinocchio's function."""
    return _pairs(quantities.QUANTITIES, quantities.batches, robots, rounds)


def _pairs(
    kinds: Sequence[Quantity],
    make: Callable[[Quantity, Robot], list[Contender]],
    robots: Sequence[Robot],
    rounds: int,
) -> Pairs:
    pairs: Pairs = {quantity: {} for quantity in kinds}
    for robot in robots:
        for quantity in kinds:
            pair = make(quantity, robot)
            with one_core():
                pairs[quantity][robot.name] = _entries(pair, pair[1], rounds)
    return pairs


def _table(makers: dict[str, Maker], robots: Sequence[Robot], count: int, rounds: int) -> Table:
    table: Table = {name: {} for name in makers}
    for robot in robots:
        states = random_states(robot.n, count)
        with one_core():
            ready = []
            for name, maker in makers.items():
                made = _make(maker, robot, states)
                if isinstance(made, Contender):
                    ready.append(made)
                else:
                    table[name][robot.name] = Entry(None, None, made)
            for name, entry in _entries(ready, ready[0], rounds).items():
                table[name][robot.name] = entry
    return table


def _make(maker: Maker, robot: Robot, states: Floats) -> Contender | str:
    """Make a contender, or return the reason why it cannot be timed."""
    try:
        return maker(robot, states)
    except ImportError:
        return NOT_INSTALLED
    except Exception as error:  # a library may raise any error for an unsupported robot
        print(f'{robot.name}: {error}')
        return 'not supported'


def _entries(ready: Sequence[Contender], reference: Contender, rounds: int) -> dict[str, Entry]:
    """Compare all results with the reference, then time the contenders that agree."""
    expected = reference.results()
    errors = {c.name: difference(c.results(), expected) for c in ready}
    timings = race([c for c in ready if errors[c.name] < WRONG], reference.name, rounds)
    return {
        name: Entry(timings.get(name), error, '' if error < WRONG else 'wrong')
        for name, error in errors.items()
    }


def names(table: dict[str, Any]) -> list[str]:
    """Return the names of the robots in a table."""
    return list(dict.fromkeys(robot for row in table.values() for robot in row))
