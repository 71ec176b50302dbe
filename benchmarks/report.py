"""The tables of doc/evidence/benchmarks.md; page.md contains the text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from . import batch, floor, growth, peers, quantities, tables
from .floor import Floor
from .growth import Growth
from .operations import count_lagrange, count_newton_euler, Operations
from .robots import stanford
from .tables import Entry, Pairs, Table
from .timing import Timing

HERE = Path(__file__).resolve().parent
PLOT = 'images/benchmarks.png'


class Results:
    """All measurements, and the description of the machine."""

    machine: str
    calls: Table
    quantities: Pairs
    quantity_batches: Pairs
    batches: Table
    papers: dict[str, Timing]
    growth: dict[str, Growth]
    floors: list[Floor]
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
            papers=papers(results.papers),
            plot=PLOT,
            exponents=exponents(results.growth),
            ratio_by_size=ratio_by_size(results.growth),
            operations=operations(results.floors),
            floors=floors(results.floors),
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


def papers(timings: dict[str, Timing]) -> str:
    """Format the paper's comparison and the same comparison on this machine."""
    arm = stanford().model
    counts = {
        growth.NEWTON_EULER: count_newton_euler(arm, folds=False),
        growth.KEPT: count_lagrange(arm, keep=True),
        growth.MULTIPLIED: count_lagrange(arm, keep=False),
    }
    own = timings[growth.NEWTON_EULER].seconds
    base = counts[growth.NEWTON_EULER].total
    rows = [
        ['paper: FORTRAN, FORTRAN', '7.9 s', '33.5 ms', '236', ''],
        ['paper: FORTRAN, assembly', '7.9 s', '4.5 ms', '1756', ''],
    ]
    for name in (growth.KEPT, growth.MULTIPLIED):
        timing = timings[name]
        label = name.replace('Lagrange', 'here')
        work = f'{counts[name].total / base:.0f} ({counts[name].total} / {base})'
        rows.append([label, duration(timing.seconds), duration(own), figures(timing), work])
    return grid(['', 'Lagrangian', 'Newton-Euler', 'ratio of times', 'ratio of operations'], rows)


def exponents(found: dict[str, Growth]) -> str:
    """Format the exponents of power laws fitted to the larger and to the largest sizes."""
    rows = []
    for name, line in found.items():
        end = int(line.sizes[-1])
        middle = int(line.sizes[len(line.sizes) // 2 - 1])
        last = int(line.sizes[-3])
        fits = [f'{line.exponent(start, end):.2f}' for start in (middle, last)]
        rows.append([name, f'n^{fits[0]}, {middle} to {end}', f'n^{fits[1]}, {last} to {end}'])
    return grid(['', 'fitted to the upper half', 'to the last three sizes'], rows)


def ratio_by_size(found: dict[str, Growth]) -> str:
    """Format the ratios of the Lagrangian form to Newton-Euler by number of joints."""
    sizes = found[growth.KEPT].sizes.tolist()
    rows = []
    for name in (growth.KEPT, growth.MULTIPLIED):
        ratios = [_short(ratio) for ratio in found[name].ratios]
        rows.append([name, *ratios, *[''] * (len(sizes) - len(ratios))])
    return grid(['joints', *(f'{n:.0f}' for n in sizes)], rows)


def operations(found: list[Floor]) -> str:
    """Format the numbers of operations."""
    return grid(
        ['multiplications + additions', *(f.name for f in found)],
        [
            ['as written', *(_count(f.written) for f in found)],
            ['folded', *(_count(f.folded) for f in found)],
        ],
    )


def floors(found: list[Floor]) -> str:
    """Format times and their ratios to the lower bound."""
    rows = []
    for name in (floor.FLOOR, floor.LOOP, floor.CALL, peers.REFERENCE):
        timings = [f.timings[name] for f in found]
        label = f'{name}, from Python' if name == peers.REFERENCE else name
        rows.append([label, *(f'{duration(t.seconds)}, {figures(t)}' for t in timings)])
    for label, name in (('passes', floor.LOOP), ('straight-line code', floor.FLOOR)):
        counts = [f.written if name == floor.LOOP else f.folded for f in found]
        times = [f.timings[name].seconds / c.total for f, c in zip(found, counts, strict=True)]
        rows.append([f'{label}, per operation', *(f'{1e9 * t:.2f} ns' for t in times)])
    return grid(['time, ratio to the lower bound', *(f.name for f in found)], rows)


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


def _count(count: Operations) -> str:
    return f'{count.multiplications} + {count.additions} = {count.total}'
