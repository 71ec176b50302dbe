"""
The mass matrix of one state, computed by the composite-rigid-body algorithm.

The composite body of a link is the link and all links that the link carries, as one rigid body. A
unit acceleration of the link's joint requires a wrench on the composite body. The entries of the
mass matrix are the projections of this wrench onto the axes of the joints from the link to the
base.

All vectors are in base coordinates, so that no rotations are necessary from link to link. Moments
are about the origin of the link.

References
----------
.. [1] M. W. Walker, D. E. Orin, "Efficient dynamic computer simulation of robotic mechanisms",
   Journal of Dynamic Systems, Measurement, and Control 104 (1982), 205-211, method 3.
.. [2] R. Featherstone, "Rigid Body Dynamics Algorithms", Springer, 2008, section 6.2.

"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .equations import add, cross, dot, subtract, symmetric, Vector
from .jit import compiled, NOT_FINITE, OK, simd_inline, WRONG_SIZE
from .link_kinematics import Axes, axes, hold_base_axes, in_base, place_in_base
from .newton_euler import place_link
from .robot_table import (
    ARMATURE,
    COM,
    COMPOSITE,
    coupling_of,
    inertia,
    JOINT,
    JOINT_COUNT,
    MASS,
    MULTIPLIER,
    PARENT,
    POSITION,
    SLIDES,
    store,
    vector,
    Z_AXIS,
)

Composite = tuple[Any, Vector, Any]
"""A composite body: mass, mass times centre of mass, and inertia about the frame's origin."""


@compiled
def mass_matrix(q: Sequence[float], matrix: Any, robot: Any) -> int:
    """
    Compute the mass matrix of one state.

    ``q`` contains the positions of n joints [rad or m]. ``matrix`` receives n rows of n numbers.
    ``robot`` is a table in the layout of `robot_table`. The returned status is `OK`, `NOT_FINITE`
    or `WRONG_SIZE`. After `WRONG_SIZE`, the matrix is unchanged. Otherwise, the matrix is exactly
    symmetric.

    """
    n = int(robot[0][JOINT_COUNT])
    if len(q) != n or len(matrix) != n or (n > 0 and len(matrix[0]) != n):
        return WRONG_SIZE
    for i in range(n):
        for j in range(n):
            matrix[i][j] = 0.0
        # Adds NaN if the position is not finite, even if no entry depends on the position.
        matrix[i][i] = robot[i + 1][ARMATURE] + (q[i] - q[i])
        ratio, before = coupling_of(robot[i + 1])
        if ratio != 0.0:
            shared = ratio * robot[i + 1][ARMATURE]
            matrix[i][before] = matrix[before][i] = shared
            matrix[before][before] += ratio * shared
    hold_base_axes(robot[0])
    for i in range(1, len(robot)):
        link = robot[i]
        place_link(link, q[int(link[JOINT])])
        place_in_base(link, robot[int(link[PARENT])])
        store_composite(link, in_base_axes(axes(link), composite_of_link(link)))
    for i in range(len(robot) - 1, 0, -1):
        link = robot[i]
        body, axis = composite(link), vector(link, Z_AXIS)
        position, slides = vector(link, POSITION), link[SLIDES]
        joint, multiplier = int(link[JOINT]), link[MULTIPLIER]
        k = int(link[PARENT])
        if k > 0:
            moved = shifted(subtract(position, vector(robot[k], POSITION)), body)
            store_composite(robot[k], combined(composite(robot[k]), moved))
        force, moment = unit_wrench(body, axis, slides)
        matrix[joint][joint] += multiplier * multiplier * along(axis, slides, force, moment)
        while k > 0:
            arm = subtract(position, vector(robot[k], POSITION))
            effort = effort_at(arm, vector(robot[k], Z_AXIS), robot[k][SLIDES], force, moment)
            effort *= multiplier * robot[k][MULTIPLIER]
            # If one of the two joints mimics the other, both entries are on the diagonal.
            other = int(robot[k][JOINT])
            matrix[joint][other] += effort
            matrix[other][joint] += effort
            k = int(robot[k][PARENT])
    return check_diagonal(matrix)


