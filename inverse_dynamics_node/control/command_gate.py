"""
Withholds the commands in a dry run.

No ROS, and no clock: the time by which ramps advance is an argument.
"""

from __future__ import annotations

import enum

import numpy as np

from ..robot.model import Floats
from .ramp_clock import ramp_fraction

_ZEROS_TIME = 0.5  # [s]; zeros after the ramp, because best-effort subscribers may lose some


class _Gate(enum.Enum):
    OPEN = enum.auto()
    CLOSING = enum.auto()
    CLOSED = enum.auto()


class CommandGate:
    """
    Decides which efforts are sent: the computed ones, or in a dry run none.

    A receiver holds the last command forever. When the gate closes, the commands therefore fall
    from the last one to zero along the stop ramp, and zeros follow for half a second. After that
    nothing is sent, so that another node may command the robot. The computed efforts are not
    affected.

    """

    def __init__(self) -> None:
        self._gate = _Gate.OPEN
        self._last: Floats | None = None
        self._top = np.zeros(0)
        self._ramp = self._fallen = 0.0  # [s]

    def reset(self, *, is_dry_run: bool) -> None:
        """Begin with an open gate, or with a closed one in a dry run; nothing has been sent."""
        self._gate = _Gate.CLOSED if is_dry_run else _Gate.OPEN
        self._last = None

    @property
    def is_open(self) -> bool:
        """Whether the computed efforts are sent."""
        return self._gate is _Gate.OPEN

    @property
    def may_open(self) -> bool:
        """Whether the gate is not open, and the robot holds no effort of an earlier command."""
        return self._gate is not _Gate.OPEN and not self.has_effort

    @property
    def has_effort(self) -> bool:
        """Whether an effort of the last command that was sent is not zero."""
        return self._last is not None and bool(self._last.any())

    @property
    def has_sent(self) -> bool:
        """Whether the robot may depend on this node: false once the gate is closed."""
        return self._last is not None

    def open(self) -> None:
        """Send the computed efforts from now on; they must rise from zero."""
        self._gate = _Gate.OPEN

    def close(self, time_to_fall: float) -> None:
        """
        Let the commands fall to zero, and end.

        Parameters
        ----------
        time_to_fall : float
            Time in which they fall; what is left of it if they already do [s].

        """
        if self._last is None:
            self._gate = _Gate.CLOSED
        elif self._gate is _Gate.OPEN:
            self._gate = _Gate.CLOSING
            self._top = self._last.copy()
            self._ramp, self._fallen = time_to_fall, 0.0

    def select(self, efforts: Floats, elapsed: float) -> Floats | None:
        """
        Select the efforts to send.

        Parameters
        ----------
        efforts : ndarray, shape (m,)
            The computed efforts [N m or N].
        elapsed : float
            Time by which ramps advance [s]; see `RampClock`.

        Returns
        -------
        efforts : ndarray or None
            None if nothing is to be sent.

        """
        if self._gate is _Gate.OPEN:
            self._last = efforts
        elif self._gate is _Gate.CLOSING:
            self._fallen += elapsed
            if self._fallen > self._ramp + _ZEROS_TIME and not self.has_effort:
                self._gate, self._last = _Gate.CLOSED, None
            else:
                self._last = self._top * (1.0 - ramp_fraction(self._fallen, self._ramp))
        return self._last
