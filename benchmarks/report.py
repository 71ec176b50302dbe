"""The tables of doc/evidence/benchmarks.md; page.md contains the text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from . import batch, peers, quantities, tables
from .tables import Entry, Pairs, Table
from .timing import Timing

HERE = Path(__file__).resolve().parent


class Results:
    """All measurements, and the description of the machine."""

    machine: str
    calls: Table
    quantities: Pairs
    quantity_batches: Pairs
    batches: Table
    startup: dict[str, dict[str, float]]


def page(results: Results) -> str:
    """Return the page with all tables."""
    return (
        (HERE / 'page.md')
        .read_text()
        .format(
            machine=results.machine,
            calls=ratios(results.calls, peers.REFERENCE, 1),
            agreement=agreement(results.calls),
            wrong=wrong(results.calls),
            quantities=pairs(results.quantities),
            quantity_times=pair_times(results.quantities),
            quantity_batches=pairs(results.quantity_batches),
            most_states=quantities.MOST_STATES,
            count=batch.COUNT,
            batches=ratios(results.batches, batch.REFERENCE, batch.COUNT),
            starts=starts(results.startup),
        )
    )


def grid(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a Markdown table with a left-aligned first column."""
    lines = [header, ['---', *['---:'] * (len(header) - 1)], *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


def ratios(table: Table, reference: str, calls: int) -> str:
    """Format the ratios of times to the reference, and the times of the reference."""
    robots = tables.names(table)
    rows = [[reference, *(_time(table[reference][robot], calls) for robot in robots)]]
    for name, entries in sorted(table.items(), key=_rank):
        if name != reference:
            cells = (entries.get(robot, Entry(None, None)) for robot in robots)
            rows.append([name, *(_ratio(entry) for entry in cells)])
    return grid(['', *robots], rows)


def _rank(row: tuple[str, dict[str, Entry]]) -> float:
    """Return a sort key: the ratio of a contender in the first column with a ratio."""
    timings = [entry.timing.ratio for entry in row[1].values() if entry.timing]
    return timings[0] if timings else float('inf')


def agreement(table: Table) -> str:
    """Describe how well the timed results agree."""
    errors = [e.error for row in table.values() for e in row.values() if e.timing and e.error]
    return (
        f'All timed results agree with `{peers.REFERENCE}` to {max(errors):.0e} of the largest '
        'effort, on every robot.'
    )


def wrong(table: Table) -> str:
    """List wrong results by library, robot and error."""
    lines = [
        f'- {name}, {robot}: off by {_percent(entry.error)} of the largest effort'
        for name, entries in table.items()
        for robot, entry in entries.items()
        if entry.note == 'wrong' and entry.error
    ]
    if not lines:
        return 'No library gave wrong results.'
    return '\n'.join(['Wrong results, where all others agree:', '', *lines])


def pairs(found: Pairs) -> str:
    """Format the ratios of this package's times to Pinocchio's."""
    rows = [
        [
            quantity.name,
            quantity.label,
            *(_ratio(robot[quantities.OURS]) for robot in row.values()),
        ]
        for quantity, row in found.items()
    ]
    return grid(['', 'Pinocchio', *next(iter(found.values()))], rows)


def pair_times(found: Pairs) -> str:
    """Format the times of Pinocchio's functions."""
    rows = {
        quantity.label: [_time(robot[quantities.THEIRS], 1) for robot in row.values()]
        for quantity, row in found.items()
    }
    return grid(['', *next(iter(found.values()))], [[name, *row] for name, row in rows.items()])


def starts(found: dict[str, dict[str, float]]) -> str:
    """Format the times of the steps of a start."""
    kinds = list(found)
    steps = list(found[kinds[0]])
    rows = [[step, *(_milliseconds(found[kind][step]) for kind in kinds)] for step in steps]
    rows[-1] = [f'**{cell}**' for cell in rows[-1]]
    return grid(['', *kinds], rows)


def duration(seconds: float) -> str:
    """Format a time with three digits and a suitable unit."""
    for unit, size in (('s', 1.0), ('ms', 1e-3), ('µs', 1e-6)):
        if seconds >= size:
            return f'{_three(seconds / size)} {unit}'
    return f'{seconds * 1e9:.0f} ns'


def figures(timing: Timing) -> str:
    """Format the ratio of a timing, with quartiles in small print."""
    if timing.low == timing.high:
        return _short(timing.ratio)
    spread = f'{_short(timing.low)}–{_short(timing.high)}'
    return f'{_short(timing.ratio)} <sub>{spread}</sub>'


def _time(entry: Entry, calls: int) -> str:
    return duration(entry.timing.seconds / calls) if entry.timing else entry.note


def _ratio(entry: Entry) -> str:
    return figures(entry.timing) if entry.timing else entry.note


def _short(ratio: float) -> str:
    return f'{ratio:.2f}' if ratio < 10.0 else f'{ratio:.0f}'


def _three(x: float) -> str:
    return f'{x:.2f}' if x < 10.0 else f'{x:.1f}' if x < 100.0 else f'{x:.0f}'


def _percent(fraction: float) -> str:
    return f'{100.0 * fraction:.2g} %' if fraction < 1.0 else f'{100.0 * fraction:.0f} %'


def _milliseconds(seconds: float) -> str:
    return f'{seconds * 1e3:.0f}' if seconds >= 1e-3 else f'{seconds * 1e3:.1f}'
