"""
The commander: sends the node a message for every joint state, and records the motion.

The message has desired accelerations or a full reference. If it has accelerations, the commander
closes the control loop, with resolved-acceleration control. The error e of every joint then obeys
``e'' + kd e' + kp e = 0``. If the message has a full reference, the node closes the loop.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
import math
import time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ...robot.model import Floats
from ...ros.qos import BEST_EFFORT, LATCHED
from ..trajectory import Reference
from .demo_setup import KD, KP

SILENT = 0.05  # [s]: after this time without joint states, `now` follows the machine's clock


class Series:
    """Rows of equal shape, sorted by their times [s]."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._rows: list[ArrayLike] = []

    def add(self, time: float, row: ArrayLike) -> None:
        """Append a row, which must not be modified afterwards."""
        self._times.append(time)
        self._rows.append(row)

    @property
    def times(self) -> Floats:
        """Times of all rows, shape (k,) [s]."""
        return np.array(self._times)

    @property
    def rows(self) -> Floats:
        """All rows, shape (k, ...)."""
        return np.array(self._rows, dtype=float)

    def between(self, begin: float, end: float) -> Floats:
        """Return the rows with begin <= time < end [s], shape (k, ...)."""
        first, last = np.searchsorted(self.times, (begin, end))
        return np.array(self._rows[first:last], dtype=float)


class History:
    """
    The recorded motion of n joints, and the recorded messages of the node.

    All times except ``arrivals`` are measured from the start of the motion [s].
    """

    def __init__(self) -> None:
        self.states = Series()
        """Positions, desired positions [rad or m], measured efforts [N m or N]; rows (3, n)."""
        self.commands = Series()
        """Commanded efforts [N m or N]; rows with one value per commanded joint."""
        self.external = Series()
        """Estimated external efforts [N m or N], NaN without an estimate; rows of shape (n,)."""
        self.brakes = Series()
        """Changes of the brakes: 1 when the brakes engaged, 0 when the brakes opened."""
        self.arrivals: list[float] = []
        """Arrival times of the commands on the steady clock [s]."""

    def command_rate(self, begin: float = -math.inf) -> float:
        """
        Return the rate [Hz] of the commands since ``begin``, a time on the steady clock [s].

        The rate is the slope of a line fitted to the arrivals, because a burst of commands after a
        pause hardly changes this slope.
        """
        times = np.array(self.arrivals[bisect_left(self.arrivals, begin) :])
        if len(times) < 2 or times[-1] == times[0]:
            return 0.0
        return float(np.polyfit(times - times[0], np.arange(len(times)), 1)[0])

    def largest_error(self, begin: float, end: float) -> Floats:
        """Return the largest position error of each joint between two times, shape (n,)."""
        rows = self.states.between(begin, end)
        if not len(rows):
            return np.full(self.states.rows.shape[2:] or (1,), math.nan)
        return np.asarray(np.max(np.abs(rows[:, 1] - rows[:, 0]), axis=0))


def resolved_acceleration(
    reference: tuple[Floats, Floats, Floats], q: Floats, qd: Floats
) -> Floats:
    """
    Return the accelerations, shape (n,), that bring the joints back to their reference.

    The reference consists of positions, velocities and accelerations.
    """
    q_ref, qd_ref, qdd_ref = reference
    return qdd_ref + KD * (qd_ref - qd) + KP * (q_ref - q)


