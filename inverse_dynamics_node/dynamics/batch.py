"""
Efforts and regressors of many states at once.

States are processed in blocks. A block has `LANES` lanes, and each lane contains one state. Arrays
have one row per body or joint. Component j of row i in lane k is ``rows[i, j * LANES + k]``. The
compiler turns loops over the lanes into vector instructions, if every step is a separate function
and every quantity has its own array.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from ..robot.model import Floats
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
    subtract,
    to_link,
    Vector,
)
from .jit import compile_for, compiled, FAST_MATH, NOT_FINITE, OK, simd_inline, simd_step
from .link_kinematics import axes_in_base, in_base
from .newton_euler import joint_friction, own_wrench, spring_effort
from .regressor import block, in_frame_of_parameters, PARAMETERS, unit_twist
from .robot_table import (
    ARMATURE,
    COUPLING,
    coupling_of,
    frame_of,
    friction_of,
    JOINT,
    MULTIPLIER,
    OMEGA,
    PARENT,
    POSITION_OFFSET,
    rotation,
    SLIDES,
)

LANES = 64  # states in a block
CACHE_LINE = 8  # numbers in a cache line of the processor
LARGEST_ANGLE = 1e5  # largest angle for `cosine_and_sine` [rad]
ROUNDER = 1.5 * 2.0**52  # adding and subtracting this number rounds to an integer

_FRAME = 12  # numbers per lane: axes x, y, z, and origin
_TURNED = 18  # numbers per lane: axes x, y, z, and motion
_SIGNATURE = f'({"f8[:,:], " * 4}f8[:,:,::1], f8[:,::1], f8[:,::1], UniTuple(f8[:,::1], 11))'


def inverse_dynamics_many(states: Sequence[Floats], tau: Floats, robot: Floats) -> int:
    """
    Compute the joint efforts of N >= `LANES` states; return `OK` or `NOT_FINITE`.

    ``states`` contains q, qd and qdd of n joints, each of shape (N, n). ``tau`` receives the
    efforts, in the same shape, and must not share memory with the states. The table ``robot`` is
    not modified.

    """
    no_matrices = np.empty((0, tau.shape[1], 0))
    return _compute(states, tau, no_matrices, np.empty((0, 9)), robot)


def regressor_many(states: Sequence[Floats], matrices: Floats, R_LZ: Floats, robot: Floats) -> int:
    """
    Compute the regressors of N >= `LANES` states; return `OK` or `NOT_FINITE`.

    ``matrices``, shape (N, n, 10 (b - 1)), receives the regressors for n joints and b bodies.
    ``R_LZ``, shape (b, 9), contains a rotation for every body, as in `regressor.regressor`.

    """
    return _compute(states, np.empty((len(matrices), 0)), matrices, R_LZ, robot)


def _compute(
    states: Sequence[Floats], tau: Floats, matrices: Floats, R_LZ: Floats, robot: Floats
) -> int:
    """Compute efforts if R_LZ is empty, otherwise regressors."""
    compile_for(_blocks, _SIGNATURE)
    n, b = states[0].shape[1], len(robot)
    shapes = [(b, 3), (b, 9), (n, 1), (n, 1), (n, 1), (1, 1)]
    if len(R_LZ) > 0:
        shapes += [(0, 6), (0, 1), (b, _FRAME), (1, _TURNED), (_count_pairs(robot), PARAMETERS)]
    else:
        shapes += [(b, 6), (n, 1), (0, _FRAME), (0, _TURNED), (0, PARAMETERS)]
    rows = tuple([np.empty((i, j * LANES)) for i, j in shapes])
    q, qd, qdd, tau = (values.T for values in (*states, tau))
    return int(_blocks(q, qd, qdd, tau, matrices, R_LZ, robot, rows))


def _count_pairs(robot: Floats) -> int:
    """Return the number of (link, joint) pairs in which the joint moves the link."""
    depth = [0]
    for parent in robot[1:, PARENT].astype(int).tolist():
        depth.append(depth[parent] + 1)
    return sum(depth)


@partial(compiled, fastmath=FAST_MATH, nogil=True)
def _blocks(
    all_q: Any,
    all_qd: Any,
    all_qdd: Any,
    all_tau: Any,
    all_matrices: Any,
    R_LZ: Any,
    robot: Any,
    rows: Any,
) -> int:
    """Compute efforts or regressors block by block; each column of ``all_q`` is a state."""
    place, motion, q, qd, qdd, residue, wrench, tau, frames, turned, factors = rows
    last = all_q.shape[1] - LANES
    hold_base(robot, motion)
    residue[:] = 0.0
    for start in range(0, last + LANES, LANES):
        # The last block may overlap the previous block, so that every block is full.
        first = min(start, last)
        states = slice(first, first + LANES)
        transpose(all_q[:, states], q)
        transpose(all_qd[:, states], qd)
        transpose(all_qdd[:, states], qdd)
        outward_pass(q, qd, qdd, robot, place, motion, wrench)
        if len(R_LZ) > 0:
            regressor_pass(robot, R_LZ, place, motion, frames, turned, factors, residue)
            store_blocks(robot, factors, all_matrices[states])
        else:
            inward_pass(q, tau, robot, place, wrench)
            finish(qd, qdd, tau, robot, residue)
            transpose(tau, all_tau[:, states])
    for k in range(LANES):
        if residue[0, k] != 0.0:
            return NOT_FINITE
    return OK


@simd_step
def transpose(source: Any, target: Any) -> None:
    """Copy an array between two memory layouts, one cache line at a time."""
    for first in range(0, LANES, CACHE_LINE):
        for row in range(len(source)):
            for k in range(first, first + CACHE_LINE):
                target[row, k] = source[row, k]


@simd_step
def hold_base(robot: Any, motion: Any) -> None:
    """Copy the motion of the base from the table into every lane."""
    for j in range(9):
        for k in range(LANES):
            motion[0, j * LANES + k] = robot[0, OMEGA + j]


@simd_step
def outward_pass(
    q: Any, qd: Any, qdd: Any, robot: Any, place: Any, motion: Any, wrench: Any
) -> None:
    """Compute the motion and the `own_wrench` of every link, from base to tips."""
    for i in range(1, len(robot)):
        parent, joint = int(robot[i, PARENT]), int(robot[i, JOINT])
        place_link(q, robot, i, joint, place)
        # The compiler does not vectorise a loop that reads and writes the same array. Therefore,
        # the motion is passed twice, once for the parent and once for the link.
        outward_step(qd, qdd, robot, i, joint, place, motion, parent, motion)
        if len(wrench) > 0:
            own_wrenches(robot, i, motion, wrench)


@simd_step
def inward_pass(q: Any, tau: Any, robot: Any, place: Any, wrench: Any) -> None:
    """Sum up the wrenches from tips to base, and project each wrench onto the joint axis."""
    for joint in range(len(tau)):
        for k in range(LANES):
            tau[joint, k] = spring_effort(robot[joint + 1], q[joint, k])
    for i in range(len(robot) - 1, 0, -1):
        parent, joint = int(robot[i, PARENT]), int(robot[i, JOINT])
        project(tau, robot, i, joint, wrench)
        if parent > 0:
            inward_step(robot, i, place, wrench, parent, wrench)


@simd_step
def place_link(q: Any, robot: Any, i: int, joint: int, place: Any) -> None:
    """Compute the cosine and sine of the joint angle, and the sliding distance."""
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
    """Compute the motion of a link from the motion of its parent."""
    R, offset = frame_of(robot[i])
    slides = robot[i, SLIDES] * robot[i, MULTIPLIER]
    turns = robot[i, MULTIPLIER] - slides
    for k in range(LANES):
        c, s, length = lane(place, i, 0, k)
        p = origin_in_parent(R, offset, length)
        omega_P, omega_dot_P = lane(parents, parent, 0, k), lane(parents, parent, 3, k)
        at_origin = point_acceleration(p, omega_P, omega_dot_P, lane(parents, parent, 6, k))
        carried, carried_dot = to_link(R, c, s, omega_P), to_link(R, c, s, omega_dot_P)
        turn, turn_dot = turns * qd[joint, k], turns * qdd[joint, k]
        slide, slide_dot = slides * qd[joint, k], slides * qdd[joint, k]
        omega = angular_velocity(carried, turn)  # (36)
        omega_dot = angular_acceleration(carried, carried_dot, turn, turn_dot)  # (37)
        at_origin = to_link(R, c, s, at_origin)
        accel = sliding_acceleration(at_origin, omega, slide, slide_dot)  # (40)
        store_vectors(motion, i, 0, k, (omega, omega_dot, accel))


@simd_step
def own_wrenches(robot: Any, i: int, motion: Any, wrench: Any) -> None:
    """Compute the `own_wrench` of a link."""
    link = robot[i]
    for k in range(LANES):
        omega, omega_dot, accel = vectors(motion, i, 0, k)
        force, moment = own_wrench(link, omega, omega_dot, accel)  # (44), (41), (42)
        store_lane(wrench, i, 0, k, force)
        store_lane(wrench, i, 3, k, moment)


@simd_step
def inward_step(robot: Any, i: int, place: Any, wrench: Any, parent: int, parents: Any) -> None:
    """Add the wrench of a link to the wrench of the parent."""
    R, offset = frame_of(robot[i])
    for k in range(LANES):
        c, s, length = lane(place, i, 0, k)
        p = origin_in_parent(R, offset, length)
        force = child_force(R, c, s, lane(wrench, i, 0, k))
        moment = child_moment(R, c, s, p, force, lane(wrench, i, 3, k))
        store_lane(parents, parent, 0, k, add(lane(parents, parent, 0, k), force))  # (45)
        store_lane(parents, parent, 3, k, add(lane(parents, parent, 3, k), moment))  # (46)


@simd_step
def project(tau: Any, robot: Any, i: int, joint: int, wrench: Any) -> None:
    """Add a link's contribution to the effort of its joint."""
    multiplier, slides = robot[i, MULTIPLIER], robot[i, SLIDES]
    for k in range(LANES):
        effort = joint_effort(lane(wrench, i, 0, k), lane(wrench, i, 3, k), slides)  # (47)
        tau[joint, k] = tau[joint, k] + multiplier * effort


