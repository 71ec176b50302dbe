r"""
The Lagrangian form of Uicker and Kahn: the paper compares its method with this equation (2).

.. math::
    \tau_i = \sum_j D_{ij} \ddot q_j + \sum_j \sum_k D_{ijk} \dot q_j \dot q_k + D_i

    D_{ij} = \sum_p tr(\partial_j T_p J_p \partial_i T_p^T),\quad
    D_{ijk} = \sum_p tr(\partial_j \partial_k T_p J_p \partial_i T_p^T),\quad
    D_i = -\sum_p m_p g^T \partial_i T_p r_p

The sums over p start at the outermost of the joints i, j and k, and end at the tip. T_p is the 4x4
homogeneous transform from link p to the base, J_p the pseudo-inertia matrix of link p, m_p its
mass, and r_p its centre of mass.

The sums are implemented literally. The paper does not say how its program computed the derivatives
in the sums. Therefore there are two versions. The first version computes the derivatives of all
T_p once and keeps them; n^4 traces follow. The second version multiplies each derivative out from
its factors wherever a sum uses it, which takes n^5 products.

A_p is the transform from link p to its parent. dA_p/dq is A_p Q_p with a constant Q_p. A
derivative of T_p is therefore the product A_1 ... A_p with Q_j inserted after A_j. The link frames
are those of `robot_table`; every joint axis is the z axis of its frame.

Arrays are always indexed by element, because 4x4 views would prevent vectorization and make the
comparison unfair.
"""

from __future__ import annotations

from math import cos, sin
from typing import Any, NamedTuple

from inverse_dynamics_node.dynamics import robot_table
from inverse_dynamics_node.dynamics.inverse_dynamics import STANDARD_GRAVITY
from inverse_dynamics_node.dynamics.jit import IS_COMPILED, simd_inline
from inverse_dynamics_node.dynamics.newton_euler import inverse_dynamics
from inverse_dynamics_node.robot.model import Floats, RobotModel
import numpy as np

if IS_COMPILED:
    import numba


def compiled(function: Any) -> Any:
    """
    Compile a function with the settings of the package, but without a cache on disk.

    With a cache, numba would use old code after a change in newton_euler.py.
    """
    return numba.njit(error_model='numpy')(function) if IS_COMPILED else function


class Chain(NamedTuple):
    """The parameters of a chain of n links, and arrays for intermediate results."""

    transforms: Floats
    """Transforms A_p from link p to its parent at position 0, shape (n, 4, 4)."""
    generators: Floats
    """Constant matrices Q_p = A_p^-1 dA_p/dq, shape (n, 4, 4)."""
    slides: Floats
    """1 for prismatic joints, otherwise 0, shape (n,)."""
    inertias: Floats
    """Pseudo-inertias J_p, shape (n, 4, 4); the last column of J_p is m_p r_p."""
    gravity: Floats
    """Free-fall acceleration in the base frame, shape (3,)."""
    A: Floats
    """Transforms A_p at the current position, shape (n, 4, 4)."""
    dT: Floats
    """First derivatives dT_p/dq_j, shape (n, n, 4, 4)."""
    ddT: Floats
    """Second derivatives d2T_p/dq_j dq_k for j up to k, shape (n, n, n, 4, 4)."""
    X: Floats
    Y: Floats
    Z: Floats
    """Scratch matrices, shape (4, 4)."""


def chain_of(robot: RobotModel) -> Chain:
    """Convert a robot that is a chain to the arrays of this module."""
    rows = robot_table.table_of(robot)
    n = len(rows) - 1
    if any(rows[1:, robot_table.PARENT] != np.arange(n)):
        raise ValueError('the equation is for chains')
    transforms, generators, inertias = np.zeros((3, n, 4, 4))
    for k, row in enumerate(rows[1:]):
        transforms[k, :3, :3] = np.reshape(robot_table.rotation(row), (3, 3))
        transforms[k, :3, 3] = robot_table.vector(row, robot_table.OFFSET)
        transforms[k, 3, 3] = 1.0
        if row[robot_table.SLIDES]:
            generators[k, 2, 3] = 1.0
        else:
            generators[k, 1, 0], generators[k, 0, 1] = 1.0, -1.0
        inertias[k] = pseudo_inertia(row)
    slides = rows[1:, robot_table.SLIDES].copy()
    gravity = np.array(STANDARD_GRAVITY)
    room = [np.zeros((n,) * k + (4, 4)) for k in (1, 2, 3, 0, 0, 0)]
    return Chain(transforms, generators, slides, inertias, gravity, *room)


