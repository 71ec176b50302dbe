"""
Interleaved timing: every round times every contender once, and ratios are taken inside a round.

A machine that others use too slows down and speeds up within seconds. Contenders timed one after
the other would not meet the same machine; two timed in the same round nearly do. And what counts
is the time that a core spent on the thread, less what others took of it in between.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
from dataclasses import dataclass
import gc
import os
from time import thread_time
from typing import Any, NamedTuple

from inverse_dynamics_node.robot.model import Floats
import numpy as np

SLICE = 0.005  # s per contender and round: long for the clock, short for the machine's moods
SLOW = 0.05  # s for one sweep, from which a contender sits most rounds out
FEW = 5  # rounds of a slow one

States = Sequence[tuple[Any, ...]]


def nothing() -> None:
    """Do nothing, for contenders with nothing to close."""


@dataclass
class Contender:
    """Something that computes the same as others, and can be told to do it a number of times."""

    name: str
    results: Callable[[], Floats]
    """What it computes, a row a state: to be compared before anything is timed."""
    seconds: Callable[[int], float]
    """Time a number of sweeps over all states; return the seconds of one call."""
    calls: int
    """Calls in a sweep."""
    close: Callable[[], None] = nothing


class Timing(NamedTuple):
    """What the rounds say of a contender."""

    seconds: float
    """The best of all rounds: what the machine does when nobody else uses it."""
    ratio: float
    """To the reference: the median over the rounds, and its quartiles."""
    low: float
    high: float


def contender(
    name: str, states: States, sweep: Callable[[States], None], result: Callable[..., Floats]
) -> Contender:
    """
    Make a contender of a loop over states, written out as a user would write it.

    A loop for each spares all of them the cost of a function between loop and library.

    """

    def seconds(sweeps: int) -> float:
        repeated = list(states) * sweeps
        start = thread_time()
        sweep(repeated)
        return (thread_time() - start) / len(repeated)

    return Contender(
        name, lambda: np.array([result(*state) for state in states]), seconds, len(states)
    )


def in_loop(name: str, sweep: Callable[..., None], states: Floats, *arguments: Any) -> Contender:
    """Make a contender of a compiled loop over states: no call from Python is timed."""
    tau = np.empty(states.shape[1:])

    def run(sweeps: int) -> Floats:
        sweep(*states, tau, *arguments, sweeps)
        return tau

    def seconds(sweeps: int) -> float:
        start = thread_time()
        run(sweeps)
        return (thread_time() - start) / (sweeps * len(tau))

    return Contender(name, lambda: run(1).copy(), seconds, len(tau))


def difference(results: Floats, expected: Floats) -> float:
    """Compare results: the largest difference, of the largest value."""
    return float(np.abs(results - expected).max() / np.abs(expected).max())


def race(contenders: Sequence[Contender], reference: str, rounds: int) -> dict[str, Timing]:
    """Time contenders against one of them."""
    return compare(run(contenders, (reference,), rounds), reference)


def run(
    contenders: Sequence[Contender], references: Sequence[str], rounds: int
) -> dict[str, list[float]]:
    """Time every contender once a round, references in every round; return the seconds of each."""
    sweeps = {c.name: _sweeps_in_a_slice(c) for c in contenders}
    taken: dict[str, list[float]] = {c.name: [] for c in contenders}
    with _without_garbage_collection():
        for k in range(rounds):
            for c in contenders:
                if k < FEW or sweeps[c.name] or c.name in references:
                    taken[c.name].append(c.seconds(max(1, sweeps[c.name])))
    return taken


def compare(taken: dict[str, list[float]], reference: str) -> dict[str, Timing]:
    """Compare the seconds of each with those of the reference in the same round."""
    return {name: _timing(times, taken[reference]) for name, times in taken.items()}


def _sweeps_in_a_slice(c: Contender) -> int:
    """Choose how often a contender sweeps in a round; 0 for once, and in few rounds only."""
    c.seconds(1)  # the first run pays for what is loaded late
    for _ in range(3):  # a pause in the middle of one sweep must not make it look slow
        sweep = c.seconds(1) * c.calls
        if sweep < SLICE:
            break
    return 0 if sweep > SLOW else max(1, round(SLICE / sweep))


def _timing(times: list[float], reference: list[float]) -> Timing:
    ratios = np.array(times) / np.array(reference[: len(times)])
    low, ratio, high = np.percentile(ratios, (25, 50, 75))
    return Timing(min(times), float(ratio), float(low), float(high))


def missed(times: Sequence[int], period: int) -> int:
    """
    Count the periods without an event in their first half.

    Parameters
    ----------
    times : sequence of int
        Of events that should come once a period.
    period : int
        In the same unit. Where periods begin is read from the events themselves.

    Returns
    -------
    count : int
        Of the periods from the first event to the last.

    """
    since = (np.array(times) - times[0]) / period
    begin = np.angle(np.exp(2j * np.pi * since).mean()) / (2.0 * np.pi)
    k = np.round(since - begin)
    # What comes later than half a period is nearer to the next; not to be taken for its event.
    is_in_time = since - begin - k > -0.25
    return int(k[-1] - k[0] + 1 - len(np.unique(k[is_in_time])))


CORES: set[int] = os.sched_getaffinity(0) if hasattr(os, 'sched_getaffinity') else set()


@contextlib.contextmanager
def on_cores(cores: set[int]) -> Iterator[None]:
    """Keep this process, and those it starts meanwhile, on some cores; where the system can."""
    if not cores:
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def one_core() -> contextlib.AbstractContextManager[None]:
    """Keep this process on one core: its caches stay warm."""
    return on_cores({max(CORES)} if CORES else set())


@contextlib.contextmanager
def _without_garbage_collection() -> Iterator[None]:
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
