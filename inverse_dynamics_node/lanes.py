"""
The passes of `newton_euler` for many states at once: a block of states, each in a lane of its own.

Every step is a loop over the lanes of a block, which reads and writes rows: component j of lane k
is at ``rows[i, j * LANES + k]``, where i is a body or a joint.

- Compiled, a block has 64 lanes of a number each, and the compiler makes every loop one of vector
  instructions. For that a step is a function of its own, and rows of a kind are an array.
- Not compiled, a block has one lane, and what is in it is an array of many states: the same
  functions are numpy expressions then.

Letters and equation numbers are those of `newton_euler`; vectors are tuples of three here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from .compilation import compile_for, compiled_for_lanes, in_lane, IS_COMPILED, lanewise
from .model import Floats
from .newton_euler import NOT_FINITE, OK

LANES = 64 if IS_COMPILED else 1
BLOCK = LANES if IS_COMPILED else 2048  # states in a block
FEWEST = 64  # states for which a block is worth its cost
LEAST_PIECE = 1024  # states for which another thread is worth its cost
LARGEST_ANGLE = 1e5  # that `cosine_and_sine` can take [rad]
ROUNDER = 1.5 * 2.0**52  # added and taken away again, it leaves a whole number

Vector = tuple[Any, Any, Any]

_SIGNATURE = f'({"f8[:,:], " * 4}f8[:,::1], UniTuple(f8[:,::1], 8))'


def inverse_dynamics_many(states: Sequence[Floats], robot: Floats, threads: int = 1) -> int:
    """
    Do `newton_euler.inverse_dynamics` for many states.

    Parameters
    ----------
    states : q, qd, qdd and tau, each an ndarray of shape (N, n)
        As there; N is `FEWEST` or more, and tau shares no memory with the others.
    robot : ndarray
        Table from `robot_table`; only read.
    threads : int
        How many work side by side, at most. The results do not depend on it.

    Returns
    -------
    status : int
        `OK` or `NOT_FINITE`.

    """
    compile_for(_blocks, _SIGNATURE)
    N = len(states[0])
    pieces = min(4 * threads, N // LEAST_PIECE)
    others = min(threads, pieces) - 1
    if others < 1:
        return _piece(states, robot)
    bounds = [N * k // pieces for k in range(pieces + 1)]
    work = deque([v[first:last] for v in states] for first, last in pairwise(bounds))
    shares = [_pool(others).submit(_share, work, robot) for _ in range(others)]
    status = _share(work, robot)
    # A thread that has not begun by now need not.
    return max(status, *(OK if share.cancel() else share.result() for share in shares))


@cache
def _pool(size: int) -> ThreadPoolExecutor:
    """Keep threads for the next batch: to start one can take longer than a batch."""
    return ThreadPoolExecutor(size, 'inverse_dynamics')


def _share(work: deque[list[Floats]], robot: Floats) -> int:
    """Do pieces of the work until none is left."""
    status = OK
    while True:
        try:
            states = work.popleft()
        except IndexError:
            return status
        status = max(status, _piece(states, robot))


def _piece(states: Sequence[Floats], robot: Floats) -> int:
    """Do some states, in rows of their own."""
    q, qd, qdd, tau = (values.T for values in states)
    n, b = len(q), len(robot)
    shapes = ((b, 3), (b, 9), (b, 6), (n, 1), (n, 1), (n, 1), (n, 1), (1, 1))
    kind = np.float64 if IS_COMPILED else np.object_
    rows = tuple([np.empty((i, j * LANES), kind) for i, j in shapes])
    if IS_COMPILED:
        return int(_blocks(q, qd, qdd, tau, robot, rows))
    q, qd, qdd = (np.ascontiguousarray(values)[:, None] for values in (q, qd, qdd))
    with np.errstate(over='ignore', invalid='ignore'):
        return int(_blocks(q, qd, qdd, tau[:, None], robot, rows))


@compiled_for_lanes
def _blocks(all_q: Any, all_qd: Any, all_qdd: Any, all_tau: Any, robot: Any, rows: Any) -> int:
    """Take block after block through both passes; the states are columns here."""
    place, motion, wrench, q, qd, qdd, tau, residue = rows
    size = min(BLOCK, all_q.shape[-1])
    last = all_q.shape[-1] - size
    hold_base(robot, motion)
    residue[:] = 0.0
    for start in range(0, last + size, size):
        # The last block reaches back for a full one, and does some states again.
        first = min(start, last)
        block = slice(first, first + size)
        transpose(all_q[..., block], q)
        transpose(all_qd[..., block], qd)
        transpose(all_qdd[..., block], qdd)
        outward_pass(q, qd, qdd, robot, place, motion, wrench)
        inward_pass(tau, robot, place, wrench)
        finish(qd, qdd, tau, robot, residue)
        transpose(tau, all_tau[..., block])
    for k in range(LANES):
        if np.any(residue[0, k] != 0.0):
            return NOT_FINITE
    return OK


@lanewise
def hold_base(robot: Any, motion: Any) -> None:
    """Let the base of every lane move as the table says."""
    for j in range(9):
        for k in range(LANES):
            motion[0, j * LANES + k] = robot[0, 49 + j]


@lanewise
def transpose(source: Any, target: Any) -> None:
    """Copy rows of joints, state by state: in memory the joints of a state are side by side."""
    for k in range(LANES):
        for joint in range(len(source)):
            target[joint, k] = source[joint, k]


@lanewise
def outward_pass(
    q: Any, qd: Any, qdd: Any, robot: Any, place: Any, motion: Any, wrench: Any
) -> None:
    """Carry the motion from base to tips, and find the net force and moment on every link."""
    for i in range(1, len(robot)):
        parent, joint = int(robot[i, 22]), int(robot[i, 23])
        place_link(q, robot, i, joint, place)
        # The motion twice: the rows of link and parent look like two arrays to the compiler,
        # which would rather not vectorise than have one written while it reads the other.
        outward_step(qd, qdd, robot, i, joint, place, motion, parent, motion)
        link_wrench(robot, i, motion, wrench)


@lanewise
def inward_pass(tau: Any, robot: Any, place: Any, wrench: Any) -> None:
    """Carry forces and moments from tips to base, and project them onto the joint axes."""
    for joint in range(len(tau)):
        for k in range(LANES):
            tau[joint, k] = 0.0
    for i in range(len(robot) - 1, 0, -1):
        parent, joint = int(robot[i, 22]), int(robot[i, 23])
        project(tau, robot, i, joint, wrench)
        if parent > 0:
            inward_step(robot, i, place, wrench, parent, wrench)


@lanewise
def place_link(q: Any, robot: Any, i: int, joint: int, place: Any) -> None:
    """Find how far a link has turned and slid: cosine, sine, length."""
    multiplier, offset = robot[i, 24], robot[i, 25]
    if robot[i, 26] != 0.0:
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


@lanewise
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
    """Find the motion of a link from its parent's."""
    R = numbers(robot, i, 0) + numbers(robot, i, 3) + numbers(robot, i, 6)
    offset = numbers(robot, i, 9)
    multiplier, slides = robot[i, 24], robot[i, 26]
    turns = 1.0 - slides
    for k in range(LANES):
        c, s, length = vector(place, i, 0, k)
        p = plus(offset, (R[2] * length, R[5] * length, R[8] * length))
        omega_P = vector(parents, parent, 0, k)
        omega_dot_P = vector(parents, parent, 3, k)
        accel_P = vector(parents, parent, 6, k)
        omega_x, omega_y, omega_z = to_link(R, c, s, omega_P)
        omega_dot = to_link(R, c, s, omega_dot_P)
        # (40) without the joint's own rates
        accel = to_link(R, c, s, accel_of_point(p, omega_P, omega_dot_P, accel_P))

        # A joint turns or slides: one of the two rates is zero.
        turn, turn_dot = turns * multiplier * qd[joint, k], turns * multiplier * qdd[joint, k]
        slide, slide_dot = slides * multiplier * qd[joint, k], slides * multiplier * qdd[joint, k]
        # (36): z turn
        store(motion, i, 0, k, (omega_x, omega_y, omega_z + turn))
        # (37): z turn_dot + omega_P x z turn
        store(motion, i, 3, k, plus(omega_dot, (omega_y * turn, -omega_x * turn, turn_dot)))
        # (40): z slide_dot + 2 omega x z slide
        slide = 2.0 * slide
        store(motion, i, 6, k, plus(accel, (omega_y * slide, -omega_x * slide, slide_dot)))


