"""
Detects positions that alternate faster than a joint can move: two publishers report one joint.

Only the distance that a position goes *back* is added up, minus the distance that the joint could
have covered since. A single jump (homing, an encoder reset) thus adds nothing, and neither does a
fast motion with several samples between its turning points. Times are those of arrival, and
messages may arrive late and several at once: a motion within the speed limit stays below the
threshold as long as no message is later than `LATENESS`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..dynamics.jit import compiled
from ..robot.model import Floats, RobotModel

LATENESS = 1.0
"""How late messages may arrive without being mistaken for alternation [s]."""
_FACTOR = 2.0  # by which a joint may exceed its speed limit
_LEAST_COUNT = 4  # of turns: A, B, A, B, A, B
_SPEEDS = ((1.0, 10.0, 30.0), (0.1, 2.0, 5.0))
# Smallest plausible speed limit, the limit to assume if there is none, and the largest plausible
# one: of revolute [rad/s] and of prismatic joints [m/s].
_NOISE = (0.02, 0.005)  # smaller steps are ignored [rad, m]

# Rows of tracks, one column per joint.
_SPEED, _IGNORED, _IS_CONTINUOUS, _LAST, _STEP, _RAW_STEP, _EXCESS, _COUNT, _OTHER, _FLAG = range(
    10
)


def make_tracks(n: int, robot: RobotModel | None = None) -> Floats:
    """
    Make the array of constants and memory of `track`.

    Parameters
    ----------
    n : int
        Number of joints.
    robot : RobotModel, optional
        Provides the speed limits of its n joints; otherwise those assumed for revolute joints.

    Returns
    -------
    tracks : ndarray, shape (10, n)

    """
    tracks = np.zeros((10, n))
    is_prismatic, limits = np.zeros(n, dtype=bool), np.full(n, math.inf)
    if robot is not None:
        is_prismatic, limits = robot.is_prismatic_joint, robot.velocity_limits
        tracks[_IS_CONTINUOUS] = robot.is_continuous
    slowest, usual, fastest = np.where(is_prismatic, *np.array(_SPEEDS)[::-1, :, None])
    tracks[_SPEED] = np.clip(np.where(np.isfinite(limits), limits, usual), slowest, fastest)
    tracks[_IGNORED] = np.where(is_prismatic, _NOISE[1], _NOISE[0])
    return tracks


def copy_track(target: Floats, i: int, source: Floats, k: int) -> None:
    """Continue the track of one joint in the tracks of another robot description."""
    target[_LAST:, i] = source[_LAST:, k]


def alternating(tracks: Floats) -> dict[int, tuple[float, float]]:
    """Return the joints whose positions alternate, each with its last two positions."""
    return {
        int(i): (float(tracks[_OTHER, i]), float(tracks[_LAST, i]))
        for i in np.flatnonzero(tracks[_FLAG])
    }


@compiled
def track(tracks: Any, i: int, position: float, elapsed: float) -> bool:
    """
    Follow the positions of one joint.

    Parameters
    ----------
    tracks : ndarray, shape (10, n)
        See `make_tracks`.
    i : int
        Index of the joint.
    position : float
        Reported position [rad or m].
    elapsed : float
        Time since the last report of this joint [s]; negative if there was none.

    Returns
    -------
    does_alternate : bool
        Whether its positions alternate. This ends when they have been consistent for as long as
        it takes to cover the distance at twice the speed limit, at most 1 s.

    """
    raw = position - tracks[_LAST, i]
    other, tracks[_LAST, i] = tracks[_LAST, i], position
    if elapsed < 0.0:
        tracks[_STEP, i] = 0.0
        return bool(tracks[_FLAG, i] != 0.0)
    step = raw
    if tracks[_IS_CONTINUOUS, i] != 0.0:
        step = raw - 2.0 * math.pi * np.rint(raw / (2.0 * math.pi))
    speed = tracks[_SPEED, i]
    excess = tracks[_EXCESS, i] - _FACTOR * speed * elapsed
    if excess <= 0.0:
        excess = tracks[_COUNT, i] = tracks[_FLAG, i] = 0.0
    if abs(step) > tracks[_IGNORED, i]:
        # A wheel that makes half a turn between two reports only seems to turn back.
        if step * tracks[_STEP, i] < 0.0 and raw * tracks[_RAW_STEP, i] < 0.0:
            excess += min(abs(step), abs(tracks[_STEP, i]))
            tracks[_COUNT, i] += 1.0
            tracks[_OTHER, i] = other
        tracks[_STEP, i], tracks[_RAW_STEP, i] = step, raw
    threshold = speed * LATENESS
    if excess > threshold and tracks[_COUNT, i] >= _LEAST_COUNT:
        tracks[_FLAG, i] = 1.0
    tracks[_EXCESS, i] = min(excess, 2.0 * threshold)
    return bool(tracks[_FLAG, i] != 0.0)
