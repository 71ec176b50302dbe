"""
The mass matrix of one state by the composite-rigid-body algorithm.

From tips to base, each link and all that it carries are combined into one rigid body. The force
and moment that accelerate this body by a unit acceleration of the link's joint, projected onto
that joint and onto every joint between it and the base, are entries of the mass matrix.

References
----------
.. [1] M. W. Walker, D. E. Orin, "Efficient dynamic computer simulation of robotic mechanisms",
   Journal of Dynamic Systems, Measurement, and Control 104 (1982), 205-211, method 3.
.. [2] R. Featherstone, "Rigid Body Dynamics Algorithms", Springer, 2008, section 6.2.

"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .columns import (
    ARMATURE,
    COM,
    COMPOSITE,
    COSINE,
    inertia,
    JOINT,
    JOINT_COUNT,
    LENGTH,
    MASS,
    MULTIPLIER,
    OFFSET,
    PARENT,
    rotation,
    SINE,
    SLIDES,
    store,
    vector,
)
from .equations import (
    add,
    child_force,
    child_moment,
    dot,
    joint_effort,
    origin_in_parent,
    symmetric,
    to_parent,
    Vector,
)
from .jit import compiled, simd_inline
from .newton_euler import (
    NOT_FINITE,
    OK,
    place_link,
    WRONG_SIZE,
)

Composite = tuple[Any, Vector, Any]
"""Mass, first moment (mass times centre of mass), and inertia about the origin of the frame."""


@compiled
def mass_matrix(q: Sequence[float], matrix: Any, robot: Any) -> int:
    """
    Compute the mass matrix of one state.

    Parameters
    ----------
    q : sequence of n floats
        Joint positions [rad or m].
    matrix : n sequences of n floats
        Receives the mass matrix, symmetric to the last bit.
    robot : table from `robot_table`

    Returns
    -------
    status : int
        `OK`, `WRONG_SIZE` (then the matrix is untouched) or `NOT_FINITE`.

    """
    n = int(robot[0][JOINT_COUNT])
    if len(q) != n or len(matrix) != n or (n > 0 and len(matrix[0]) != n):
        return WRONG_SIZE
    for i in range(n):
        for j in range(n):
            matrix[i][j] = 0.0
        # A position that is not finite must not go unnoticed where no entry depends on it.
        matrix[i][i] = robot[i + 1][ARMATURE] + (q[i] - q[i])
    for i in range(1, len(robot)):
        link = robot[i]
        place_link(link, q[int(link[JOINT])])
        store_composite(link, composite_of_link(link))
    for i in range(len(robot) - 1, 0, -1):
        link = robot[i]
        body = composite(link)
        force, moment = unit_wrench(body, link[SLIDES])
        joint, multiplier = int(link[JOINT]), link[MULTIPLIER]
        effort = joint_effort(force, moment, link[SLIDES])
        matrix[joint][joint] += multiplier * multiplier * effort
        R, c, s, p = frame(link)
        parent = robot[int(link[PARENT])]
        if int(link[PARENT]) > 0:
            moved = composite_in_parent(R, c, s, p, body)
            store_composite(parent, combined(composite(parent), moved))
        while int(link[PARENT]) > 0:
            force = child_force(R, c, s, force)
            moment = child_moment(R, c, s, p, force, moment)
            link = robot[int(link[PARENT])]
            # If one of the two joints mimics the other, both entries are on the diagonal.
            other = int(link[JOINT])
            effort = multiplier * link[MULTIPLIER] * joint_effort(force, moment, link[SLIDES])
            matrix[joint][other] += effort
            matrix[other][joint] += effort
            R, c, s, p = frame(link)
    for i in range(n):
        for j in range(n):
            if matrix[i][j] - matrix[i][j] != 0.0:  # 0 only for finite numbers
                return NOT_FINITE
    return OK


@simd_inline
def composite_of_link(link: Any) -> Composite:
    """Return the link alone as a composite body."""
    mass, com = link[MASS], vector(link, COM)
    first = mass * com[0], mass * com[1], mass * com[2]
    return mass, first, about_origin(inertia(link), com, first)


@simd_inline
def about_origin(J: Any, com: Vector, first: Vector) -> Any:
    """Return the inertia about the origin, from the inertia about the centre of mass."""
    x, y, z = com[0] * first[0], com[1] * first[1], com[2] * first[2]
    return (
        J[0] + y + z,
        J[1] - com[0] * first[1],
        J[2] - com[0] * first[2],
        J[3] + x + z,
        J[4] - com[1] * first[2],
        J[5] + x + y,
    )


@simd_inline
def composite_in_parent(R: Any, c: Any, s: Any, p: Vector, body: Composite) -> Composite:
    """Return a composite body in the frame of the parent, about the parent's origin."""
    mass, first, inertia = body
    h_x, h_y, h_z = to_parent(R, c, s, first)
    J = rotated(R, c, s, inertia)
    p_x, p_y, p_z = p
    # The parallel-axis theorem, with h the first moment about the link's origin
    g_x, g_y, g_z = 2.0 * h_x + mass * p_x, 2.0 * h_y + mass * p_y, 2.0 * h_z + mass * p_z
    x, y, z = p_x * g_x, p_y * g_y, p_z * g_z
    moved = (h_x + mass * p_x, h_y + mass * p_y, h_z + mass * p_z)
    shifted = (
        J[0] + y + z,
        J[1] - p_x * h_y - p_y * moved[0],
        J[2] - p_x * h_z - p_z * moved[0],
        J[3] + x + z,
        J[4] - p_y * h_z - p_z * moved[1],
        J[5] + x + y,
    )
    return mass, moved, shifted


