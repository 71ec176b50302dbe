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

    def fill(self, loop: ControlLoop, message: JointTrajectory) -> None:
        """
        Publish a trajectory with its efforts.

        Parameters
        ----------
        loop : ControlLoop
            The loop whose dynamics and joint positions to use.
        message : JointTrajectory
            The trajectory, of any of the joints.

        Raises
        ------
        InverseDynamicsError
            If the trajectory cannot be used, or there is no subscriber.

        """
        if not self._publisher.get_subscription_count():
            raise TrajectoryError('~/joint_trajectory_out has no subscriber')
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
