"""Collects statistics on the commands and messages of the node."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import compress
import math

import numpy as np

from ..control.loop import Command

_MOST_REASONS = 20  # further reasons are counted together
_LONGEST_PAUSE = 2.0  # [s]; a longer time between reports means that the process was suspended


class Monitor:
    """
    Collects statistics since the start, and since the last report.

    `period` is the requested time between commands [s]; 0 if each joint state produces a command.
    """

    def __init__(self, period: float = 0.0) -> None:
        self.rejected: Counter[str] = Counter()
        """Number of messages rejected since the start, by topic and reason."""
        self.cut_counts: Counter[str] = Counter()
        """How often the effort of each joint has been cut to its limit since the start."""
        self.slowed: Counter[str] = Counter()
        """How often a rate limit has slowed the effort of each joint since the start."""
        self.overruns = 0
        """Number of commands since the start that were more than half a period late."""
        self.period = period
        self._last = math.nan
        self.begin_report()

    def begin_report(self) -> None:
        """Begin the statistics for the next report."""
        self.periods: list[float] = []
        """Times between commands [s]."""
        self.durations: list[float] = []
        """Times to compute and send a command [s]."""
        self.cut: list[str] = []
        """Joints whose efforts were cut to their limits."""
        self.rejections = 0
        """Number of rejected messages."""

    @property
    def rate(self) -> float:
        """Rate of the commands since the last report [Hz]."""
        total = sum(self.periods)
        return len(self.periods) / total if total > 0.0 else 0.0

    def step(self, now: float, duration: float, command: Command, joints: Sequence[str]) -> None:
        """
        Record one command.

        `now` is the time when the computation of the command began [s]. `duration` is the time to
        compute and send the command [s].
        """
        elapsed = now - self._last
        self._last = now
        if elapsed >= 0.0:  # false for the first command, and after the clock was set back
            self.periods.append(elapsed)
            self.overruns += 0.0 < 1.5 * self.period < elapsed
        self.durations.append(duration)
        if np.count_nonzero(command.is_saturated):  # any() takes longer
            cut = list(compress(joints, command.is_saturated))
            self.cut_counts.update(cut)
            self.cut += [name for name in cut if name not in self.cut]
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
        self.rejections += 1


def lasting_silence(silence: float, elapsed: float, *, is_silent: bool) -> float:
    """
    Return how long publishers have been silent that could have sent messages [s].

    `silence` is the result for the last report, and `elapsed` the time since then [s]. A process
    that was suspended meanwhile could not hear anything.
    """
    return silence + min(elapsed, _LONGEST_PAUSE) if is_silent else 0.0