@lanewise
def link_wrench(robot: Any, i: int, motion: Any, wrench: Any) -> None:
    """Find the force and moment that a link needs for its own motion, and no other's."""
    mass, com = robot[i, 12], numbers(robot, i, 13)
    J = numbers(robot, i, 16) + numbers(robot, i, 19)
    external_force, external_moment = numbers(robot, i, 27), numbers(robot, i, 30)
    for k in range(LANES):
        omega = vector(motion, i, 0, k)
        omega_dot = vector(motion, i, 3, k)
        # (44)
        a_x, a_y, a_z = accel_of_point(com, omega, omega_dot, vector(motion, i, 6, k))
        # (41), (42)
        force_net = mass * a_x, mass * a_y, mass * a_z
        moment_net = plus(times(J, omega_dot), cross(omega, times(J, omega)))
        # The link's own share of (45) and (46), less what the world does to it
        store(wrench, i, 0, k, minus(force_net, external_force))
        moment = plus(moment_net, cross(com, force_net))
        store(wrench, i, 3, k, minus(moment, external_moment))


@lanewise
def inward_step(robot: Any, i: int, place: Any, wrench: Any, parent: int, parents: Any) -> None:
    """Add what a link passes on to what its parent has: (45) and (46) in the parent's frame."""
    R = numbers(robot, i, 0) + numbers(robot, i, 3) + numbers(robot, i, 6)
    offset = numbers(robot, i, 9)
    for k in range(LANES):
        c, s, length = vector(place, i, 0, k)
        p = plus(offset, (R[2] * length, R[5] * length, R[8] * length))
        force = to_parent(R, c, s, vector(wrench, i, 0, k))
        moment = plus(to_parent(R, c, s, vector(wrench, i, 3, k)), cross(p, force))
        store(parents, parent, 0, k, plus(vector(parents, parent, 0, k), force))
        store(parents, parent, 3, k, plus(vector(parents, parent, 3, k), moment))