@simd_inline
def rotated(R: Any, c: Any, s: Any, J: Any) -> Any:
    """R_PL J R_LP, where J is symmetric: xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = J
    # First by the angle of the joint, about z,
    a, b = c * xx - s * xy, c * xy - s * yy
    d, e = s * xx + c * xy, s * xy + c * yy
    J = (c * a - s * b, s * a + c * b, c * xz - s * yz, s * d + c * e, s * xz + c * yz, zz)
    # then by R: the rows of R J, and their products with the rows of R.
    x, y, z = (R[0], R[1], R[2]), (R[3], R[4], R[5]), (R[6], R[7], R[8])
    u, v, w = symmetric(J, x), symmetric(J, y), symmetric(J, z)
    return dot(u, x), dot(u, y), dot(u, z), dot(v, y), dot(v, z), dot(w, z)


@simd_inline
def combined(a: Composite, b: Composite) -> Composite:
    """Return two composite bodies in the same frame as one."""
    J, K = a[2], b[2]
    inertia = J[0] + K[0], J[1] + K[1], J[2] + K[2], J[3] + K[3], J[4] + K[4], J[5] + K[5]
    return a[0] + b[0], add(a[1], b[1]), inertia


@simd_inline
def unit_wrench(body: Composite, slides: Any) -> tuple[Vector, Vector]:
    """
    Return the force and moment for a unit acceleration of the joint, the body at rest.

    A rotational joint needs z x h and the third column of the inertia; a translational joint
    needs m z and h x z, with h the first moment.

    """
    mass, h, J = body
    turns = 1.0 - slides
    force = 0.0 - turns * h[1], turns * h[0], slides * mass
    moment = turns * J[2] + slides * h[1], turns * J[4] - slides * h[0], turns * J[5]
    return force, moment


@simd_inline
def frame(link: Any) -> Any:
    """Read R, c, s and p of `equations`, as `place_link` has left them."""
    R = rotation(link)
    return R, link[COSINE], link[SINE], origin_in_parent(R, vector(link, OFFSET), link[LENGTH])


@simd_inline
def composite(row: Any) -> Composite:
    """Read a composite body."""
    k = COMPOSITE
    inertia = row[k + 4], row[k + 5], row[k + 6], row[k + 7], row[k + 8], row[k + 9]
    return row[k], vector(row, k + 1), inertia


@simd_inline
def store_composite(row: Any, body: Composite) -> None:
    """Write a composite body."""
    k = COMPOSITE
    mass, first, J = body
    row[k] = mass
    store(row, k + 1, first)
    store(row, k + 4, (J[0], J[1], J[2]))
    store(row, k + 7, (J[3], J[4], J[5]))