@simd_step
def finish(qd: Any, qdd: Any, tau: Any, robot: Any, residue: Any) -> None:
    """Add the armature and friction efforts, and check that the joint efforts are finite."""
    for joint in range(len(tau)):
        armature, numbers = robot[joint + 1, ARMATURE], friction_of(robot[joint + 1])
        if robot[joint + 1, COUPLING] != 0.0:
            share_drive(qd, qdd, tau, robot, joint, residue)
            continue
        for k in range(LANES):
            load = tau[joint, k]
            friction = joint_friction(numbers, qd[joint, k], load)
            effort = load + armature * qdd[joint, k] + friction
            tau[joint, k] = effort
            # Adds 0 if the number is finite, and NaN otherwise.
            residue[0, k] = residue[0, k] + (effort - effort)


@simd_step
def share_drive(qd: Any, qdd: Any, tau: Any, robot: Any, joint: int, residue: Any) -> None:
    """Add armature and friction efforts of a coupled drive to its joint and the previous joint."""
    armature, numbers = robot[joint + 1, ARMATURE], friction_of(robot[joint + 1])
    ratio, before = coupling_of(robot[joint + 1])
    for k in range(LANES):
        rate, rate_dot = qd[before, k], qdd[before, k]
        rate, rate_dot = qd[joint, k] + ratio * rate, qdd[joint, k] + ratio * rate_dot
        friction = joint_friction(numbers, rate, tau[joint, k])
        effort = armature * rate_dot + friction
        tau[before, k] = tau[before, k] + ratio * effort
        effort = tau[joint, k] + effort
        tau[joint, k] = effort
        residue[0, k] = residue[0, k] + (effort - effort)


