"""The tables of doc/evidence/loop.md."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .processes import PRIORITY
from .report import duration, figures, grid
from .timing import compare
from .wire import Answers, Ticks

OURS = 'this node'
RELAY = 'relay'
IDLE, BUSY = 'idle', 'busy'


class Task(NamedTuple):
    """A contender, whether it has real-time priority, and the other load on the machine."""

    name: str
    has_priority: bool
    load: str

    def __str__(self) -> str:
        return f'{self.name}, {priority_name(self.has_priority)}, {self.load}'


def priority_name(has_priority: bool) -> str:
    """Return the name of a priority for a table."""
    return f'SCHED_FIFO {PRIORITY}' if has_priority else 'normal'


def permission(is_permitted: bool) -> str:
    """Describe the priority of the process that simulates the robot."""
    if is_permitted:
        return "The robot's side has a higher real-time priority than all contenders."
    return (
        'Real-time priority is not permitted on this machine: only normal priority is measured,\n'
        "and the delays of the robot's side are included."
    )


def answers_table(found: dict[Task, list[Answers]], load: str, period: float) -> str:
    """Format the times from joint states to commands in all turns."""
    rows = []
    for task, turns in found.items():
        if task.load != load:
            continue
        times = np.concatenate([turn.times for turn in turns])
        quantiles = np.percentile(times, (50, 99, 99.9, 100))
        rows.append(
            [
                task.name,
                priority_name(task.has_priority),
                f'{100 * np.mean(times <= period):.2f} %',
                *(duration(float(time)) for time in quantiles),
                f'{100 * np.mean([turn.cpu for turn in turns]):.1f} %',
            ]
        )
    quantities = ['within the period', 'median', '99 %', '99.9 %', 'longest', 'CPU of one core']
    return grid(['', 'priority', *quantities], rows)


def ratios_table(found: dict[Task, list[Answers]]) -> str:
    """Format ratios of node to relay: the ratio in each round, then the median over the rounds."""
    kinds = dict.fromkeys(task[1:] for task in found)
    rows = []
    for label, quantity in (('median', _median), ('99 %', _late), ('CPU', _cpu)):
        cells = []
        for kind in kinds:
            of = {name: list(map(quantity, found[Task(name, *kind)])) for name in (OURS, RELAY)}
            cells.append(figures(compare(of, RELAY)[OURS]))
        rows.append([f'{OURS} / {RELAY}, {label}', *cells])
    header = [f'{priority_name(has_priority)}, {load}' for has_priority, load in kinds]
    return grid(['', *header], rows)


def _median(turn: Answers) -> float:
    return float(np.median(turn.times))


def _late(turn: Answers) -> float:
    return float(np.percentile(turn.times, 99))


def _cpu(turn: Answers) -> float:
    return turn.cpu


def ticks_table(found: dict[Task, list[Ticks]]) -> str:
    """Format the fractions of late commands, and the CPU load."""
    rows = []
    for task, turns in found.items():
        periods = sum(turn.periods for turn in turns)
        counts = [sum(getattr(turn, field) for turn in turns) for field in ('missed', 'slept')]
        cpu = np.mean([turn.cpu for turn in turns])
        fractions = [f'{100 * n / periods:.2f} %' for n in counts]
        kind = [task.name, priority_name(task.has_priority), task.load]
        rows.append([*kind, *fractions, f'{100 * cpu:.1f} %'])
    quantities = ['late or missed', 'late or missed states', 'CPU of one core']
    return grid(['', 'priority', 'machine', *quantities], rows)


def gaps_table(found: dict[Task, dict[str, list[float]]]) -> str:
    """Format the longest times without a command: median and maximum over the turns."""
    rows = []
    for event in next(iter(found.values())):
        cells = [
            f'{duration(float(np.median(gaps[event])))}, {duration(max(gaps[event]))}'
            for gaps in found.values()
        ]
        rows.append([event, *cells])
    header = [f'{priority_name(task.has_priority)}, {task.load}' for task in found]
    return grid(['', *header], rows)
