"""
Detects positions that change faster than a joint can move, whatever the cause.

Examples of causes: two nodes report one joint, an encoder is reset, or a suspended process resumes
and receives the messages of the whole pause within milliseconds.

All times are times of arrival. Messages may be late. A joint may therefore seem to move slightly
faster than it can. To allow for this, each joint has room for motion in either direction. The room
grows with time at twice the speed limit, and shrinks as the joint moves into it. The room never
exceeds the distance that a joint covers at twice the speed limit during the largest delay of a
message. After a pause the room is zero, because messages of the pause may follow.
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

_LATENESS = 0.03  # [s]; largest delay of messages
_LONGEST_STEP = 0.1  # [s]; a longer interval permits no more motion than this interval


@compiled
def has_jumped(tracks: Any, i: int, position: float, elapsed: float) -> bool:
    """
    Return whether a joint has moved further than is possible; call this before `track`.

    ``tracks`` comes from `publisher_conflicts.make_tracks`, and ``i`` is the index of the joint.
    ``position`` is the reported position [rad or m]. ``elapsed`` is the time since the last report
    of this joint [s]. It is inf if there was no report, and negative if the clock was set back.

    """
    speed = FACTOR * tracks[SPEED, i]
    most = speed * _LATENESS
    if elapsed == math.inf:
        tracks[ROOM_ABOVE, i] = tracks[ROOM_BELOW, i] = most
        return False
    step = min(max(position - tracks[LAST, i], -LARGEST), LARGEST)
    # A full turn of a joint that is not continuous would change the computed-torque feedback.
    if abs(step) < LARGEST and tracks[IS_CONTINUOUS, i] != 0.0:
        step -= 2.0 * math.pi * np.rint(step / (2.0 * math.pi))
    if not 0.0 <= elapsed <= _LONGEST_STEP:
        tracks[ROOM_ABOVE, i] = tracks[ROOM_BELOW, i] = most = 0.0
    gained = speed * min(max(elapsed, 0.0), _LONGEST_STEP)
    above, below = tracks[ROOM_ABOVE, i] + gained - step, tracks[ROOM_BELOW, i] + gained + step
    tracks[ROOM_ABOVE, i] = min(max(above, 0.0), most)
    tracks[ROOM_BELOW, i] = min(max(below, 0.0), most)
    return bool(min(above, below) < 0.0)
