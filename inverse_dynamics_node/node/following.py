"""Follows the trajectories of ``~/joint_trajectory``, as joint_trajectory_controller does."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from rclpy.lifecycle import LifecycleNode
from trajectory_msgs.msg import JointTrajectory

from ..control.following import JointLimits, Plan, plan
from ..control.loop import ControlLoop
from ..errors import InverseDynamicsError, TrajectoryError
from ..robot.model import Floats
from ..ros.middleware import overridable, RELIABLE
from .runner import LoopRunner
from .trajectory_filler import deserialize_trajectory, read_trajectory
from .worker import Refuse, WorkQueue

TOPIC = '~/joint_trajectory'
_MAX_SIZE = 5_000_000  # [bytes]
_SMALL = 4096  # [bytes]; a message of this size is read at once, because it may stop the arm


def plan_message(
    data: bytes, limits: JointLimits, present: Floats, now: float
) -> tuple[Plan, float]:
    """
    Return the plan of a serialized trajectory, and its stamp [s].

    `now` is the time of ROS [s]; the other arguments are those of `plan`.
    """
    message = deserialize_trajectory(data)
    stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    begin = max(0.0, now - stamp) if stamp else 0.0
    return plan(read_trajectory(message), limits, present, begin), stamp


class TrajectoryFollower:
    """Lets a worker read trajectories, and the control loop follow them."""

    def __init__(self, node: LifecycleNode, runner: LoopRunner, queue: WorkQueue) -> None:
        self._runner, self._queue, self._clock = runner, queue, node.get_clock()
        self._last = 0  # number of the last message; a worker may still read an older one
        node.create_subscription(
            JointTrajectory, TOPIC, self._on_trajectory, RELIABLE, raw=True, **overridable()
        )

    def _on_trajectory(self, data: bytes) -> None:
        refuse = partial(self._runner.reject, TOPIC)
        try:
            self.submit(data, refuse)
        except InverseDynamicsError as error:
            refuse(error)

    def submit(
        self,
        data: bytes,
        refuse: Refuse,
        begin: Callable[[Plan], None] = lambda plan: None,
    ) -> None:
        """
        Follow a serialized trajectory as soon as a worker has read it.

        The caller learns later from `begin` or `refuse` whether the trajectory has been accepted.
        Raise a TrajectoryError if no trajectory can be followed now.
        """
        loop = self._runner.loop
        if loop is None or not self._runner.is_active:
            raise TrajectoryError('the node is not active')
        if len(data) > _MAX_SIZE:
            raise TrajectoryError(f'there are {len(data)} bytes, expected at most {_MAX_SIZE}')
        self._last += 1
        if len(data) <= _SMALL and not deserialize_trajectory(data).points:
            self.stop('an empty trajectory has arrived')
            return
        finish = partial(self._begin, loop, (self._last, loop.endings), begin)
        limits, present = loop.following.limits, loop.present_motion()
        self._queue.submit(finish, refuse, plan_message, data, limits, present, self._now())

    def stop(self, reason: str) -> None:
        """Let the arm decelerate and hold it; also forget a trajectory that is being read."""
        self._last += 1
        if self._runner.loop is not None:
            following = self._runner.loop.following
            following.hold(following.state, reason)

    def _begin(
        self,
        loop: ControlLoop,
        numbers: tuple[int, int],
        begin: Callable[[Plan], None],
        result: tuple[Plan, float],
    ) -> None:
        is_outdated = numbers != (self._last, loop.endings)
        if is_outdated or loop is not self._runner.loop or not self._runner.is_active:
            raise TrajectoryError('another message or a stop has come before its first point')
        found, stamp = result
        loop.follow_trajectory(found, self._now() - stamp if stamp else 0.0)
        duration, points = loop.following.time_left, len(found.times)
        text = f'a trajectory of {points} points begins, which lasts {duration:.3g} s'
        self._runner.log.report_message(TOPIC, text, is_problem=False)
        begin(found)

    def _now(self) -> float:
        """Return the time of ROS [s]."""
        return 1e-9 * float(self._clock.now().nanoseconds)
