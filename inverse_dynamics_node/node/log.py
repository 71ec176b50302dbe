"""A log that does not repeat itself all the time."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

_PERIOD = 2.0  # [s]; how often it repeats what lasts


class SparseLog:
    """
    Tells what lasts now and then; a logger's own throttle costs 0.2 ms even when it is silent.

    Parameters
    ----------
    logger : rclpy.impl.rcutils_logger.RcutilsLogger
        Of the node.

    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._times: dict[str, float] = {}

    def warn(self, now: float, key: str, text: str | Callable[[], str]) -> None:
        """Warn, unless it was said lately; words that take time to find come as a function."""
        if self.is_due(now, key):
            self._logger.warning(text if isinstance(text, str) else text())

    def is_due(self, now: float, key: str) -> bool:
        """Tell whether it is time to say something again, and take it as said."""
        if abs(now - self._times.get(key, -math.inf)) < _PERIOD:
            return False
        self._times[key] = now
        return True
