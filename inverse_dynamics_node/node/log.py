"""Log of the node: reports each change once, and lasting problems repeatedly."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Sequence
from itertools import compress
import math
import time
from typing import Any

import numpy as np

from ..control.loop import Command, ControlLoop
from ..control.status import Level, NodeNames, Part
from ..control.status_text import (
    activity,
    describe_implausible,
    describe_late,
    describe_lost_imu,
    describe_motion,
    describe_unstable_gains,
)
from ..control.supervision import COMPUTING_PHASES, Phase, TOO_FAR_PHASES
from ..errors import shortened_lines

_PERIOD = 2.0  # [s]; between repetitions of a lasting problem
_LONG_PERIOD = 10.0  # [s]; between repetitions of a problem that only a user can solve
_ALARMS = (Phase.STATE_LOST, Phase.NO_SOLUTION, Phase.LIMIT_STOP)
_MOST_CHANGES = 6  # at most this many changes of activity are logged within _PERIOD
_MOST_MESSAGES = 3  # at most this many reports for each topic are logged within _PERIOD
_MAX_KEYS = 1000  # limits the memory; with more keys, a message may be repeated early


class BoundedLogger:
    """A logger that shortens long lines, because names in messages can be very long."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger

    def __getattr__(self, name: str) -> Any:
        return getattr(self._logger, name)

    def info(self, text: str, **options: Any) -> bool:
        """Log a message; `options` are passed to the logger of rclpy."""
        return bool(self._logger.info(shortened_lines(text), **options))

    def warning(self, text: str, **options: Any) -> bool:
        return bool(self._logger.warning(shortened_lines(text), **options))

    def error(self, text: str, **options: Any) -> bool:
        return bool(self._logger.error(shortened_lines(text), **options))


