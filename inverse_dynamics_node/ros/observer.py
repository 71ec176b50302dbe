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

_MOST_WARNINGS = 50
_RATES = 3  # number of rate reports to keep; a report arrives every second
_STALE = 0.5  # [s]; older efforts are treated as unknown
_LONGEST_GAP = 0.5  # [s]; the filters restart after a longer gap, as in the node
_SETTLING = 0.3  # [s]; time until the filters of this process agree with the filters of the node
_QUEUE = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_LOG = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_EFFORTS = 'external_efforts', 'joint_efforts'
_CHECK_MODEL = '/check_model'


class LogLine(NamedTuple):
    """A warning or an error in the log of the node."""

    time: float
    """Time stamp, in seconds since 1970."""
    level: str
    """Severity: ``WARN``, ``ERROR`` or ``FATAL``."""
    text: str


class Sample(NamedTuple):
    """The latest values of all n joints of the robot; NaN if unknown."""

    time: float
    """Time of the sample on the steady clock [s]."""
    positions: Floats
    """Positions as received, shape (n,) [rad or m]."""
    q: Floats
    """Positions after the low-pass filter, shape (n,) [rad or m]."""
    qd: Floats
    """Velocities after the low-pass filter, shape (n,) [rad/s or m/s]."""
    measured: Floats
    """Filtered measured efforts times `measured_effort_scale`, shape (n,) [N m or N]."""
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
        self.log: deque[LogLine] = deque(maxlen=_MOST_WARNINGS)
        """The latest warnings and errors, in the order of their arrival."""
        self.on_joint_state: Callable[[bytes, float], None] | None = None
        """Called by `poll` with each serialized joint state and its arrival time [s]."""
        self._diagnostics = self._subscribe(DiagnosticArray, self._diagnostics_topic(), QUEUED)
        self._logs = self._subscribe(Log, '/rosout', _LOG)
        self._descriptions = self._subscribe(String, f'{name}/robot_description', LATCHED)
        self._topics: dict[str, str] = {}
        self._subscriptions: dict[str, Any] = {}
        self._reader = JointStateReader()
        self.state_count = 0
        """Number of joint states of this robot that `poll` has taken."""
        self._clear()

    def _clear(self) -> None:
        names = self.robot.joint_names if self.robot else ()
        count = len(names)
        self._index = {name: i for i, name in enumerate(names)}
        self._positions = np.full(count, np.nan)
        self._filtered = np.full((3, count), np.nan)
        self._efforts = {topic: np.full(count, np.nan) for topic in _EFFORTS}
        self._effort_times = dict.fromkeys(_EFFORTS, -np.inf)  # of arrival
        self._filters: dict[tuple[str, ...], LowPass] = {}
        self._settled_at = np.inf
        self._last_q: tuple[float, Floats] | None = None

    def poll(self) -> bool:
        """Handle new messages; return True if a new robot description invalidates old samples."""
        for message, _ in waiting_messages(self._diagnostics, DiagnosticArray):
            status = read_status(message, self.name)
            if status is not None:
                self.status, self.status_time = status, time.monotonic()
                rate = status.number('joint states', 'rate [Hz]')
                if rate is not None:
                    self._state_rates.append(rate)
        for message, _ in waiting_messages(self._logs, Log):
            self._store_log(message)
        has_changed = False
        for message, _ in waiting_messages(self._descriptions, String):
            has_changed = True
            self._load_robot(message.data)
        if self.status is not None:
            self._follow_topics(self.status)
        self._read_joint_states()
        self._read_efforts()
        return has_changed

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
        for joint, factor in (self.status.measured_scale() if self.status else {}).items():
            if joint in self._index:
                measured[self._index[joint]] *= factor
        if not np.isfinite(qd).any() and self._last_q is not None:
            last, last_values = self._last_q
            if now > last:
                qd = (q - last_values) / (now - last)
        self._last_q = now, q
        external, commands = (
            np.where(now > self._effort_times[topic] + _STALE, np.nan, efforts)
            for topic, efforts in self._efforts.items()
        )
        if now < self._settled_at:
            external[:] = np.nan
        return Sample(now, self._positions.copy(), q, qd, measured, measured - external, commands)

    def _subscribe(self, kind: Any, topic: str, profile: QoSProfile, raw: bool = False) -> Any:
        # The callback is never called: no executor spins this node.
        return self._node.create_subscription(kind, topic, print, profile, raw=raw)

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

    def _store_log(self, message: Any) -> None:
        name = self.name.strip('/').replace('/', '.')
        if message.name != name and not message.name.startswith(f'{name}.'):
            return
        level = int(message.level)
        for least, word in ((50, 'FATAL'), (40, 'ERROR'), (30, 'WARN')):
            if level >= least:
                stamp = message.stamp.sec + 1e-9 * message.stamp.nanosec
                self.log.append(LogLine(stamp, word, message.msg))
                return

    def _load_robot(self, description: str) -> None:
        self.robot, self.robot_problem = None, ''
        try:
            self.robot = load_urdf(description)
        except InverseDynamicsError as error:
            self.robot_problem = str(error).partition('\n')[0]
        self._clear()

    def _follow_topics(self, status: NodeStatus) -> None:
        """Subscribe to the joint topics under the names that the diagnostics report."""
        for name, part, key, profile in (
            ('joint_states', 'joint states', 'topic', _QUEUE),
            ('joint_efforts', 'efforts', 'topic with names', _LATEST),
            ('external_efforts', 'efforts', 'topic of the external efforts', _LATEST),
        ):
            topic = status.text(part, key)
            if topic and topic != self._topics.get(name):
                if name in self._subscriptions:
                    self._node.destroy_subscription(self._subscriptions[name])
                self._topics[name] = topic
                self._subscriptions[name] = self._subscribe(JointState, topic, profile, raw=True)

    def _read_joint_states(self) -> None:
        if 'joint_states' not in self._subscriptions:
            return
        for data, received in waiting_messages(
            self._subscriptions['joint_states'], JointState, raw=True
        ):
            if self.on_joint_state:
                self.on_joint_state(data, received)
            if self._index:
                self._store_state(data, received or time.monotonic())

    def _store_state(self, data: bytes, received: float) -> None:
        try:
            names, positions, velocities, efforts = self._reader.read(data)
        except JointStateError:
            return
        if len(positions) != len(names):
            return
        self.state_count += 1
        if names not in self._filters:
            self._filters[names] = LowPass(np.zeros((3, len(names))), CUTOFF)
            self._settled_at = time.monotonic() + _SETTLING
        unknown = np.full(len(names), np.nan)
        low_pass = self._filters[names]
        signals = [
            values if len(values) == len(names) else unknown
            for values in (positions, velocities, efforts)
        ]
        filtered = low_pass.update(received, np.array(signals), _LONGEST_GAP)
        # A position that is NaN is not reported in this message.
        is_reported = ~np.isnan(positions)
        ours = [k for k, name in enumerate(names) if name in self._index and is_reported[k]]
        index = [self._index[names[k]] for k in ours]
        self._positions[index] = positions[ours]
        self._filtered[:, index] = filtered[:, ours]

    def _read_efforts(self) -> None:
        for topic, target in self._efforts.items():
            if topic not in self._subscriptions:
                continue
            for data, _ in waiting_messages(self._subscriptions[topic], JointState, raw=True):
                try:
                    arrays = self._reader.read(data)
                except JointStateError:
                    continue
                target[:] = np.nan
                for joint, effort in zip(arrays.joints, arrays.efforts, strict=False):
                    if joint in self._index:
                        target[self._index[joint]] = effort
                self._effort_times[topic] = time.monotonic()
