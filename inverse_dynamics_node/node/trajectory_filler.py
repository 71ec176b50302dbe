"""Adds the required efforts to trajectories, in a process beside the control loop."""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
import contextlib
import ctypes
from itertools import compress
import multiprocessing
import os
import pickle
import signal
import traceback
from typing import Any, NamedTuple

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..control.loop import ControlLoop
from ..dynamics.trajectory import complete, joint_index, Trajectory, trajectory_efforts
from ..errors import InverseDynamicsError, listed, TrajectoryError
from ..robot.model import Floats
from ..ros.middleware import overridable, RELIABLE
from .runner import LoopRunner

with contextlib.suppress(ImportError):  # reported when a trajectory is filled
    # Imported here, because the import would take tenths of a second in the child process.
    import scipy.interpolate  # noqa: F401

_MAX_SIZE = 1_000_000  # [bytes]; a trajectory of this size delays commands by milliseconds
_MAX_WAITING = 10
_PERIOD = 0.005  # [s]; between checks for results
_FIELDS = ('positions', 'velocities', 'accelerations', 'effort')
_PR_SET_PDEATHSIG = 1  # prctl(2)
_ENDED = (
    'the process that fills trajectories has ended, for example for lack of memory; restart the '
    'node to fill trajectories'
)


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
    trajectory, notes = complete(_read_trajectory(message))
    efforts = trajectory_efforts(loop.dynamics, trajectory, loop.collector.q)
    index = joint_index(trajectory.joint_names, loop.robot.joint_names)
    scale, limits = np.ones_like(loop.collector.q), loop.robot.effort_limits.copy()
    scale[loop.index], limits[loop.index] = loop.of_joint['effort_scale'], loop.limits
    efforts = scale[index] * efforts
    is_beyond = (np.abs(efforts) > limits[index]).any(axis=0)
    filled = _write_trajectory(message, trajectory, efforts)
    beyond = list(compress(trajectory.joint_names, is_beyond))
    return Filled(serialize_message(filled), notes, beyond)


class Worker:
    """
    Calls functions one at a time in a child process.

    A thread that reads a long message would hold the global interpreter lock for
    milliseconds, and so delay the control loop. On a busy machine, the scheduler may also
    interrupt the thread while it holds the lock.

    The child process is a copy of this process. Create the worker after the imports, so that the
    processes share the memory of the libraries. Create the worker before the node, so that the
    copy contains no ROS entities. Create `Scheduling` before the worker, so that the threads
    that the worker starts in this process get the priority of the loop.
    """

    def __init__(self) -> None:
        self.problem = ''
        """Why the child process could not be created, or an empty string."""
        try:
            fork = multiprocessing.get_context('fork')
            self._pool = ProcessPoolExecutor(1, fork, _prepare, (os.getpid(),))
            self._pool.submit(int)  # creates the process
        except OSError as error:  # a limit on processes or on memory
            self.problem = f'cannot create the process that fills trajectories ({error})'

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """
        Schedule a call of a module-level function, and pickle the arguments now.

        Callers must poll the future, because its callbacks run in another thread. Raise a
        TrajectoryError if the process could not be created or has ended.
        """
        if self.problem:
            raise TrajectoryError(self.problem)
        try:
            return self._pool.submit(_call, pickle.dumps((function, arguments)))
        except BrokenExecutor as error:
            raise TrajectoryError(_ENDED) from error


def _prepare(parent: int) -> None:
    """Make the child process ignore signals, end with its parent, and run at normal priority."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # sent by a terminal or a service manager
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # the parent may run under chrt


def _call(request: bytes) -> Any:
    function, arguments = pickle.loads(request)
    try:
        return function(*arguments)
    except InverseDynamicsError:
        raise
    except Exception:  # an error of a library cannot always be pickled
        raise InverseDynamicsError(traceback.format_exc()) from None


class TrajectoryFiller:
    """Lets a worker compute the efforts for trajectories, and publishes the results."""

    def __init__(self, node: LifecycleNode, runner: LoopRunner, worker: Worker) -> None:
        self._runner, self._worker = runner, worker
        self._waiting: deque[Future[Filled]] = deque()
        self._publisher = node.create_publisher(
            JointTrajectory, '~/joint_trajectory_out', RELIABLE, **overridable()
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_PERIOD, self.poll, clock=steady)
        self._timer.cancel()

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
        if len(self._waiting) >= _MAX_WAITING:
            raise TrajectoryError(f'{_MAX_WAITING} trajectories are already queued')
        self._waiting.append(self._worker.submit(fill, loop, data))
        self._timer.reset()

    def poll(self) -> None:
        """Publish the next trajectory if its efforts have been computed."""
        if not self._waiting:
            self._timer.cancel()
        elif self._waiting[0].done():
            self._finish(self._waiting.popleft())

    def _finish(self, future: Future[Filled]) -> None:
        try:
            filled = future.result()
        except BrokenExecutor:
            self._runner.reject('~/joint_trajectory_in', _ENDED)
            return
        except Exception as error:  # any error in the other process
            self._runner.reject('~/joint_trajectory_in', error)
            return
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


def _read_trajectory(message: JointTrajectory) -> Trajectory:
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
