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
from .columns import (
    ARMATURE,
    JOINT,
    MULTIPLIER,
    OFFSET,
    PARENT,
    rotation,
    SLIDES,
    vector,
)
from .equations import (
    child_force,
    child_moment,
    joint_effort,
    origin_in_parent,
)
from .jit import (
    compile_for,
    IS_COMPILED,
    simd_inline,
    simd_kernel,
    simd_step,
)
from .mass_matrix import (
    combined,
    Composite,
    composite_in_parent,
    composite_of_link,
    unit_wrench,
)
from .newton_euler import NOT_FINITE, OK

_SIGNATURE = '(f8[:,:], f8[:,:], f8[:,::1], UniTuple(f8[:,::1], 6))'


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
    shapes = ((b, 3), (b, 10), (2, 6), (n, 1), (n * n, 1), (1, 1))
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
    place, bodies, wrench, q, matrix, residue = rows
    size = min(BLOCK, all_q.shape[-1])
    last = all_q.shape[-1] - size
    residue[:] = 0.0
    for start in range(0, last + size, size):
        # The last block overlaps the one before, so that every block is full.
        first = min(start, last)
        block = slice(first, first + size)
        transpose(all_q[..., block], q)
        begin(q, robot, matrix, residue)
        for i in range(1, len(robot)):
            place_link(q, robot, i, int(robot[i, JOINT]), place)
            begin_body(robot, i, bodies)
        for i in range(len(robot) - 1, 0, -1):
            begin_wrench(robot, i, bodies, wrench)
            add_entry(robot, i, i, wrench, 0, matrix, len(q))
            link, side = i, 0
            parent = int(robot[i, PARENT])
            if parent > 0:
                combine(robot, i, place, bodies, parent, bodies)
            while parent > 0:
                move_wrench(robot, link, place, wrench, side, wrench)
                link, side = parent, 1 - side
                add_entry(robot, i, link, wrench, side, matrix, len(q))
                parent = int(robot[link, PARENT])
        check(matrix, residue)
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
def begin_body(robot: Any, i: int, bodies: Any) -> None:
    """Set a composite body to the link alone."""
    body = composite_of_link(robot[i])
    for k in range(LANES):
        store_body(bodies, i, k, body)


@simd_step
def begin_wrench(robot: Any, i: int, bodies: Any, wrench: Any) -> None:
    """Compute the force and moment for a unit acceleration of the joint of a link."""
    slides = robot[i, SLIDES]
    for k in range(LANES):
        force, moment = unit_wrench(lane_body(bodies, i, k), slides)
        store_lane(wrench, 0, 0, k, force)
        store_lane(wrench, 0, 3, k, moment)


@simd_step
def combine(robot: Any, i: int, place: Any, bodies: Any, parent: int, parents: Any) -> None:
    """Add the composite body of a link to its parent's."""
    R, offset = rotation(robot[i]), vector(robot[i], OFFSET)
    for k in range(LANES):
        c, s, length = lane(place, i, 0, k)
        p = origin_in_parent(R, offset, length)
        moved = composite_in_parent(R, c, s, p, lane_body(bodies, i, k))
        store_body(parents, parent, k, combined(lane_body(parents, parent, k), moved))


@simd_step
def move_wrench(robot: Any, i: int, place: Any, wrench: Any, side: int, moved: Any) -> None:
    """Express a force and moment in the frame of the parent; the result is on the other side."""
    R, offset = rotation(robot[i]), vector(robot[i], OFFSET)
    for k in range(LANES):
        c, s, length = lane(place, i, 0, k)
        p = origin_in_parent(R, offset, length)
        force = child_force(R, c, s, lane(wrench, side, 0, k))
        moment = child_moment(R, c, s, p, force, lane(wrench, side, 3, k))
        store_lane(moved, 1 - side, 0, k, force)
        store_lane(moved, 1 - side, 3, k, moment)


@simd_step
def add_entry(robot: Any, i: int, j: int, wrench: Any, side: int, matrix: Any, n: int) -> None:
    """Add the effort of link j's joint for the acceleration of link i's to the matrix."""
    a, b = int(robot[i, JOINT]), int(robot[j, JOINT])
    multiplier, slides = robot[i, MULTIPLIER] * robot[j, MULTIPLIER], robot[j, SLIDES]
    for k in range(LANES):
        force, moment = lane(wrench, side, 0, k), lane(wrench, side, 3, k)
        entry = multiplier * joint_effort(force, moment, slides)
        matrix[a * n + b, k] = matrix[a * n + b, k] + entry
    if i != j:
        for k in range(LANES):
            force, moment = lane(wrench, side, 0, k), lane(wrench, side, 3, k)
            entry = multiplier * joint_effort(force, moment, slides)
            matrix[b * n + a, k] = matrix[b * n + a, k] + entry


@simd_step
def check(matrix: Any, residue: Any) -> None:
    """Note entries that are not finite."""
    for entry in range(len(matrix)):
        for k in range(LANES):
            # The difference is 0 only for finite numbers, and a NaN stays a NaN.
            residue[0, k] = residue[0, k] + (matrix[entry, k] - matrix[entry, k])


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
