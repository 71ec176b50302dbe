"""Newton-Euler and the Lagrangian form, on the paper's arm and on chains of growing length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.robot.model import Floats
import numpy as np

from . import peers
from .lagrange import chain_of, kept_sweep, multiplied_sweep, newton_euler_sweep
from .operations import table_under_gravity
from .robots import chain, random_states, Robot, stanford
from .timing import compare, Contender, difference, in_loop, race, run, Timing

SIZES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 100, 200, 400)
MOST_KEPT = 64  # joints; for longer chains, a call takes more than 50 ms
MOST_MULTIPLIED = 24  # joints
TOLERANCE = 1e-10  # relative to the largest effort
NEWTON_EULER = 'Newton-Euler'
KEPT = 'Lagrange, derivatives kept'
MULTIPLIED = 'Lagrange, multiplied out'
FROM_PYTHON = 'ours, from Python'


class Growth(NamedTuple):
    """Seconds per call by number of joints, and their ratio to the seconds of Newton-Euler."""

    sizes: Floats
    seconds: Floats
    ratios: Floats

    def exponent(self, start: int, end: int) -> float:
        """Return the exponent of a power law fitted within a range of the number of joints."""
        within = (self.sizes >= start) & (self.sizes <= end)
        slope, _ = np.polyfit(np.log(self.sizes[within]), np.log(self.seconds[within]), 1)
        return float(slope)


def contenders(robot: Robot) -> list[Contender]:
    """Return the contenders in compiled loops, after a comparison of their results."""
    states = random_states(robot.n)
    expected = InverseDynamics(robot.model).efforts(*states)
    rows = table_under_gravity(robot.model)
    found = [in_loop(NEWTON_EULER, newton_euler_sweep, states, rows)]
    if robot.n <= MOST_KEPT:
        found.append(in_loop(KEPT, kept_sweep, states, chain_of(robot.model)))
    if robot.n <= MOST_MULTIPLIED:
        found.append(in_loop(MULTIPLIED, multiplied_sweep, states, chain_of(robot.model)))
    for c in found:
        error = difference(c.results(), expected)
        if error > TOLERANCE:
            raise RuntimeError(f'{c.name}, {robot.n} joints: off by {error:.1e} of the largest')
    return found


def on_the_papers_arm(rounds: int) -> dict[str, Timing]:
    """Time the methods that the paper timed on a PDP-11/45."""
    return race(contenders(stanford()), NEWTON_EULER, rounds)


def with_joints(sizes: Sequence[int], rounds: int) -> dict[str, Growth]:
    """
    Time chains of increasing length, and single calls of this package and of Pinocchio.

    Each round covers all sizes, so that a temporary load on the machine affects all sizes.
    """
    names: dict[int, list[str]] = {}
    entered: list[Contender] = []
    for n in sizes:
        robot = chain(n)
        states = random_states(n)
        calls = [peers.ours(robot, states, FROM_PYTHON), peers.pinocchio(robot, states)]
        here = [*contenders(robot), *calls]
        names[n] = [c.name for c in here]
        entered += [replace(c, name=f'{c.name}, {n}') for c in here]
    references = [f'{NEWTON_EULER}, {n}' for n in sizes]
    taken = run(entered, references, rounds)
    found: dict[str, list[tuple[float, ...]]] = {}
    for n in sizes:
        of_size = {name: taken[f'{name}, {n}'] for name in names[n]}
        for name, timing in compare(of_size, NEWTON_EULER).items():
            found.setdefault(name, []).append((n, timing.seconds, timing.ratio))
    return {name: Growth(*np.array(points).T) for name, points in found.items()}
