"""Observes a running node, on this or another machine, by subscribing to its topics."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import os
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from rcl_interfaces.msg import Log
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ..control.contact import CUTOFF
from ..control.filters import LowPass
from ..errors import InverseDynamicsError, JointStateError
from ..robot.model import Floats, RobotModel
from ..robot.urdf import load_urdf
from .cdr import JointStateReader
from .diagnostics import NodeStatus, read_status
from .middleware import explained_start, LATCHED, QUEUED, start_ros
from .private import waiting_messages

_RATES = 3  # number of rate reports to keep; a report arrives every second
_STALE = 0.5  # [s]; older efforts are treated as unknown
_LONGEST_GAP = 0.5  # [s]; the filters restart after a longer gap, as in the node
_SETTLING = 0.3  # [s]; time until the filters of this process agree with the filters of the node
_QUEUE = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_LOG = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_WARN = 30  # level of warnings in the log
_EFFORTS = 'external_efforts', 'joint_efforts'
_TOPICS = {
    'joint_states': ('joint states', 'topic', _QUEUE),
    'joint_efforts': ('efforts', 'topic with names', _LATEST),
    'external_efforts': ('efforts', 'topic of the external efforts', _LATEST),
}
"""Part and key of the diagnostics that name each topic, and its quality of service."""
_CHECK_MODEL = '/check_model'


class Sample(NamedTuple):
    """The latest values of all n joints, through a low-pass filter; NaN if unknown."""

    time: float
    """Time of the sample on the steady clock [s]."""
    q: Floats
    """Positions, shape (n,) [rad or m]."""
    qd: Floats
    """Velocities, shape (n,) [rad/s or m/s]."""
    measured: Floats
    """Measured efforts times `measured_effort_scale`, shape (n,) [N m or N]."""
    modelled: Floats
    """Modelled efforts for the measured motion, shape (n,) [N m or N]."""
    commands: Floats
    """Commanded efforts, not filtered, shape (n,) [N m or N]."""


@contextmanager
def observing_node(arguments: Sequence[str] = ()) -> Iterator[Node]:
    """
    Yield a hidden node of this process, for `find_nodes` and `Observer`.

    The node has no services and no log topic. The caller handles signals. `arguments` are ROS
    arguments.
    """
    try:
        with explained_start():
            start_ros([*arguments])
            node = rclpy.create_node(
                f'_inverse_dynamics_watch_{os.getpid()}',
                enable_rosout=False,
                start_parameter_services=False,
                parameter_overrides=[Parameter('start_type_description_service', value=False)],
            )
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def find_nodes(node: Node) -> list[str]:
    """Return the fully qualified names of the running inverse dynamics nodes."""
    return sorted(
        name.removesuffix(_CHECK_MODEL)
        for name, types in node.get_service_names_and_types()
        if name.endswith(_CHECK_MODEL) and 'std_srvs/srv/Trigger' in types
    )


class Observer:
    """
    Collects the messages of the node with the fully qualified name `name`.

    `poll` takes the messages from the middleware. No executor spins the observing node, because
    an executor would wake up for each message, often a thousand times per second.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node, self.name = node, name
        self.status: NodeStatus | None = None
        """The latest diagnostics; None before the first message."""
        self.status_time = -np.inf
        """Arrival time of the latest diagnostics on the steady clock [s]."""
        self._state_rates: deque[float] = deque(maxlen=_RATES)
        self.robot: RobotModel | None = None
        """The robot of the node; None if unknown."""
        self.robot_problem = ''
        """Why the robot description cannot be used; empty if there is no problem."""
        self.last_warning = ''
        """The latest warning or error in the log of the node."""
        self.on_joint_state: Callable[[bytes, float], None] | None = None
        """Called by `poll` with each serialized joint state and its arrival time [s]."""
        self.state_count = 0
        """Number of joint states of this robot that `poll` has taken."""
        self._subscriptions: dict[str, Any] = {}
        self._subscribe('diagnostics', DiagnosticArray, self._diagnostics_topic(), QUEUED)
        self._subscribe('log', Log, '/rosout', _LOG)
        self._subscribe('description', String, f'{name}/robot_description', LATCHED)
        self._reader = JointStateReader()
        self._clear()

    def _clear(self) -> None:
        names = self.robot.joint_names if self.robot else ()
        self._index = {name: i for i, name in enumerate(names)}
        self._filtered = np.full((3, len(names)), np.nan)
        self._efforts = {topic: np.full(len(names), np.nan) for topic in _EFFORTS}
        self._effort_times = dict.fromkeys(_EFFORTS, -np.inf)  # of arrival
        self._filters: dict[tuple[str, ...], LowPass] = {}
        self._settled_at = np.inf

    def poll(self) -> bool:
        """Handle new messages; return True if a new robot description invalidates old samples."""
        for message, _ in self._take('diagnostics'):
            status = read_status(message, self.name)
            if status is not None:
                self.status, self.status_time = status, time.monotonic()
                rate = status.number('joint states', 'rate [Hz]')
                if rate is not None:
                    self._state_rates.append(rate)
        name = self.name.strip('/').replace('/', '.')
        for message, _ in self._take('log'):
            if message.level >= _WARN and f'{message.name}.'.startswith(f'{name}.'):
                self.last_warning = message.msg
        descriptions = [message.data for message, _ in self._take('description')]
        if descriptions:
            self.robot, self.robot_problem = None, ''
            try:
                self.robot = load_urdf(descriptions[-1])
            except InverseDynamicsError as error:
                self.robot_problem = str(error).partition('\n')[0]
            self._clear()
        # The diagnostics say under which names the node uses these topics.
        for topic, (part, key, profile) in _TOPICS.items():
            found = self.status.text(part, key) if self.status else ''
            if found:
                self._subscribe(topic, JointState, found, profile)
        for data, received in self._take('joint_states'):
            if self.on_joint_state:
                self.on_joint_state(data, received)
            if self._index:
                self._store_state(data, received or time.monotonic())
        for topic in _EFFORTS:
            for data, _ in self._take(topic):
                self._store_efforts(topic, data)
        return bool(descriptions)

    @property
    def state_rate(self) -> float | None:
        """
        Highest rate [Hz] of joint states in the latest reports; None before the second report.

        The rate in a single report is too low if the robot was not connected yet, or if this
        machine was suspended.
        """
        return max(self._state_rates) if len(self._state_rates) > 1 else None

    def sample(self) -> Sample:
        """Return the latest values of all joints."""
        now = time.monotonic()
        q, qd, measured = self._filtered.copy()
        if self.status is not None:
            for joint, factor in self.status.measured_scale().items():
                if joint in self._index:
                    measured[self._index[joint]] *= factor
            for joint, position in self.status.locked_positions().items():
                if joint in self._index and np.isnan(q[self._index[joint]]):
                    q[self._index[joint]], qd[self._index[joint]] = position, 0.0
        external, commands = (
            np.where(now > self._effort_times[topic] + _STALE, np.nan, self._efforts[topic])
            for topic in _EFFORTS
        )
        if now < self._settled_at:
            external[:] = np.nan
        return Sample(now, q, qd, measured, measured - external, commands)

    # ---- Messages ------------------------------------------------------------------------

    def _subscribe(self, key: str, kind: Any, topic: str, profile: QoSProfile) -> None:
        """Subscribe to a topic, instead of the one that had the same key before."""
        old = self._subscriptions.get(key)
        if old is not None and old.topic == topic:
            return
        if old is not None:
            self._node.destroy_subscription(old)
        # The callback is never called: no executor spins this node.
        self._subscriptions[key] = self._node.create_subscription(
            kind, topic, print, profile, raw=kind is JointState
        )

    def _take(self, key: str) -> Iterator[tuple[Any, float]]:
        """Yield each message in a queue with its arrival time [s]; joint states are serialized."""
        if subscription := self._subscriptions.get(key):
            yield from waiting_messages(subscription, subscription.msg_type, raw=subscription.raw)

    def _diagnostics_topic(self) -> str:
        namespace, _, name = self.name.rpartition('/')
        try:
            published = self._node.get_publisher_names_and_types_by_node(name, namespace or '/')
        except Exception:  # the node is unknown; the error type depends on the version of rclpy
            published = []
        for topic, types in published:
            if 'diagnostic_msgs/msg/DiagnosticArray' in types:
                return str(topic)
        return '/diagnostics'

    def _store_state(self, data: bytes, received: float) -> None:
        try:
            names, *signals = self._reader.read(data)
        except JointStateError:
            return
        positions = signals[0]
        if len(positions) != len(names):
            return
        self.state_count += 1
        if names not in self._filters:
            self._filters[names] = LowPass(np.zeros((3, len(names))), CUTOFF)
            self._settled_at = time.monotonic() + _SETTLING
        unknown = np.full(len(names), np.nan)
        known = [values if len(values) == len(names) else unknown for values in signals]
        filtered = self._filters[names].update(received, np.array(known), _LONGEST_GAP)
        # A position that is NaN is not reported in this message.
        is_reported = ~np.isnan(positions)
        ours = [k for k, name in enumerate(names) if name in self._index and is_reported[k]]
        self._filtered[:, [self._index[names[k]] for k in ours]] = filtered[:, ours]

    def _store_efforts(self, topic: str, data: bytes) -> None:
        try:
            arrays = self._reader.read(data)
        except JointStateError:
            return
        efforts = self._efforts[topic] = np.full(len(self._index), np.nan)
        for joint, effort in zip(arrays.joints, arrays.efforts, strict=False):
            if joint in self._index:
                efforts[self._index[joint]] = effort
        self._effort_times[topic] = time.monotonic()
