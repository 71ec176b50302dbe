"""
Axes, origins, poses and geometric Jacobians of links in base coordinates, for one state.

References
----------
.. [1] B. Siciliano, L. Sciavicco, L. Villani, G. Oriolo, "Robotics: Modelling, Planning and
   Control", Springer, 2009, section 3.1.

"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..robot.model import Floats, RobotModel
from .equations import add, cross, dot, origin_in_parent, subtract, Vector
from .jit import compiled, NOT_FINITE, OK, simd_inline, WRONG_SIZE
from .newton_euler import check, place_link
from .robot_table import (
    COSINE,
    JOINT,
    JOINT_COUNT,
    joint_of,
    LENGTH,
    OFFSET,
    PARENT,
    POSITION,
    rotation,
    SINE,
    store,
    vector,
    X_AXIS,
    Y_AXIS,
    Z_AXIS,
)

Axes = tuple[Vector, Vector, Vector]
"""Unit vectors x, y, z of a frame."""

# Columns of `row_of_link`: the body, and the pose of the link in the frame of the body
BODY = 0
ORIGIN = 1  # [m]
AXES = 4  # nine columns: the axes x, y, z of the link, one after the other


def row_of_link(robot: RobotModel, R_ZL: Floats, link: str) -> Floats:
    """Return 13 numbers for a link: BODY, ORIGIN and AXES; R_ZL is from `rotations_to_z`."""
    k = robot.link_index(link)
    body = robot.link_body[k]
    axes = R_ZL[body] @ robot.link_rotation[k]
    return np.array([body, *(R_ZL[body] @ robot.link_position[k]), *axes.T.ravel()])


@compiled
def pose(q: Sequence[float], link: Any, matrix: Any, robot: Any) -> int:
    """
    Compute the homogeneous transformation matrix from a link's frame to the base frame.

    ``q`` contains the positions of n joints [rad or m]. ``link`` is a row from `row_of_link`.
    ``matrix`` receives 4 rows of 4 numbers. ``robot`` is a table in the layout of `robot_table`.
    The returned status is `OK`, `NOT_FINITE` or `WRONG_SIZE`. After `WRONG_SIZE`, the matrix is
    unchanged.

    """
    if len(q) != int(robot[0][JOINT_COUNT]) or len(matrix) != 4 or len(matrix[0]) != 4:
        return WRONG_SIZE
    if check(q) != OK:  # also checks joints that do not move the link
        return NOT_FINITE
    origin = place_bodies(q, link, robot)
    axes_of_body = axes(robot[int(link[BODY])])
    x = in_base(axes_of_body, vector(link, AXES))
    y = in_base(axes_of_body, vector(link, AXES + 3))
    z = in_base(axes_of_body, vector(link, AXES + 6))
    for i in range(3):
        matrix[i][0], matrix[i][1], matrix[i][2], matrix[i][3] = x[i], y[i], z[i], origin[i]
        matrix[3][i] = 0.0
    matrix[3][3] = 1.0
    return check_rows(matrix)


@compiled
def jacobian(q: Sequence[float], link: Any, matrix: Any, robot: Any) -> int:
    """
    Compute the geometric Jacobian of the origin of a link.

    ``matrix`` receives 6 rows of n numbers for n joints: three linear rows, and three angular
    rows. The other arguments and the status are as in `pose`.

    """
    n = int(robot[0][JOINT_COUNT])
    if len(q) != n or len(matrix) != 6 or len(matrix[0]) != n:
        return WRONG_SIZE
    if check(q) != OK:  # also checks joints that do not move the link
        return NOT_FINITE
    origin = place_bodies(q, link, robot)
    for i in range(6):
        for j in range(n):
            matrix[i][j] = 0.0
    k = int(link[BODY])
    while k > 0:
        parent, joint, multiplier, slides = joint_of(robot[k])
        axis, arm = vector(robot[k], Z_AXIS), subtract(origin, vector(robot[k], POSITION))
        turned = cross(axis, arm)
        for i in range(3):  # a mimic joint contributes to its master joint
            linear = axis[i] if slides != 0.0 else turned[i]
            matrix[i][joint] += multiplier * linear
            matrix[i + 3][joint] += multiplier * (1.0 - slides) * axis[i]
        k = parent
    return check_rows(matrix)


@simd_inline
def place_bodies(q: Sequence[float], link: Any, robot: Any) -> Vector:
    """Store the poses of all bodies up to number ``link[BODY]``; return the origin of the link."""
    body = int(link[BODY])
    hold_base_axes(robot[0])
    for i in range(1, body + 1):  # parents have smaller indices
        place_link(robot[i], q[int(robot[i][JOINT])])
        place_in_base(robot[i], robot[int(robot[i][PARENT])])
    place = robot[body]
    return add(vector(place, POSITION), in_base(axes(place), vector(link, ORIGIN)))


@compiled
def check_rows(matrix: Any) -> int:
    """Return `NOT_FINITE` if an entry of the matrix is not finite, otherwise `OK`."""
    for i in range(len(matrix)):
        if check(matrix[i]) != OK:
            return NOT_FINITE
    return OK


@simd_inline
def hold_base_axes(base: Any) -> None:
    """Store the axes and the origin of the base."""
    store(base, X_AXIS, (1.0, 0.0, 0.0))
    store(base, Y_AXIS, (0.0, 1.0, 0.0))
    store(base, Z_AXIS, (0.0, 0.0, 1.0))
    store(base, POSITION, (0.0, 0.0, 0.0))


@simd_inline
def place_in_base(link: Any, parent: Any) -> None:
    """Store the axes and the origin of a link in base coordinates; call `place_link` first."""
    R, axes_P = rotation(link), axes(parent)
    p = origin_in_parent(R, vector(link, OFFSET), link[LENGTH])
    x, y, z = axes_in_base(axes_P, R, link[COSINE], link[SINE])
    store(link, X_AXIS, x)
    store(link, Y_AXIS, y)
    store(link, Z_AXIS, z)
    store(link, POSITION, add(vector(parent, POSITION), in_base(axes_P, p)))


@simd_inline
def axes(row: Any) -> Axes:
    """Read the axes of a link."""
    return vector(row, X_AXIS), vector(row, Y_AXIS), vector(row, Z_AXIS)


@simd_inline
def axes_in_base(axes_P: Axes, R: Any, c: Any, s: Any) -> Axes:
    """Compute the axes of a link from its parent's axes; R, c and s are as in `equations`."""
    x = c * R[0] + s * R[1], c * R[3] + s * R[4], c * R[6] + s * R[7]
    y = c * R[1] - s * R[0], c * R[4] - s * R[3], c * R[7] - s * R[6]
    z = R[2], R[5], R[8]
    return in_base(axes_P, x), in_base(axes_P, y), in_base(axes_P, z)


@simd_inline
def in_base(axes: Axes, v: Vector) -> Vector:
    """Convert a vector from the frame with the given axes to base coordinates."""
    x, y, z = axes
    return (
        x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
    )


@simd_inline
def in_frame(axes: Axes, v: Vector) -> Vector:
    """Convert a vector from base coordinates to the frame with the given axes."""
    return dot(axes[0], v), dot(axes[1], v), dot(axes[2], v)
