"""From statuses to a message, as REP-107 has them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ..control.status import Status
from ..errors import shortened

_LONGEST = 1000  # characters; names come from messages and robot descriptions


def diagnostic_array(
    stamp: Any, node: str, hardware: str, statuses: Sequence[Status]
) -> DiagnosticArray:
    """
    Make the message for `/diagnostics`.

    Parameters
    ----------
    stamp : builtin_interfaces.msg.Time
        Of the header.
    node : str
        Fully qualified name of the node, with which the names begin.
    hardware : str
        Name of the robot; empty if there is none yet.
    statuses : sequence of Status
        One for each part.

    """
    message = DiagnosticArray()
    message.header.stamp = stamp
    message.status = [
        DiagnosticStatus(
            level=bytes([status.level]),
            name=f'{node.strip("/")}: {status.part}',
            message=shortened(status.message, _LONGEST),
            hardware_id=shortened(hardware),
            values=[
                KeyValue(key=shortened(key, _LONGEST), value=shortened(value, _LONGEST))
                for key, value in status.values.items()
            ],
        )
        for status in statuses
    ]
    return message
