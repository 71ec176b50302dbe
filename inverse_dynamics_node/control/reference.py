"""The desired motion of the commanded joints."""

from __future__ import annotations

from typing import NamedTuple

from ..robot.model import Floats


class Reference(NamedTuple):
    """Desired motion of the commanded joints."""

    accelerations: Floats
    """Shape (m,) [rad/s^2 or m/s^2]."""
    efforts: Floats
    """Added to the command, shape (m,) [N m or N]."""
    time: float
    """Time of arrival [s]."""
    positions: Floats | None = None
    """Shape (m,) [rad or m]; None if the reference has none."""
    velocities: Floats | None = None
    """Shape (m,) [rad/s or m/s]; None if the reference has none."""
