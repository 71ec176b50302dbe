"""
The two passes of Luh, Walker and Paul for many states at once; the equations are in `equations`.

A block of states is computed together, each state in a lane: see `lanes`. Every step is a loop
over the lanes of a block. Compiled, the compiler turns every loop into vector instructions. This
requires that a step is a function of its own, and that rows of each kind are an array of their
own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from ..robot.model import Floats
from .columns import (
    ARMATURE,
    COULOMB,
    DAMPING,
    INVERSE_WIDTH,
    JOINT,
    LOAD_FRICTION,
    MULTIPLIER,
    OFFSET,
    OMEGA,
    PARENT,
    POSITION_OFFSET,
    rotation,
    SLIDES,
    vector,
)
from .equations import (
    add,
    angular_acceleration,
    angular_velocity,
    child_force,
    child_moment,
    joint_effort,
    origin_in_parent,
    point_acceleration,
    sliding_acceleration,
    to_link,
    to_parent,
)
from .jit import compile_for, IS_COMPILED, simd_kernel, simd_step
from .lanes import BLOCK, CACHE_LINE, holds_nan, lane, LANES, store_lane, transpose
from .newton_euler import NOT_FINITE, OK, own_wrench
from .trigonometry import cosine_and_sine, LARGEST_ANGLE

LEAST_PIECE = 1024  # states from which on another thread saves time

_NO_ROTATIONS = np.empty((0, 9))
_SIGNATURE = f'({"f8[:,:], " * 5}f8[:,::1], f8[:,::1], UniTuple(f8[:,::1], 8))'


def inverse_dynamics_many(states: Sequence[Floats], robot: Floats, threads: int = 1) -> int:
    """
    Compute the joint efforts of many states; see `newton_euler.inverse_dynamics`.

    Parameters
    ----------
    states : q, qd, qdd and tau, each an ndarray of shape (N, n)
        N is at least `lanes.FEWEST`, and tau does not share memory with the others.
    robot : ndarray
        Table from `robot_table`; read only.
    threads : int
        Maximum number of threads. The results do not depend on it.

    Returns
    -------
    status : int
        `OK` or `NOT_FINITE`.

    """
    N = len(states[0])
    states = (*states, np.empty((N, 0)))
    pieces = min(4 * threads, N // LEAST_PIECE)
    others = min(threads, pieces) - 1
    if others < 1:
        return _piece(states, _NO_ROTATIONS, robot)
    bounds = [N * k // pieces for k in range(pieces + 1)]
    work = deque([v[first:last] for v in states] for first, last in pairwise(bounds))
    shares = [_pool(others).submit(_share, work, robot) for _ in range(others)]
    status = _share(work, robot)
    # A thread that has not started by now has nothing left to do.
    return max(status, *(OK if share.cancel() else share.result() for share in shares))


def joint_wrenches_many(
    states: Sequence[Floats], wrenches: Floats, R_LZ: Floats, robot: Floats
) -> int:
    """
    Compute the force and moment on every body; see `joint_wrenches.joint_wrenches`.

    Parameters
    ----------
    states, robot
        As for `inverse_dynamics_many`.
    wrenches : ndarray, shape (N, b, 6)
        Receives force and moment.
    R_LZ : ndarray, shape (b, 9)
        Rotations into the frames of the wrenches, from the frames of the table.

    Returns
    -------
    status : int
        `OK` or `NOT_FINITE`.

    """
    return _piece((*states, wrenches.reshape(len(wrenches), -1)), R_LZ, robot)


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    """Keep the threads for the next batch; starting one can take longer than a batch."""
    return ThreadPoolExecutor(size, 'inverse_dynamics')


def _share(work: deque[list[Floats]], robot: Floats) -> int:
    """Compute pieces of the work until none is left."""
    status = OK
    while True:
        try:
            states = work.popleft()
        except IndexError:
            return status
        status = max(status, _piece(states, _NO_ROTATIONS, robot))


def _piece(states: Sequence[Floats], R_LZ: Floats, robot: Floats) -> int:
    """Compute one piece in newly allocated rows."""
    compile_for(_blocks, _SIGNATURE)
    q, qd, qdd, tau, wrenches = (values.T for values in states)
    n, b = len(q), len(robot)
    shapes = ((b, 3), (b, 9), (b, 6), (n, 1), (n, 1), (n, 1), (n, 1), (1, 1))
    kind = np.float64 if IS_COMPILED else np.object_
    rows = tuple([np.empty((i, j * LANES), kind) for i, j in shapes])
    if IS_COMPILED:
        return int(_blocks(q, qd, qdd, tau, wrenches, R_LZ, robot, rows))
    q, qd, qdd = (np.ascontiguousarray(values)[:, None] for values in (q, qd, qdd))
    with np.errstate(over='ignore', invalid='ignore'):
        return int(_blocks(q, qd, qdd, tau[:, None], wrenches[:, None], R_LZ, robot, rows))


@simd_kernel
def _blocks(
    all_q: Any,
    all_qd: Any,
    all_qdd: Any,
    all_tau: Any,
    all_wrenches: Any,
    R_LZ: Any,
    robot: Any,
    rows: Any,
) -> int:
    """Compute block after block; the states are columns here. Wrenches only if R_LZ has rows."""
    place, motion, wrench, q, qd, qdd, tau, residue = rows
    size = min(BLOCK, all_q.shape[-1])
    last = all_q.shape[-1] - size
    hold_base(robot, motion)
    residue[:] = 0.0
    for start in range(0, last + size, size):
        # The last block overlaps the one before, so that every block is full.
        first = min(start, last)
        block = slice(first, first + size)
        transpose(all_q[..., block], q)
        transpose(all_qd[..., block], qd)
        transpose(all_qdd[..., block], qdd)
        outward_pass(q, qd, qdd, robot, place, motion, wrench)
        if len(R_LZ) > 0:
            own_wrenches(robot, 0, motion, wrench)
        inward_pass(tau, robot, place, wrench, len(R_LZ) > 0)
        finish(qd, qdd, tau, robot, residue)
        transpose(tau, all_tau[..., block])
        if len(R_LZ) > 0:
            rotate_wrenches(R_LZ, wrench)
            transpose_wrenches(wrench, all_wrenches[..., block])
    for k in range(LANES):
        if holds_nan(residue[0, k]):
            return NOT_FINITE
    return OK


@simd_step
def hold_base(robot: Any, motion: Any) -> None:
    """Copy the motion of the base from the table into every lane."""
    for j in range(9):
        for k in range(LANES):
            motion[0, j * LANES + k] = robot[0, OMEGA + j]


@simd_step
def rotate_wrenches(R_LZ: Any, wrench: Any) -> None:
    """Rotate force and moment on every body."""
    for i in range(len(wrench)):
        R = rotation(R_LZ[i])
        for k in range(LANES):
            force, moment = lane(wrench, i, 0, k), lane(wrench, i, 3, k)
            store_lane(wrench, i, 0, k, to_parent(R, 1.0, 0.0, force))
            store_lane(wrench, i, 3, k, to_parent(R, 1.0, 0.0, moment))


@simd_step
def transpose_wrenches(wrench: Any, target: Any) -> None:
    """Copy forces and moments; see `transpose`."""
    for first in range(0, LANES, CACHE_LINE):
        for i in range(len(wrench)):
            for j in range(6):
                for k in range(first, min(first + CACHE_LINE, LANES)):
                    target[6 * i + j, k] = wrench[i, j * LANES + k]


@simd_step
def outward_pass(
    q: Any, qd: Any, qdd: Any, robot: Any, place: Any, motion: Any, wrench: Any
) -> None:
    """Propagate the motion from base to tips, and compute each link's own force and moment."""
    for i in range(1, len(robot)):
        parent, joint = int(robot[i, PARENT]), int(robot[i, JOINT])
        place_link(q, robot, i, joint, place)
        # The motion is passed twice, so that the rows of link and parent look like two arrays to
        # the compiler. It does not vectorise a loop that reads and writes the same array.
        outward_step(qd, qdd, robot, i, joint, place, motion, parent, motion)
        own_wrenches(robot, i, motion, wrench)


