"""The mass matrices of many states at once: `mass_matrix` on blocks of `lanes`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..robot.model import Floats
from .batch import place_link
from .batch_base_axes import (
    arranged,
    count_pairs,
    FRAME,
    frame_step,
    hold_base_frame,
    lane_axes,
    lane_axis,
    lane_origin,
    matrices_of,
)
from .columns import ARMATURE, JOINT, MULTIPLIER, PARENT, SLIDES
from .equations import subtract
from .jit import (
    compile_for,
    IS_COMPILED,
    simd_inline,
    simd_kernel,
    simd_step,
)
from .lanes import BLOCK, CACHE_LINE, holds_nan, lane, LANES, store_lane, transpose
from .mass_matrix import (
    along,
    combined,
    Composite,
    composite_of_link,
    effort_at,
    in_base_axes,
    shifted,
    unit_wrench,
)
from .newton_euler import NOT_FINITE, OK

_SIGNATURE = '(f8[:,:], f8[:,:,::1], f8[:,::1], UniTuple(f8[:,::1], 7))'


def mass_matrix_many(q: Floats, matrices: Floats, robot: Floats) -> int:
    """
    Compute the mass matrices of many states; see `mass_matrix.mass_matrix`.

    Parameters
    ----------
    q : ndarray, shape (N, n)
        Joint positions [rad or m]; N is at least `lanes.FEWEST`.
    matrices : ndarray, shape (N, n, n)
        Receives the mass matrices.
    robot : ndarray
        Table from `robot_table`; read only.

    Returns
    -------
    status : int
        `OK` or `NOT_FINITE`.

    """
    compile_for(_blocks, _SIGNATURE)
    n, b = q.shape[1], len(robot)
    pairs = (count_pairs(robot), 1)
    shapes = ((b, 3), (b, FRAME), (b, 10), (1, 6), pairs, (n, 1), (1, 1))
    kind = np.float64 if IS_COMPILED else np.object_
    rows = tuple([np.empty((i, j * LANES), kind) for i, j in shapes])
    columns = q.T if IS_COMPILED else np.ascontiguousarray(q.T)[:, None]
    with np.errstate(over='ignore', invalid='ignore'):
        return int(_blocks(columns, arranged(matrices), robot, rows))


@simd_kernel
def _blocks(all_q: Any, all_matrices: Any, robot: Any, rows: Any) -> int:
    """Compute block after block; the states are columns here."""
    place, frames, bodies, wrench, entries, q, residue = rows
    size = min(BLOCK, all_q.shape[-1])
    last = all_q.shape[-1] - size
    hold_base_frame(frames)
    residue[:] = 0.0
    for start in range(0, last + size, size):
        # The last block overlaps the one before, so that every block is full.
        first = min(start, last)
        block = slice(first, first + size)
        transpose(all_q[..., block], q)
        check(q, residue)
        for i in range(1, len(robot)):
            parent = int(robot[i, PARENT])
            place_link(q, robot, i, int(robot[i, JOINT]), place)
            frame_step(robot, i, place, frames, parent, frames)
            begin_body(robot, i, frames, bodies)
        pair = 0
        for i in range(len(robot) - 1, 0, -1):
            mover = int(robot[i, PARENT])
            if mover > 0:
                combine(i, frames, bodies, mover, bodies)
            begin_wrench(robot, i, frames, bodies, wrench, entries, pair, residue)
            pair += 1
            while mover > 0:
                compute_entry(robot, i, mover, frames, wrench, entries, pair)
                mover = int(robot[mover, PARENT])
                pair += 1
        store_entries(robot, entries, matrices_of(block, all_matrices))
    for k in range(LANES):
        if holds_nan(residue[0, k]):
            return NOT_FINITE
    return OK


@simd_step
def check(q: Any, residue: Any) -> None:
    """Note positions that are not finite."""
    for joint in range(len(q)):
        for k in range(LANES):
            # The difference is 0 only for finite numbers, and a NaN stays a NaN.
            residue[0, k] = residue[0, k] + (q[joint, k] - q[joint, k])


@simd_step
def begin_body(robot: Any, i: int, frames: Any, bodies: Any) -> None:
    """Set a composite body to the link alone."""
    body = composite_of_link(robot[i])
    for k in range(LANES):
        store_body(bodies, i, k, in_base_axes(lane_axes(frames, i, k), body))


@simd_step
def combine(i: int, frames: Any, bodies: Any, parent: int, parents: Any) -> None:
    """Add the composite body of a link to its parent's."""
    for k in range(LANES):
        p = subtract(lane_origin(frames, i, k), lane_origin(frames, parent, k))
        moved = shifted(p, lane_body(bodies, i, k))
        store_body(parents, parent, k, combined(lane_body(parents, parent, k), moved))