@compiled
def check_diagonal(matrix: Any) -> int:
    """
    Return `NOT_FINITE` if an entry of the matrix is not finite, otherwise `OK`.

    Only the diagonal is checked, because the largest entry of a positive definite matrix is on the
    diagonal.

    """
    for i in range(len(matrix)):
        if matrix[i][i] - matrix[i][i] != 0.0:  # 0 for finite numbers only
            return NOT_FINITE
    return OK


@simd_inline
def composite_of_link(link: Any) -> Composite:
    """Return the mass, first moment and inertia of a single link."""
    mass, com = link[MASS], vector(link, COM)
    first = mass * com[0], mass * com[1], mass * com[2]
    return mass, first, about_origin(inertia(link), com, first)


@simd_inline
def about_origin(J: Any, com: Vector, first: Vector) -> Any:
    """Convert an inertia about the centre of mass to an inertia about the frame's origin."""
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
def in_base_axes(axes: Axes, body: Composite) -> Composite:
    """Convert a composite body from the axes of the link to the axes of the base."""
    mass, first, J = body
    x, y, z = axes
    # Rows of the rotation matrix, and products of J with the rows
    a, b, c = (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])
    u, v, w = symmetric(J, a), symmetric(J, b), symmetric(J, c)
    rotated = dot(u, a), dot(u, b), dot(u, c), dot(v, b), dot(v, c), dot(w, c)
    return mass, in_base(axes, first), rotated


@simd_inline
def shifted(p: Vector, body: Composite) -> Composite:
    """Move the origin of a composite body; p points from the new origin to the old origin."""
    mass, h, J = body
    # Parallel-axis theorem; h is the first moment about the old origin.
    moved = h[0] + mass * p[0], h[1] + mass * p[1], h[2] + mass * p[2]
    x, y, z = p[0] * (h[0] + moved[0]), p[1] * (h[1] + moved[1]), p[2] * (h[2] + moved[2])
    about_point = (
        J[0] + y + z,
        J[1] - p[0] * h[1] - p[1] * moved[0],
        J[2] - p[0] * h[2] - p[2] * moved[0],
        J[3] + x + z,
        J[4] - p[1] * h[2] - p[2] * moved[1],
        J[5] + x + y,
    )
    return mass, moved, about_point


@simd_inline
def combined(a: Composite, b: Composite) -> Composite:
    """Combine two composite bodies that refer to the same frame."""
    J, K = a[2], b[2]
    inertia = J[0] + K[0], J[1] + K[1], J[2] + K[2], J[3] + K[3], J[4] + K[4], J[5] + K[5]
    return a[0] + b[0], add(a[1], b[1]), inertia


@simd_inline
def unit_wrench(body: Composite, axis: Vector, slides: Any) -> tuple[Vector, Vector]:
    """Return the force and moment that a unit acceleration of the joint requires at rest."""
    mass, h, J = body
    if slides != 0.0:
        force = mass * axis[0], mass * axis[1], mass * axis[2]
        return force, cross(h, axis)
    return cross(axis, h), symmetric(J, axis)


@simd_inline
def along(axis: Vector, slides: Any, force: Vector, moment: Vector) -> Any:
    """Return the effort of a joint due to a wrench about the joint's origin."""
    return dot(axis, force) if slides != 0.0 else dot(axis, moment)


@simd_inline
def effort_at(arm: Vector, axis: Vector, slides: Any, force: Vector, moment: Vector) -> Any:
    """Return the effort due to a wrench; ``arm`` points from the joint to the wrench's origin."""
    if slides != 0.0:
        return dot(axis, force)
    return dot(axis, add(moment, cross(arm, force)))


@simd_inline
def composite(row: Any) -> Composite:
    """Read a composite body from a row of the table."""
    k = COMPOSITE
    inertia = row[k + 4], row[k + 5], row[k + 6], row[k + 7], row[k + 8], row[k + 9]
    return row[k], vector(row, k + 1), inertia


@simd_inline
def store_composite(row: Any, body: Composite) -> None:
    """Write a composite body into a row of the table."""
    k = COMPOSITE
    mass, first, J = body
    row[k] = mass
    store(row, k + 1, first)
    store(row, k + 4, (J[0], J[1], J[2]))
    store(row, k + 7, (J[3], J[4], J[5]))