@simd_step
def inward_pass(tau: Any, robot: Any, place: Any, wrench: Any, to_base: bool) -> None:
    """Propagate forces and moments from tips to base, and project them onto the joint axes."""
    for joint in range(len(tau)):
        for k in range(LANES):
            tau[joint, k] = 0.0
    for i in range(len(robot) - 1, 0, -1):
        parent, joint = int(robot[i, PARENT]), int(robot[i, JOINT])
        project(tau, robot, i, joint, wrench)
        if parent > 0 or to_base:
            inward_step(robot, i, place, wrench, parent, wrench)


@simd_step
def place_link(q: Any, robot: Any, i: int, joint: int, place: Any) -> None:
    """Compute how far a link has turned and slid: cosine, sine, length."""
    multiplier, offset = robot[i, MULTIPLIER], robot[i, POSITION_OFFSET]
    if robot[i, SLIDES] != 0.0:
        for k in range(LANES):
            place[i, k] = 1.0
            place[i, LANES + k] = 0.0
            place[i, 2 * LANES + k] = multiplier * q[joint, k] + offset
        return
    far = False
    for k in range(LANES):
        angle = multiplier * q[joint, k] + offset
        place[i, k], place[i, LANES + k] = cosine_and_sine(angle)
        place[i, 2 * LANES + k] = 0.0
        if IS_COMPILED:
            far |= not abs(angle) <= LARGEST_ANGLE
    if far:
        for k in range(LANES):
            angle = multiplier * q[joint, k] + offset
            if not abs(angle) <= LARGEST_ANGLE:
                place[i, k], place[i, LANES + k] = np.cos(angle), np.sin(angle)


