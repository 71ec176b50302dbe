"""What the node says: what has changed, and now and then what has not and should."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

import numpy as np

from ..controller import Command, Phase
from ..rig import Rig

_PERIOD = 2.0  # [s]; how often it repeats what lasts
_MOST_KEYS = 1000  # more things to say than that are better said twice than kept


class NodeLog:
    """
    Says everything once, and again as long as it lasts, but not all the time.

    A logger's own throttle costs 0.2 ms even when it is silent.

    Parameters
    ----------
    logger : rclpy.impl.rcutils_logger.RcutilsLogger
        Of the node.

    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._times: dict[str, float] = {}
        self._last_phase = Phase.WAITING

    def begin(self) -> None:
        """Take it that nothing has been said of a phase yet."""
        self._last_phase = Phase.WAITING

    def warn(self, now: float, key: str, text: str | Callable[[], str]) -> None:
        """Warn, unless it was said lately; words that take time to find come as a function."""
        if self._is_due(now, key):
            self._logger.warning(text if isinstance(text, str) else text())

    def introduce(self, rig: Rig) -> None:
        """Say what has been loaded, and what looks wrong about it."""
        robot, joints = rig.robot, rig.controller.joints
        for warning in robot.warnings:
            self._logger.warning(warning)
        others = [name for name in robot.joint_names if name not in joints]
        self._logger.info(
            f"robot '{robot.name}', {np.sum(robot.mass):.3g} kg; commands {', '.join(joints)}"
            + (f'; takes into account {", ".join(others)}' if others else '')
        )

    def tell_waiting(
        self, now: float, rig: Rig, topic: str, publishers: Callable[[], int]
    ) -> None:
        """Say what is missing before there can be a command."""
        self.warn(
            now,
            'waiting',
            lambda: (
                f'no command yet: {topic} ({publishers()} publishers) has not told '
                f'{", ".join(rig.missing())}'
            ),
        )

    def tell(self, now: float, rig: Rig, command: Command) -> None:
        """Say how a step went, if that is news."""
        phase = rig.controller.phase
        if phase is not self._last_phase:
            self._tell_phase(now, rig)
            self._last_phase = phase
        if phase is Phase.STATE_LOST:
            self.warn(now, 'state lost', lambda: _what_is_stale(now, rig))
        if np.count_nonzero(command.is_saturated):  # any() takes longer
            joints = command.is_saturated.tobytes().hex()  # others are news
            self.warn(now, f'saturated {joints}', lambda: _what_is_saturated(rig, command))

    def _tell_phase(self, now: float, rig: Rig) -> None:
        phase = rig.controller.phase
        if self._last_phase is Phase.WAITING:
            for name in rig.collector.without_velocity():
                self._logger.warning(f"joint_states: no velocity of '{name}', taken as zero")
            for name in rig.collector.unseen():
                self._logger.warning(f"joint_states: '{name}' not seen, taken as locked")
        if not self._is_due(now, phase.name):
            return
        if phase in (Phase.RUNNING, Phase.HOLDING, Phase.STOPPED):
            self._logger.info(phase.value)
        else:
            self._logger.error(phase.value)

    def _is_due(self, now: float, key: str) -> bool:
        if abs(now - self._times.get(key, -math.inf)) < _PERIOD:
            return False
        if len(self._times) >= _MOST_KEYS:
            self._times.clear()
        self._times[key] = now
        return True


def _what_is_stale(now: float, rig: Rig) -> str:
    timeout = rig.controller.settings.state_timeout
    joints = rig.collector.stale(now, timeout)
    return f'no joint state for more than {timeout:g} s of {", ".join(joints)}'


def _what_is_saturated(rig: Rig, command: Command) -> str:
    joints = rig.controller.joints
    cut = [name for name, cut in zip(joints, command.is_saturated, strict=True) if cut]
    return f'effort cut to its limit: {", ".join(cut)}'