def pseudo_inertia(row: Floats) -> Floats:
    """Return the 4x4 pseudo-inertia of a link: second moments, first moments, and mass."""
    mass, com = row[robot_table.MASS], np.array(robot_table.vector(row, robot_table.COM))
    xx, xy, xz, yy, yz, zz = robot_table.inertia(row)
    about_com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    second = np.trace(about_com) / 2.0 * np.eye(3) - about_com + mass * np.outer(com, com)
    first = mass * com
    return np.block([[second, first[:, None]], [first[None, :], np.array([[mass]])]])


@compiled
def newton_euler_sweep(q: Any, qd: Any, qdd: Any, tau: Any, robot: Any, times: int) -> None:
    """Run Newton-Euler over all states several times, in a compiled loop."""
    for _ in range(times):
        for k in range(len(q)):
            inverse_dynamics(q[k], qd[k], qdd[k], tau[k], robot)


@compiled
def kept_sweep(q: Any, qd: Any, qdd: Any, tau: Any, chain: Any, times: int) -> None:
    """Run the Lagrangian form with kept derivatives over all states several times."""
    transforms, generators, slides, inertias, gravity, A, dT, ddT, X, Y, _ = chain
    for _ in range(times):
        for k in range(len(q)):
            place_links(q[k], transforms, slides, A)
            keep_derivatives(A, generators, dT, ddT, X, Y)
            sum_kept(qd[k], qdd[k], tau[k], inertias, gravity, dT, ddT)


@compiled
def multiplied_sweep(q: Any, qd: Any, qdd: Any, tau: Any, chain: Any, times: int) -> None:
    """Run the Lagrangian form with multiplied-out derivatives over all states several times."""
    transforms, generators, slides, inertias, gravity, A, _, _, X, Y, Z = chain
    for _ in range(times):
        for k in range(len(q)):
            place_links(q[k], transforms, slides, A)
            sum_multiplied(qd[k], qdd[k], tau[k], inertias, gravity, A, generators, X, Y, Z)


@compiled
def sum_kept(qd: Any, qdd: Any, tau: Any, inertias: Any, gravity: Any, dT: Any, ddT: Any) -> None:
    """Evaluate equation (2) with precomputed derivatives."""
    n = len(tau)
    for i in range(n):
        effort = 0.0
        for j in range(n):
            D_ij = 0.0
            for p in range(max(i, j), n):
                D_ij += trace(dT[p, j], inertias[p], dT[p, i])
            effort += D_ij * qdd[j]
            for k in range(n):
                D_ijk = 0.0
                for p in range(max(i, max(j, k)), n):
                    D_ijk += trace(ddT[p, min(j, k), max(j, k)], inertias[p], dT[p, i])
                effort += D_ijk * qd[j] * qd[k]
        for p in range(i, n):
            effort += weight(gravity, dT[p, i], inertias[p])
        tau[i] = effort


