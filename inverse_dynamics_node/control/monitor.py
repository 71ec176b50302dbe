"""Collects health statistics of the node."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
import math

import numpy as np

from .loop import Command, ControlLoop
from .status import (
    EffortsStatus,
    GraphInfo,
    JointStatesStatus,
    LoopStatus,
    MessagesStatus,
    ModelStatus,
    NodeStatus,
    Payload,
    ReferenceStatus,
)
from .status_text import (
    judge_efforts,
    judge_joint_states,
    judge_loop,
    judge_messages,
    judge_model,
    judge_other_nodes,
    judge_reference,
)

_MOST_REASONS = 20  # further reasons are counted together
_LONGEST_PAUSE = 2.0  # [s]; a longer time between updates means that the process was suspended


class Monitor:
    """
    Collects statistics for periodic reports.

    ``period`` is the requested time between commands [s]; 0 if each joint state produces a
    command.

    """

    def __init__(self, period: float = 0.0) -> None:
        self.rejected: Counter[str] = Counter()
        """Number of messages rejected since the start, by topic and reason."""
        self.clamped: Counter[str] = Counter()
        """How often the effort of each joint has been cut to its limit since the start."""
        self.slowed: Counter[str] = Counter()
        """How often a rate limit has slowed the effort of each joint since the start."""
        self.overruns = 0
        """Number of commands since the start that were more than half a period late."""
        self.period = period
        self._last = math.nan
        # Since the last report:
        self._periods: list[float] = []
        self._durations: list[float] = []
        self._clamped_joints: list[str] = []
        self._rejections = 0

    def step(self, now: float, duration: float, command: Command, joints: Sequence[str]) -> None:
        """
        Record one command.

        ``now`` is the time when the computation of the command began [s]. ``duration`` is the time
        to compute and send the command [s].

        """
        elapsed = now - self._last
        self._last = now
        if elapsed >= 0.0:  # false for the first command, and after the clock was set back
            self._periods.append(elapsed)
            self.overruns += 0.0 < 1.5 * self.period < elapsed
        self._durations.append(duration)
        if np.count_nonzero(command.is_saturated):
            clamped = list(compress(joints, command.is_saturated))
            self.clamped.update(clamped)
            self._clamped_joints += [name for name in clamped if name not in self._clamped_joints]
        if np.count_nonzero(command.is_slowed):
            self.slowed.update(compress(joints, command.is_slowed))

    def pause(self) -> None:
        """Exclude the time until the next command from the statistics."""
        self._last = math.nan

    def reject(self, topic: str, reason: str) -> None:
        """Count one rejected message."""
        text = f'{topic}: {reason}'
        if text not in self.rejected and len(self.rejected) >= _MOST_REASONS:
            text = 'others'
        self.rejected[text] += 1
        self._rejections += 1

    def report(self, now: float, loop: ControlLoop | None, around: GraphInfo) -> NodeStatus:
        """
        Return the status since the last report; the caller adds the scheduling status.

        ``loop`` is None until the node is configured. ``around`` contains the state and the
        connections of the node.

        """
        level, message = judge_other_nodes(loop, around)
        status = NodeStatus(
            self._loop_status(now, loop, around),
            self._messages_status(),
            replace(around.others, level=level, message=message),
            around.clock,
        )
        if loop is not None:
            status = replace(
                status,
                joint_states=_joint_states(now, loop, around),
                reference=_reference(now, loop, around),
                efforts=self._efforts_status(now, loop, around),
                model=_model(now, loop),
            )
        self._periods, self._durations, self._clamped_joints = [], [], []
        self._rejections = 0
        return status

    def _loop_status(self, now: float, loop: ControlLoop | None, around: GraphInfo) -> LoopStatus:
        total = sum(self._periods)
        rate = len(self._periods) / total if total > 0.0 else 0.0
        requested = 1.0 / self.period if self.period else None
        status = LoopStatus(
            *judge_loop(now, loop, around, rate, requested),
            state=around.state,
            rate=rate,
            requested_rate=requested,
            period_p99=_percentile(self._periods, 99.0),
            period_worst=_percentile(self._periods, 100.0),
            compute_time_p99=_percentile(self._durations, 99.0),
            overruns=self.overruns,
        )
        if not around.is_active or loop is None:
            return status
        return replace(
            status,
            mode=loop.controller.settings.mode,
            phase=loop.controller.phase,
            is_dry_run=loop.dry_run.is_active,
            gain=loop.controller.shaper.gain,
        )

    def _messages_status(self) -> MessagesStatus:
        total = sum(self.rejected.values())
        return MessagesStatus(*judge_messages(self._rejections, total), dict(self.rejected))

    def _efforts_status(self, now: float, loop: ControlLoop, around: GraphInfo) -> EffortsStatus:
        return EffortsStatus(
            *judge_efforts(now, loop, around, self._clamped_joints),
            receivers=around.receivers,
            topic=around.topics.joint_efforts,
            external_topic=around.topics.external_efforts,
            measures_gravity=loop.measures_gravity,
            measured_scale=tuple(loop.external_effort_estimator.scale[loop.index].tolist()),
            scale=tuple(loop.controller.scale.tolist()),
            limits=tuple(loop.controller.limits.tolist()),
            cut=tuple(self._clamped_joints),
            cut_counts=dict(self.clamped),
            slowed_counts=dict(self.slowed),
        )


class StalledPublishers:
    """Measures how long publishers have been silent while messages were expected."""

    def __init__(self, now: float) -> None:
        self._since = self._last_update = now

    def update(self, now: float, last_message: float, is_expected: bool) -> float:
        """
        Return the length of the silence [s].

        ``is_expected`` says whether a publisher that could send messages is connected. The silence
        excludes times when no message was expected, and times when this process was suspended. All
        times are in [s].

        """
        pause = now - self._last_update
        self._last_update = now
        self._since = max(self._since, last_message)
        if not is_expected:
            self._since = now
        elif pause > _LONGEST_PAUSE:
            self._since = min(now, self._since + pause)
        return now - self._since


def _joint_states(now: float, loop: ControlLoop, around: GraphInfo) -> JointStatesStatus:
    collector, settings = loop.collector, loop.controller.settings
    return JointStatesStatus(
        *judge_joint_states(now, loop, around),
        topic=around.topics.joint_states,
        rate=around.state_rate,
        age=now - collector.time if math.isfinite(collector.time) else None,
        timeout=settings.state_timeout,
        publishers=around.publishers,
        late=tuple(collector.late(now)),
        locked=tuple(collector.unseen()),
        without_velocity=tuple(collector.without_velocity()),
    )


def _reference(now: float, loop: ControlLoop, around: GraphInfo) -> ReferenceStatus:
    settings = loop.controller.settings
    return ReferenceStatus(
        *judge_reference(loop, around),
        age=None if loop.reference is None else now - loop.reference.time,
        timeout=settings.reference_timeout,
        mode=settings.mode,
    )


def _model(now: float, loop: ControlLoop) -> ModelStatus:
    robot, loads = loop.robot, loop.loads
    return ModelStatus(
        *judge_model(now, loop),
        robot=robot.name,
        mass=float(np.sum(robot.mass)),
        joints=loop.controller.joints,
        payloads=tuple(Payload(load.mass, link) for link, load in loads.payloads.items()),
        payload_coms=tuple(x for load in loads.payloads.values() for x in load.com.tolist()),
        gravity=tuple(loads.gravity.tolist()) if loads.include_gravity else None,
        gravity_at_root=tuple(loads.gravity_at_root.tolist()),
        warnings=tuple(map(str, robot.warnings)),
    )


def _percentile(times: list[float], percentile: float) -> float | None:
    return float(np.percentile(times, percentile)) if times else None