class NodeLog:
    """
    Logs each new problem, and logs it again every few seconds while it lasts.

    The logger of rclpy can also limit repetitions, but takes 0.2 ms for each suppressed message.
    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._times: dict[Hashable, float] = {}  # time of the last message for each key
        self._last_activity: tuple[Phase, bool] | None = None
        self._changes: deque[float] = deque(maxlen=_MOST_CHANGES)  # times of the latest changes
        self._has_reported_imu = False
        self._last_parts: dict[str, tuple[Level, str]] = {}
        self._message_times: dict[str, deque[float]] = {}  # times of reports by topic

    def begin(self) -> None:
        """Let the next step report the activity, even if it has not changed."""
        self._last_activity = None
        self._changes.clear()

    def warn(self, key: Hashable, text: str | Callable[[], str], period: float = _PERIOD) -> None:
        """Log a warning, unless the same key was logged less than `period` [s] ago."""
        if self._is_due(key, period):
            self._logger.warning(text if isinstance(text, str) else text())

    def error(self, key: Hashable, text: str) -> None:
        """Log an error, unless the same key was logged a moment ago."""
        if self._is_due(key):
            self._logger.error(text)

    def report_message(self, topic: str, text: str, *, is_problem: bool = True) -> None:
        """
        Log the effect of an incoming message, or why the message was dropped.

        The log entry is a warning if `is_problem`. Nothing is logged if the same text was
        logged a moment ago, or if this topic has just had too many log entries.
        """
        times = self._message_times.setdefault(topic, deque(maxlen=_MOST_MESSAGES))
        now = time.monotonic()
        is_full = len(times) == _MOST_MESSAGES and now - times[0] < _PERIOD
        if is_full or not self._is_due((topic, hash(text))):
            return
        times.append(now)
        if is_problem:
            self._logger.warning(f'{topic}: {text}')
        else:
            self._logger.info(f'{topic}: {text}')

    def report_robot(self, loop: ControlLoop) -> None:
        """Report the loaded robot, and the warnings about its description."""
        robot, joints = loop.robot, loop.controller.joints
        for warning in robot.warnings:
            self._logger.warning(str(warning))
        others = [name for name in robot.joint_names if name not in joints]
        self._logger.info(
            f"robot '{robot.name}', {np.sum(robot.mass):.3g} kg; "
            f'the node commands {", ".join(joints)}'
            + (f', and also models {", ".join(others)}' if others else '')
        )

    def report_part(self, name: str, part: Part | None) -> None:
        """Log a problem in a part of the status at once and every ten seconds; log its end."""
        if part is None:
            return
        last = self._last_parts.get(name, (Level.OK, ''))
        this = part.level, part.message
        if part.level is Level.OK:
            if last[0] is not Level.OK:
                self._logger.info(part.message)
        elif last != this or self._is_due(('part', name), _LONG_PERIOD):
            self._times[('part', name)] = time.monotonic()
            if part.level is Level.ERROR:  # a logger accepts one severity per line of code
                self._logger.error(part.message)
            else:
                self._logger.warning(part.message)
        self._last_parts[name] = this

    def report_step(self, now: float, loop: ControlLoop, command: Command) -> None:
        """Report a change of activity and the problems of the step; repeat alarms."""
        controller = loop.controller
        phase = controller.phase
        # The end of a ramp down is reported, even though the phase does not change.
        key = (phase, phase in COMPUTING_PHASES or controller.has_effort)
        if key != self._last_activity or phase in _ALARMS:
            self._report_activity(now, loop, key)
        if loop.has_imu:
            self._report_imu(now, loop)
        motion = describe_motion(now, loop)
        if motion:
            self.error('motion', motion)
        if loop.collector.late_count:
            self.warn('late', lambda: '; '.join(describe_late(loop, now)))
        if np.count_nonzero(command.is_saturated):  # any() takes longer
            # A change of the saturated joints is reported at once.
            joints, flags = controller.joints, command.is_saturated
            self.warn(
                ('saturated', flags.tobytes()),
                lambda: f'effort cut to its limit: {", ".join(compress(joints, flags))}',
            )

    def report_lost_velocities(self, joints: Sequence[str], publishers: Sequence[str]) -> None:
        """Warn that new joint states lack velocities, and name the publishers."""
        self.warn(
            'velocities',
            f'joint_states: the velocities of {", ".join(joints)} are missing in new messages '
            f'from {NodeNames.of(publishers)}; zero is used',
        )

    def report_implausible(self, loop: ControlLoop) -> None:
        """Warn about joints that are far outside their position limits."""
        for joint, text in describe_implausible(loop).items():
            self.warn(('implausible', joint), text, _LONG_PERIOD)

    def report_gains(self, loop: ControlLoop) -> None:
        """Warn of gains with which joints may oscillate."""
        text = describe_unstable_gains(loop)
        if text:
            self.warn(('gains', text), text, _LONG_PERIOD)

    def _report_imu(self, now: float, loop: ControlLoop) -> None:
        """While IMU messages are missing, log an error every few seconds; log when they return."""
        text = describe_lost_imu(now, loop)
        if text and self._is_due('imu'):
            self._has_reported_imu = True
            self._logger.error(text)
        elif not text and self._has_reported_imu:
            self._has_reported_imu = False
            self._logger.info('the motion of the base is known again')

    def _report_activity(self, now: float, loop: ControlLoop, key: tuple[Phase, bool]) -> None:
        if self._last_activity is None:
            for name in loop.collector.without_velocity():
                self._logger.warning(f"joint_states: '{name}' has no velocity; zero is used")
            for name in loop.collector.unseen():
                self._logger.warning(
                    f"joint_states: '{name}' is not reported; its locked position is used"
                )
            self.report_implausible(loop)
            self._last_activity = Phase.WAITING, False
        steady = time.monotonic()
        if key == self._last_activity:
            is_due = steady - self._changes[-1] >= _PERIOD
        else:
            # Several changes may follow in quick succession, for example after a clock jump.
            is_due = len(self._changes) < _MOST_CHANGES or steady - self._changes[0] >= _PERIOD
        if not is_due:
            return  # the next step tries again
        self._changes.append(steady)
        self._last_activity = key
        text = activity(now, loop)
        if key[0] in _ALARMS:
            self._logger.error(text)
        elif key[0] in TOO_FAR_PHASES:
            self._logger.warning(text)
        else:
            self._logger.info(text)
        if key[0] in COMPUTING_PHASES:
            self.report_gains(loop)

    def _is_due(self, key: Hashable, period: float = _PERIOD) -> bool:
        now = time.monotonic()  # simulated time may pause or run fast
        if now - self._times.get(key, -math.inf) < period:
            return False
        if len(self._times) >= _MAX_KEYS:
            self._times.clear()
        self._times[key] = now
        return True
