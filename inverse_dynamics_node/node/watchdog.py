"""Keeps the loop and the signals working while messages arrive faster than they are handled."""

from __future__ import annotations

import threading
import time
from typing import Any

from rclpy.task import Future

_TIMEOUT = 0.1  # [s]; time-out of a spin that is not interrupted
_PATIENCE = 0.03  # [s]; a spin that returns later than this is interrupted
_CHECK_PERIOD = 0.05  # [s]
_SHORT_TIMEOUT = 0.01  # [s]; the same three while there are too many messages
_SHORT_PATIENCE = 0.005
_SHORT_CHECK_PERIOD = 0.01


class Watchdog:
    """
    Spins an executor so that it returns in time, even from a queue that never becomes empty.

    rclpy's EventsExecutor queues one event for each message that arrives, and timers queue behind
    them. Its time-out applies only once the queue is empty. A thread therefore ends the spin
    between two events, and the caller does everything that is overdue. The events stay in the
    queue. A new executor would drop them, but in rclpy 7.1 services no longer answer after that.

    """

    def __init__(self) -> None:
        self.is_congested = False
        """Whether the last spin had to be interrupted."""
        self._future = Future()
        self._deadline = float('inf')
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, name='watchdog', daemon=True)
        self._thread.start()

    def spin(self, executor: Any) -> None:
        """Let an executor handle events for about a tenth of a second."""
        timeout, patience = (
            (_SHORT_TIMEOUT, _SHORT_PATIENCE) if self.is_congested else (_TIMEOUT, _PATIENCE)
        )
        future = self._future = Future()
        self._deadline = time.monotonic() + timeout + patience
        # spin() never returns in builds against an old C library, and spin_once() would return
        # for every message.
        executor.spin_until_future_complete(future, timeout_sec=timeout)
        self._deadline = float('inf')
        self.is_congested = future.done()

    @property
    def native_id(self) -> int:
        """Id of the thread in the kernel."""
        assert self._thread.native_id is not None
        return self._thread.native_id

    def close(self) -> None:
        """End the thread."""
        self._is_closed.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._is_closed.wait(
            _SHORT_CHECK_PERIOD if self.is_congested else _CHECK_PERIOD
        ):
            future = self._future
            if time.monotonic() > self._deadline and not future.done():
                future.set_result(None)
