"""
The regressor of one state: the matrix that maps the inertial parameters to the efforts.

The inertial parameters of a body are the mass, the first moment (mass times centre of mass), and
the inertia about the origin of the body's frame. The net force and moment on a body are linear in
the inertial parameters.

A body contributes to the effort of every joint that moves the body. By the principle of virtual
work, the contribution is the power of the net force and moment at unit rate of the joint. A block
of the regressor contains the ten factors for one joint and one body.

References
----------
.. [1] C. G. Atkeson, C. H. An, J. M. Hollerbach, "Estimation of inertial parameters of manipulator
   loads and links", International Journal of Robotics Research 5(3) (1986), 101-119.

"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .equations import cross, dot, point_acceleration, subtract, Vector
from .jit import compiled, NOT_FINITE, OK, simd_inline, WRONG_SIZE
from .link_kinematics import Axes, axes, hold_base_axes, in_base, in_frame, place_in_base
from .newton_euler import outward_pass
from .robot_table import (
    JOINT,
    JOINT_COUNT,
    motion_of,
    MULTIPLIER,
    PARENT,
    POSITION,
    rotation,
    SLIDES,
    vector,
    Z_AXIS,
)

PARAMETERS = 10
"""Number of parameters per body: m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""


@compiled
def regressor(
    q: Sequence[float],
    qd: Sequence[float],
    qdd: Sequence[float],
    R_LZ: Any,
    matrix: Any,
    robot: Any,
) -> int:
    """
    Compute the regressor of one state, for n joints and b bodies including the base.

    ``matrix`` receives n rows of 10 (b - 1) numbers. ``R_LZ`` has a row of 9 numbers for each
    body: the rotation from the body's frame in the table to the body's URDF frame. The other
    arguments and the status are as in `newton_euler.inverse_dynamics`.

    """
    n, b = int(robot[0][JOINT_COUNT]), len(robot)
    if len(q) != n or len(qd) != n or len(qdd) != n or len(matrix) != n:
        return WRONG_SIZE
    if n > 0 and len(matrix[0]) != PARAMETERS * (b - 1):
        return WRONG_SIZE
    for joint in range(n):
        for k in range(PARAMETERS * (b - 1)):
            matrix[joint][k] = 0.0
    outward_pass(q, qd, qdd, robot)
    hold_base_axes(robot[0])
    for i in range(1, b):
        place_in_base(robot[i], robot[int(robot[i][PARENT])])
    residue = 0.0
    for i in range(1, b):
        link = robot[i]
        R = rotation(R_LZ[i])
        own_axes, motion = in_frame_of_parameters(R, axes(link), motion_of(link))
        p, first, k = vector(link, POSITION), PARAMETERS * (i - 1), i
        while k > 0:
            mover = robot[k]
            arm = subtract(p, vector(mover, POSITION))
            twist = unit_twist(own_axes, vector(mover, Z_AXIS), arm, mover[SLIDES])
            row = matrix[int(mover[JOINT])]
            # A mimic joint contributes to the row of its master joint.
            residue += add_block(row, first, mover[MULTIPLIER], block(twist, motion))
            k = int(mover[PARENT])
    return OK if residue == 0.0 else NOT_FINITE


@simd_inline
def in_frame_of_parameters(R: Any, axes_Z: Axes, motion: Any) -> Any:
    """Rotate the axes and the motion of a link by R = R_LZ into the URDF frame of the link."""
    x, y, z = (R[0], R[1], R[2]), (R[3], R[4], R[5]), (R[6], R[7], R[8])
    turned = in_base(axes_Z, x), in_base(axes_Z, y), in_base(axes_Z, z)
    omega, omega_dot, accel = motion
    new = (x, y, z)
    return turned, (in_frame(new, omega), in_frame(new, omega_dot), in_frame(new, accel))


@simd_inline
def unit_twist(axes_L: Axes, z: Vector, arm: Vector, slides: Any) -> tuple[Vector, Vector]:
    """
    Return the angular velocity of a body, and the velocity of the body's origin.

    The velocities are those at unit rate of a joint, in the frame of the body. ``axes_L`` are
    the axes of the frame, ``z`` is the axis of the joint, and ``arm`` points from the joint's
    origin to the body's origin. The arguments are in base coordinates. ``slides`` is 1.0 for a
    prismatic joint and 0.0 for a revolute joint.

    """
    axis, swept = in_frame(axes_L, z), in_frame(axes_L, cross(z, arm))
    turns = 1.0 - slides
    omega = turns * axis[0], turns * axis[1], turns * axis[2]
    velocity = (
        slides * axis[0] + turns * swept[0],
        slides * axis[1] + turns * swept[1],
        slides * axis[2] + turns * swept[2],
    )
    return omega, velocity


@simd_inline
def block(twist: tuple[Vector, Vector], motion: tuple[Vector, Vector, Vector]) -> Any:
    """
    Return the ten factors that multiply a body's parameters in the effort of a joint.

    ``twist`` contains w and v, the velocities from `unit_twist`. The first moment is h, and the
    inertia about the origin is I. The net force is m accel + omega_dot x h + omega x (omega x h).
    The net moment about the origin is I omega_dot + omega x (I omega) + h x accel. The effort
    w . moment + v . force is linear in m, h and I.

    """
    (w, v), (omega, omega_dot, accel) = twist, motion
    # The net force is a linear map of h. A negative omega_dot gives the transpose of this map.
    backwards = 0.0 - omega_dot[0], 0.0 - omega_dot[1], 0.0 - omega_dot[2]
    h = point_acceleration(v, omega, backwards, cross(accel, w))
    # w . (omega x (I omega)) = u . (I omega)
    u = cross(w, omega)
    return (
        dot(v, accel),
        h[0],
        h[1],
        h[2],
        w[0] * omega_dot[0] + u[0] * omega[0],
        w[0] * omega_dot[1] + w[1] * omega_dot[0] + u[0] * omega[1] + u[1] * omega[0],
        w[1] * omega_dot[1] + u[1] * omega[1],
        w[0] * omega_dot[2] + w[2] * omega_dot[0] + u[0] * omega[2] + u[2] * omega[0],
        w[1] * omega_dot[2] + w[2] * omega_dot[1] + u[1] * omega[2] + u[2] * omega[1],
        w[2] * omega_dot[2] + u[2] * omega[2],
    )


@simd_inline
def add_block(row: Any, first: int, multiplier: float, factors: Any) -> float:
    """Add ``multiplier * factors`` to a row; return 0 if the sums are finite, otherwise NaN."""
    residue = 0.0
    for k in range(PARAMETERS):
        entry = row[first + k] + multiplier * factors[k]
        row[first + k] = entry
        residue += entry - entry
    return residue