class Commander(Node):
    """
    Records the motion of the robot, and sends messages after the first call of `follow`.

    ``joint_names`` are in the order that the node uses. ``sends`` is the kind of message that the
    commander sends for every joint state: 'accelerations', 'reference', or '' for no message.
    """

    def __init__(self, joint_names: tuple[str, ...], sends: str = 'accelerations') -> None:
        super().__init__('commander')
        self.state: tuple[Floats, Floats, Floats] | None = None
        """Latest positions, velocities and efforts; None before the first joint state."""
        self.time = 0.0
        """Time from the start of the trajectory to the stamp of the latest joint state [s]."""
        self.desired: Floats = np.zeros(len(joint_names))
        """Desired positions at the stamp of the latest joint state, shape (n,) [rad or m]."""
        self.commands = 0
        """Number of commands received from the node."""
        self.external_efforts = 0
        """Number of external-effort estimates received from the node."""
        self.brakes_on = True
        """Whether the brakes are on."""
        self.history = History()
        """Everything recorded since the start of the trajectory."""
        self._joint_names = joint_names
        self._names: list[str] = []
        self._order: list[int] = []
        self._trajectory: Reference | None = None
        self._records = True
        self._began: int | None = None
        self._last_state = math.inf
        self._now = 0.0
        self._event_publishers: dict[str, Any] = {}
        self._send = self._make_sender(sends)
        self.create_subscription(JointState, 'joint_states', self._on_state, BEST_EFFORT)
        self.create_subscription(Bool, 'brakes', self._on_brakes, LATCHED)
        # The queue is deep, because the commands are counted.
        self.create_subscription(
            Float64MultiArray, 'inverse_dynamics/commands', self._on_command, 1000
        )

    def record_external_efforts(self) -> None:
        """Start to record the external efforts that the node estimates."""
        self.create_subscription(
            JointState, 'inverse_dynamics/external_efforts', self._on_external, 100
        )

    def advertise(self, messages: Mapping[str, Any]) -> None:
        """Create a publisher for each topic of the given messages."""
        for topic, message in messages.items():
            if topic not in self._event_publishers:
                self._event_publishers[topic] = self.create_publisher(type(message), topic, 10)

    def topics_without_subscriber(self) -> list[str]:
        """Return the advertised topics that no other node has subscribed to yet."""
        own = [subscription.topic_name for subscription in self.subscriptions]  # recorder's too
        return [
            topic
            for topic, publisher in self._event_publishers.items()
            if publisher.get_subscription_count() <= own.count(publisher.topic_name)
        ]

    def publish(self, topic: str, message: Any) -> None:
        """Publish a message; its header, if any, gets the stamp of the latest joint state."""
        if hasattr(message, 'header'):
            message.header.stamp = self._stamp
        self._event_publishers[topic].publish(message)

    def follow(self, trajectory: Reference, records: bool = True) -> None:
        """Follow a trajectory from the next joint state on; if ``records``, fill the history."""
        self._records = records
        self._began = None
        self._now = self.time = 0.0
        self._trajectory = trajectory

    @property
    def silence(self) -> float:
        """Time since the latest joint state [s]."""
        return time.monotonic() - self._last_state

    @property
    def now(self) -> float:
        """Time since the start of the trajectory [s]; also runs while joint states are missing."""
        waited = self.silence if self.silence > SILENT else 0.0
        self._now = max(self._now, self.time + waited)
        return self._now

    def _make_sender(self, sends: str) -> Callable[[tuple[Floats, Floats, Floats]], None]:
        """Return the function that sends a sample of the trajectory."""
        if sends == 'accelerations':
            self._accelerations = self.create_publisher(
                Float64MultiArray, 'inverse_dynamics/desired_accelerations', 10
            )
            self._message = Float64MultiArray()
            return self._send_accelerations
        if sends == 'reference':
            self._reference = self.create_publisher(
                JointTrajectory, 'inverse_dynamics/reference', 10
            )
            self._point = JointTrajectoryPoint()
            self._points = JointTrajectory(
                joint_names=list(self._joint_names), points=[self._point]
            )
            return self._send_reference
        return lambda sample: None

    def _send_accelerations(self, sample: tuple[Floats, Floats, Floats]) -> None:
        assert self.state is not None
        q, qd, _ = self.state
        self._message.data = resolved_acceleration(sample, q, qd).tolist()
        self._accelerations.publish(self._message)

    def _send_reference(self, sample: tuple[Floats, Floats, Floats]) -> None:
        positions, velocities, accelerations = sample
        self._point.positions = positions.tolist()
        self._point.velocities = velocities.tolist()
        self._point.accelerations = accelerations.tolist()
        self._points.header.stamp = self._stamp
        self._reference.publish(self._points)

    def _on_state(self, message: JointState) -> None:
        if message.name != self._names:
            self._learn_order(list(message.name))
        if not self._order:
            return
        q, qd, effort = (
            np.array(values)[self._order]
            for values in (message.position, message.velocity, message.effort)
        )
        self.state = q, qd, effort
        self._last_state = time.monotonic()
        if self._trajectory is None:
            return
        stamp = Time.from_msg(message.header.stamp).nanoseconds
        if self._began is None:
            self._began = stamp
        self.time = (stamp - self._began) * 1e-9
        sample = self._trajectory.sample(self.time)
        self.desired = sample[0]
        self._stamp = message.header.stamp
        self._send(sample)
        if self._records:
            self.history.states.add(self.time, (q, self.desired, effort))

    def _learn_order(self, names: list[str]) -> None:
        complete = set(self._joint_names) <= set(names)
        self._order = [names.index(name) for name in self._joint_names] if complete else []
        self._names = names

    def _on_command(self, message: Float64MultiArray) -> None:
        self.commands += 1
        if self._records and self._began is not None:
            self.history.commands.add(self.now, np.array(message.data))
            self.history.arrivals.append(time.monotonic())

    def _on_external(self, message: JointState) -> None:
        self.external_efforts += 1
        if self._records and self._began is not None:
            efforts = dict(zip(message.name, message.effort, strict=True))
            row = [efforts.get(name, math.nan) for name in self._joint_names]
            self.history.external.add(self.now, row)

    def _on_brakes(self, message: Bool) -> None:
        self.brakes_on = message.data
        if self._records and self._began is not None:
            self.history.brakes.add(self.now, float(message.data))
