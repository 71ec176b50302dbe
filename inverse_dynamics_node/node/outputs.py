"""Publishes the commands and the URDF; publishes other topics only if they have subscribers."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import WrenchStamped
import numpy as np
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from ..control.loop import ControlLoop
from ..robot.model import Floats
from ..ros.cdr import serialize_numbers
from ..ros.middleware import LATCHED, overridable, RELIABLE

_NO_NUMBERS: Floats = np.zeros(0)


class Outputs:
    """Publishes commands, external efforts and the robot description."""

    def __init__(self, node: LifecycleNode) -> None:
        def publisher(kind: Any, topic: str) -> Any:
            return node.create_lifecycle_publisher(kind, topic, RELIABLE, **overridable())

        self._node, self._clock = node, node.get_clock()
        self.commands = publisher(Float64MultiArray, '~/commands')
        self._joint_efforts = publisher(JointState, '~/joint_efforts')
        self._joint_commands = publisher(JointState, '~/joint_commands')
        own_name = f'{node.get_fully_qualified_name()}/joint_efforts'
        self.may_command_by_name: bool = self._joint_efforts.topic_name != own_name
        """Whether ~/joint_efforts is remapped, and may therefore command a robot by joint name."""
        by_name = [self._joint_efforts] * self.may_command_by_name
        self.forms: list[Any] = [self.commands, self._joint_commands, *by_name]
        """Publishers of the topics that may carry the commands."""
        self._external_efforts = publisher(JointState, '~/external_efforts')
        self._tool_wrench = publisher(WrenchStamped, '~/tool_wrench')
        self._description = node.create_publisher(String, '~/robot_description', LATCHED)
        self._joints = JointState()
        self._subscribed: set[Any] = set()
        self.uses_measured_efforts = False
        """Whether a topic with a subscriber needs measured efforts."""

    def find_subscribers(self) -> None:
        """Store which topics have subscribers; a check before every message would be too slow."""
        of_measured = self._external_efforts, self._tool_wrench
        optional = self._joint_efforts, self._joint_commands, *of_measured
        self._subscribed = {each for each in optional if each.get_subscription_count()}
        self.uses_measured_efforts = not self._subscribed.isdisjoint(of_measured)

    @property
    def receivers(self) -> int:
        """Total number of subscribers to the topics that may carry the commands."""
        return sum(form.get_subscription_count() for form in self.forms)

    def publish_description(self, loop: ControlLoop) -> None:
        """Publish the URDF of the loop, also to nodes that subscribe later."""
        self._description.publish(String(data=loop.description))

    def publish_command(self, loop: ControlLoop, efforts: Floats, sent: Floats | None) -> None:
        """
        Publish the efforts of the m commanded joints.

        `efforts` are the computed efforts, shape (m,) [N m or N]. `sent` are the efforts for the
        robot, or None if nothing is sent.
        """
        if sent is not None:
            self.commands.publish(serialize_numbers(sent))
            if self._joint_commands in self._subscribed:
                joints, motion = loop.joints, loop.drive_reference()
                self._publish_efforts(self._joint_commands, joints, sent, *motion)
            else:
                loop.drive.reset()  # the reference is ramped in for a later subscriber
        by_name = sent if self.may_command_by_name else efforts
        if by_name is not None and self._joint_efforts in self._subscribed:
            self._publish_efforts(self._joint_efforts, loop.joints, by_name)

    def describe_dry_run(self, to: str) -> str:
        """
        Describe where a dry run publishes efforts.

        `to` names the topic that gets no commands, for example 'to /arm/commands'.
        """
        if self.may_command_by_name:
            by_name = self._joint_efforts.topic_name
            return f'are only computed (dry run); nothing is sent {to} or to {by_name}'
        return f'are published on ~/joint_efforts only (dry run); nothing is sent {to}'

    def publish_zeros(self, loop: ControlLoop) -> None:
        """Publish zeros, and wait until reliable subscribers have acknowledged them."""
        zeros = np.zeros(len(loop.joints))
        for _ in range(3):  # because best-effort subscribers do not acknowledge
            self.publish_command(loop, zeros, zeros)
        for publisher in (self.commands, self._joint_efforts, self._joint_commands):
            publisher.wait_for_all_acked(Duration(seconds=1))

    @property
    def has_best_effort_receivers(self) -> bool:
        """Whether any receiver of the commands acknowledges nothing."""
        return any(
            receiver.qos_profile.reliability is not ReliabilityPolicy.RELIABLE
            for form in self.forms
            for receiver in self._node.get_subscriptions_info_by_topic(form.topic_name)
        )

    def publish_external_efforts(self, loop: ControlLoop) -> None:
        """Publish the external efforts of the joints with measured efforts, and their wrench."""
        if not self.uses_measured_efforts:
            return
        efforts = loop.external_efforts()
        measured = np.flatnonzero(np.isfinite(efforts))
        if len(measured) and self._tool_wrench in self._subscribed:
            self._publish_wrench(loop.tool_link, loop.tool_wrench(efforts).tolist())
        if len(measured) and self._external_efforts in self._subscribed:
            names = [loop.robot.joint_names[i] for i in measured]
            self._publish_efforts(self._external_efforts, names, efforts[measured])

    def _publish_wrench(self, link: str, wrench: Sequence[float]) -> None:
        message = WrenchStamped()
        message.header.stamp, message.header.frame_id = self._clock.now().to_msg(), link
        force, moment = message.wrench.force, message.wrench.torque
        force.x, force.y, force.z, moment.x, moment.y, moment.z = wrench
        self._tool_wrench.publish(message)

    def _publish_efforts(
        self,
        publisher: Any,
        joints: Sequence[str],
        efforts: Floats,
        positions: Floats = _NO_NUMBERS,
        velocities: Floats = _NO_NUMBERS,
    ) -> None:
        message = self._joints
        message.name = list(joints)
        message.position = array('d', positions.tobytes())
        message.velocity = array('d', velocities.tobytes())
        message.effort = array('d', efforts.tobytes())
        message.header.stamp = self._clock.now().to_msg()
        publisher.publish(message)
