"""A part of a recording, and the cause that acts during it."""

from __future__ import annotations

from typing import NamedTuple

from ...robot.model import Floats
from .fault import FaultKind
from .regression_data import RegressionData
from .robot_fit import RobotFit


class FaultInterval(NamedTuple):
    """A part of a recording, and the cause that acts during it."""

    kind: FaultKind
    """A payload, an external force, or a mounting that changes."""
    interval: tuple[float, float]
    """Begin and end [s]."""
    outside: RobotFit
    """Explanation of these data."""
    data: RegressionData
    """Samples of the rest of the recording; if a load acts inside, all samples."""
    joints: tuple[int, ...] = ()
    """Joints on which an external force acts."""
    knots: Floats | None = None
    """Times at which gravity was fitted, shape (k,) [s]."""
    gravity: Floats | None = None
    """Gravity in the base frame at the knots, shape (k, 3) [m/s^2]."""


def span(data: RegressionData) -> tuple[float, float]:
    """Return the times of the first and last samples [s]."""
    times = [samples.times for samples in data.joints]
    return min(float(t[0]) for t in times), max(float(t[-1]) for t in times) + 1e-9
