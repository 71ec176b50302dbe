"""Compiled functions for the arrays of `JointStateCollector`."""

from __future__ import annotations

import math
from typing import Any

from ..dynamics.jit import compile_for, compiled
from .position_jumps import has_jumped
from .publisher_conflicts import ignored_step, track, way

LONG_AGO = -1e300
"""Time stored for a locked joint until its first report [s]; finite, so that its age is finite."""
# Rows of the known state, one column per joint of the robot.
POSITION, VELOCITY, TIME, EFFORT = range(4)
# Rows of a message, one column per joint in the message.
_POSITION, _VELOCITY, _EFFORT = range(3)
# Results of `store_joint_state`: `NOT_FINITE`, or `CONSISTENT` plus any other flags.
NOT_FINITE, CONSISTENT, ALTERNATING, JUMPED, LEAPT = 0, 1, 2, 4, 8


def compile_kernels() -> None:
    """Compile all functions for joint states before the control loop starts."""
    compile_for(find_oldest, 'UniTuple(f8, 2)(f8[::1], b1[::1])')
    compile_for(ignored_step, 'f8(f8[:,::1], i8, f8)')
    compile_for(way, 'f8(f8[:,::1], i8, f8, f8)')
    compile_for(track, 'b1(f8[:,::1], i8, f8, f8)')
    compile_for(has_jumped, 'b1(f8[:,::1], i8, f8, f8)')
    compile_for(
        store_joint_state, 'i8(f8[:,::1], i8[:,::1], f8[:,::1], f8[:,::1], b1[::1], f8, b1)'
    )


@compiled
def find_oldest(times: Any, is_commanded: Any) -> tuple[float, float]:
    """
    Return the oldest arrival among the commanded joints, and among the other joints [s].

    ``times`` contains the arrival time of each joint's state, shape (n,). Locked joints that were
    never reported are ignored. The result for a group without joints is inf.

    """
    commanded = others = math.inf
    for i in range(len(times)):
        if is_commanded[i]:
            commanded = min(commanded, times[i])
        elif times[i] != LONG_AGO:
            others = min(others, times[i])
    return commanded, others


@compiled
def store_joint_state(
    received: Any,
    places: Any,
    known: Any,
    tracks: Any,
    is_commanded: Any,
    now: float,
    has_efforts: bool,
) -> int:
    """
    Store the joint states of a message if all are finite; otherwise change nothing.

    - ``received`` contains positions, velocities and efforts of the l joints of a message, shape
      (3, l).
    - ``places`` contains the indices of the k joints to store, shape (2, k): first among the n
      joints of the robot, then among the l joints of the message.
    - ``known`` receives positions, velocities, times and efforts, shape (4, n). A joint that is
      not commanded keeps its position and zero velocity while its positions alternate.
    - ``tracks`` comes from `publisher_conflicts.make_tracks`.
    - ``now`` is the time [s].

    The result is `NOT_FINITE` if a position or velocity is not finite. Otherwise it is
    `CONSISTENT` plus the following flags:

    - `ALTERNATING`: the positions of a joint alternate faster than it can move.
    - `JUMPED`: a joint whose position is stored has moved further than it can.
    - `LEAPT`: the joint that has moved too far is commanded.

    """
    in_robot, in_message = places[0], places[1]
    for k in range(len(in_robot)):
        j = in_message[k]
        if not (math.isfinite(received[_POSITION, j]) and math.isfinite(received[_VELOCITY, j])):
            return NOT_FINITE
    result = CONSISTENT
    for k in range(len(in_robot)):
        i, j = in_robot[k], in_message[k]
        is_known = known[TIME, i] > LONG_AGO
        elapsed = now - known[TIME, i] if is_known else math.inf
        is_jump = has_jumped(tracks, i, received[_POSITION, j], elapsed)
        elapsed = max(0.0, elapsed) if is_known else -1.0
        is_alternating = track(tracks, i, received[_POSITION, j], elapsed)
        if is_alternating:
            result |= ALTERNATING
        if is_alternating and not is_commanded[i]:
            known[VELOCITY, i] = 0.0
        else:
            if is_jump:
                result |= JUMPED | LEAPT if is_commanded[i] else JUMPED
            known[POSITION, i] = received[_POSITION, j]
            known[VELOCITY, i] = received[_VELOCITY, j]
        known[TIME, i] = now
        if has_efforts:
            known[EFFORT, i] = received[_EFFORT, j]
    return result
