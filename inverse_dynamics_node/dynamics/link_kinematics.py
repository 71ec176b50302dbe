"""
Pose and geometric Jacobian of one link for one state, in coordinates of the base.

References
----------
.. [1] B. Siciliano, L. Sciavicco, L. Villani, G. Oriolo, "Robotics: Modelling, Planning and
   Control", Springer, 2009, section 3.1.

"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .base_axes import axes, hold_base_axes, in_base, place_in_base
from .equations import add, cross, subtract, Vector
from .jit import compiled, simd_inline
from .newton_euler import check, NOT_FINITE, OK, place_link, WRONG_SIZE
from .robot_table import JOINT, JOINT_COUNT, joint_of, PARENT, POSITION, vector, Z_AXIS

# A link, as one row: its body, and its place in the frame of the body in the robot table
BODY = 0
ORIGIN = 1  # [m]
AXES = 4  # nine columns: the axes x, y, z of the link, one after the other


@compiled
def pose(q: Sequence[float], link: Any, matrix: Any, robot: Any) -> int:
    """
    Compute the pose of a link.

    Parameters
    ----------
    q : sequence of n floats
        Joint positions [rad or m].
    link : sequence of 13 floats
        The body of the link, and its place in it: `BODY`, `ORIGIN`, `AXES`.
    matrix : 4 sequences of 4 floats
        Receives the homogeneous matrix from the link's frame to the base frame.
    robot : table from `robot_table`
        The robot.

    Returns
    -------
    status : int
        `OK`, `WRONG_SIZE` (then the matrix is untouched) or `NOT_FINITE`.

    """
    if len(q) != int(robot[0][JOINT_COUNT]) or len(matrix) != 4 or len(matrix[0]) != 4:
        return WRONG_SIZE
    if check(q) != OK:  # also of joints on which the result does not depend
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

    Parameters
    ----------
    q, link, robot
        As for `pose`.
    matrix : 6 sequences of n floats
        Receives the Jacobian: three linear rows, then three angular ones.

    Returns
    -------
    status : int
        As `pose`.

    """
    n = int(robot[0][JOINT_COUNT])
    if len(q) != n or len(matrix) != 6 or len(matrix[0]) != n:
        return WRONG_SIZE
    if check(q) != OK:  # also of joints on which the result does not depend
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
        for i in range(3):  # a mimic joint adds to the column of its master
            linear = axis[i] if slides != 0.0 else turned[i]
            matrix[i][joint] += multiplier * linear
            matrix[i + 3][joint] += multiplier * (1.0 - slides) * axis[i]
        k = parent
    return check_rows(matrix)


@simd_inline
def place_bodies(q: Sequence[float], link: Any, robot: Any) -> Vector:
    """Store the places of the bodies up to that of a link; return the link's origin."""
    body = int(link[BODY])
    hold_base_axes(robot[0])
    for i in range(1, body + 1):  # parents have smaller numbers
        place_link(robot[i], q[int(robot[i][JOINT])])
        place_in_base(robot[i], robot[int(robot[i][PARENT])])
    place = robot[body]
    return add(vector(place, POSITION), in_base(axes(place), vector(link, ORIGIN)))


@compiled
def check_rows(matrix: Any) -> int:
    """Return `NOT_FINITE` if an entry is."""
    for i in range(len(matrix)):
        if check(matrix[i]) != OK:
            return NOT_FINITE
    return OK
