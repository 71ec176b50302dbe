"""
Converts `NodeStatus` to and from ``/diagnostics`` messages in the format of REP-107.

Each field of the status declares its key and format. The format also rounds the numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, get_args, get_origin, get_type_hints, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ..control.settings import Mode
from ..control.status import Level, NodeNames, NodeStatus, Part, Payload
from ..control.supervision import Phase
from ..errors import shortened

_MAX_LENGTH = 1000  # [characters]; names from messages and robot descriptions can be long
_NONE = 'none'


class _Kind(NamedTuple):
    """Functions that convert values of one type to text and back; `read` may raise ValueError."""

    write: Callable[[Any], str]
    read: Callable[[str], Any]


def _read_nodes(text: str) -> NodeNames:
    if text == _NONE:
        return NodeNames()
    names, _, more = text.partition(' and ')
    return NodeNames(tuple(names.split(', ')), int(more.removesuffix(' more') or 0))


def _read_payload(text: str) -> Payload:
    mass, _, link = text.partition(' kg on ')
    return Payload(float(mass), link)


_KINDS = {
    str: _Kind(str, str),
    int: _Kind(str, int),
    bool: _Kind(lambda flag: 'yes' if flag else 'no', lambda text: text == 'yes'),
    Mode: _Kind(lambda mode: str(mode.value), Mode),
    Phase: _Kind(lambda phase: str(phase.value), Phase),
    NodeNames: _Kind(lambda nodes: str(nodes) or _NONE, _read_nodes),
    Payload: _Kind(str, _read_payload),
}


def _number(form: str, factor: float) -> _Kind:
    return _Kind(lambda x: format(factor * x, form), lambda text: float(text) / factor)


def _list_of(item: _Kind) -> _Kind:
    def read(text: str) -> tuple[Any, ...]:
        return tuple(map(item.read, text.split(', '))) if text != _NONE else ()

    return _Kind(lambda values: ', '.join(map(item.write, values)) or _NONE, read)


@dataclass(frozen=True)
class _Key:
    """The key of a value; a ``*`` in the key stands for the name or number of each item."""

    value: str
    name: str
    absent: str
    kind: _Kind
    is_counted: bool

    def write(self, value: Any) -> dict[str, str]:
        """Convert the value to strings, and return them by key."""
        if value is None:
            return {self.name: self.absent} if self.absent else {}
        if '*' not in self.name:
            return {self.name: self.kind.write(value)}
        pairs = value.items() if self.is_counted else enumerate(value, start=1)
        return {self.name.replace('*', str(name)): str(each) for name, each in pairs}

    def read(self, values: Mapping[str, str]) -> Any:
        """Read the value from the strings in `values`; return None if the value is missing."""
        if '*' not in self.name:
            text = values.get(self.name, self.absent)
            return None if text == self.absent else self.kind.read(text)
        before, _, after = self.name.partition('*')
        found = [key for key in values if key.startswith(before) and key.endswith(after)]
        if not self.is_counted:
            return tuple(values[key] for key in found)
        return {key.removesuffix(after): int(values[key]) for key in found}


def _keys(part: type[Part]) -> list[_Key]:
    """Return the keys that the fields of a part declare."""
    keys = []
    hints = get_type_hints(part)
    for field in fields(part):
        if 'key' not in field.metadata:
            continue
        name, form, absent = (field.metadata[word] for word in ('key', 'form', 'absent'))
        hint = _without_none(hints[field.name])
        item = get_args(hint)[0] if get_origin(hint) is tuple else hint
        factor = 1e3 if name.endswith('[ms]') else 1.0
        kind = _number(form, factor) if item is float else _KINDS.get(item, _KINDS[str])
        is_counted = get_origin(hint) is Mapping
        kind = _list_of(kind) if item is not hint else kind
        keys.append(_Key(field.name, name, absent, kind, is_counted))
    return keys


def _without_none(hint: Any) -> Any:
    return get_args(hint)[0] if type(None) in get_args(hint) else hint


_PARTS = {name: _without_none(hint) for name, hint in get_type_hints(NodeStatus).items()}
_KEYS: dict[type[Part], list[_Key]] = {part: _keys(part) for part in _PARTS.values()}


def write_values(part: Part) -> dict[str, str]:
    """Return the values of a part as strings, by key."""
    values: dict[str, str] = {}
    for key in _KEYS[type(part)]:
        values |= key.write(getattr(part, key.value))
    return values


def write_status(stamp: Any, node: str, status: NodeStatus) -> DiagnosticArray:
    """
    Return the message for ``/diagnostics``, with long strings shortened.

    `stamp` is the time in the header. `node` is the fully qualified name of the node. The name of
    each part begins with `node`, without the leading slash.
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
    Read the status of the node with the fully qualified name `node`.

    Return None if the message is from another node. Values that cannot be read keep their
    defaults, because the node may have another version of this package.
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
    for key in _KEYS[kind]:
        try:
            value = key.read(values)
        except ValueError:
            continue
        if value is not None:
            known[key.value] = value
    return kind(Level(message.level[0]), message.message, **known)
