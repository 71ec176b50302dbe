"""Shows the state of a node as a full-screen view, as a line of text, or as JSON."""

from __future__ import annotations

from collections.abc import Mapping
import math
import os
import time
from typing import Any, TYPE_CHECKING

from ..analysis.diagnosis.live import Agreement, Obstacle, Outcome
from ..control.status import JointStatesStatus, NodeStatus, OtherNodesStatus, ReferenceStatus
from ..errors import escaped
from ..report.diagnosis_text import agreement_sentence
from ..report.tables import counted

if TYPE_CHECKING:
    from ..ros.observer import Observer, Sample

BAR = 12  # largest length of a bar [characters]
WIDTH_WITHOUT_BAR = 76  # width of the joint table without bars [characters]
NEAR_LIMIT, AT_LIMIT = 0.7, 0.95
MOST_WARNINGS = 4
RECENT = 60.0  # [s]; older warnings are not shown
_COLOURS = {Outcome.AGREE: 'green', Outcome.DIFFER: 'red', Outcome.SATURATED: 'red'}


class LiveView:
    """A full-screen view that is updated in place until the ``with`` block ends."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.live import Live

        # Some shells export COLUMNS and LINES, which would fix the size of the screen.
        size = {'COLUMNS', 'LINES'}
        environment = {key: os.environ[key] for key in os.environ.keys() - size}
        self._console = Console(highlight=False, _environ=environment)
        self._live = Live(console=self._console, screen=True, auto_refresh=False)
        self.last_words = ''
        """Text to print after the screen has been closed."""

    def __enter__(self) -> LiveView:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()
        if self.last_words:
            self._console.print(_text(self.last_words), soft_wrap=True)

    def show(self, observer: Observer, sample: Sample | None, agreement: Agreement) -> None:
        """Show the latest values."""
        content = screen(observer, sample, agreement, self._console.width)
        self._live.update(_cropped(content, self._console), refresh=True)


def screen(observer: Observer, sample: Sample | None, agreement: Agreement, width: int) -> Any:
    """Return the content of the screen as a `rich` renderable, with the important lines first."""
    from rich.console import Group

    status = None if agreement.obstacle is Obstacle.NO_DIAGNOSTICS else observer.status
    parts: list[Any] = [
        _headline(observer, agreement),
        _text(agreement_sentence(agreement), _COLOURS.get(agreement.outcome, 'yellow') + ' bold'),
    ]
    if status is not None:
        parts += _problems(status)
    parts.append(_text(''))
    if sample is not None:
        parts += [_joint_table(observer, sample, agreement, width), _text('')]
    if status is not None:
        parts.append(_node_table(status))
    parts += _log(observer)
    return Group(*parts)


def _cropped(content: Any, console: Any) -> Any:
    """Replace the lines that do not fit on the terminal with a hint."""
    from rich.console import Group
    from rich.segment import Segment, Segments

    lines = console.render_lines(content, console.options.update(height=None), pad=False)
    rest = len(lines) - console.height
    if rest <= 0:
        return content
    shown = [[*line, Segment.line()] for line in lines[: console.height - 1]]
    hint = f'... and {rest + 1} more lines: enlarge the terminal'
    return Group(Segments([each for line in shown for each in line]), _text(hint, 'cyan'))


def _headline(observer: Observer, agreement: Agreement) -> Any:
    text = _text(observer.name, 'bold')
    if observer.robot is not None:
        text.append(escaped(f"  robot '{observer.robot.name}'"), 'not bold')
    status = observer.status
    if status is None:
        text.append('  waiting for diagnostics', 'not bold yellow')
        return text
    if agreement.obstacle is Obstacle.NO_DIAGNOSTICS:
        text.append('  NO DIAGNOSTICS', 'bold red')
        return text
    loop = status.loop
    if loop.is_dry_run:
        text.append('  DRY RUN', 'bold cyan')
    text.append(escaped(f'  {loop.state}'), 'not bold')
    if loop.message != loop.state:
        text.append(escaped(f'  {loop.message.removeprefix("dry run: ")}'), 'not bold')
    return text


def _joint_table(observer: Observer, sample: Sample, agreement: Agreement, width: int) -> Any:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style='cyan')
    table.add_column('joint')  # only this column shrinks on a narrow terminal
    for title in ('position', 'measured', 'modelled', 'residual', 'command', 'limit'):
        table.add_column(title, justify='right', no_wrap=True)
    bar = min(BAR, max(0, width - WIDTH_WITHOUT_BAR))
    table.add_column('', no_wrap=True, width=bar)
    problems = {joint for fault in agreement.faults for joint in fault.joints}
    problems.update(agreement.saturated)
    for row in joint_rows(observer, sample):
        marked = row['name'] in problems
        unit = 'mm' if row['is_prismatic'] else 'deg'
        position = row['position']
        if position is not None:
            position *= 1e3 if row['is_prismatic'] else 180.0 / math.pi
        effort = 'N' if row['is_prismatic'] else 'N m'
        table.add_row(
            _text(row['name'], no_wrap=True, overflow='ellipsis'),
            _number(position, 1) + f' {unit:3}',
            *(_number(row[key], 2) for key in ('measured', 'modelled', 'residual')),
            f'{_number(row["command"], 2)} {effort:3}',
            '-' if row['fraction'] is None else f'{row["fraction"]:.0%}',
            _bar(row['fraction'], bar),
            style='bold red' if marked else '',
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
        limits |= status.limits()
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


def _node_table(status: NodeStatus) -> Any:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style='cyan', no_wrap=True)
    table.add_column()
    for label, text in node_lines(status):
        table.add_row(label, _text(text))
    return table


def node_lines(status: NodeStatus) -> list[tuple[str, str]]:
    """Return lines about the node, as pairs of label and text."""
    loop, others = status.loop, status.other_nodes or OtherNodesStatus()
    states = status.joint_states or JointStatesStatus()
    reference = status.reference or ReferenceStatus()
    lines = []
    if loop.mode:
        lines.append(('mode', loop.mode.value))
    if payload := _payload(status):
        lines.append(('payload', payload))
    if others.commands:
        count = (status.efforts and status.efforts.receivers) or 0
        names = f': {str(others.subscribers) or "none"}' if count else ''
        are = 'not sent, ' if loop.is_dry_run else ''
        subscribers = counted(count, 'subscriber')
        lines.append(('commands', f'{others.commands}, {are}{subscribers}{names}'))
    expected = '' if loop.requested_rate is None else f' of {loop.requested_rate:g}'
    rates = [f'commands {_number(loop.rate, 1)}{expected} Hz']
    if states.rate is not None:
        rates.append(f'joint states {states.rate:.1f} Hz')
    lines.append(('rates', ', '.join(rates)))
    ages = [
        f'{what} {_age(part.age)} ({_time_limit(part.timeout)})'
        for what, part in (('joint states', states), ('reference', reference))
        if part.timeout is not None
    ]
    if ages:
        lines.append(('ages', ', '.join(ages)))
    return lines


def _payload(status: NodeStatus) -> str:
    """List the payloads; return '' until the node has a robot model."""
    return ', '.join(map(str, status.model.payloads)) or 'none' if status.model else ''


def _problems(status: NodeStatus) -> list[Any]:
    return [
        _text(
            f'{problem.level} {problem.part}: {problem.message}',
            'bold red' if problem.level == 'ERROR' else 'yellow',
        )
        for problem in status.problems()
    ]


def _log(observer: Observer) -> list[Any]:
    lines = []
    oldest = time.time() - RECENT
    recent = [line for line in observer.log if line.time > oldest]
    last = {line.text: line for line in recent}  # a persistent problem is logged repeatedly
    for line in sorted(last.values(), key=lambda line: line.time)[-MOST_WARNINGS:]:
        clock = time.strftime('%H:%M:%S', time.localtime(line.time))
        count = sum(other.text == line.text for other in recent)
        times = f' ({count} times)' if count > 1 else ''
        lines.append(_text(f'{clock} {line.level} {line.text}{times}', 'yellow'))
    return [_text(''), *lines] if lines else []


def as_line(observer: Observer, agreement: Agreement) -> str:
    """Return the state as one line of text, for output to a pipe."""
    status = None if agreement.obstacle is Obstacle.NO_DIAGNOSTICS else observer.status
    words = [time.strftime('%H:%M:%S'), observer.name]
    if status is not None:
        words.append('dry run' if status.loop.is_dry_run else status.loop.state)
        rate = status.joint_states.rate if status.joint_states else None
        words.append(f'{_number(rate, 0)} Hz')
    return escaped(f'{" ".join(words)}: {agreement_sentence(agreement)}')


def as_json(
    observer: Observer, sample: Sample | None, agreement: Agreement, codes: Mapping[Outcome, int]
) -> dict[str, Any]:
    """Return the values to print as JSON; doc/watch.md describes the keys."""
    status = None if agreement.obstacle is Obstacle.NO_DIAGNOSTICS else observer.status
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
        'unchecked_joints': [*agreement.unchecked, *agreement.unmeasured],
        'saturated_joints': list(agreement.saturated),
        'status': None if status is None else _status_json(status),
        'joints': joint_rows(observer, sample) if sample is not None else [],
        'log': [line._asdict() for line in list(observer.log)[-MOST_WARNINGS:]],
    }


def _status_json(status: NodeStatus) -> dict[str, Any]:
    loop, others = status.loop, status.other_nodes or OtherNodesStatus()
    states = status.joint_states or JointStatesStatus()
    reference = status.reference or ReferenceStatus()
    return {
        'state': loop.state,
        'phase': loop.phase.value if loop.phase else None,
        'activity': loop.message,
        'mode': loop.mode.value if loop.mode else None,
        'dry_run': bool(loop.is_dry_run),
        'payload': _payload(status) or None,
        'commands_topic': others.commands or None,
        'subscribers': status.efforts.receivers if status.efforts else None,
        'rate': loop.rate,
        'requested_rate': loop.requested_rate,
        'joint_state_rate': states.rate,
        'joint_state_age': states.age,
        'joint_state_timeout': states.timeout,
        'reference_age': reference.age,
        'reference_timeout': reference.timeout,
        'problems': [problem._asdict() for problem in status.problems()],
    }


def _text(text: str, style: str = '', **options: Any) -> Any:
    """Return a `rich.text.Text`; rich is imported here, because plain text does not need it."""
    from rich.text import Text

    return Text(escaped(text), style, **options)


def _bar(fraction: float | None, length: int) -> Any:
    if fraction is None:
        return _text('')
    filled = min(length, round(fraction * length))
    colour = 'red' if fraction >= AT_LIMIT else 'yellow' if fraction >= NEAR_LIMIT else 'green'
    text = _text('█' * filled, colour)
    text.append('░' * (length - filled), 'dim')
    return text


def _age(seconds: float | None) -> str:
    return 'never received' if seconds is None else f'{seconds:.3f} s'


def _time_limit(seconds: float) -> str:
    return f'limit {seconds:g} s' if seconds else 'no limit'


def _number(value: float | None, decimals: int) -> str:
    # Adding zero removes the sign of a rounded zero.
    return '-' if value is None else f'{round(value, decimals) + 0.0:.{decimals}f}'


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
