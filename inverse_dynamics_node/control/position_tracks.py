"""
Follows the reported positions of each joint to detect two kinds of faults.

**Alternating positions** change back and forth faster than the joint can move. The usual cause is
that two publishers report the same joint. `track` detects alternating positions by their
reversals. A reversal is a step against the direction of the previous step. `track` adds up the
sizes of the reversals, and subtracts the distance that the joint could cover meanwhile at twice
its speed limit. A single jump, for example after an encoder is reset, does not cause an alarm.
Motion within the speed limit does not cause an alarm if each message is at most `LATENESS` late.
Three kinds of reversals are ignored, because they are harmless:

- reversals due to noise or coarse encoders
- full turns of rotary joints
- reversals due to a second publisher that relays the positions with a slight delay

The size of the reversals reveals such a relay. Relayed positions lag by only a fraction of the
distance that the joint has recently covered. Contradictory positions differ by the whole distance
that the joint seems to cover.

**Jumps** are steps that are faster than a joint can move; see `has_jumped`. For example, an
encoder is reset, or a suspended process resumes and receives many old messages at once. A joint
may seem to move slightly too fast, because messages may be late. Each joint therefore has some
room for motion in each direction. The room grows at twice the speed limit, and shrinks as the
joint moves in this direction. The room is at most the distance that the joint covers at twice the
speed limit within the largest expected delay. After a pause, the room is zero, so that motion in a
burst of old messages is treated as a jump.

All times are times of arrival.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..dynamics.jit import compiled
from ..robot.model import Floats, RobotModel

LATENESS = 1.0
"""Largest delay of a message that does not cause a false alarm [s]."""
_FACTOR = 2.0  # factor by which a joint may exceed its speed limit
_LEAST_COUNT = 4  # reversals before an alarm, as in positions A, B, A, B, A, B
# Smallest, default and largest speed limits of revolute joints [rad/s] and prismatic joints [m/s].
_SPEEDS = ((1.0, 10.0, 30.0), (0.1, 2.0, 5.0))
_NOISE = (0.02, 0.005)  # smaller steps are ignored [rad, m]
_COARSEST = (0.1, 0.02)  # largest plausible step of an encoder [rad, m]
_COUNTS = 2.5  # steps up to this multiple of the smallest step are ignored
_LEAST_STEP = 1e-6  # [rad, m]; smaller steps may be rounding errors
_WINDOW = 0.1  # [s]; `way` returns the range over the last one or two windows
_RELAYED = 0.5  # ignored fraction of `way`, so that relays may be up to 50 ms late
_LARGEST = 1e6  # [rad, m]; larger steps are cut to this size
_DELAY = 0.03  # [s]; largest message delay that `has_jumped` expects
_LONGEST_STEP = 0.1  # [s]; a longer interval does not permit more motion

# Rows of tracks, with one column per joint. Constants:
_CONSTANTS = 5
_SPEED, _IGNORED, _COARSE, _IS_PRISMATIC, _IS_CONTINUOUS = range(_CONSTANTS)
# Reported positions and steps:
_LAST, _STEP, _RAW_STEP, _EXCESS, _COUNT, _OTHER, _FLAG, _SMALLEST = range(5, 13)
# Smallest and largest positions relative to the last position, in this and the previous window:
_LOW, _HIGH, _LAST_LOW, _LAST_HIGH, _AGE, _ANY_STEP = range(13, 19)
# Room for the next step; see `has_jumped`:
_ROOM_ABOVE, _ROOM_BELOW = range(19, 21)
_ROWS = 21


def make_tracks(n: int, robot: RobotModel | None = None) -> Floats:
    """
    Make the tracks of n joints, an array of shape (21, n).

    Each column contains the constants and the history of a joint. The speed limits are those of
    ``robot``. Without ``robot``, all joints are assumed to be revolute.

    """
    tracks = np.zeros((_ROWS, n))
    is_prismatic, limits = np.zeros(n, dtype=bool), np.full(n, math.inf)
    if robot is not None:
        is_prismatic, limits = robot.is_prismatic_joint, robot.velocity_limits
        tracks[_IS_PRISMATIC], tracks[_IS_CONTINUOUS] = is_prismatic, robot.is_continuous
    slowest, usual, fastest = np.where(is_prismatic, *np.array(_SPEEDS)[::-1, :, None])
    tracks[_SPEED] = np.clip(np.where(np.isfinite(limits), limits, usual), slowest, fastest)
    tracks[_IGNORED] = np.where(is_prismatic, _NOISE[1], _NOISE[0])
    tracks[_COARSE] = np.where(is_prismatic, _COARSEST[1], _COARSEST[0])
    tracks[_SMALLEST] = math.inf
    return tracks


def alternating(tracks: Floats) -> dict[int, tuple[float, float]]:
    """Return the two positions between which each faulty joint alternates, by joint index."""
    return {
        int(i): (float(tracks[_OTHER, i]), float(tracks[_LAST, i]))
        for i in np.flatnonzero(tracks[_FLAG])
    }


def forget_silent(tracks: Floats, ages: Floats) -> None:
    """End the alarms of joints that are no longer reported; ``ages`` has shape (n,) [s]."""
    is_over = tracks[_EXCESS] <= _FACTOR * tracks[_SPEED] * ages
    tracks[_FLAG, is_over] = tracks[_COUNT, is_over] = tracks[_EXCESS, is_over] = 0.0


@compiled
def track(tracks: Any, i: int, position: float, elapsed: float) -> bool:
    """
    Follow the positions of one joint; return whether the positions alternate.

    ``tracks`` comes from `make_tracks`, and ``i`` is the index of the joint. ``position`` is the
    reported position [rad or m]. ``elapsed`` is the time since the previous report of this joint
    [s], or negative for the first report.

    The result stays true until the sum of the reversals has fallen to zero, at most 1 s after the
    last reversal.

    """
    raw = min(max(position - tracks[_LAST, i], -_LARGEST), _LARGEST)
    other, tracks[_LAST, i] = tracks[_LAST, i], position
    if elapsed < 0.0:
        tracks[_STEP, i] = 0.0
        return bool(tracks[_FLAG, i] != 0.0)
    step = raw
    if tracks[_IS_PRISMATIC, i] == 0.0:
        # Positions of revolute joints with limits may also wrap.
        step = raw - 2.0 * math.pi * np.rint(raw / (2.0 * math.pi))
    ignored = max(ignored_step(tracks, i, step), _RELAYED * way(tracks, i, step, elapsed))
    speed = tracks[_SPEED, i]
    excess = tracks[_EXCESS, i] - _FACTOR * speed * elapsed
    if excess <= 0.0:
        excess = tracks[_COUNT, i] = tracks[_FLAG, i] = 0.0
    if abs(step) > ignored:
        # A wheel seems to reverse if it makes half a turn between two reports.
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


@compiled
def ignored_step(tracks: Any, i: int, step: float) -> float:
    """Return the largest step [rad or m] that noise or the encoder resolution can explain."""
    # Include the sum of two steps, because every second position may come from the same publisher.
    for change in (step, step + tracks[_ANY_STEP, i]):
        if abs(change) > _LEAST_STEP:
            tracks[_SMALLEST, i] = min(tracks[_SMALLEST, i], abs(change))
    tracks[_ANY_STEP, i] = step
    resolution = min(_COUNTS * tracks[_SMALLEST, i], tracks[_COARSE, i])
    return float(max(resolution, tracks[_IGNORED, i]))


@compiled
def way(tracks: Any, i: int, step: float, elapsed: float) -> float:
    """Return the range of the recently reported positions [rad or m]."""
    tracks[_AGE, i] += elapsed
    if tracks[_AGE, i] > _WINDOW:
        is_recent = tracks[_AGE, i] <= 2.0 * _WINDOW
        tracks[_LAST_LOW, i] = tracks[_LOW, i] if is_recent else 0.0
        tracks[_LAST_HIGH, i] = tracks[_HIGH, i] if is_recent else 0.0
        tracks[_LOW, i] = tracks[_HIGH, i] = tracks[_AGE, i] = 0.0
    tracks[_LOW, i] = min(tracks[_LOW, i] - step, 0.0)
    tracks[_HIGH, i] = max(tracks[_HIGH, i] - step, 0.0)
    tracks[_LAST_LOW, i] -= step
    tracks[_LAST_HIGH, i] -= step
    lowest = min(tracks[_LOW, i], tracks[_LAST_LOW, i])
    highest = max(tracks[_HIGH, i], tracks[_LAST_HIGH, i])
    return float(highest - lowest)


@compiled
def has_jumped(tracks: Any, i: int, position: float, elapsed: float) -> bool:
    """
    Return whether a joint has apparently moved faster than it can; call this before `track`.

    ``tracks`` comes from `make_tracks`, and ``i`` is the index of the joint. ``position`` is the
    reported position [rad or m]. ``elapsed`` is the time since the previous report of this joint
    [s]. This time is inf for the first report, and negative if the clock was set back.

    """
    speed = _FACTOR * tracks[_SPEED, i]
    most = speed * _DELAY
    if elapsed == math.inf:
        tracks[_ROOM_ABOVE, i] = tracks[_ROOM_BELOW, i] = most
        return False
    step = min(max(position - tracks[_LAST, i], -_LARGEST), _LARGEST)
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