@compiled
def sum_multiplied(
    qd: Any,
    qdd: Any,
    tau: Any,
    inertias: Any,
    gravity: Any,
    A: Any,
    Q: Any,
    X: Any,
    Y: Any,
    Z: Any,
) -> None:
    """Evaluate equation (2) with derivatives multiplied out in the sums."""
    n = len(tau)
    for i in range(n):
        effort = 0.0
        for j in range(n):
            D_ij = 0.0
            for p in range(max(i, j), n):
                multiply_out(p, j, -1, A, Q, X, Z)
                multiply_out(p, i, -1, A, Q, Y, Z)
                D_ij += trace(X, inertias[p], Y)
            effort += D_ij * qdd[j]
            for k in range(n):
                D_ijk = 0.0
                for p in range(max(i, max(j, k)), n):
                    multiply_out(p, j, k, A, Q, X, Z)
                    multiply_out(p, i, -1, A, Q, Y, Z)
                    D_ijk += trace(X, inertias[p], Y)
                effort += D_ijk * qd[j] * qd[k]
        for p in range(i, n):
            multiply_out(p, i, -1, A, Q, Y, Z)
            effort += weight(gravity, Y, inertias[p])
        tau[i] = effort


@compiled
def place_links(q: Any, transforms: Any, slides: Any, A: Any) -> None:
    """Compute the transform A_p from every link to its parent at the joint positions q."""
    for p in range(len(q)):
        c, s = cos(q[p]), sin(q[p])
        for row in range(4):
            x, y = transforms[p, row, 0], transforms[p, row, 1]
            z, t = transforms[p, row, 2], transforms[p, row, 3]
            if slides[p] != 0.0:
                t += z * q[p]
            else:
                x, y = c * x + s * y, c * y - s * x
            A[p, row, 0], A[p, row, 1], A[p, row, 2], A[p, row, 3] = x, y, z, t


@compiled
def keep_derivatives(A: Any, Q: Any, dT: Any, ddT: Any, T: Any, T_before: Any) -> None:
    """Compute all first and second derivatives of T_p recursively from link to link."""
    copy(A[0], T)
    for p in range(len(A)):
        if p > 0:
            copy(T, T_before)
            multiply(T_before, A[p], T)
        multiply(T, Q[p], dT[p, p])
        for j in range(p + 1):
            if j < p:
                multiply(dT[p - 1, j], A[p], dT[p, j])
            for k in range(j, p):
                multiply(ddT[p - 1, j, k], A[p], ddT[p, j, k])
            multiply(dT[p, j], Q[p], ddT[p, j, p])


@simd_inline
def multiply_out(p: int, j: int, k: int, A: Any, Q: Any, product: Any, room: Any) -> None:
    """Multiply A_1 ... A_p, with Q_j inserted after A_j and Q_k after A_k."""
    copy(A[0], product)
    for link in range(p + 1):
        if link > 0:
            copy(product, room)
            multiply(room, A[link], product)
        if link == j:
            copy(product, room)
            multiply(room, Q[link], product)
        if link == k:
            copy(product, room)
            multiply(room, Q[link], product)


@simd_inline
def copy(a: Any, b: Any) -> None:
    """Copy a 4x4 matrix."""
    for row in range(4):
        for column in range(4):
            b[row, column] = a[row, column]


@simd_inline
def multiply(a: Any, b: Any, product: Any) -> None:
    """Write the product of two 4x4 matrices to a third matrix."""
    for row in range(4):
        for column in range(4):
            product[row, column] = (
                a[row, 0] * b[0, column]
                + a[row, 1] * b[1, column]
                + a[row, 2] * b[2, column]
                + a[row, 3] * b[3, column]
            )


@simd_inline
def trace(a: Any, inertia: Any, b: Any) -> float:
    """Compute tr(a J b^T) for a pseudo-inertia J."""
    total = 0.0
    for row in range(4):
        for column in range(4):
            total += b[row, column] * (
                a[row, 0] * inertia[0, column]
                + a[row, 1] * inertia[1, column]
                + a[row, 2] * inertia[2, column]
                + a[row, 3] * inertia[3, column]
            )
    return total


@simd_inline
def weight(gravity: Any, dT: Any, inertia: Any) -> float:
    """Compute the gravity term -m g^T dT r; the last column of the pseudo-inertia is m r."""
    total = 0.0
    for row in range(3):
        for column in range(4):
            total -= gravity[row] * dT[row, column] * inertia[column, 3]
    return total
