"""Finds other nodes in the ROS graph."""

from __future__ import annotations

from collections import Counter
import time
from typing import Any, NamedTuple

from rclpy.lifecycle import LifecycleNode

from ..errors import listed

_DISCOVERY = 1.0  # [s]; time allowed for the discovery of publishers
_UNKNOWN = 'a node with an unknown name'
_MOST_NAMES = 5  # largest number of node names in one message


class OtherNodes(NamedTuple):
    """Other nodes that use the topic of the commands, or have the name of this node."""

    commands: str
    """Topic of the commands."""
    subscribers: str = ''
    """Names of the nodes that subscribe to the commands."""
    rivals: str = ''
    """Names of the other nodes that publish the commands."""
    namesakes: int = 0
    """Number of other nodes with the name of this node."""
    names: tuple[str, ...] = ()
    """Names of all nodes."""


class SimulatedClock(NamedTuple):
    """The clock of a simulation."""

    time: float
    """Simulated time [s]; 0 if none has arrived."""
    unchanged_for: float
    """Time since the last change of the simulated time, measured by a steady clock [s]."""
    publishers: int
    """Number of publishers of /clock."""


class Graph:
    """
    Queries the ROS graph on behalf of a node.

    Make queries only in low-rate timers, because a query takes up to 50 us, or more in a large
    graph. `forms` are the publishers of the topics that may carry the commands. The command topic
    is the first of these topics that has a subscriber, or else the first topic.
    """

    def __init__(self, node: LifecycleNode, *forms: Any) -> None:
        self._node, self._forms = node, forms
        self._name = node.get_fully_qualified_name()
        self._last_rivals: set[str] = set()
        self._last_namesakes = 0
        self._last_time = -1
        self._last_advance = time.monotonic()
        self.expect_discovery()

    def expect_discovery(self) -> None:
        """Suppress reports of missing inputs for one second, while publishers are discovered."""
        self._discovered_at = time.monotonic() + _DISCOVERY

    @property
    def is_discovered(self) -> bool:
        """Whether one second has passed since `expect_discovery`."""
        return time.monotonic() >= self._discovered_at

    @property
    def _commands(self) -> Any:
        used = (form for form in self._forms if form.get_subscription_count())
        return next(used, self._forms[0])

    def with_publishers(self, name: str) -> str:
        """Return the resolved name of a topic and the number of its publishers."""
        topic = str(self._node.resolve_topic_name(name))
        count = self._node.count_publishers(topic)
        return f'{topic} ({count} publisher{"" if count == 1 else "s"})'

    def publishers(self, name: str) -> list[str]:
        """Return the nodes that publish on a topic."""
        topic = self._node.resolve_topic_name(name)
        return sorted({_name_of(info) for info in self._node.get_publishers_info_by_topic(topic)})

    def with_subscribers(self) -> str:
        """Return the name of the command topic and the nodes that subscribe to it."""
        commands = self._commands
        names = listed(self._subscribers(commands), _MOST_NAMES)
        return f'{commands.topic_name} ({names or "no subscriber yet"})'

    def others(self) -> OtherNodes:
        """
        Return the interfering nodes that both this call and the previous call have found.

        A single call may be wrong, because a publisher is discovered before the name of its node,
        and because a node that has ended stays in the graph for up to a second.
        """
        rivals: set[str] = set()
        commands = self._commands
        topic = commands.topic_name
        for form in self._forms:
            found = self._rivals(form)
            topic = form.topic_name if found and not rivals else topic
            rivals |= found
        nodes = Counter(
            _joined(namespace, name)
            for name, namespace in self._node.get_node_names_and_namespaces()
        )
        namesakes = nodes[self._name] - 1
        seen = OtherNodes(
            commands=topic,
            subscribers=listed(self._subscribers(commands), _MOST_NAMES),
            rivals=listed(sorted(rivals & self._last_rivals), _MOST_NAMES),
            namesakes=max(0, min(namesakes, self._last_namesakes)),
            names=tuple(nodes),
        )
        self._last_rivals, self._last_namesakes = rivals, namesakes
        return seen

    def clock(self) -> SimulatedClock:
        """Return the simulated time, and the time since its last change."""
        now = self._node.get_clock().now().nanoseconds
        steady = time.monotonic()
        if now != self._last_time:
            self._last_time, self._last_advance = now, steady
        publishers = int(self._node.count_publishers(self._node.resolve_topic_name('/clock')))
        return SimulatedClock(now * 1e-9, steady - self._last_advance, publishers)

    def _rivals(self, commands: Any) -> set[str]:
        """Return the other nodes that publish on the topic of `commands`, with the same type."""
        kind = type_name(commands.msg_type)
        publishers = Counter(
            _name_of(info)
            for info in self._node.get_publishers_info_by_topic(commands.topic_name)
            if info.topic_type == kind
        )
        publishers[self._name] -= 1  # the publisher of this node
        return {name for name, count in publishers.items() if count > 0}

    def _subscribers(self, commands: Any) -> list[str]:
        infos = self._node.get_subscriptions_info_by_topic(commands.topic_name)
        return sorted({_name_of(info) for info in infos})


def subscribers_by_endpoint(node: LifecycleNode, publisher: Any) -> dict[bytes, str]:
    """
    Return the nodes that subscribe to the topic and type of a publisher, by subscription.

    The keys identify the subscriptions. A subscription whose node is not known yet is missing.
    """
    kind = type_name(publisher.msg_type)
    names = {
        bytes(info.endpoint_gid): _name_of(info)
        for info in node.get_subscriptions_info_by_topic(publisher.topic_name)
        if info.topic_type == kind
    }
    return {endpoint: name for endpoint, name in names.items() if name != _UNKNOWN}


def type_name(message: type) -> str:
    """Return the name of a message type, such as 'sensor_msgs/msg/JointState'."""
    return f'{message.__module__.replace(".", "/").rpartition("/")[0]}/{message.__name__}'


def _name_of(info: Any) -> str:
    return _joined(info.node_namespace, info.node_name)


def _joined(namespace: str, name: str) -> str:
    if name == '_NODE_NAME_UNKNOWN_':  # a placeholder of the middleware
        return _UNKNOWN
    return f'{namespace.rstrip("/")}/{name}'
