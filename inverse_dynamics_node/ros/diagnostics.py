"""The status of a node, and its transfer through ``/diagnostics`` in the format of REP-107."""

from __future__ import annotations

import enum
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ..control.supervisor import COMPUTING_PHASES
from ..errors import shortened

_NONE = 'none'  # the text of an empty list
_MAX_LENGTH = 1000  # [characters]; names from messages and robot descriptions can be long


class Level(enum.IntEnum):
    """Severity of a status; the numbers are those of diagnostic_msgs."""

    OK = 0
    WARN = 1
    ERROR = 2


class Part(NamedTuple):
    """The status of one part of the node."""

    level: Level
    message: str
    values: dict[str, str]


class NodeStatus(dict[str, Part]):
    """
    The parts of the status by name, in the order of publication.

    `node/status.py` writes all values, as text. A part or value that does not exist is read as an
    empty text or list, or as None.
    """

    def text(self, part: str, key: str) -> str:
        """Return a value as it was written."""
        return self[part].values.get(key, '') if part in self else ''

    def number(self, part: str, key: str) -> float | None:
        """Return a value that is one number."""
        try:
            return float(self.text(part, key))
        except ValueError:
            return None

    def names(self, part: str, key: str) -> list[str]:
        """Return the items of a list."""
        text = self.text(part, key)
        return text.split(', ') if text not in ('', _NONE) else []

    def numbers(self, part: str, key: str) -> list[float]:
        """Return a list of numbers."""
        try:
            return [float(text) for text in self.names(part, key)]
        except ValueError:
            return []

    def by_joint(self, key: str) -> dict[str, float]:
        """Return numbers of the efforts by commanded joint; empty if they are unknown."""
        joints, values = self.names('model', 'joints'), self.numbers('efforts', key)
        return dict(zip(joints, values, strict=True)) if len(joints) == len(values) else {}

    def measured_scale(self) -> dict[str, float]:
        """Return the factor for the measured efforts of each commanded joint."""
        return self.by_joint('scale of the measured efforts')

    def locked_positions(self) -> dict[str, float]:
        """Return the positions [rad or m] that the node uses for joints without any report."""
        joints = self.names('joint states', 'locked, never reported')
        positions = self.numbers('joint states', 'locked positions [rad, m]')
        return dict(zip(joints, positions, strict=True)) if len(joints) == len(positions) else {}

    def gravity(self) -> list[float]:
        """Return gravity in the frame of the root link [m/s^2], even if commands exclude it."""
        return self.numbers('model', 'gravity in the root link [m/s^2]')

    def payloads(self) -> list[tuple[str, float, list[float]]]:
        """Return link, mass [kg] and centre of mass in the frame of the link [m] of each load."""
        links = self.names('model', 'payload links')
        masses = self.numbers('model', 'payload masses [kg]')
        coms = self.numbers('model', 'payload com [m]')
        if not 3 * len(links) == 3 * len(masses) == len(coms):
            return []
        return [(link, masses[k], coms[3 * k : 3 * k + 3]) for k, link in enumerate(links)]

    def trajectory(self) -> str | None:
        """Return how far a trajectory has been followed, and how well; None if there is none."""
        doing, progress, left, error = (
            self.text('reference', f'trajectory{key}')
            for key in ('', ' progress [%]', ' time left [s]', ' largest error [rad, m]')
        )
        if doing in ('', _NONE):
            return None
        return f'{doing}, {progress} %, {left} s left, largest error {error} rad or m'

    @property
    def is_computing(self) -> bool:
        """Whether the node computes efforts for the current joint states."""
        phases = [phase.value for phase in COMPUTING_PHASES]
        return self.text('loop', 'state') == 'active' and self.text('loop', 'phase') in phases

    def problems(self) -> dict[str, Part]:
        """Return the parts that are not OK, with errors first."""
        found = [(-part.level, name) for name, part in self.items() if part.level is not Level.OK]
        return {name: self[name] for _, name in sorted(found)}


def as_text(value: Any) -> str:
    """Return the text of a value: a text, a number, a list, or None for an empty list."""
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    if isinstance(value, float):
        return f'{value + 0.0:g}'  # the sum has no negative zero
    if isinstance(value, str | int):
        return str(value)
    return ', '.join(map(as_text, () if value is None else value)) or _NONE


def write_status(stamp: Any, node: str, status: NodeStatus) -> DiagnosticArray:
    """
    Return the message for ``/diagnostics``, with long texts shortened.

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
            hardware_id=shortened(status.text('model', 'robot')),
            values=[
                KeyValue(key=shortened(key, _MAX_LENGTH), value=shortened(value, _MAX_LENGTH))
                for key, value in part.values.items()
            ],
        )
        for name, part in status.items()
    ]
    return message


def read_status(message: Any, node: str) -> NodeStatus | None:
    """Read the status of a node; return None if the message is from another node."""
    prefix = f'{node.strip("/")}: '
    status = NodeStatus(
        (
            each.name.removeprefix(prefix),
            Part(
                Level(each.level[0]), each.message, {pair.key: pair.value for pair in each.values}
            ),
        )
        for each in message.status
        if each.name.startswith(prefix)
    )
    return status if 'loop' in status else None