@simd_step
def outward_step(
    qd: Any,
    qdd: Any,
    robot: Any,
    i: int,
    joint: int,
    place: Any,
    parents: Any,
    parent: int,
    motion: Any,
) -> None:
    """Compute the motion of a link from its parent's."""
    R, offset = rotation(robot[i]), vector(robot[i], OFFSET)
    slides = robot[i, SLIDES] * robot[i, MULTIPLIER]
    turns = robot[i, MULTIPLIER] - slides
    for k in range(LANES):
        c, s, length = lane(place, i, 0, k)
        p = origin_in_parent(R, offset, length)
        omega_P, omega_dot_P = lane(parents, parent, 0, k), lane(parents, parent, 3, k)
        accel = point_acceleration(p, omega_P, omega_dot_P, lane(parents, parent, 6, k))
        omega_P, omega_dot_P = to_link(R, c, s, omega_P), to_link(R, c, s, omega_dot_P)
        turn, turn_dot = turns * qd[joint, k], turns * qdd[joint, k]
        slide, slide_dot = slides * qd[joint, k], slides * qdd[joint, k]
        omega = angular_velocity(omega_P, turn)
        omega_dot = angular_acceleration(omega_P, omega_dot_P, turn, turn_dot)
        accel = sliding_acceleration(to_link(R, c, s, accel), omega, slide, slide_dot)
        store_lane(motion, i, 0, k, omega)
        store_lane(motion, i, 3, k, omega_dot)
        store_lane(motion, i, 6, k, accel)


@simd_step
def own_wrenches(robot: Any, i: int, motion: Any, wrench: Any) -> None:
    """Compute the force and moment that a link's own motion requires, less its external load."""
    link = robot[i]
    for k in range(LANES):
        omega, omega_dot, accel = (
            lane(motion, i, 0, k),
            lane(motion, i, 3, k),
            lane(motion, i, 6, k),
        )
        force, moment = own_wrench(link, omega, omega_dot, accel)
        store_lane(wrench, i, 0, k, force)
        store_lane(wrench, i, 3, k, moment)


@simd_step
def inward_step(robot: Any, i: int, place: Any, wrench: Any, parent: int, parents: Any) -> None:
    """Add the link's force (45) and moment (46) to its parent's, in the parent's frame."""
    R, offset = rotation(robot[i]), vector(robot[i], OFFSET)
    for k in range(LANES):
        c, s, length = lane(place, i, 0, k)
        p = origin_in_parent(R, offset, length)
        force = child_force(R, c, s, lane(wrench, i, 0, k))
        moment = child_moment(R, c, s, p, force, lane(wrench, i, 3, k))
        store_lane(parents, parent, 0, k, add(lane(parents, parent, 0, k), force))
        store_lane(parents, parent, 3, k, add(lane(parents, parent, 3, k), moment))


@simd_step
def project(tau: Any, robot: Any, i: int, joint: int, wrench: Any) -> None:
    """Add a link's contribution to the effort of its joint, (47)."""
    multiplier, slides = robot[i, MULTIPLIER], robot[i, SLIDES]
    for k in range(LANES):
        effort = joint_effort(lane(wrench, i, 0, k), lane(wrench, i, 3, k), slides)
        tau[joint, k] = tau[joint, k] + multiplier * effort


@simd_step
def finish(qd: Any, qdd: Any, tau: Any, robot: Any, residue: Any) -> None:
    """Add the terms of a single joint: rotor inertia and friction; check."""
    for joint in range(len(tau)):
        armature, damping = robot[joint + 1, ARMATURE], robot[joint + 1, DAMPING]
        coulomb, inverse_width = robot[joint + 1, COULOMB], robot[joint + 1, INVERSE_WIDTH]
        load_friction = robot[joint + 1, LOAD_FRICTION]
        if coulomb != 0.0 or load_friction != 0.0:
            for k in range(LANES):
                # So far, tau contains the efforts that load the gears.
                bound = coulomb + load_friction * abs(tau[joint, k])
                friction = bound * np.tanh(inverse_width * qd[joint, k])
                tau[joint, k] = tau[joint, k] + friction
        for k in range(LANES):
            effort = tau[joint, k] + armature * qdd[joint, k] + damping * qd[joint, k]
            tau[joint, k] = effort
            # The difference is 0 only for finite numbers, and a NaN stays a NaN.
            residue[0, k] = residue[0, k] + (effort - effort)
