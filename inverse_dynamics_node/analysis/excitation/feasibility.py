"""How far states are beyond the limits of a motion."""

from __future__ import annotations

import math

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.kinematics import moving_points
from ...robot.model import Floats
from .limits import MotionLimits
from .states import States, whole_states

_HEIGHT = 0.1
"""Height below the floor that is as bad as twice the limit of a speed [m]."""


def excess(
    dynamics: InverseDynamics, limits: MotionLimits, states: States, aim: float = 1.0
) -> Floats:
    """
    Return by how much states exceed each limit, relative to the limit.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with its loads.
    limits : MotionLimits
        The limits of its m joints that move.
    states : States
        States of these joints, each of shape (k, m).
    aim : float
        Fraction of the limits that is regarded as the limit.

    Returns
    -------
    excess : ndarray, shape (k, c)
        One column for each limit of position, speed, effort and height; 0 within it.

    """
    parts = [
        np.abs(states.q - limits.middle) / limits.half,
        np.abs(states.qd) / limits.speeds,
    ]
    whole = whole_states(limits, states)
    bounded = np.isfinite(limits.efforts)
    if bounded.any():
        efforts = dynamics.efforts(*whole)
        parts.append(np.abs(efforts[:, bounded]) / limits.efforts[bounded])
    if math.isfinite(limits.floor):
        heights = moving_points(dynamics.robot, whole.q, np.array([0.0, 0.0, 1.0]))
        parts.append(aim + (limits.floor - heights) / _HEIGHT)
    found: Floats = np.maximum(np.concatenate(parts, axis=1) - aim, 0.0)
    return found
