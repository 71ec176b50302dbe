"""Fills trajectories with efforts."""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory

from ..control.control_loop import ControlLoop
from ..dynamics.trajectory import complete, joint_index, trajectory_efforts
from ..errors import TrajectoryError
from . import messages
from .log import NodeLog

_MAX_SIZE = 1_000_000  # [bytes]; takes up to half a second, without commands


class TrajectoryFiller:
    """
    Publishes trajectories with the efforts that they take, on ``~/joint_trajectory_out``.

    Parameters
    ----------
    node : LifecycleNode
        The node that publishes.
    log : NodeLog
        For warnings.
    qos : QoSProfile
        Quality of service of the topic.
    **options
        Passed to ``create_publisher``.

    """

    def __init__(self, node: LifecycleNode, log: NodeLog, qos: QoSProfile, **options: Any) -> None:
        self._log = log
        self._publisher = node.create_publisher(
            JointTrajectory, '~/joint_trajectory_out', qos, **options
        )

    def fill(self, loop: ControlLoop, data: bytes, is_active: bool) -> None:
        """
        Publish a trajectory with its efforts.

        Parameters
        ----------
        loop : ControlLoop
            The loop whose dynamics and joint positions to use.
        data : bytes
            The serialized trajectory, of any of the joints.
        is_active : bool
            Whether the node is active, and must not go without commands for long.

        Raises
        ------
        InverseDynamicsError
            If the trajectory cannot be used, or there is no subscriber.

        """
        if not self._publisher.get_subscription_count():
            raise TrajectoryError('~/joint_trajectory_out has no subscriber')
        if is_active and len(data) > _MAX_SIZE:
            raise TrajectoryError(
                f'{len(data)} bytes, expected at most {_MAX_SIZE} while the node is active, '
                'because no commands are sent until the efforts have been computed: deactivate '
                'the node first, or split the trajectory'
            )
        message = messages.deserialize_trajectory(data)
        trajectory, derived = complete(messages.read_trajectory(message))
        for note in derived:
            self._log.warn(note, f'~/joint_trajectory_in: {note}')
        efforts = trajectory_efforts(loop.dynamics, trajectory, loop.collector.q)
        index = joint_index(trajectory.joint_names, loop.robot.joint_names)
        efforts = loop.calibrated(index, efforts)
        for name in loop.beyond_limits(index, efforts):
            warning = f"~/joint_trajectory_in: efforts of '{name}' exceed its limit"
            self._log.warn(warning, warning)
        self._publisher.publish(messages.write_trajectory(message, trajectory, efforts))
