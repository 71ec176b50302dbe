"""
Detects positions that change faster than a joint can move, whatever the cause.

After the process was suspended, messages of the whole pause may arrive within milliseconds. Two
nodes may report one joint, and an encoder may be reset. Times are those of arrival, so a joint may
move a little further than its speed and the time explain: a message may have been late.

A joint has room on either side. The room grows with time at twice the speed limit, shrinks as the
joint moves into it, and is limited by how late messages may be. It is lost after a pause, because
messages of the pause may follow.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..dynamics.jit import compiled
from .publisher_conflicts import (
    FACTOR,
    IS_CONTINUOUS,
    LARGEST,
    LAST,
    ROOM_ABOVE,
    ROOM_BELOW,
    SPEED,
)

_LATENESS = 0.03  # [s]; how late messages may be
_LONGEST_STEP = 0.1  # [s]; after a longer time, a joint may have moved only as far as in this one


@compiled
def has_jumped(tracks: Any, i: int, position: float, elapsed: float) -> bool:
    """
    Return whether a joint has moved further than it can; to be called before `track`.

    Parameters
    ----------
    tracks : ndarray, shape (21, n)
        See `publisher_conflicts.make_tracks`.
    i : int
        Index of the joint.
    position : float
        Reported position [rad or m].
    elapsed : float
        Time since the last report of this joint [s]; inf if there was none, and negative if the
        clock was set back since.

    """
    speed = FACTOR * tracks[SPEED, i]
    most = speed * _LATENESS
    if elapsed == math.inf:
        tracks[ROOM_ABOVE, i] = tracks[ROOM_BELOW, i] = most
        return False
    step = min(max(position - tracks[LAST, i], -LARGEST), LARGEST)
    # A full turn of another joint would change the feedback of computed torque.
    if abs(step) < LARGEST and tracks[IS_CONTINUOUS, i] != 0.0:
        step -= 2.0 * math.pi * np.rint(step / (2.0 * math.pi))
    if not 0.0 <= elapsed <= _LONGEST_STEP:
        tracks[ROOM_ABOVE, i] = tracks[ROOM_BELOW, i] = most = 0.0
    gained = speed * min(max(elapsed, 0.0), _LONGEST_STEP)
    above, below = tracks[ROOM_ABOVE, i] + gained - step, tracks[ROOM_BELOW, i] + gained + step
    tracks[ROOM_ABOVE, i] = min(max(above, 0.0), most)
    tracks[ROOM_BELOW, i] = min(max(below, 0.0), most)
    return bool(min(above, below) < 0.0)
