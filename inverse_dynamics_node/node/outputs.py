"""What the node publishes: messages made once, and only for those who listen."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import WrenchStamped
import numpy as np
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from ..control.control_loop import ControlLoop
from ..dynamics.inverse_dynamics import EffortTerms
from ..robot.model import Floats
from . import messages
from .cdr import serialize_numbers


class Outputs:
    """
    The commands, and beside them what others like to know.

    Parameters
    ----------
    node : LifecycleNode
        Which publishes.
    qos : QoSProfile
        Of all topics.
    **options
        For ``create_lifecycle_publisher``.

    """

    def __init__(self, node: LifecycleNode, qos: QoSProfile, **options: Any) -> None:
        def publisher(kind: Any, topic: str) -> Any:
            return node.create_lifecycle_publisher(kind, topic, qos, **options)

        self._clock = node.get_clock()
        self.commands = publisher(Float64MultiArray, '~/commands')
        self._joint_efforts = publisher(JointState, '~/joint_efforts')
        self._terms = [publisher(JointState, f'~/terms/{term}') for term in EffortTerms._fields]
        self._external_efforts = publisher(JointState, '~/external_efforts')
        self._base_wrench = publisher(WrenchStamped, '~/base_wrench')
        self._efforts, self._wrench = JointState(), WrenchStamped()
        self._listeners: set[Any] = set()

    def look_for_listeners(self) -> None:
        """See who listens: to ask before every message would cost as much as some of them."""
        self._listeners = {
            publisher
            for publisher in (
                self._joint_efforts,
                *self._terms,
                self._external_efforts,
                self._base_wrench,
            )
            if publisher.get_subscription_count()
        }

    @property
    def receivers(self) -> int:
        """How many subscribe to the commands."""
        return int(self.commands.get_subscription_count())

    @property
    def wants_measured_efforts(self) -> bool:
        """Whether someone listens to what is made of measured efforts."""
        return self._external_efforts in self._listeners

    def publish_command(self, loop: ControlLoop, efforts: Floats) -> None:
        """
        Publish efforts of the commanded joints.

        Parameters
        ----------
        loop : ControlLoop
            Whose joints they are for.
        efforts : ndarray, shape (m,)
            [N m or N].

        """
        self.commands.publish(serialize_numbers(efforts))
        if self._joint_efforts in self._listeners:
            self._publish_efforts(self._joint_efforts, loop.controller.joints, efforts)

    def publish_zeros(self, loop: ControlLoop) -> None:
        """Publish zeros, and see that they arrive."""
        for _ in range(3):  # once is enough where messages are acknowledged
            self.publish_command(loop, np.zeros(len(loop.controller.joints)))
        for publisher in (self.commands, self._joint_efforts):
            publisher.wait_for_all_acked(Duration(seconds=1))

    def publish_explanation(self, loop: ControlLoop) -> None:
        """Publish what the last command is made of, and what was measured beside it."""
        if not self._listeners.isdisjoint(self._terms):
            for publisher, term in zip(self._terms, loop.effort_terms(), strict=True):
                if publisher in self._listeners:
                    self._publish_efforts(publisher, loop.controller.joints, term)
        if self._base_wrench in self._listeners:
            messages.write_wrench(self._wrench, loop.base_link, *loop.base_wrench())
            self._wrench.header.stamp = self._clock.now().to_msg()
            self._base_wrench.publish(self._wrench)
        if self._external_efforts in self._listeners:
            self._publish_external_efforts(loop)

    def _publish_external_efforts(self, loop: ControlLoop) -> None:
        efforts = loop.external_efforts()
        measured = np.flatnonzero(np.isfinite(efforts))
        if len(measured):
            names = [loop.robot.joint_names[i] for i in measured]
            self._publish_efforts(self._external_efforts, names, efforts[measured])

    def _publish_efforts(self, publisher: Any, joints: Any, efforts: Floats) -> None:
        messages.write_joint_efforts(self._efforts, joints, efforts)
        self._efforts.header.stamp = self._clock.now().to_msg()
        publisher.publish(self._efforts)
