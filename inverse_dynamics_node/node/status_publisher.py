"""Publishes the status of the node on ``/diagnostics``, and logs its problems."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.lifecycle import LifecycleNode

from ..ros.diagnostics import write_status
from ..ros.middleware import QUEUED
from ..ros.private import lifecycle_state
from .inputs import Inputs
from .monitor import lasting_silence
from .runner import LoopRunner
from .scheduling import Scheduling
from .status import describe_node, Surroundings

_PERIOD = 1.0  # [s]; recommended by REP-107
_TOPICS = 'joint_states', '~/joint_efforts', '~/external_efforts'


class StatusPublisher:
    """Publishes the status of the node once a second, in every lifecycle state."""

    def __init__(
        self,
        node: LifecycleNode,
        runner: LoopRunner,
        inputs: Inputs,
        clock: Clock,
        scheduling: Scheduling,
    ) -> None:
        self._node, self._runner, self._inputs = node, runner, inputs
        self._graph, self._scheduling = runner.graph, scheduling
        self._uses_sim_time = bool(node.get_parameter('use_sim_time').value)
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', QUEUED)
        self._last_time = time.monotonic()
        self._last_count, self._silence = 0, 0.0
        node.create_timer(_PERIOD, self._on_timer, clock=clock)

    def publish_if_late(self) -> None:
        """Publish the status if the timer is late."""
        if time.monotonic() > self._last_time + 1.5 * _PERIOD:
            self._on_timer()

    def _on_timer(self) -> None:
        runner, node = self._runner, self._node
        around = self._look_around()
        status = describe_node(runner.now(), runner.loop, around, runner.monitor)
        runner.monitor.begin_report()
        if self._graph.is_discovered:
            runner.log.report_status(status, is_active=runner.is_active)
        stamp = node.get_clock().now().to_msg()
        self._publisher.publish(write_status(stamp, node.get_fully_qualified_name(), status))

    def _look_around(self) -> Surroundings:
        node, graph, now = self._node, self._graph, time.monotonic()
        has_message = self._inputs.last_joint_state > self._last_time
        elapsed, self._last_time = now - self._last_time, now
        states = self._inputs.state_count - self._last_count
        self._last_count = self._inputs.state_count
        publishers = node.count_publishers(node.resolve_topic_name('joint_states'))
        clock = graph.clock() if self._uses_sim_time else None
        is_paused = clock is not None and clock.unchanged_for > _PERIOD
        is_silent = bool(publishers) and not is_paused and not has_message
        self._silence = lasting_silence(self._silence, elapsed, is_silent=is_silent)
        joint_states, efforts, external = map(node.resolve_topic_name, _TOPICS)
        return Surroundings(
            state=lifecycle_state(node),
            is_active=self._runner.is_active,
            name=node.get_fully_qualified_name(),
            receivers=self._runner.outputs.receivers,
            publishers=publishers,
            silence=self._silence,
            state_rate=states / elapsed if elapsed > 0.0 else 0.0,
            inputs=(graph.with_publishers('joint_states'), graph.with_publishers('imu')),
            topics=(joint_states, efforts, external),
            others=graph.others(),
            controllers=self._runner.controllers.known,
            objection=self._runner.objection,
            clock=clock,
            scheduled=self._scheduling.look(),
        )
