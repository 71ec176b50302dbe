"""Health statistics of the node."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import math

import numpy as np

from ..robot.model import Booleans
from .activity import activity, join_names
from .control_loop import ControlLoop
from .controller import Command
from .graph_info import GraphInfo
from .status import (
    clock_status,
    joint_states_status,
    Level,
    model_status,
    other_nodes_status,
    reference_status,
    Status,
)

_MOST_REASONS = 20  # distinct ones to keep apart
_SLOW = 0.95  # fraction of the requested rate below which the loop is too slow


class Monitor:
    """
    Counts events, and summarizes them in periodic reports.

    Parameters
    ----------
    period : float
        Requested time between commands [s]; 0 for one command per joint state.

    """

    def __init__(self, period: float = 0.0) -> None:
        self.rejected: Counter[str] = Counter()
        """Rejected messages since the start, by topic and reason."""
        self.clamped: Counter[str] = Counter()
        """Commands since the start in which the effort of a joint was cut to its limit."""
        self.slowed: Counter[str] = Counter()
        """Commands since the start in which a rate limit slowed the effort of a joint."""
        self.overruns = 0
        """Commands since the start that were more than half a period late."""
        self.period = period
        self._last = math.nan
        # Since the last report:
        self._periods: list[float] = []
        self._durations: list[float] = []
        self._clamped_joints: list[str] = []
        self._rejections = 0

    def step(self, now: float, duration: float, command: Command, joints: Sequence[str]) -> None:
        """
        Count one command.

        Parameters
        ----------
        now : float
            Time at which its computation began [s].
        duration : float
            Time to compute and send it [s].
        command : Command
            The command as sent.
        joints : sequence of str
            The commanded joints.

        """
        elapsed = now - self._last
        self._last = now
        if elapsed >= 0.0:  # false for the first command, and after the clock was set back
            self._periods.append(elapsed)
            self.overruns += 0.0 < 1.5 * self.period < elapsed
        self._durations.append(duration)
        if np.count_nonzero(command.is_saturated):
            clamped = _selected(joints, command.is_saturated)
            self.clamped.update(clamped)
            self._clamped_joints += [name for name in clamped if name not in self._clamped_joints]
        if np.count_nonzero(command.is_slowed):
            self.slowed.update(_selected(joints, command.is_slowed))

    def pause(self) -> None:
        """Leave the time until the next command out of the statistics."""
        self._last = math.nan

    def reject(self, topic: str, reason: str) -> None:
        """Count one rejected message."""
        text = f'{topic}: {reason}'
        if text not in self.rejected and len(self.rejected) >= _MOST_REASONS:
            text = 'others'
        self.rejected[text] += 1
        self._rejections += 1

    def report(self, now: float, loop: ControlLoop | None, around: GraphInfo) -> list[Status]:
        """
        Report the status of each part of the node since the last report.

        Parameters
        ----------
        now : float
            The time [s].
        loop : ControlLoop or None
            None as long as the node is not configured.
        around : GraphInfo
            The state of the node, and its connections.

        Returns
        -------
        statuses : list of Status
            One for each part.

        """
        statuses = [
            self._loop_status(now, loop, around),
            self._messages_status(),
            other_nodes_status(around),
        ]
        if around.simulated is not None:
            statuses.append(clock_status(around.simulated))
        if loop is not None:
            statuses += [
                joint_states_status(now, loop, around),
                reference_status(now, loop, around),
                self._efforts_status(now, loop, around),
                model_status(now, loop),
            ]
        self._periods, self._durations, self._clamped_joints = [], [], []
        self._rejections = 0
        return statuses

    def _loop_status(self, now: float, loop: ControlLoop | None, around: GraphInfo) -> Status:
        total = sum(self._periods)
        rate = len(self._periods) / total if total > 0.0 else 0.0
        requested = f'{1.0 / self.period:g}' if self.period else 'that of the joint states'
        values = {
            'state': around.state,
            'rate [Hz]': f'{rate:.1f}',
            'requested rate [Hz]': requested,
            'period p99 [ms]': _in_ms(self._periods, 99.0),
            'period worst [ms]': _in_ms(self._periods, 100.0),
            'compute time p99 [ms]': _in_ms(self._durations, 99.0),
            'overruns': str(self.overruns),
        }
        if not around.is_active or loop is None:
            return Status('loop', Level.OK, around.state, values)
        values['mode'] = loop.controller.settings.mode.value
        values['phase'] = loop.controller.phase.value
        values['dry run'] = 'yes' if around.is_dry_run else 'no'
        values['gain'] = f'{loop.controller.gain:.3f}'
        if self.period and total > 0.0 and rate * self.period < _SLOW:
            return Status('loop', Level.WARN, f'only {rate:.1f} commands/s', values)
        return Status('loop', Level.OK, _activity(now, loop, around), values)

    def _messages_status(self) -> Status:
        values = {text: str(count) for text, count in self.rejected.items()}
        if self._rejections:
            message = f'{self._rejections} rejected since the last report'
            return Status('messages', Level.WARN, message, values)
        total = sum(self.rejected.values())
        return Status('messages', Level.OK, f'{total} rejected in total', values)

    def _efforts_status(self, now: float, loop: ControlLoop, around: GraphInfo) -> Status:
        values = {
            'receivers': str(around.receivers),
            'topic with names': around.topics.joint_efforts,
            'topic of the external efforts': around.topics.external_efforts,
            'cutoff of the external efforts [Hz]': f'{loop.external_effort_estimator.cutoff:g}',
            'limits [N m, N]': ', '.join(f'{limit:g}' for limit in loop.controller.limits),
        }
        values['cut to limit since the last report'] = ', '.join(self._clamped_joints) or 'none'
        values |= {f'{name} cut to limit': str(count) for name, count in self.clamped.items()}
        values |= {f'{name} slowed': str(count) for name, count in self.slowed.items()}
        if around.is_active and not around.receivers and not around.is_dry_run:
            message = 'the commands have no subscribers'
            if around.others.subscribers:
                names = join_names(around.others.subscribers)
                message += f': {names} subscribes with another type or quality of service'
            return Status('efforts', Level.WARN, message, values)
        if self._clamped_joints:
            message = f'cut to its limit: {", ".join(self._clamped_joints)}'
            return Status('efforts', Level.WARN, message, values)
        return Status('efforts', Level.OK, _activity(now, loop, around), values)


def _activity(now: float, loop: ControlLoop, around: GraphInfo) -> str:
    return activity(now, loop, is_dry_run=around.is_dry_run)


def _selected(joints: Sequence[str], flags: Booleans) -> list[str]:
    return [name for name, flag in zip(joints, flags, strict=True) if flag]


def _in_ms(times: list[float], percentile: float) -> str:
    return f'{1e3 * float(np.percentile(times, percentile)):.3f}' if times else 'none'
