"""
Track a reference by resolved acceleration: what to ask of the node, once per joint state.

The node turns accelerations into efforts; this closes the loop around it. With the dynamics of the
robot cancelled, every joint's error obeys ``e'' + kd e' + kp e = 0``, whatever the robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from ..model import Floats
from .trajectory import Trajectory

# Critically damped at 20 rad/s: stiff enough that two samples of latency cost less than a
# millirad, soft enough that holding one command for 20 ms does no harm.
KP, KD = 400.0, 40.0
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


@dataclass(eq=False)
class Tracking:
    """
    How far n joints were from where they should have been.

    Attributes
    ----------
    moving : float
        When the motion ends [s].
    settled : float
        From when on the joints count as at rest [s].
    moving_error, rest_error : ndarray, shape (n,)
        Largest distance so far [rad or m]; NaN before the first.

    """

    moving: float
    settled: float
    moving_error: Floats
    rest_error: Floats

    def record(self, time: float, error: Floats) -> None:
        """Take note of the errors at a time [s]; those in between moving and settled are left."""
        if time <= self.moving:
            np.fmax(self.moving_error, abs(error), out=self.moving_error)
        elif time >= self.settled:
            np.fmax(self.rest_error, abs(error), out=self.rest_error)


class Commander(Node):
    """
    The node's user: watches a robot, and asks for accelerations once it has a trajectory.

    Parameters
    ----------
    joint_names : tuple of str
        The n joints to move, in the node's order.
    kp, kd : float
        Gains of the loop [1/s^2] and [1/s].

    Attributes
    ----------
    state : tuple of three ndarrays, shape (n,), or None
        Newest positions [rad or m], velocities and efforts [N m or N]; None before the first.
    time : float
        Since the trajectory began, by the stamps of the joint states [s].
    desired : ndarray, shape (n,)
        Where the joints should be at that time [rad or m].
    commands : int
        How many commands the node has sent.
    brakes_on : bool
        What the robot said last about its brakes.

    """

    def __init__(self, joint_names: tuple[str, ...], kp: float = KP, kd: float = KD) -> None:
        super().__init__('commander')
        self.state: tuple[Floats, Floats, Floats] | None = None
        self.time = 0.0
        self.desired: Floats = np.zeros(len(joint_names))
        self.commands = 0
        self.brakes_on = True
        self._joint_names = joint_names
        self._gains = kp, kd
        self._names: list[str] = []
        self._order: list[int] = []
        self._trajectory: Trajectory | None = None
        self._tracking: Tracking | None = None
        self._began: int | None = None
        self._message = Float64MultiArray()
        self._accelerations = self.create_publisher(
            Float64MultiArray, 'inverse_dynamics/desired_accelerations', 10
        )
        self.create_subscription(JointState, 'joint_states', self._on_state, NEWEST)
        self.create_subscription(Bool, 'brakes', self._on_brakes, LATCHED)
        # Deep and reliable: these are counted.
        self.create_subscription(
            Float64MultiArray, 'inverse_dynamics/commands', self._on_command, 1000
        )

    def follow(self, trajectory: Trajectory, settled: float) -> Tracking:
        """Track a trajectory from the next joint state on; judge rest from a time [s] on."""
        unknown = np.full(len(self._joint_names), np.nan)
        self._tracking = Tracking(trajectory.moving, settled, unknown, unknown.copy())
        self._began = None
        self._trajectory = trajectory
        return self._tracking

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
        if self._trajectory is not None and self._tracking is not None:
            self._command(Time.from_msg(message.header.stamp).nanoseconds, self._trajectory)
            self._tracking.record(self.time, self.desired - q)

    def _learn_order(self, names: list[str]) -> None:
        complete = set(self._joint_names) <= set(names)
        self._order = [names.index(name) for name in self._joint_names] if complete else []
        self._names = names

    def _command(self, stamp: int, trajectory: Trajectory) -> None:
        assert self.state is not None
        if self._began is None:
            self._began = stamp
        self.time = (stamp - self._began) * 1e-9
        reference = trajectory.sample(self.time)
        self.desired = reference[0]
        q, qd, _ = self.state
        qdd = resolved_acceleration(reference, q, qd, *self._gains)
        self._message.data = qdd.tolist()
        self._accelerations.publish(self._message)

    def _on_command(self, _: Float64MultiArray) -> None:
        self.commands += 1

    def _on_brakes(self, message: Bool) -> None:
        self.brakes_on = message.data
