"""Shows the state of a node as a full-screen view, as a line of text, or as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
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

MOST_WARNINGS = 4
RECENT = 60.0  # [s]; older warnings are not shown
_COLOURS = {Outcome.AGREE: 'green', Outcome.DIFFER: 'red', Outcome.SATURATED: 'red'}
_AT_THE_TOP = 'state', 'phase', 'activity', 'dry_run', 'problems'
_UNITS = {'rate': ' Hz', 'age': ' s', 'timeout': ' s'}  # by the last word of a key


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

    values = node_values(observer, agreement)
    parts = [
        _text(_headline(observer, agreement, values), 'bold'),
        _text(agreement_sentence(agreement), _COLOURS.get(agreement.outcome, 'yellow') + ' bold'),
    ]
    for problem in values.get('problems', ()):
        style = 'bold red' if problem['level'] == 'ERROR' else 'yellow'
        parts.append(_text('{level} {part}: {message}'.format(**problem), style))
    parts.append(_text(''))
    if sample is not None:
        parts += [_joint_table(observer, sample, agreement), _text('')]
    parts.append(_node_table(values))
    recent = [line for line in observer.log if line.time > time.time() - RECENT]
    for line in recent[-MOST_WARNINGS:]:
        clock = time.strftime('%H:%M:%S', time.localtime(line.time))
        parts.append(_text(f'{clock} {line.level} {line.text}', 'yellow'))
    return Group(*parts)


def _headline(observer: Observer, agreement: Agreement, values: Mapping[str, Any]) -> str:
    words = [observer.name]
    if observer.robot is not None:
        words.append(f"robot '{observer.robot.name}'")
    if agreement.obstacle is Obstacle.NO_DIAGNOSTICS:
        words.append('NO DIAGNOSTICS')
    elif not values:
        words.append('waiting for diagnostics')
    else:
        words += ['DRY RUN'] * values['dry_run']
        # The activity may be the same as the state.
        words += dict.fromkeys([values['state'], values['activity'].removeprefix('dry run: ')])
    return '  '.join(words)


def _joint_table(observer: Observer, sample: Sample, agreement: Agreement) -> Any:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style='cyan')
    table.add_column('joint')  # only this column shrinks on a narrow terminal
    for title in ('position', 'measured', 'modelled', 'residual', 'command', 'limit'):
        table.add_column(title, justify='right', no_wrap=True)
    problems = {joint for fault in agreement.faults for joint in fault.joints}
    problems.update(agreement.saturated)
    for row in joint_rows(observer, sample):
        unit, effort = ('mm ', 'N  ') if row['is_prismatic'] else ('deg', 'N m')
        position = row['position']
        if position is not None:
            position *= 1e3 if row['is_prismatic'] else 180.0 / math.pi
        table.add_row(
            _text(row['name'], no_wrap=True, overflow='ellipsis'),
            f'{_number(position, 1)} {unit}',
            *(_number(row[key], 2) for key in ('measured', 'modelled', 'residual')),
            f'{_number(row["command"], 2)} {effort}',
            '-' if row['fraction'] is None else f'{row["fraction"]:.0%}',
            style='bold red' if row['name'] in problems else '',
        )
    if not table.rows:
        table.add_row(_text('no joints yet'))
    return table


def joint_rows(observer: Observer, sample: Sample) -> list[dict[str, Any]]:
    """Return the values of each joint; unknown values are None."""
    robot, status = observer.robot, observer.status
    if robot is None:
        return []
    limits = dict(zip(robot.joint_names, robot.effort_limits.tolist(), strict=True))
    if status is not None:
        limits |= status.by_joint('limits [N m, N]')
    rows = []
    for i, name in enumerate(robot.joint_names):
        limit = limits[name]
        values = {
            'position': sample.positions[i],
            'measured': sample.measured[i],
            'modelled': sample.modelled[i],
            'residual': sample.measured[i] - sample.modelled[i],
            'command': sample.commands[i],
            'limit': limit,
            'fraction': abs(sample.commands[i]) / limit if 0.0 < limit < math.inf else math.nan,
        }
        rows.append(
            {'name': name, 'is_prismatic': bool(robot.is_prismatic_joint[i])}
            | {key: _known(value) for key, value in values.items()}
        )
    return rows


def _node_table(values: Mapping[str, Any]) -> Any:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style='cyan', no_wrap=True)
    table.add_column()
    for key, value in values.items():
        if value is not None and key not in _AT_THE_TOP:
            words = key.split('_')
            text = f'{value:.4g}' if isinstance(value, float) else str(value)
            table.add_row(' '.join(words), _text(text + _UNITS.get(words[-1], '')))
    return table


def as_line(observer: Observer, agreement: Agreement) -> str:
    """Return the state as one line of text, for output to a pipe."""
    words = [time.strftime('%H:%M:%S'), observer.name]
    if values := node_values(observer, agreement):
        words.append('dry run' if values['dry_run'] else values['state'])
        words.append(f'{_number(values["joint_state_rate"], 0)} Hz')
    # Wrong joints of a controller, and gravity that a driver adds, do not show in the efforts.
    others = [each for each in values.get('problems', ()) if each['part'] == 'other nodes']
    text = '; '.join([agreement_sentence(agreement), *(each['message'] for each in others)])
    return escaped(f'{" ".join(words)}: {text}')


def as_json(
    observer: Observer, sample: Sample | None, agreement: Agreement, codes: Mapping[Outcome, int]
) -> dict[str, Any]:
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
        'exit_code': codes[agreement.outcome],
        'problem_joints': list(fault.joints) if fault else [],
        'problem_values': [_known(value) for value in values],
        'problem_link': (fault.link or None) if fault else None,
        'unchecked_joints': {name: agreement.checks[name].value for name in agreement.unchecked},
        'saturated_joints': list(agreement.saturated),
        'status': node_values(observer, agreement) or None,
        'joints': joint_rows(observer, sample) if sample is not None else [],
        'log': [line._asdict() for line in list(observer.log)[-MOST_WARNINGS:]],
    }


def node_values(observer: Observer, agreement: Agreement) -> dict[str, Any]:
    """Return the values of the latest diagnostics by name; {} if there are none."""
    status = observer.status
    if status is None or agreement.obstacle is Obstacle.NO_DIAGNOSTICS:
        return {}
    receivers = status.number('efforts', 'receivers')
    return {
        'state': status.text('loop', 'state'),
        'phase': status.text('loop', 'phase') or None,
        'activity': status['loop'].message,
        'mode': status.text('loop', 'mode') or None,
        'dry_run': status.text('loop', 'dry run') == 'yes',
        'payload': status.text('model', 'payload') or None,
        'commands_topic': status.text('other nodes', 'commands') or None,
        'subscribers': None if receivers is None else int(receivers),
        'rate': status.number('loop', 'rate [Hz]'),
        'requested_rate': status.number('loop', 'requested rate [Hz]'),
        'joint_state_rate': status.number('joint states', 'rate [Hz]'),
        'joint_state_age': status.number('joint states', 'age [s]'),
        'joint_state_timeout': status.number('joint states', 'timeout [s]'),
        'reference_age': status.number('reference', 'age [s]'),
        'reference_timeout': status.number('reference', 'timeout [s]'),
        'trajectory': status.trajectory(),
        'problems': [
            {'part': name, 'level': part.level.name, 'message': part.message}
            for name, part in status.problems().items()
        ],
    }


def _text(text: str, style: str = '', **options: Any) -> Any:
    """Return a `rich.text.Text`; rich is imported here, because plain text does not need it."""
    from rich.text import Text

    return Text(escaped(text), style, **options)


def _number(value: float | None, decimals: int) -> str:
    # Adding zero removes the sign of a rounded zero.
    return '-' if value is None else f'{round(value, decimals) + 0.0:.{decimals}f}'


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
