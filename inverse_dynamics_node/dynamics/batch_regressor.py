"""The regressors of many states at once: `regressor` on blocks of `lanes`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..robot.model import Floats
from .batch import hold_base, outward_step, place_link
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
    store_axes,
)
from .columns import JOINT, MULTIPLIER, PARENT, rotation, SLIDES
from .equations import subtract
from .jit import compile_for, IS_COMPILED, simd_kernel, simd_step
from .lanes import BLOCK, CACHE_LINE, holds_nan, lane, LANES, store_lane, transpose
from .newton_euler import NOT_FINITE, OK
from .regressor import block, in_frame_of_parameters, PARAMETERS, unit_twist

_SIGNATURE = f'({"f8[:,:], " * 3}f8[:,:,::1], f8[:,::1], f8[:,::1], UniTuple(f8[:,::1], 9))'


def regressor_many(states: Sequence[Floats], matrices: Floats, R_LZ: Floats, robot: Floats) -> int:
    """
    Compute the regressors of many states; see `regressor.regressor`.

    Parameters
    ----------
    states : q, qd and qdd, each an ndarray of shape (N, n)
        N is at least `lanes.FEWEST`.
    matrices : ndarray, shape (N, n, 10 (b - 1))
        Receives the regressors.
    R_LZ : ndarray, shape (b, 9)
        Rotations into the frames of the parameters, from the frames of the table.
    robot : ndarray
        Table from `robot_table`; read only.

    Returns
    -------
    status : int
        `OK` or `NOT_FINITE`.

    """
    compile_for(_blocks, _SIGNATURE)
    n, b = states[0].shape[1], len(robot)
    q, qd, qdd = (values.T for values in states)
    pairs = (count_pairs(robot), PARAMETERS)
    shapes = ((b, 3), (b, 9), (b, FRAME), (1, 18), pairs, (n, 1), (n, 1), (n, 1), (1, 1))
    kind = np.float64 if IS_COMPILED else np.object_
    rows = tuple([np.empty((i, j * LANES), kind) for i, j in shapes])
    if not IS_COMPILED:
        q, qd, qdd = (np.ascontiguousarray(values)[:, None] for values in (q, qd, qdd))
    with np.errstate(over='ignore', invalid='ignore'):
        return int(_blocks(q, qd, qdd, arranged(matrices), R_LZ, robot, rows))


@simd_kernel
def _blocks(
    all_q: Any, all_qd: Any, all_qdd: Any, all_matrices: Any, R_LZ: Any, robot: Any, rows: Any
) -> int:
    """Compute block after block; the states are columns here."""
    place, motion, frames, turned, factors, q, qd, qdd, residue = rows
    size = min(BLOCK, all_q.shape[-1])
    last = all_q.shape[-1] - size
    hold_base(robot, motion)
    hold_base_frame(frames)
    residue[:] = 0.0
    for start in range(0, last + size, size):
        # The last block overlaps the one before, so that every block is full.
        first = min(start, last)
        states = slice(first, first + size)
        transpose(all_q[..., states], q)
        transpose(all_qd[..., states], qd)
        transpose(all_qdd[..., states], qdd)
        pair = 0
        for i in range(1, len(robot)):
            parent, joint = int(robot[i, PARENT]), int(robot[i, JOINT])
            place_link(q, robot, i, joint, place)
            outward_step(qd, qdd, robot, i, joint, place, motion, parent, motion)
            frame_step(robot, i, place, frames, parent, frames)
            turn(R_LZ, i, motion, frames, turned)
            mover = i
            while mover > 0:
                compute_block(robot, i, mover, frames, turned, factors, pair, residue)
                mover = int(robot[mover, PARENT])
                pair += 1
        store_blocks(robot, factors, matrices_of(states, all_matrices))
    for k in range(LANES):
        if holds_nan(residue[0, k]):
            return NOT_FINITE
    return OK


@simd_step
def turn(R_LZ: Any, i: int, motion: Any, frames: Any, turned: Any) -> None:
    """Turn axes and motion of a link into the frame of its parameters."""
    R = rotation(R_LZ[i])
    for k in range(LANES):
        own = lane(motion, i, 0, k), lane(motion, i, 3, k), lane(motion, i, 6, k)
        axes, new = in_frame_of_parameters(R, lane_axes(frames, i, k), own)
        store_axes(turned, 0, k, axes)
        store_lane(turned, 0, 9, k, new[0])
        store_lane(turned, 0, 12, k, new[1])
        store_lane(turned, 0, 15, k, new[2])


@simd_step
def compute_block(
    robot: Any,
    i: int,
    mover: int,
    frames: Any,
    turned: Any,
    factors: Any,
    pair: int,
    residue: Any,
) -> None:
    """Compute the factors of the parameters of link i in the effort of the joint of a mover."""
    multiplier, slides = robot[mover, MULTIPLIER], robot[mover, SLIDES]
    for k in range(LANES):
        arm = subtract(lane_origin(frames, i, k), lane_origin(frames, mover, k))
        twist = unit_twist(lane_axes(turned, 0, k), lane_axis(frames, mover, k), arm, slides)
        motion = lane(turned, 0, 9, k), lane(turned, 0, 12, k), lane(turned, 0, 15, k)
        f = block(twist, motion)
        factors[pair, k] = multiplier * f[0]
        store_lane(factors, pair, 1, k, (multiplier * f[1], multiplier * f[2], multiplier * f[3]))
        store_lane(factors, pair, 4, k, (multiplier * f[4], multiplier * f[5], multiplier * f[6]))
        store_lane(factors, pair, 7, k, (multiplier * f[7], multiplier * f[8], multiplier * f[9]))
    for parameter in range(PARAMETERS):
        for k in range(LANES):
            # The difference is 0 only for finite numbers, and a NaN stays a NaN.
            factor = factors[pair, parameter * LANES + k]
            residue[0, k] = residue[0, k] + (factor - factor)


@simd_step
def store_blocks(robot: Any, factors: Any, matrices: Any) -> None:
    """Write the regressors, a few states at a time, so that they stay in the processor's cache."""
    for first in range(0, LANES, CACHE_LINE):
        last = min(first + CACHE_LINE, LANES)
        for k in range(first, last):
            for row in range(matrices.shape[1]):
                for column in range(matrices.shape[2]):
                    matrices[k, row, column] = 0.0
        pair = 0
        for i in range(1, len(robot)):
            mover = i
            while mover > 0:
                row, start = int(robot[mover, JOINT]), PARAMETERS * (i - 1)
                for k in range(first, last):
                    for j in range(PARAMETERS):
                        # The row of a mimic joint adds to its master's.
                        entry = matrices[k, row, start + j] + factors[pair, j * LANES + k]
                        matrices[k, row, start + j] = entry
                mover = int(robot[mover, PARENT])
                pair += 1
