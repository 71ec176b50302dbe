"""
Writes `NodeStatus` to ``/diagnostics`` in the format of REP-107, and reads it back.

All keys are in `_KEYS`, with the kind of text that both directions use. Values have the precision
of the text after the way through a message.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, get_args, get_type_hints, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ..control.settings import Mode
from ..control.status import (
    ClockStatus,
    EffortsStatus,
    JointStatesStatus,
    Level,
    LoopStatus,
    MessagesStatus,
    ModelStatus,
    NodeNames,
    NodeStatus,
    OtherNodesStatus,
    Part,
    Payload,
    ReferenceStatus,
    SchedulingStatus,
)
from ..control.supervision import Phase
from ..errors import shortened

_MAX_LENGTH = 1000  # [characters]; texts contain names from messages and robot descriptions
_NONE = 'none'


class _Kind(NamedTuple):
    """How values of one kind are written, and read; reading another text is a ValueError."""

    write: Callable[[Any], str]
    read: Callable[[str], Any]


def _number(form: str, factor: float = 1.0) -> _Kind:
    """Return the kind of numbers that are printed in this format, times a factor."""
    return _Kind(lambda x: format(factor * x, form), lambda text: float(text) / factor)


def _list_of(item: _Kind, if_empty: str = _NONE) -> _Kind:
    def read(text: str) -> tuple[Any, ...]:
        return tuple(map(item.read, text.split(', '))) if text != if_empty else ()

    return _Kind(lambda values: ', '.join(map(item.write, values)) or if_empty, read)


def _read_nodes(text: str) -> NodeNames:
    if text == _NONE:
        return NodeNames()
    names, _, more = text.partition(' and ')
    return NodeNames(tuple(names.split(', ')), int(more.removesuffix(' more') or 0))


def _read_payload(text: str) -> Payload:
    mass, _, link = text.partition(' kg on ')
    return Payload(float(mass), link)


_TEXT = _Kind(str, str)
_COUNT = _Kind(str, int)
_FLAG = _Kind(lambda flag: 'yes' if flag else 'no', lambda text: text == 'yes')
_MODE, _PHASE = (_Kind(lambda member: str(member.value), kind) for kind in (Mode, Phase))
_TIME_LIMIT, _AGE = _number('g'), _number('.3f')
_RATE, _MILLISECONDS = _number('.1f'), _number('.3f', factor=1e3)
_NAMES = _list_of(_TEXT)
_NODES = _Kind(lambda nodes: str(nodes) or _NONE, _read_nodes)
_PAYLOADS = _list_of(_Kind(str, _read_payload))


class _Key(NamedTuple):
    """One key; a value of None is written as another text, or if that is empty, not at all."""

    name: str
    kind: _Kind
    absent: str = ''

    def write(self, value: Any) -> dict[str, str]:
        if value is None:
            return {self.name: self.absent} if self.absent else {}
        return {self.name: self.kind.write(value)}

    def read(self, values: Mapping[str, str]) -> Any:
        text = values.get(self.name, self.absent)
        return None if text == self.absent else self.kind.read(text)


class _Counts(NamedTuple):
    """A key for each name, followed by the same words."""

    words: str = ''

    def write(self, counts: Mapping[str, int]) -> dict[str, str]:
        return {f'{name}{self.words}': str(count) for name, count in counts.items()}

    def read(self, values: Mapping[str, str]) -> dict[str, int]:
        found = {key: text for key, text in values.items() if key.endswith(self.words)}
        return {key.removesuffix(self.words): int(text) for key, text in found.items()}


class _Numbered(NamedTuple):
    """A key for each text: a word and its number."""

    word: str

    def write(self, texts: tuple[str, ...]) -> dict[str, str]:
        return {f'{self.word} {k}': text for k, text in enumerate(texts, start=1)}

    def read(self, values: Mapping[str, str]) -> tuple[str, ...]:
        return tuple(text for key, text in values.items() if key.startswith(f'{self.word} '))


_KEYS: dict[type[Part], dict[str, _Key | _Counts | _Numbered]] = {
    LoopStatus: {
        'state': _Key('state', _TEXT),
        'rate': _Key('rate [Hz]', _RATE),
        'requested_rate': _Key('requested rate [Hz]', _number('g'), 'that of the joint states'),
        'period_p99': _Key('period p99 [ms]', _MILLISECONDS, _NONE),
        'period_worst': _Key('period worst [ms]', _MILLISECONDS, _NONE),
        'compute_time_p99': _Key('compute time p99 [ms]', _MILLISECONDS, _NONE),
        'overruns': _Key('overruns', _COUNT),
        'mode': _Key('mode', _MODE),
        'phase': _Key('phase', _PHASE),
        'is_dry_run': _Key('dry run', _FLAG),
        'gain': _Key('gain', _number('.3f')),
    },
    MessagesStatus: {'rejected': _Counts()},
    OtherNodesStatus: {
        'commands': _Key('commands', _TEXT),
        'subscribers': _Key('subscribers of the commands', _NODES),
        'rivals': _Key('other publishers of the commands', _NODES),
        'namesakes': _Key('other nodes with this name', _COUNT),
    },
    ClockStatus: {
        'time': _Key('time [s]', _AGE),
        'unchanged_for': _Key('unchanged for [s]', _number('.1f')),
        'publishers': _Key('publishers', _COUNT),
    },
    JointStatesStatus: {
        'topic': _Key('topic', _TEXT),
        'rate': _Key('rate [Hz]', _RATE),
        'age': _Key('age [s]', _AGE, 'never'),
        'timeout': _Key('timeout [s]', _TIME_LIMIT),
        'publishers': _Key('publishers', _COUNT),
        'late': _Key('late, not commanded', _NAMES),
        'locked': _Key('locked, never reported', _NAMES),
        'without_velocity': _Key('without velocity', _NAMES),
    },
    ReferenceStatus: {
        'age': _Key('age [s]', _AGE, 'never'),
        'timeout': _Key('timeout [s]', _TIME_LIMIT),
        'mode': _Key('mode', _MODE),
    },
    EffortsStatus: {
        'receivers': _Key('receivers', _COUNT),
        'topic': _Key('topic with names', _TEXT),
        'external_topic': _Key('topic of the external efforts', _TEXT),
        'external_cutoff': _Key('cutoff of the external efforts [Hz]', _number('g')),
        'limits': _Key('limits [N m, N]', _list_of(_number('g'), '')),
        'cut': _Key('cut to limit since the last report', _NAMES),
        'cut_counts': _Counts(' cut to limit'),
        'slowed_counts': _Counts(' slowed'),
    },
    ModelStatus: {
        'robot': _Key('robot', _TEXT),
        'mass': _Key('mass [kg]', _number('.4g')),
        'joints': _Key('joints', _list_of(_TEXT, '')),
        'payloads': _Key('payload', _PAYLOADS),
        'gravity': _Key('gravity [m/s^2]', _list_of(_number('.3f'), ''), 'not included'),
        'warnings': _Numbered('warning'),
    },
    SchedulingStatus: {
        'memory': _Key('memory', _TEXT),
        'policy': _Key('policy', _TEXT),
        'priority': _Key('priority', _COUNT),
        'cpus': _Key('CPUs', _list_of(_COUNT, '')),
        'threads': _Key('threads', _COUNT),
    },
}


def write_values(part: Part) -> dict[str, str]:
    """Return the keys and values of a part."""
    values: dict[str, str] = {}
    for name, key in _KEYS[type(part)].items():
        values |= key.write(getattr(part, name))
    return values


def write_status(stamp: Any, node: str, status: NodeStatus) -> DiagnosticArray:
    """
    Make the message for ``/diagnostics``.

    Parameters
    ----------
    stamp : builtin_interfaces.msg.Time
        Time stamp of the header.
    node : str
        Fully qualified name of the node; the names of the parts begin with it.
    status : NodeStatus
        The status.

    Returns
    -------
    message : DiagnosticArray
        The message, with long texts shortened.

    """
    message = DiagnosticArray()
    message.header.stamp = stamp
    message.status = [
        DiagnosticStatus(
            level=bytes([part.level]),
            name=f'{node.strip("/")}: {name}',
            message=shortened(part.message, _MAX_LENGTH),
            hardware_id=shortened(status.model.robot) if status.model else '',
            values=[
                KeyValue(key=shortened(key, _MAX_LENGTH), value=shortened(value, _MAX_LENGTH))
                for key, value in write_values(part).items()
            ],
        )
        for name, part in status.parts().items()
    ]
    return message


def read_status(message: Any, node: str) -> NodeStatus | None:
    """
    Read the status of a node.

    Parameters
    ----------
    message : diagnostic_msgs.msg.DiagnosticArray
        A message of any node, also of another version of this package.
    node : str
        Fully qualified name of the node.

    Returns
    -------
    status : NodeStatus or None
        Without the values that cannot be read. None if the message is from another node.

    """
    prefix = f'{node.strip("/")}: '
    parts = {
        status.name.removeprefix(prefix).replace(' ', '_'): status
        for status in message.status
        if status.name.startswith(prefix)
    }
    if 'loop' not in parts:
        return None
    known = {name: _read_part(kind, parts[name]) for name, kind in _PARTS.items() if name in parts}
    return NodeStatus(**known)


def _read_part(kind: type[Part], message: Any) -> Any:
    values = {pair.key: pair.value for pair in message.values}
    known: dict[str, Any] = {}
    for name, key in _KEYS[kind].items():
        try:
            value = key.read(values)
        except ValueError:
            continue
        if value is not None:
            known[name] = value
    return kind(Level(message.level[0]), message.message, **known)


def _kinds_of_parts() -> dict[str, type[Part]]:
    hints = get_type_hints(NodeStatus)
    return {name: (get_args(hint) or (hint,))[0] for name, hint in hints.items()}


_PARTS = _kinds_of_parts()
