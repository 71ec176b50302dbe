"""
Interleaved timing: every round times every contender once, and ratios are computed per round.

The speed of a shared machine changes within seconds. Within a round, all contenders run under
nearly the same conditions. Times are CPU times of the thread, which exclude other processes.
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

SLICE = 0.005  # [s] per contender and round: above the clock's resolution, below load changes
SLOW = 0.05  # [s] per sweep: slower contenders skip most rounds
FEW = 5  # number of rounds for a slow contender

States = Sequence[tuple[Any, ...]]


@dataclass
class Contender:
    """An implementation to be timed; a sweep is one pass over all states."""

    name: str
    results: Callable[[], Floats]
    """Returns the results, one row per state, to be compared before the timing."""
    seconds: Callable[[int], float]
    """Runs a number of sweeps over all states; returns the seconds per call."""
    calls: int
    """Number of calls per sweep."""


class Timing(NamedTuple):
    """The timing of a contender over all rounds."""

    seconds: float
    """Shortest time per call of all rounds, close to the time on an idle machine."""
    ratio: float
    """Median of the ratios to the reference; the quartiles follow."""
    low: float
    high: float


def contender(
    name: str, states: States, sweep: Callable[[States], None], result: Callable[..., Floats]
) -> Contender:
    """
    Make a contender from a Python loop over states, as a user would write it.

    Each contender has its own loop, which avoids a function call between loop and library.
    """

    def seconds(sweeps: int) -> float:
        repeated = list(states) * sweeps
        start = thread_time()
        sweep(repeated)
        return (thread_time() - start) / len(repeated)

    return Contender(
        name, lambda: np.array([result(*state) for state in states]), seconds, len(states)
    )


def difference(results: Floats, expected: Floats) -> float:
    """Return the largest difference relative to the largest expected value."""
    return float(np.abs(results - expected).max() / np.abs(expected).max())


def race(contenders: Sequence[Contender], reference: str, rounds: int) -> dict[str, Timing]:
    """Time contenders, and compute the ratios to the reference contender."""
    return compare(_run(contenders, reference, rounds), reference)


def _run(contenders: Sequence[Contender], reference: str, rounds: int) -> dict[str, list[float]]:
    """Return the times of all contenders [s]; slow ones except the reference skip rounds."""
    sweeps = {c.name: _sweeps_in_a_slice(c) for c in contenders}
    taken: dict[str, list[float]] = {c.name: [] for c in contenders}
    with _without_garbage_collection():
        for k in range(rounds):
            for c in contenders:
                if k < FEW or sweeps[c.name] or c.name == reference:
                    taken[c.name].append(c.seconds(max(1, sweeps[c.name])))
    return taken


def compare(taken: dict[str, list[float]], reference: str) -> dict[str, Timing]:
    """Compute the ratios to the reference in the same round."""
    return {name: _timing(times, taken[reference]) for name, times in taken.items()}


def _sweeps_in_a_slice(c: Contender) -> int:
    """Return the number of sweeps per round; 0 for a slow contender, which skips most rounds."""
    c.seconds(1)  # finish lazy loading
    for _ in range(3):  # one sweep may be slow because the machine paused
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
    Count the periods from the first event to the last that have no event in their first half.

    The events should occur once per period. Times and period have the same unit. The phase of the
    periods is estimated from the events.
    """
    since = (np.array(times) - times[0]) / period
    begin = np.angle(np.exp(2j * np.pi * since).mean()) / (2.0 * np.pi)
    k = np.round(since - begin)
    # An event that is late by more than half a period must not be assigned to the next period.
    is_in_time = since - begin - k > -0.25
    return int(k[-1] - k[0] + 1 - len(np.unique(k[is_in_time])))


@contextlib.contextmanager
def one_core() -> Iterator[None]:
    """Keep this process and its new children on one core if the system supports this."""
    if not hasattr(os, 'sched_getaffinity'):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})  # its caches stay warm
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextlib.contextmanager
def _without_garbage_collection() -> Iterator[None]:
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
