"""
Finds positions that change faster than a joint can move.

For example, an encoder is reset, or a suspended process resumes and receives many old messages at
once. A joint may seem to move slightly too fast, because messages may be late. Each joint
therefore has some room for motion in each direction. The room grows at twice the speed limit, and
shrinks as the joint moves in this direction. The room is at most the distance that the joint
covers at twice the speed limit within the largest expected delay. After a pause, the room is zero,
so that motion in a burst of old messages is treated as a jump. All times are times of arrival.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..dynamics.jit import compiled
from ..robot.model import Floats, RobotModel

_FACTOR = 2.0  # factor by which a joint may exceed its speed limit
# Smallest, default and largest speed limits of revolute joints [rad/s] and prismatic joints [m/s].
_SPEEDS = ((1.0, 10.0, 30.0), (0.1, 2.0, 5.0))
_LARGEST = 1e6  # [rad, m]; larger steps are cut to this size
_DELAY = 0.03  # [s]; largest message delay that `has_jumped` expects
_LONGEST_STEP = 0.1  # [s]; a longer interval does not permit more motion
# Rows of tracks, with one column per joint: constants, the last position, and the room for the
# next step in each direction.
_SPEED, _IS_CONTINUOUS, _LAST, _ROOM_ABOVE, _ROOM_BELOW = range(5)
_ROWS = 5


def make_tracks(n: int, robot: RobotModel | None = None) -> Floats:
    """
    Make the tracks of n joints, an array of shape (5, n).

    Each column contains the constants and the history of a joint. The speed limits are those of
    ``robot``. Without ``robot``, all joints are assumed to be revolute.

    """
    tracks = np.zeros((_ROWS, n))
    is_prismatic, limits = np.zeros(n, dtype=bool), np.full(n, math.inf)
    if robot is not None:
        is_prismatic, limits = robot.is_prismatic_joint, robot.velocity_limits
        tracks[_IS_CONTINUOUS] = robot.is_continuous
    slowest, usual, fastest = np.where(is_prismatic, *np.array(_SPEEDS)[::-1, :, None])
    tracks[_SPEED] = np.clip(np.where(np.isfinite(limits), limits, usual), slowest, fastest)
    return tracks


@compiled
def has_jumped(tracks: Any, i: int, position: float, elapsed: float) -> bool:
    """
    Return whether a joint has apparently moved faster than it can, and store its position.

    ``tracks`` comes from `make_tracks`, and ``i`` is the index of the joint. ``position`` is the
    reported position [rad or m]. ``elapsed`` is the time since the previous report of this joint
    [s]. This time is inf for the first report, and negative if the clock was set back.

    """
    speed = _FACTOR * tracks[_SPEED, i]
    most = speed * _DELAY
    last, tracks[_LAST, i] = tracks[_LAST, i], position
    if elapsed == math.inf:
        tracks[_ROOM_ABOVE, i] = tracks[_ROOM_BELOW, i] = most
        return False
    step = min(max(position - last, -_LARGEST), _LARGEST)
    # Ignore full turns of continuous joints only. Other full turns change the feedback.
    if abs(step) < _LARGEST and tracks[_IS_CONTINUOUS, i] != 0.0:
        step -= 2.0 * math.pi * np.rint(step / (2.0 * math.pi))
    if not 0.0 <= elapsed <= _LONGEST_STEP:
        tracks[_ROOM_ABOVE, i] = tracks[_ROOM_BELOW, i] = most = 0.0
    gained = speed * min(max(elapsed, 0.0), _LONGEST_STEP)
    above, below = tracks[_ROOM_ABOVE, i] + gained - step, tracks[_ROOM_BELOW, i] + gained + step
    tracks[_ROOM_ABOVE, i] = min(max(above, 0.0), most)
    tracks[_ROOM_BELOW, i] = min(max(below, 0.0), most)
    return bool(min(above, below) < 0.0)
