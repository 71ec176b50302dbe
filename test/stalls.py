"""Tells a test that failed because the machine stood still from one that found a fault."""

import threading
import time

PERIOD = 0.01  # [s]
TOLERATED = 0.02  # [s]; a simulated arm that gets no command for longer leaves its path


class StalledMachineError(AssertionError):
    """A test in real time failed while the machine was too busy for it."""


class StallMeter:
    """Measures, while used as a context, how late the machine lets a thread continue."""

    def __enter__(self):
        self.longest = 0.0  # [s]
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._measure, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._is_over.set()
        self._thread.join()

    def _measure(self):
        due = time.monotonic() + PERIOD
        while not self._is_over.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            self.longest = max(self.longest, now - due)
            due = now + PERIOD
