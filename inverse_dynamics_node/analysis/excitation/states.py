"""States of the joints that move, and of the whole robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...robot.model import Floats
from .limits import MotionLimits

_STEP = 1e-6
"""Step of difference quotients: of a position [rad or m], or relative to the largest speed."""


class States(NamedTuple):
    """States of the m joints that move, each of shape (k, m)."""

    q: Floats
    """[rad or m]."""
    qd: Floats
    """[rad/s or m/s]."""
    qdd: Floats
    """[rad/s^2 or m/s^2]."""


def whole_states(limits: MotionLimits, states: States) -> States:
    """Return the states of all joints of the robot, each of shape (k, n)."""
    k, n = len(states.q), len(limits.rest)
    whole = States(np.tile(limits.rest, (k, 1)), np.zeros((k, n)), np.zeros((k, n)))
    for part, values in zip(whole, states, strict=True):
        part[:, limits.index] = values
    return whole


def random_states(limits: MotionLimits, count: int, rng: np.random.Generator) -> States:
    """Draw states within the limits; accelerations are such as to reach the speed in 0.5 s."""
    m = len(limits.speeds)
    q = rng.uniform(limits.lower, limits.upper, (count, m))
    qd = rng.uniform(-limits.speeds, limits.speeds, (count, m))
    qdd = rng.uniform(-2.0 * limits.speeds, 2.0 * limits.speeds, (count, m))
    return States(q, qd, qdd)


def gradient(function: Callable[[States], Floats], states: States, limits: MotionLimits) -> States:
    """
    Differentiate a function of the state at every sample.

    Parameters
    ----------
    function : callable
        Returns one number for each of k samples, shape (k,), which depends on its state only.
    states : States
        States, each of shape (k, m).
    limits : MotionLimits
        Limits of the m joints, for the size of the differences.

    Returns
    -------
    slopes : States
        Derivatives, each of shape (k, m).

    """
    here = function(states)
    k, m = states.q.shape
    slopes = States(*np.empty((3, k, m)))
    for j in range(m):
        steps = _STEP * np.array([1.0, limits.speeds[j], limits.speeds[j]])
        moved = States(*(np.tile(part, (3, 1)) for part in states))
        for order in range(3):
            moved[order][order * k : (order + 1) * k, j] += steps[order]
        changes = function(moved).reshape(3, k) - here
        for order in range(3):
            slopes[order][:, j] = changes[order] / steps[order]
    return slopes