@simd_step
def begin_wrench(
    robot: Any,
    i: int,
    frames: Any,
    bodies: Any,
    wrench: Any,
    entries: Any,
    pair: int,
    residue: Any,
) -> None:
    """Compute force, moment and effort for a unit acceleration of the joint of a link."""
    multiplier, slides = robot[i, MULTIPLIER] * robot[i, MULTIPLIER], robot[i, SLIDES]
    for k in range(LANES):
        axis = lane_axis(frames, i, k)
        force, moment = unit_wrench(lane_body(bodies, i, k), axis, slides)
        store_lane(wrench, 0, 0, k, force)
        store_lane(wrench, 0, 3, k, moment)
        effort = multiplier * along(axis, slides, force, moment)
        entries[pair, k] = effort
        # It is enough to check the diagonal, see `mass_matrix.check_diagonal`.
        residue[0, k] = residue[0, k] + (effort - effort)


@simd_step
def compute_entry(
    robot: Any, i: int, j: int, frames: Any, wrench: Any, entries: Any, pair: int
) -> None:
    """Compute the effort of link j's joint for the acceleration of link i's."""
    multiplier, slides = robot[i, MULTIPLIER] * robot[j, MULTIPLIER], robot[j, SLIDES]
    for k in range(LANES):
        arm = subtract(lane_origin(frames, i, k), lane_origin(frames, j, k))
        force, moment = lane(wrench, 0, 0, k), lane(wrench, 0, 3, k)
        effort = effort_at(arm, lane_axis(frames, j, k), slides, force, moment)
        entries[pair, k] = multiplier * effort


@simd_step
def store_entries(robot: Any, entries: Any, matrices: Any) -> None:
    """Write the matrices, a few states at a time, so that they stay in the processor's cache."""
    n = matrices.shape[1]
    for first in range(0, LANES, CACHE_LINE):
        last = min(first + CACHE_LINE, LANES)
        for k in range(first, last):
            for row in range(n):
                for column in range(n):
                    matrices[k, row, column] = 0.0
            for joint in range(n):
                matrices[k, joint, joint] = robot[joint + 1, ARMATURE]
        pair = 0
        for i in range(len(robot) - 1, 0, -1):
            a, mover = int(robot[i, JOINT]), i
            while mover > 0:
                b = int(robot[mover, JOINT])
                for k in range(first, last):
                    matrices[k, a, b] = matrices[k, a, b] + entries[pair, k]
                    if mover != i:
                        matrices[k, b, a] = matrices[k, b, a] + entries[pair, k]
                mover = int(robot[mover, PARENT])
                pair += 1


@simd_inline
def lane_body(bodies: Any, i: int, k: int) -> Composite:
    """Read a composite body from its rows."""
    J, K = lane(bodies, i, 4, k), lane(bodies, i, 7, k)
    return bodies[i, k], lane(bodies, i, 1, k), (J[0], J[1], J[2], K[0], K[1], K[2])


@simd_inline
def store_body(bodies: Any, i: int, k: int, body: Composite) -> None:
    """Write a composite body into its rows."""
    mass, first, J = body
    bodies[i, k] = mass
    store_lane(bodies, i, 1, k, first)
    store_lane(bodies, i, 4, k, (J[0], J[1], J[2]))
    store_lane(bodies, i, 7, k, (J[3], J[4], J[5]))
