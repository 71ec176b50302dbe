"""Publishes the status of the node on ``/diagnostics``, and logs its problems."""

from __future__ import annotations

from dataclasses import replace
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.lifecycle import LifecycleNode

from ..control.monitor import StalledPublishers
from ..control.status import GraphInfo, Topics
from ..control.status_text import describe_silence
from ..ros.diagnostics import write_status
from ..ros.middleware import QUEUED
from .inputs import Inputs
from .runner import LoopRunner
from .scheduling import Scheduling

_PERIOD = 1.0  # [s]; recommended by REP-107


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
        self._graph, self._log = runner.graph, runner.log
        self._scheduling = scheduling
        self._uses_sim_time = bool(node.get_parameter('use_sim_time').value)
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', QUEUED)
        self._last_time = time.monotonic()
        self._last_count = 0
        self._stalled = StalledPublishers(self._last_time)
        names = ('joint_states', '~/joint_efforts', '~/external_efforts')
        self._topics = Topics(*(str(node.resolve_topic_name(name)) for name in names))
        node.create_timer(_PERIOD, self._on_timer, clock=clock)

    def publish_if_late(self) -> None:
        """Publish the status if the timer is late."""
        if time.monotonic() > self._last_time + 1.5 * _PERIOD:
            self._on_timer()

    def _on_timer(self) -> None:
        now = time.monotonic()
        elapsed, self._last_time = now - self._last_time, now
        loop, is_active = self._runner.loop, self._runner.is_active
        graph = self._inspect_graph(elapsed)
        silence = describe_silence(graph) if is_active else ''
        if silence:
            self._log.error('silence', silence)
        if loop is not None:
            self._log.report_implausible(loop)
        status = self._runner.monitor.report(self._runner.now(), loop, graph)
        status = replace(status, scheduling=self._scheduling.status())
        self._log.report_part('other nodes', status.other_nodes)
        self._log.report_part('clock', status.clock)
        self._publisher.publish(
            write_status(
                self._node.get_clock().now().to_msg(),
                self._node.get_fully_qualified_name(),
                status,
            )
        )

    def _inspect_graph(self, elapsed: float) -> GraphInfo:
        node = self._node
        states = self._inputs.state_count - self._last_count
        self._last_count = self._inputs.state_count
        publisher_count = node.count_publishers(node.resolve_topic_name('joint_states'))
        clock = self._graph.clock() if self._uses_sim_time else None
        is_paused = clock is not None and (clock.unchanged_for or 0.0) > _PERIOD
        return GraphInfo(
            receivers=self._runner.outputs.receivers,
            publishers=publisher_count,
            is_active=self._runner.is_active,
            # The only public way to get the state is a service.
            state=str(node._state_machine.current_state[1]),
            name=node.get_fully_qualified_name(),
            others=self._graph.others(),
            clock=clock,
            silence=self._stalled.update(
                self._last_time,
                self._inputs.last_joint_state,
                is_expected=bool(publisher_count) and not is_paused,
            ),
            state_rate=states / elapsed if elapsed > 0.0 else 0.0,
            topics=self._topics,
        )