@simd_step
def regressor_pass(
    robot: Any,
    R_LZ: Any,
    place: Any,
    motion: Any,
    frames: Any,
    turned: Any,
    factors: Any,
    residue: Any,
) -> None:
    """Compute a regressor block for every (link, joint) pair in which the joint moves the link."""
    hold_base_frame(frames)
    pair = 0
    for i in range(1, len(robot)):
        frame_step(robot, i, place, frames, int(robot[i, PARENT]), frames)
        turn(R_LZ, i, motion, frames, turned)
        mover = i
        while mover > 0:
            compute_block(robot, i, mover, frames, turned, factors, pair, residue)
            mover = int(robot[mover, PARENT])
            pair += 1


@simd_step
def hold_base_frame(frames: Any) -> None:
    """Set the axes and the origin of the base in every lane."""
    for k in range(LANES):
        store_vectors(frames, 0, 0, k, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
        store_lane(frames, 0, 9, k, (0.0, 0.0, 0.0))


@simd_step
def frame_step(robot: Any, i: int, place: Any, parents: Any, parent: int, frames: Any) -> None:
    """Compute the axes and the origin of a link in coordinates of the base."""
    R, offset = frame_of(robot[i])
    for k in range(LANES):
        c, s, length = lane(place, i, 0, k)
        axes_P = vectors(parents, parent, 0, k)
        p = in_base(axes_P, origin_in_parent(R, offset, length))
        store_vectors(frames, i, 0, k, axes_in_base(axes_P, R, c, s))
        store_lane(frames, i, 9, k, add(lane(parents, parent, 9, k), p))


@simd_step
def turn(R_LZ: Any, i: int, motion: Any, frames: Any, turned: Any) -> None:
    """Express the axes and the motion of a link in the link's URDF frame."""
    R = rotation(R_LZ[i])
    for k in range(LANES):
        axes, own_motion = vectors(frames, i, 0, k), vectors(motion, i, 0, k)
        axes, own_motion = in_frame_of_parameters(R, axes, own_motion)
        store_vectors(turned, 0, 0, k, axes)
        store_vectors(turned, 0, 9, k, own_motion)


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
    """Compute the regressor block of link i for the joint of body ``mover``."""
    multiplier, slides = robot[mover, MULTIPLIER], robot[mover, SLIDES]
    for k in range(LANES):
        arm = subtract(lane(frames, i, 9, k), lane(frames, mover, 9, k))
        twist = unit_twist(vectors(turned, 0, 0, k), lane(frames, mover, 6, k), arm, slides)
        f = block(twist, vectors(turned, 0, 9, k))
        factors[pair, k] = multiplier * f[0]
        store_lane(factors, pair, 1, k, (multiplier * f[1], multiplier * f[2], multiplier * f[3]))
        store_lane(factors, pair, 4, k, (multiplier * f[4], multiplier * f[5], multiplier * f[6]))
        store_lane(factors, pair, 7, k, (multiplier * f[7], multiplier * f[8], multiplier * f[9]))
    for parameter in range(PARAMETERS):
        for k in range(LANES):
            # Adds 0 if the number is finite, and NaN otherwise.
            factor = factors[pair, parameter * LANES + k]
            residue[0, k] = residue[0, k] + (factor - factor)


@simd_step
def store_blocks(robot: Any, factors: Any, matrices: Any) -> None:
    """Write the regressors of a few states at a time, so that the data fit into the cache."""
    for first in range(0, LANES, CACHE_LINE):
        last = first + CACHE_LINE
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
                        # A mimic joint contributes to the row of its master joint.
                        entry = matrices[k, row, start + j] + factors[pair, j * LANES + k]
                        matrices[k, row, start + j] = entry
                mover = int(robot[mover, PARENT])
                pair += 1


@simd_inline
def lane(rows: Any, i: int, j: int, k: int) -> Vector:
    """Read the vector that starts at component j of row i, in lane k."""
    return rows[i, j * LANES + k], rows[i, (j + 1) * LANES + k], rows[i, (j + 2) * LANES + k]


@simd_inline
def store_lane(rows: Any, i: int, j: int, k: int, v: Vector) -> None:
    """Write the vector that starts at component j of row i, in lane k."""
    rows[i, j * LANES + k] = v[0]
    rows[i, (j + 1) * LANES + k] = v[1]
    rows[i, (j + 2) * LANES + k] = v[2]


@simd_inline
def vectors(rows: Any, i: int, j: int, k: int) -> tuple[Vector, Vector, Vector]:
    """Read three vectors, such as the axes or the motion of a link."""
    return lane(rows, i, j, k), lane(rows, i, j + 3, k), lane(rows, i, j + 6, k)


@simd_inline
def store_vectors(rows: Any, i: int, j: int, k: int, three: tuple[Vector, Vector, Vector]) -> None:
    """Write three vectors, such as the axes or the motion of a link."""
    store_lane(rows, i, j, k, three[0])
    store_lane(rows, i, j + 3, k, three[1])
    store_lane(rows, i, j + 6, k, three[2])


@simd_inline
def cosine_and_sine(x: Any) -> tuple[Any, Any]:
    """
    Return cosine and sine; the error is at most 2 units in the last place.

    The function has no branches, so that the compiler can vectorise loops over the lanes. The
    nearest multiple of a quarter turn is subtracted first. The magnitude of the remainder
    is at most pi/4. In this range, the minimax polynomials have an error of 4e-18 before rounding.

    """
    quarters = (x * 0.6366197723675814 + ROUNDER) - ROUNDER
    # pi/2 is split into 33, 33 and 53 bits, so that the first two products are exact.
    near = x - quarters * 1.5707963267341256
    second = quarters * 6.077100506303966e-11
    r = near - second
    rounded = (near - r) - second
    r = r + (rounded - quarters * 2.0222662487959506e-21)
    z = r * r
    s = -2.505074748976053e-08 + z * 1.5896213905538575e-10
    s = -0.00019841269829584776 + z * (2.7557313619688146e-06 + z * s)
    s = -0.1666666666666663 + z * (0.008333333333322113 + z * s)
    s = r + r * z * s
    c = 2.0875723479154387e-09 - z * 1.1359658852901971e-11
    c = 2.4801587289487012e-05 + z * (-2.7557314353789556e-07 + z * c)
    c = 0.0416666666666666 + z * (-0.0013888888888874131 + z * c)
    c = 1.0 - (0.5 * z - z * z * c)
    # ``quarter`` is between -2 and 2, where -2 and 2 are the same half turn.
    quarter = quarters - 4.0 * ((quarters * 0.25 + ROUNDER) - ROUNDER)
    odd, opposite = abs(quarter) == 1.0, abs(quarter) == 2.0
    cosine, sine = (s, c) if odd else (c, s)
    cosine = -cosine if opposite or quarter == 1.0 else cosine
    return cosine, -sine if opposite or quarter == -1.0 else sine
