"""Log of the node: prints each change once, and lasting problems repeatedly."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
import math
import re
import time
from typing import Any

import numpy as np

from ..control.loop import ControlLoop
from ..control.supervisor import COMPUTING_PHASES, Phase, TOO_FAR_PHASES
from ..errors import shortened_lines
from ..ros.diagnostics import Level, NodeStatus
from .status_text import activity

_PERIOD = 2.0  # [s]; between repetitions of an event
_LONG_PERIOD = 10.0  # [s]; between repetitions of a lasting problem
_MOST_CHANGES = 6  # at most this many changes of activity are logged within _PERIOD
_MOST_MESSAGES = 3  # at most this many reports for each topic are logged within _PERIOD
_ACTIVITY = 'activity'
_MAX_KEYS = 1000  # limits the memory; with more keys, a message may be repeated early
_NUMBER = re.compile(r'(?<!\w)[\d.]+')
_LEVELS = dict.fromkeys((*TOO_FAR_PHASES, Phase.CONTACT), Level.WARN) | dict.fromkeys(
    (Phase.STATE_LOST, Phase.NO_SOLUTION, Phase.LIMIT_STOP), Level.ERROR
)
_LOGGED_AT_ONCE = 'messages', 'reference', 'scheduling'
"""Parts whose problems are not logged from the status, but already when they happen."""


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
        self._write = {
            Level.OK: logger.info,
            Level.WARN: logger.warning,
            Level.ERROR: logger.error,
        }
        self._times: dict[Hashable, float] = {}  # time of the last message for each key
        self._lines: dict[str, deque[float]] = {}  # times of the latest messages by their source
        self._last_activity: tuple[Phase, bool] | None = None
        self._problems: dict[str, tuple[Hashable, str]] = {}  # key and message for each part

    def begin(self) -> None:
        """Let the next step report the activity, even if it has not changed."""
        self._last_activity = None
        self._lines.pop(_ACTIVITY, None)

    def report_message(self, topic: str, text: str, *, is_problem: bool = True) -> None:
        """
        Log the effect of an incoming message, or why the message was dropped.

        The log entry is a warning if `is_problem`. Nothing is logged if the same text was
        logged a moment ago, or if this topic has just had too many log entries.
        """
        if self._has_room(topic, _MOST_MESSAGES) and self._is_due((topic, hash(text))):
            self._lines[topic].append(time.monotonic())
            self._write[Level.WARN if is_problem else Level.OK](f'{topic}: {text}')

    def report_robot(self, loop: ControlLoop) -> None:
        """Report the loaded robot, and the warnings about its description."""
        robot, joints = loop.robot, loop.joints
        for warning in robot.warnings:
            self._write[Level.WARN](str(warning))
        others = [name for name in robot.joint_names if name not in joints]
        self._write[Level.OK](
            f"robot '{robot.name}', {np.sum(robot.mass):.3g} kg; "
            f'the node commands {", ".join(joints)}'
            + (f', and also models {", ".join(others)}' if others else '')
        )

    def report_status(self, status: NodeStatus, *, is_active: bool) -> None:
        """Log new problems at once, and lasting problems every ten seconds; log their end."""
        for name, (level, message, _) in status.items():
            if name in _LOGGED_AT_ONCE or (name == 'joint states' and not is_active):
                continue
            # Warnings about the robot are logged when it is loaded.
            if level is Level.ERROR or (level is Level.WARN and name != 'model'):
                key = _key_of(level, message)
                is_lasting = name in self._problems and self._problems[name][0] == key
                self._problems[name] = key, message
                if self._is_due(key, _LONG_PERIOD if is_lasting else _PERIOD):
                    self._write[level](message)
            elif name in self._problems and self._is_due(('end', name), _LONG_PERIOD):
                _, past = self._problems.pop(name)
                self._write[Level.OK](f'solved: {past}')

    def report_activity(self, now: float, loop: ControlLoop) -> None:
        """Report what the loop does, if this has changed."""
        phase = loop.phase
        # The end of a ramp down is reported, even though the phase does not change.
        key = phase, phase in COMPUTING_PHASES or loop.has_effort
        if key == self._last_activity:
            return
        if self._last_activity is None:
            for name in loop.collector.without_velocity():
                self._write[Level.WARN](f"joint_states: '{name}' has no velocity; zero is used")
        # Several changes may follow in quick succession, for example after a clock jump.
        if not self._has_room(_ACTIVITY, _MOST_CHANGES):
            return  # the next step tries again
        self._last_activity, steady = key, time.monotonic()
        level, text = _LEVELS.get(phase, Level.OK), activity(now, loop)
        self._lines[_ACTIVITY].append(steady)
        self._times[_key_of(level, text)] = steady
        self._write[level](text)

    def _has_room(self, source: str, most: int) -> bool:
        """Return whether a source has had fewer than `most` log entries within _PERIOD."""
        times = self._lines.setdefault(source, deque(maxlen=most))
        return len(times) < most or time.monotonic() - times[0] >= _PERIOD

    def _is_due(self, key: Hashable, period: float = _PERIOD) -> bool:
        now = time.monotonic()  # simulated time may pause or run fast
        if now - self._times.get(key, -math.inf) < period:
            return False
        if len(self._times) >= _MAX_KEYS:
            self._times.clear()
        self._times[key] = now
        return True


def _key_of(level: Level, message: str) -> Hashable:
    """Return what identifies a problem: its message may contain other numbers each time."""
    return level, _NUMBER.sub('', message)
