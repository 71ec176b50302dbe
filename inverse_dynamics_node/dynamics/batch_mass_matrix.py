"""The mass matrices of many states at once: `mass_matrix` on blocks of `lanes`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..robot.model import Floats
from .batch import (
    BLOCK,
    holds_nan,
    lane,
    LANES,
    place_link,
    store_lane,
    transpose,
)
from .batch_base_axes import (
    FRAME,
    frame_step,
    hold_base_frame,
    lane_axes,
    lane_axis,
    lane_origin,
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

_SIGNATURE = '(f8[:,:], f8[:,:], f8[:,::1], UniTuple(f8[:,::1], 7))'


def mass_matrix_many(q: Floats, matrices: Floats, robot: Floats) -> int:
    """
    Compute the mass matrices of many states; see `mass_matrix.mass_matrix`.

    Parameters
    ----------
    q : ndarray, shape (N, n)
        Joint positions [rad or m]; N is at least `batch.FEWEST`.
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
    N, n = q.shape
    b = len(robot)
    columns, entries = q.T, matrices.reshape(N, n * n).T
    shapes = ((b, 3), (b, FRAME), (b, 10), (1, 6), (n, 1), (n * n, 1), (1, 1))
    kind = np.float64 if IS_COMPILED else np.object_
    rows = tuple([np.empty((i, j * LANES), kind) for i, j in shapes])
    if IS_COMPILED:
        return int(_blocks(columns, entries, robot, rows))
    with np.errstate(over='ignore', invalid='ignore'):
        columns = np.ascontiguousarray(columns)[:, None]
        return int(_blocks(columns, entries[:, None], robot, rows))


@simd_kernel
def _blocks(all_q: Any, all_matrices: Any, robot: Any, rows: Any) -> int:
    """Compute block after block; the states are columns here."""
    place, frames, bodies, wrench, q, matrix, residue = rows
    size = min(BLOCK, all_q.shape[-1])
    last = all_q.shape[-1] - size
    hold_base_frame(frames)
    residue[:] = 0.0
    for start in range(0, last + size, size):
        # The last block overlaps the one before, so that every block is full.
        first = min(start, last)
        block = slice(first, first + size)
        transpose(all_q[..., block], q)
        begin(q, robot, matrix, residue)
        for i in range(1, len(robot)):
            parent = int(robot[i, PARENT])
            place_link(q, robot, i, int(robot[i, JOINT]), place)
            frame_step(robot, i, place, frames, parent, frames)
            begin_body(robot, i, frames, bodies)
        for i in range(len(robot) - 1, 0, -1):
            mover = int(robot[i, PARENT])
            if mover > 0:
                combine(i, frames, bodies, mover, bodies)
            begin_wrench(robot, i, frames, bodies, wrench, matrix, len(q))
            while mover > 0:
                add_entry(robot, i, mover, frames, wrench, matrix, len(q))
                mover = int(robot[mover, PARENT])
        check(matrix, len(q), residue)
        transpose(matrix, all_matrices[..., block])
    for k in range(LANES):
        if holds_nan(residue[0, k]):
            return NOT_FINITE
    return OK


@simd_step
def begin(q: Any, robot: Any, matrix: Any, residue: Any) -> None:
    """Set the matrices to the armature, and note positions that are not finite."""
    n = len(q)
    for joint in range(len(matrix)):
        for k in range(LANES):
            matrix[joint, k] = 0.0
    for joint in range(n):
        armature = robot[joint + 1, ARMATURE]
        for k in range(LANES):
            matrix[joint * (n + 1), k] = armature
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
    robot: Any, i: int, frames: Any, bodies: Any, wrench: Any, matrix: Any, n: int
) -> None:
    """Compute the force and moment for a unit acceleration of the joint of a link."""
    entry, slides = int(robot[i, JOINT]) * (n + 1), robot[i, SLIDES]
    multiplier = robot[i, MULTIPLIER] * robot[i, MULTIPLIER]
    for k in range(LANES):
        axis = lane_axis(frames, i, k)
        force, moment = unit_wrench(lane_body(bodies, i, k), axis, slides)
        store_lane(wrench, 0, 0, k, force)
        store_lane(wrench, 0, 3, k, moment)
        effort = multiplier * along(axis, slides, force, moment)
        matrix[entry, k] = matrix[entry, k] + effort


@simd_step
def add_entry(robot: Any, i: int, j: int, frames: Any, wrench: Any, matrix: Any, n: int) -> None:
    """Add the effort of link j's joint for the acceleration of link i's to the matrix."""
    a, b = int(robot[i, JOINT]), int(robot[j, JOINT])
    multiplier, slides = robot[i, MULTIPLIER] * robot[j, MULTIPLIER], robot[j, SLIDES]
    for k in range(LANES):
        arm = subtract(lane_origin(frames, i, k), lane_origin(frames, j, k))
        force, moment = lane(wrench, 0, 0, k), lane(wrench, 0, 3, k)
        effort = multiplier * effort_at(arm, lane_axis(frames, j, k), slides, force, moment)
        matrix[a * n + b, k] = matrix[a * n + b, k] + effort
        matrix[b * n + a, k] = matrix[b * n + a, k] + effort


@simd_step
def check(matrix: Any, n: int, residue: Any) -> None:
    """Note entries that are not finite; see `mass_matrix.check_diagonal`."""
    for joint in range(n):
        for k in range(LANES):
            entry = matrix[joint * (n + 1), k]
            # The difference is 0 only for finite numbers, and a NaN stays a NaN.
            residue[0, k] = residue[0, k] + (entry - entry)


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