@lanewise
def project(tau: Any, robot: Any, i: int, joint: int, wrench: Any) -> None:
    """Add a link's share to the effort of its joint, (47)."""
    slide = robot[i, 24] * robot[i, 26]
    turn = robot[i, 24] - slide
    for k in range(LANES):
        along_z = slide * wrench[i, 2 * LANES + k] + turn * wrench[i, 5 * LANES + k]
        tau[joint, k] = tau[joint, k] + along_z


@lanewise
def finish(qd: Any, qdd: Any, tau: Any, robot: Any, residue: Any) -> None:
    """Add what happens at a joint alone: rotor inertia, viscous and Coulomb friction; check."""
    for joint in range(len(tau)):
        armature, damping = robot[joint + 1, 33], robot[joint + 1, 34]
        coulomb, inverse_width = robot[joint + 1, 35], robot[joint + 1, 36]
        if coulomb != 0.0:
            for k in range(LANES):
                friction = coulomb * np.tanh(inverse_width * qd[joint, k])
                tau[joint, k] = tau[joint, k] + friction
        for k in range(LANES):
            effort = tau[joint, k] + armature * qdd[joint, k] + damping * qd[joint, k]
            tau[joint, k] = effort
            # The difference is 0 for finite numbers only, and a NaN stays one.
            residue[0, k] = residue[0, k] + (effort - effort)


@in_lane
def cosine_and_sine(x: Any) -> tuple[Any, Any]:
    """
    Compute both to 2 units in the last place, without a branch.

    The angle less a whole number of quarter turns is at most pi/4. There the polynomials, minimax
    by Remez' algorithm, are off by 4e-18 before they round.

    """
    if not IS_COMPILED:
        return np.cos(x), np.sin(x)
    quarters = (x * 0.6366197723675814 + ROUNDER) - ROUNDER
    # pi/2 in three parts, of 33, 33 and 53 bits: the first two products are exact.
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
    # Which quarter: -2 .. 2, where -2 and 2 are the same
    quarter = quarters - 4.0 * ((quarters * 0.25 + ROUNDER) - ROUNDER)
    odd, opposite = abs(quarter) == 1.0, abs(quarter) == 2.0
    cosine, sine = (s, c) if odd else (c, s)
    cosine = -cosine if opposite or quarter == 1.0 else cosine
    return cosine, -sine if opposite or quarter == -1.0 else sine


# Vectors


@in_lane
def numbers(robot: Any, i: int, j: int) -> Vector:
    return robot[i, j], robot[i, j + 1], robot[i, j + 2]


@in_lane
def vector(rows: Any, i: int, j: int, k: int) -> Vector:
    return rows[i, j * LANES + k], rows[i, (j + 1) * LANES + k], rows[i, (j + 2) * LANES + k]


@in_lane
def store(rows: Any, i: int, j: int, k: int, v: Vector) -> None:
    rows[i, j * LANES + k] = v[0]
    rows[i, (j + 1) * LANES + k] = v[1]
    rows[i, (j + 2) * LANES + k] = v[2]


@in_lane
def to_link(R: Any, c: Any, s: Any, v: Vector) -> Vector:
    """R_LP v, where R is R_PL at position 0, and c, s are of the angle since."""
    x = R[0] * v[0] + R[3] * v[1] + R[6] * v[2]
    y = R[1] * v[0] + R[4] * v[1] + R[7] * v[2]
    z = R[2] * v[0] + R[5] * v[1] + R[8] * v[2]
    return c * x + s * y, c * y - s * x, z


@in_lane
def to_parent(R: Any, c: Any, s: Any, v: Vector) -> Vector:
    """R_PL v, R, c and s as for `to_link`."""
    x, y, z = c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]
    return (
        R[0] * x + R[1] * y + R[2] * z,
        R[3] * x + R[4] * y + R[5] * z,
        R[6] * x + R[7] * y + R[8] * z,
    )


@in_lane
def accel_of_point(p: Vector, omega: Vector, omega_dot: Vector, accel: Vector) -> Vector:
    """Accel + omega_dot x p + omega x (omega x p): of point p, where accel is the origin's."""
    return plus(accel, plus(cross(omega_dot, p), cross(omega, cross(omega, p))))


@in_lane
def times(J: Any, v: Vector) -> Vector:
    """J v, where J is symmetric: xx, xy, xz, yy, yz, zz."""
    return (
        J[0] * v[0] + J[1] * v[1] + J[2] * v[2],
        J[1] * v[0] + J[3] * v[1] + J[4] * v[2],
        J[2] * v[0] + J[4] * v[1] + J[5] * v[2],
    )


@in_lane
def plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@in_lane
def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@in_lane
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
