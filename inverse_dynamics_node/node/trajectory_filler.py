"""Adds the required efforts to trajectories, in a process beside the control loop."""

from __future__ import annotations

from array import array
import contextlib
from functools import partial
from itertools import compress
from typing import NamedTuple

import numpy as np
from rclpy.lifecycle import LifecycleNode
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..control.loop import ControlLoop
from ..dynamics.trajectory import complete, joint_index, Trajectory, trajectory_efforts
from ..errors import listed, TrajectoryError
from ..robot.model import Floats
from ..ros.middleware import overridable, RELIABLE
from .runner import LoopRunner
from .worker import WorkQueue

with contextlib.suppress(ImportError):  # reported when a trajectory is filled
    # Imported here, because the import would take tenths of a second in the child process.
    import scipy.interpolate  # noqa: F401

_MAX_SIZE = 1_000_000  # [bytes]; a trajectory of this size delays commands by milliseconds
_MAX_WAITING = 10
_FIELDS = ('positions', 'velocities', 'accelerations', 'effort')


class Filled(NamedTuple):
    """A trajectory with its efforts."""

    data: bytes
    """The serialized message with the efforts."""
    notes: tuple[str, ...]
    """Notes that say how missing velocities or accelerations were derived."""
    beyond: list[str]
    """Joints whose efforts exceed their limits."""


def fill(loop: ControlLoop, data: bytes) -> Filled:
    """
    Compute the efforts for a serialized trajectory of some or all joints of the robot.

    The loop provides the positions of all other joints. Raise a TrajectoryError if the trajectory
    cannot be used.
    """
    message = deserialize_trajectory(data)
    trajectory, notes = complete(read_trajectory(message))
    efforts = trajectory_efforts(loop.dynamics, trajectory, loop.collector.q)
    index = joint_index(trajectory.joint_names, loop.robot.joint_names)
    scale, limits = np.ones_like(loop.collector.q), loop.robot.effort_limits.copy()
    scale[loop.index], limits[loop.index] = loop.of_joint['effort_scale'], loop.limits
    efforts = scale[index] * efforts
    is_beyond = (np.abs(efforts) > limits[index]).any(axis=0)
    filled = _write_trajectory(message, trajectory, efforts)
    beyond = list(compress(trajectory.joint_names, is_beyond))
    return Filled(serialize_message(filled), notes, beyond)


class TrajectoryFiller:
    """Lets a worker compute the efforts for trajectories, and publishes the results."""

    def __init__(self, node: LifecycleNode, runner: LoopRunner, queue: WorkQueue) -> None:
        self._runner, self._queue = runner, queue
        self._publisher = node.create_publisher(
            JointTrajectory, '~/joint_trajectory_out', RELIABLE, **overridable()
        )

    def submit(self, loop: ControlLoop, data: bytes) -> None:
        """
        Queue a serialized trajectory for the computation of its efforts.

        The worker gets a copy of the loop in its present state. Raise a TrajectoryError if nobody
        subscribes to the results, if too many trajectories are waiting, or if the worker has no
        process. Also raise the error if the node is active and the message is so large that it
        would delay commands.
        """
        if not self._publisher.get_subscription_count():
            raise TrajectoryError('~/joint_trajectory_out has no subscriber')
        if self._runner.is_active and len(data) > _MAX_SIZE:
            raise TrajectoryError(
                f'the trajectory has {len(data)} bytes, expected at most {_MAX_SIZE} while the '
                'node is active, because a larger trajectory would delay commands; '
                'deactivate the node first, or split the trajectory'
            )
        if len(self._queue) >= _MAX_WAITING:
            raise TrajectoryError(f'{_MAX_WAITING} trajectories are already queued')
        topic = '~/joint_trajectory_in'
        self._queue.submit(self._finish, partial(self._runner.reject, topic), fill, loop, data)

    def _finish(self, filled: Filled) -> None:
        notes = [*filled.notes]
        if filled.beyond:
            notes.append(f'the efforts of {listed(filled.beyond)} exceed their limits')
        for note in notes:
            self._runner.log.report_message('~/joint_trajectory_in', note)
        self._publisher.publish(filled.data)


def deserialize_trajectory(data: bytes) -> JointTrajectory:
    """Deserialize a trajectory, or raise a TrajectoryError."""
    try:
        return deserialize_message(data, JointTrajectory)
    except Exception as error:  # RMWError, which is not public
        text = f'{len(data)} bytes cannot be read as a JointTrajectory ({error})'
        raise TrajectoryError(text) from error


def read_trajectory(message: JointTrajectory) -> Trajectory:
    names, points = tuple(message.joint_names), message.points

    def read(what: str) -> Floats | None:
        rows = [getattr(point, what) for point in points]
        lengths = {len(row) for row in rows}
        if lengths <= {0}:
            return None
        if lengths != {len(names)}:
            raise TrajectoryError(
                f'points have {" or ".join(map(str, sorted(lengths)))} {what}, expected '
                f'{len(names)} at every point or none at all'
            )
        return np.array(rows, dtype=np.float64)

    positions = read('positions')
    if positions is None:
        raise TrajectoryError('there are no positions, expected one per joint at every point')
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points]
    velocities, accelerations = read('velocities'), read('accelerations')
    return Trajectory(names, np.array(times), positions, velocities, accelerations)


def _write_trajectory(
    message: JointTrajectory, trajectory: Trajectory, efforts: Floats
) -> JointTrajectory:
    """Return a message with the trajectory, its efforts, and the header and times of `message`."""
    result = JointTrajectory(header=message.header, joint_names=message.joint_names)
    rows = (trajectory.positions, trajectory.velocities, trajectory.accelerations, efforts)
    result.points = [
        JointTrajectoryPoint(
            **{
                name: array('d', row[k].tobytes())
                for name, row in zip(_FIELDS, rows, strict=True)
                if row is not None
            },
            time_from_start=point.time_from_start,
        )
        for k, point in enumerate(message.points)
    ]
    return result
