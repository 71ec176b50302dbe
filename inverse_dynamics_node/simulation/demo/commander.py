"""
The node's user: asks something of it for every joint state, and takes note of what happens.

Asked for accelerations, the node turns them into efforts, and the loop is closed here, by resolved
acceleration: with the dynamics of the robot cancelled, every joint's error obeys
``e'' + kd e' + kp e = 0``, whatever the robot. Asked for a reference, the node closes it itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
import time
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ...robot.model import Floats
from ..trajectory import Trajectory
from .history import History

# Critically damped at 20 rad/s: stiff enough that two samples of latency cost less than a
# millirad, soft enough that holding one command for 20 ms does no harm.
KP, KD = 400.0, 40.0
SILENT = 0.05  # [s]: without joint states for so long, time is that of the machine
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def resolved_acceleration(
    reference: tuple[Floats, Floats, Floats], q: Floats, qd: Floats, kp: float, kd: float
) -> Floats:
    """
    Compute the acceleration that brings joints back to their reference.

    Parameters
    ----------
    reference : tuple of three ndarrays, shape (n,)
        Positions [rad or m], velocities and accelerations.
    q, qd : ndarray, shape (n,)
        Measured positions [rad or m] and velocities [rad/s or m/s].
    kp, kd : float
        Gains [1/s^2] and [1/s].

    Returns
    -------
    qdd : ndarray, shape (n,)
        Acceleration to ask for [rad/s^2 or m/s^2].

    """
    q_ref, qd_ref, qdd_ref = reference
    return qdd_ref + kd * (qd_ref - qd) + kp * (q_ref - q)


class Commander(Node):
    """
    Watches a robot, and asks the node to move it once it has a trajectory.

    Parameters
    ----------
    joint_names : tuple of str
        The n joints to move, in the node's order.
    asks_for : str
        What to send for every joint state: 'accelerations', 'reference' or nothing.
    kp, kd : float
        Gains of the loop that is closed here [1/s^2] and [1/s].

    Attributes
    ----------
    state : tuple of three ndarrays, shape (n,), or None
        Newest positions [rad or m], velocities and efforts [N m or N]; None before the first.
    time : float
        Since the trajectory began, by the stamp of the newest joint state [s].
    desired : ndarray, shape (n,)
        Where the joints should be at that time [rad or m].
    command : ndarray, shape (m,)
        The efforts that the node sent last [N m or N]; empty before the first.
    commands : int
        How many commands the node has sent.
    brakes_on : bool
        What the robot said last about its brakes.
    history : History
        What has happened since the trajectory began.

    """

    def __init__(
        self,
        joint_names: tuple[str, ...],
        asks_for: str = 'accelerations',
        kp: float = KP,
        kd: float = KD,
    ) -> None:
        super().__init__('commander')
        self.state: tuple[Floats, Floats, Floats] | None = None
        self.time = 0.0
        self.desired: Floats = np.zeros(len(joint_names))
        self.command: Floats = np.zeros(0)
        self.commands = 0
        self.brakes_on = True
        self.history = History()
        self._joint_names = joint_names
        self._gains = kp, kd
        self._names: list[str] = []
        self._order: list[int] = []
        self._trajectory: Trajectory | None = None
        self._began: int | None = None
        self._heard = math.inf
        self._now = 0.0
        self._told: dict[str, Any] = {}
        self._ask = self._asker(asks_for)
        self.create_subscription(JointState, 'joint_states', self._on_state, NEWEST)
        self.create_subscription(Bool, 'brakes', self._on_brakes, LATCHED)
        # Deep and reliable: these are counted.
        self.create_subscription(
            Float64MultiArray, 'inverse_dynamics/commands', self._on_command, 1000
        )

    def watch_external_efforts(self) -> None:
        """Take note of what the node tells of contact, too."""
        self.create_subscription(
            JointState, 'inverse_dynamics/external_efforts', self._on_external, 100
        )

    def will_tell(self, messages: Mapping[str, Any]) -> None:
        """Get ready to publish messages on their topics."""
        for topic, message in messages.items():
            if topic not in self._told:
                self._told[topic] = self.create_publisher(type(message), topic, 10)

    def without_listener(self) -> list[str]:
        """Return the topics to publish on that nobody has subscribed to yet."""
        return [t for t, told in self._told.items() if not told.get_subscription_count()]

    def tell(self, topic: str, message: Any) -> None:
        """Publish a message, with the stamp of the newest joint state if it has any."""
        if hasattr(message, 'header'):
            message.header.stamp = self._stamp
        self._told[topic].publish(message)

    def follow(self, trajectory: Trajectory) -> None:
        """Track a trajectory from the next joint state on."""
        self._began = None
        self._now = self.time = 0.0
        self._trajectory = trajectory

    @property
    def silence(self) -> float:
        """How long ago the newest joint state came [s]."""
        return time.monotonic() - self._heard

    @property
    def now(self) -> float:
        """Since the trajectory began [s]; also while no joint states come; it never goes back."""
        waited = self.silence if self.silence > SILENT else 0.0
        self._now = max(self._now, self.time + waited)
        return self._now

    def _asker(self, asks_for: str) -> Callable[[tuple[Floats, Floats, Floats]], None]:
        """Return what to do with a sample of the trajectory."""
        if asks_for == 'accelerations':
            self._accelerations = self.create_publisher(
                Float64MultiArray, 'inverse_dynamics/desired_accelerations', 10
            )
            self._message = Float64MultiArray()
            return self._ask_accelerations
        if asks_for == 'reference':
            self._reference = self.create_publisher(
                JointTrajectory, 'inverse_dynamics/reference', 10
            )
            self._point = JointTrajectoryPoint()
            self._points = JointTrajectory(
                joint_names=list(self._joint_names), points=[self._point]
            )
            return self._ask_reference
        return lambda sample: None

    def _ask_accelerations(self, sample: tuple[Floats, Floats, Floats]) -> None:
        assert self.state is not None
        q, qd, _ = self.state
        self._message.data = resolved_acceleration(sample, q, qd, *self._gains).tolist()
        self._accelerations.publish(self._message)

    def _ask_reference(self, sample: tuple[Floats, Floats, Floats]) -> None:
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
        self._heard = time.monotonic()
        if self._trajectory is None:
            return
        stamp = Time.from_msg(message.header.stamp).nanoseconds
        if self._began is None:
            self._began = stamp
        self.time = (stamp - self._began) * 1e-9
        sample = self._trajectory.sample(self.time)
        self.desired = sample[0]
        self._stamp = message.header.stamp
        self._ask(sample)
        self.history.states.add(self.time, (q, self.desired, effort))

    def _learn_order(self, names: list[str]) -> None:
        complete = set(self._joint_names) <= set(names)
        self._order = [names.index(name) for name in self._joint_names] if complete else []
        self._names = names

    def _on_command(self, message: Float64MultiArray) -> None:
        self.commands += 1
        self.command = np.array(message.data)
        if self._began is not None:
            self.history.commands.add(self.now, self.command)
            self.history.arrivals.append(time.monotonic())

    def _on_external(self, message: JointState) -> None:
        if self._began is not None:
            efforts = dict(zip(message.name, message.effort, strict=True))
            row = [efforts.get(name, math.nan) for name in self._joint_names]
            self.history.external.add(self.now, row)

    def _on_brakes(self, message: Bool) -> None:
        self.brakes_on = message.data
        if self._began is not None:
            self.history.brakes.add(self.now, float(message.data))
