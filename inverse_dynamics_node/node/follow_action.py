"""The action ``~/follow_joint_trajectory``, for MoveIt and other clients; needs control_msgs."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
import math
from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from rclpy.serialization import serialize_message
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectoryPoint

from ..control.following import Plan
from ..control.loop import ControlLoop
from ..dynamics.trajectory import joint_index
from ..errors import InverseDynamicsError, TrajectoryError
from ..robot.model import Floats
from .following import TrajectoryFollower
from .runner import LoopRunner

NAME = '~/follow_joint_trajectory'
_PERIOD = 0.05  # [s]; between feedback messages, and between checks of the tolerances


def serve_action(node: LifecycleNode, runner: LoopRunner, follower: TrajectoryFollower) -> None:
    """Offer the action if control_msgs is installed."""
    try:
        from control_msgs.action import FollowJointTrajectory
    except ImportError as error:
        node.get_logger().debug(f'no action {NAME}: {error}')
    else:
        _TrajectoryAction(node, runner, follower, FollowJointTrajectory)


class _Goal:
    """A goal that has been accepted and has not ended."""

    def __init__(self, handle: Any, loop: ControlLoop) -> None:
        self.handle, self.loop = handle, loop
        self.result: Future = Future()
        self.plan: Plan | None = None
        """None until a worker has read the trajectory."""
        self.late = 0.0
        """Time since the end of the trajectory [s]."""

    def read(self) -> bytes:
        """Read the tolerances; return the serialized trajectory."""
        request, joints = self.handle.request, self.loop.joints
        self.of_path = _tolerances(request.path_tolerance, joints)
        self.of_end = _tolerances(request.goal_tolerance, joints)
        self.patience = _seconds(request.goal_time_tolerance)
        if not request.trajectory.points:
            raise TrajectoryError('the trajectory has no points, expected at least one')
        data: bytes = serialize_message(request.trajectory)
        return data

    async def wait(self, handle: Any) -> Any:
        """Return the result when the goal has ended."""
        return await self.result

    @property
    def errors(self) -> Floats:
        """Distances and differences of velocity from the reference, shape (2, m)."""
        loop = self.loop
        speed = loop.following.state[1] - loop.collector.qd[loop.index]
        return np.array([loop.following.error, np.abs(speed)])


class _TrajectoryAction:
    """
    Lets the control loop follow the trajectory of a goal, and reports how it ends.

    A new goal, a message on ``~/joint_trajectory``, and whatever ends a trajectory, end the goal.
    """

    def __init__(
        self, node: LifecycleNode, runner: LoopRunner, follower: TrajectoryFollower, action: Any
    ) -> None:
        self._runner, self._follower, self._action = runner, follower, action
        self._clock = node.get_clock()
        self._goal: _Goal | None = None
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_PERIOD, self._on_timer, clock=steady)
        self._timer.cancel()
        self._server = ActionServer(
            node,
            action,
            NAME,
            _Goal.wait,
            goal_callback=self._respond,
            handle_accepted_callback=self._on_goal,
            cancel_callback=self._on_cancel,
        )

    def _respond(self, request: Any) -> GoalResponse:
        """Reject a goal only if no loop could follow it, because a rejection has no reason."""
        if self._runner.is_active:
            return GoalResponse.ACCEPT
        self._runner.reject(NAME, 'the node is not active', 'goal')
        return GoalResponse.REJECT

    def _on_goal(self, handle: Any) -> None:
        assert self._runner.loop is not None
        self._end('abort', 'INVALID_GOAL', 'another goal has arrived')
        goal = self._goal = _Goal(handle, self._runner.loop)
        handle.execute(goal.wait)
        self._timer.reset()

        def begin(plan: Plan) -> None:
            goal.plan = plan

        def refuse(reason: object) -> None:
            if goal is self._goal:
                self._runner.reject(NAME, reason, 'goal')
                self._end('abort', self._code_of_refusal(goal), str(reason))
                # The trajectory of the last goal may still be followed, and nobody watches it.
                self._follower.stop('another goal has arrived, which was refused')

        try:
            self._follower.submit(goal.read(), refuse, begin)
        except InverseDynamicsError as error:
            refuse(error)

    def _code_of_refusal(self, goal: _Goal) -> str:
        """Return the result code that control_msgs has for a trajectory that is refused."""
        message = goal.handle.request.trajectory
        try:
            joint_index(message.joint_names, goal.loop.joints)
        except TrajectoryError:
            return 'INVALID_JOINTS'
        stamp, now = _seconds(message.header.stamp), 1e-9 * self._clock.now().nanoseconds
        lasts = _seconds(message.points[-1].time_from_start) if message.points else 0.0
        return 'OLD_HEADER_TIMESTAMP' if 0.0 < stamp < now - lasts else 'INVALID_GOAL'

    def _on_cancel(self, handle: Any) -> CancelResponse:
        if self._goal is not None and handle == self._goal.handle:
            self._follower.stop('the goal was cancelled')
        return CancelResponse.ACCEPT

    def _end(self, event: str, code: str, text: str) -> None:
        """
        End the goal, if there is one.

        `event` is the name of a method of the goal handle, and `code` that of a result code.
        """
        goal, self._goal = self._goal, None
        self._timer.cancel()
        if goal is None:
            return
        getattr(goal.handle, 'canceled' if goal.handle.is_cancel_requested else event)()
        result = self._action.Result
        goal.result.set_result(result(error_code=getattr(result, code), error_string=text))

    def _on_timer(self) -> None:
        goal = self._goal
        if goal is None:
            return
        if goal.handle.is_cancel_requested:
            self._end('canceled', 'SUCCESSFUL', 'cancelled')
        elif goal.loop is not self._runner.loop:
            self._end('abort', 'INVALID_GOAL', 'the node was cleaned up')
        elif goal.plan is not None:
            self._judge(goal, goal.plan)

    def _judge(self, goal: _Goal, plan: Plan) -> None:
        """Publish feedback, and end the goal if it is reached or if a tolerance is violated."""
        loop, following = goal.loop, goal.loop.following
        if plan is not following.plan and plan is not following.next:
            has_failed = bool(loop.supervisor.limit_stop or loop.supervisor.contact)
            code = 'PATH_TOLERANCE_VIOLATED' if has_failed else 'INVALID_GOAL'
            self._end('abort', code, following.reason or 'another trajectory has arrived')
            return
        if plan is not following.plan:
            return  # it begins later
        self._publish_feedback(goal)
        largest = np.array([following.largest_error, goal.errors[1]])
        if text := _violation(loop, largest, goal.of_path):
            self._follower.stop('a path tolerance was violated')
            self._end('abort', 'PATH_TOLERANCE_VIOLATED', text)
        elif not following.time_left:
            text = _violation(loop, goal.errors, goal.of_end)
            if not text:
                self._end('succeed', 'SUCCESSFUL', '')
            elif goal.late >= goal.patience:
                self._end('abort', 'GOAL_TOLERANCE_VIOLATED', text)
            goal.late += _PERIOD

    def _publish_feedback(self, goal: _Goal) -> None:
        loop = goal.loop
        desired = loop.following.state
        actual = np.array([loop.collector.q[loop.index], loop.collector.qd[loop.index]])
        feedback = self._action.Feedback(joint_names=list(loop.joints))
        feedback.header.stamp = self._clock.now().to_msg()
        rows = desired, actual, desired[:2] - actual
        feedback.desired, feedback.actual, feedback.error = map(_point, rows)
        goal.handle.publish_feedback(feedback)


def _point(rows: Floats) -> JointTrajectoryPoint:
    names = 'positions', 'velocities', 'accelerations'
    arrays = (array('d', row.tobytes()) for row in rows)
    return JointTrajectoryPoint(**dict(zip(names, arrays, strict=False)))


def _seconds(time: Any) -> float:
    """Return a time or duration in [s]."""
    return float(time.sec + 1e-9 * time.nanosec)


def _tolerances(messages: Sequence[Any], joints: Sequence[str]) -> Floats:
    """Return tolerances of positions and velocities, shape (2, m); inf where none is given."""
    tolerances = np.full((2, len(joints)), math.inf)
    for message in messages:
        (k,) = joint_index([message.name], joints)
        given = np.array([message.position, message.velocity])
        tolerances[:, k] = np.where(given > 0.0, given, math.inf)
    return tolerances


def _violation(loop: ControlLoop, errors: Floats, tolerances: Floats) -> str:
    """Describe the largest error that is beyond its tolerance; return '' if none is."""
    excess = errors / tolerances
    row, k = divmod(int(np.argmax(excess)), len(loop.joints))
    if excess[row, k] <= 1.0:
        return ''
    unit = loop.following.limits.units[k] + '/s' * row
    what = ('position', 'velocity')[row]
    return (
        f"the {what} of joint '{loop.joints[k]}' is {errors[row, k]:.4g} {unit} off, "
        f'tolerance {tolerances[row, k]:g} {unit}'
    )
