"""The space that a robot sweeps in a motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...robot.kinematics import moving_points
from ...robot.model import Floats, RobotModel


class Extent(NamedTuple):
    """A box in the frame of the base, each end of shape (3,) [m]."""

    lowest: Floats
    highest: Floats


def swept_box(robot: RobotModel, q: Floats) -> Extent:
    """
    Return the box that contains the links that move, and their centres of mass, in all poses.

    The thickness of the links is unknown.

    Parameters
    ----------
    robot : RobotModel
        With n joints.
    q : ndarray, shape (k, n)
        Joint positions [rad or m].

    """
    sides = [moving_points(robot, q, axis) for axis in np.eye(3)]
    lowest, highest = ([float(f(side)) for side in sides] for f in (np.min, np.max))
    return Extent(np.array(lowest), np.array(highest))
