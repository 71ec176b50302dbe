"""Lets a running node follow trajectories, one after another."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
import time

from builtin_interfaces.msg import Duration
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..errors import ConfigurationError
from ..robot.model import Floats
from .middleware import QUEUED
from .observer import Observer

Motion = tuple[Sequence[str], Floats, Floats, Floats | None, Floats | None]
"""Joints, times, positions, velocities and accelerations, as of `dynamics.Trajectory`."""
_PATIENCE = 5.0  # [s]; longest wait for diagnostics, which come once a second
_POLL = 0.02  # [s]


def follow(
    node: Node, observer: Observer, trajectories: Iterable[Motion]
) -> Generator[bool, None, None]:
    """
    Send each trajectory when the one before has ended; yield False until the last one has ended.

    The caller polls `observer`. If the generator is closed earlier, the arm decelerates and holds.
    Raise a ConfigurationError if the node does not follow a trajectory to its end.
    """
    publisher = node.create_publisher(JointTrajectory, f'{observer.name}/joint_trajectory', QUEUED)
    is_done = False
    try:
        for trajectory in trajectories:
            due = time.monotonic() + _PATIENCE
            while not publisher.get_subscription_count() and time.monotonic() < due:
                yield False
            publisher.publish(_message(trajectory))
            begin, has_begun = time.monotonic(), False
            while not has_begun or _state(observer) == 'followed':
                latest = observer.status_time
                has_begun = has_begun or (latest > begin and _state(observer) == 'followed')
                if time.monotonic() > (latest if has_begun else begin) + _PATIENCE:
                    raise ConfigurationError(_problem(observer, has_begun))
                yield False
            if _state(observer) != 'held':
                raise ConfigurationError(_problem(observer, has_begun))
        is_done = True
        yield True
    finally:
        end = time.monotonic() + _PATIENCE
        while not is_done and time.monotonic() < end:
            publisher.publish(JointTrajectory())
            sent = time.monotonic()
            while observer.status_time < sent and time.monotonic() < end:
                time.sleep(_POLL)
                observer.poll()
            is_done = _state(observer) != 'followed'


def _state(observer: Observer) -> str:
    """Return whether a trajectory is followed or held, or why it has ended."""
    return observer.status.text('reference', 'trajectory') if observer.status else ''


def _problem(observer: Observer, has_begun: bool) -> str:
    last = f': {observer.last_warning}' if observer.last_warning else ''
    if not has_begun:
        topic = f'{observer.name}/joint_trajectory'
        return f'{observer.name} does not follow the trajectory on {topic}{last}'
    return f'{observer.name} has ended the trajectory: {_state(observer)}{last}'


def _message(trajectory: Motion) -> JointTrajectory:
    joints, times, *signals = trajectory
    message = JointTrajectory(joint_names=list(joints))
    for k, seconds in enumerate(times.tolist()):
        q, qd, qdd = ([] if x is None else x[k].tolist() for x in signals)
        due = Duration(sec=int(seconds), nanosec=int(1e9 * (seconds % 1.0)))
        message.points.append(
            JointTrajectoryPoint(
                positions=q, velocities=qd, accelerations=qdd, time_from_start=due
            )
        )
    return message
