"""Shows the state of a node as a full-screen view, as a line of text, or as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import math
import os
import time
from typing import Any, TYPE_CHECKING

from ..analysis.diagnosis.live import Agreement, Obstacle, Outcome
from ..errors import escaped
from ..report.diagnosis_text import agreement_sentence

if TYPE_CHECKING:
    from ..ros.observer import Observer, Sample

CODES = {
    Outcome.AGREE: 0,
    Outcome.DIFFER: 3,
    Outcome.UNDECIDED: 4,
    Outcome.SATURATED: 5,
    Outcome.NOT_CHECKED: 6,
}
"""Exit codes of the outcomes."""
_COLOURS = {Outcome.AGREE: 'green', Outcome.DIFFER: 'red', Outcome.SATURATED: 'red'}
_LEVELS = {'WARN': 'yellow', 'ERROR': 'bold red'}


@contextmanager
def live_view(last_words: Callable[[], str]) -> Iterator[Callable[..., None]]:
    """
    Open a full screen; yield a function that updates it with the arguments of `screen`.

    After the screen has been closed, print the ``last_words``.
    """
    from rich.console import Console
    from rich.live import Live

    # Some shells export COLUMNS and LINES, which would fix the size of the screen.
    size = {'COLUMNS', 'LINES'}
    environment = {key: os.environ[key] for key in os.environ.keys() - size}
    console = Console(highlight=False, _environ=environment)
    try:
        with Live(console=console, screen=True, auto_refresh=False) as live:
            yield lambda *values: live.update(screen(*values), refresh=True)
    finally:
        console.print(_text(last_words()), soft_wrap=True)


def screen(observer: Observer, sample: Sample | None, agreement: Agreement) -> Any:
    """Return the content of the screen as a `rich` renderable, with the important lines first."""
    from rich.console import Group
    from rich.table import Table

    status = _status(observer, agreement)
    robot = [f"robot '{observer.robot.name}'"] if observer.robot else []
    doing = 'NO DIAGNOSTICS' if observer.status else 'waiting for diagnostics'
    if status:
        doing = status['loop']['message']
        if status['loop']['values'].get('dry run') == 'yes':
            doing = f'DRY RUN  {doing.removeprefix("dry run: ")}'
    colour = _COLOURS.get(agreement.outcome, 'yellow')
    joints = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style='cyan')
    joints.add_column('joint')  # only this column shrinks on a narrow terminal
    for title in ('position', 'measured', 'modelled', 'residual', 'command', 'limit'):
        joints.add_column(title, justify='right', no_wrap=True)
    problems = {joint for fault in agreement.faults for joint in fault.joints}
    problems.update(agreement.saturated)
    for row in _joint_rows(observer, sample):
        unit, effort, factor = ('mm ', 'N  ', 1e3) if row['is_prismatic'] else (
            'deg', 'N m', 180.0 / math.pi,
        )  # fmt: skip
        position = None if row['position'] is None else factor * row['position']
        joints.add_row(
            _text(row['name'], no_wrap=True, overflow='ellipsis'),
            f'{_number(position, 1)} {unit}',
            *(_number(row[key], 2) for key in ('measured', 'modelled', 'residual')),
            f'{_number(row["command"], 2)} {effort}',
            '-' if row['fraction'] is None else f'{row["fraction"]:.0%}',
            style='bold red' if row['name'] in problems else '',
        )
    parts = Table(box=None, pad_edge=False, show_header=False)
    for name, part in status.items():
        parts.add_row(_text(name), _text(part['message']), style=_LEVELS.get(part['level'], ''))
    if status and observer.status and (trajectory := observer.status.trajectory()):
        parts.add_row('trajectory', _text(trajectory))
    return Group(
        _text('  '.join([observer.name, *robot, doing]), 'bold'),
        _text(agreement_sentence(agreement), f'{colour} bold'),
        *([_text(''), joints] if joints.rows else []),
        _text(''),
        parts,
    )


def as_line(observer: Observer, agreement: Agreement) -> str:
    """Return the state as one line of text, for output to a pipe."""
    words, notes = [time.strftime('%H:%M:%S'), observer.name], [agreement_sentence(agreement)]
    if status := _status(observer, agreement):
        loop = status['loop']['values']
        rate = observer.status.number('joint states', 'rate [Hz]') if observer.status else None
        words.append('dry run' if loop.get('dry run') == 'yes' else loop.get('state', ''))
        words.append(f'{_number(rate, 0)} Hz')
        # Wrong joints of a controller, and gravity that a driver adds, do not show in the efforts.
        if (others := status.get('other nodes')) and others['level'] != 'OK':
            notes.append(others['message'])
    return escaped(f'{" ".join(words)}: {"; ".join(notes)}')


def as_json(observer: Observer, sample: Sample | None, agreement: Agreement) -> dict[str, Any]:
    """Return the values to print as JSON; doc/watch.md describes the keys."""
    fault = agreement.faults[0] if agreement.faults else None
    values = agreement.numbers or (fault.values if fault else ())
    return {
        'time': time.time(),
        'node': observer.name,
        'robot': observer.robot.name if observer.robot else None,
        'outcome': agreement.outcome.value,
        'cause': None if agreement.cause is None else agreement.cause.value,
        'sentence': agreement_sentence(agreement),
        'exit_code': CODES[agreement.outcome],
        'problem_joints': list(fault.joints) if fault else [],
        'problem_values': [_known(value) for value in values],
        'problem_link': (fault.link or None) if fault else None,
        'unchecked_joints': {name: agreement.checks[name].value for name in agreement.unchecked},
        'saturated_joints': list(agreement.saturated),
        'status': _status(observer, agreement) or None,
        'joints': _joint_rows(observer, sample),
    }


def _status(observer: Observer, agreement: Agreement) -> dict[str, dict[str, Any]]:
    """Return level, message and values of each part of the diagnostics; {} if there are none."""
    if observer.status is None or agreement.obstacle is Obstacle.NO_DIAGNOSTICS:
        return {}
    return {
        name: {**part._asdict(), 'level': part.level.name}
        for name, part in observer.status.items()
    }


def _joint_rows(observer: Observer, sample: Sample | None) -> list[dict[str, Any]]:
    """Return the values of each joint; unknown values are None."""
    robot, rows = observer.robot, []
    if robot is None or sample is None:
        return []
    given = observer.status.by_joint('limits [N m, N]') if observer.status else {}
    for i, name in enumerate(robot.joint_names):
        limit, command = given.get(name, float(robot.effort_limits[i])), sample.commands[i]
        values = {
            'position': sample.q[i],
            'measured': sample.measured[i],
            'modelled': sample.modelled[i],
            'residual': sample.measured[i] - sample.modelled[i],
            'command': command,
            'limit': limit,
            'fraction': abs(command) / limit if 0.0 < limit < math.inf else math.nan,
        }
        known = {key: _known(value) for key, value in values.items()}
        rows.append({'name': name, 'is_prismatic': bool(robot.is_prismatic_joint[i]), **known})
    return rows


def _text(text: str, style: str = '', **options: Any) -> Any:
    """Return a `rich.text.Text`; rich is imported here, because plain text does not need it."""
    from rich.text import Text

    return Text(escaped(text), style, **options)


def _number(value: float | None, decimals: int) -> str:
    # Adding zero removes the sign of a rounded zero.
    return '-' if value is None else f'{round(value, decimals) + 0.0:.{decimals}f}'


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
