"""
Records topics to a ROS 2 bag.

Messages are kept in memory and written at the end, so that the disk cannot delay the control loop.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import time
from typing import Any, Literal

from rclpy.node import Node
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from ...ros.cdr import stamp_of
from ...ros.qos import LATCHED

STORAGES = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
VERSION: Literal[9] = 9  # version of the bag metadata in ROS 2 Jazzy
DEEP = 1000  # depth of the queues


class Recorder:
    """
    Records topics through the subscriptions of one node.

    A message with a header is recorded with its stamp. A message without a header is recorded with
    the stamp of the latest joint state, because the message probably responds to this joint state.
    ``topics`` maps topics to message classes. Topics in ``latched`` are transient local.
    """

    def __init__(
        self, node: Node, topics: Mapping[str, Any], latched: tuple[str, ...] = ()
    ) -> None:
        self._messages: dict[str, list[tuple[int, bytes]]] = {}
        self._types: dict[str, str] = {}
        self._latched = {node.resolve_topic_name(topic) for topic in latched}
        self.latest = 0  # stamp of the latest joint state [ns]
        for topic, type_ in topics.items():
            name = node.resolve_topic_name(topic)
            self._messages[name] = []
            self._types[name] = '/'.join((type_.__module__.split('.')[0], 'msg', type_.__name__))
            qos = LATCHED if topic in latched else DEEP
            keep = self._keeper(name, has_header=hasattr(type_, 'header'))
            node.create_subscription(type_, topic, keep, qos, raw=True)
        self._joint_states = node.resolve_topic_name('joint_states')

    def _keeper(self, name: str, has_header: bool) -> Any:
        messages = self._messages[name]

        def keep(data: bytes) -> None:
            if has_header:
                stamp = stamp_of(data)
                if name == self._joint_states:
                    self.latest = stamp
            else:
                stamp = self.latest or time.time_ns()
            messages.append((stamp, data))

        return keep

    def begin(self) -> None:
        """Drop the messages recorded so far, except the latest message of each latched topic."""
        for name, messages in self._messages.items():
            del messages[: -1 if name in self._latched else None]

    def write(self, folder: str | Path, storage: str = 'mcap') -> int:
        """
        Write all messages, sorted by time, to a new folder; return the number of messages.

        The folder must not exist yet. The storage is 'mcap' or 'sqlite3'.
        """
        typestore = get_typestore(Stores.ROS2_JAZZY)
        with Writer(folder, version=VERSION, storage_plugin=STORAGES[storage]) as writer:
            rows = []
            for name, messages in self._messages.items():
                connection = writer.add_connection(name, self._types[name], typestore=typestore)
                rows += [(stamp, connection, data) for stamp, data in messages]
            rows.sort(key=lambda row: row[0])
            for stamp, connection, data in rows:
                writer.write(connection, stamp, data)
        return len(rows)
