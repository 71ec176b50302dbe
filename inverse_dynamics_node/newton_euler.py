r"""
The two passes of Luh, Walker and Paul, each link in its own frame.

Cited as LWP, with the equation numbers of the 1979 paper:

    J. Y. S. Luh, M. W. Walker, R. P. C. Paul, "Newton-Euler formulation of manipulator dynamics
    for computer control", IFAC, 1979, 165-172.

=============  ================================================================  ============
name here      meaning, in coordinates of the link's own frame                   unit
=============  ================================================================  ============
omega          angular velocity of the link                                      rad/s
omega_dot      angular acceleration of the link                                  rad/s^2
accel          acceleration of the link's origin, minus gravity                  m/s^2
accel_com      acceleration of the link's centre of mass, minus gravity          m/s^2
force_net      resultant force on the link                                       N
moment_net     resultant moment on the link, about its centre of mass            N m
force          force that the parent exerts on the link                          N
moment         moment that the parent exerts on the link, about its own origin   N m
=============  ================================================================  ============

Gravity is no term of its own: the base accelerates with -g (LWP 31), and every link inherits it.

Frames differ from the paper's in one way: joint i turns or slides along the z axis of link i's own
frame, where the paper's Denavit-Hartenberg frames put it on the link before. So the offset p from
the parent's origin is constant in the parent's frame (a sliding joint adds q along its axis), and
moments are taken about the link's own origin.

The functions are compiled by numba where it is installed and run as they stand where it is not.
For both to be fast they take a robot as one table, a row a body (an array for numba, a list of
lists for Python), and keep vectors as three scalars: ``omega_x, omega_y, omega_z``.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import Any

import numpy as np

from .compilation import compiled
from .model import Floats, RobotModel

# Columns of a robot's row, by number in the passes: what the body is ...
_ROTATION = slice(0, 9)  # R_PL at position 0, row by row
_OFFSET = slice(9, 12)  # p_PL at position 0
_MASS = 12
_COM = slice(13, 16)
_INERTIA = slice(16, 22)  # xx, xy, xz, yy, yz, zz
_PARENT = 22
_JOINT = 23
_MULTIPLIER = 24
_POSITION_OFFSET = 25
_IS_PRISMATIC = 26
# ... and what the passes leave in it: R_PL 27-35 and p_PL 36-38 now, then
OMEGA = slice(39, 42)
OMEGA_DOT = slice(42, 45)
ACCEL = slice(45, 48)
FORCE = slice(48, 51)
MOMENT = slice(51, 54)
_COLUMNS = 54

OK = 0
WRONG_SIZE = 1
NOT_FINITE = 2


def robot_table(robot: RobotModel, gravity: Floats) -> Floats:
    """
    Lay a robot out for the passes, its frames turned so that every joint axis is z.

    Parameters
    ----------
    robot : RobotModel
        The robot, with b bodies.
    gravity : ndarray, shape (3,)
        Free-fall acceleration in the base frame [m/s^2].

    Returns
    -------
    table : ndarray, shape (b, columns)
        The argument ``robot`` of the functions below, which use it as their scratch space too.

    """
    table = np.zeros((len(robot.parent), _COLUMNS))
    # R_LZ takes coordinates from the frame with z on the axis (Z) to the URDF's frame (L).
    R_LZ = np.array([_rotation_of_z_to(axis) for axis in robot.axis])
    R_ZL = R_LZ.transpose(0, 2, 1)
    R_ZL_of_parent = R_ZL[robot.parent]
    inertia = R_ZL @ robot.inertia @ R_LZ
    upper = np.triu_indices(3)
    table[:, _ROTATION] = (R_ZL_of_parent @ robot.R_PL @ R_LZ).reshape(-1, 9)
    table[:, _OFFSET] = _rotate(R_ZL_of_parent, robot.p_PL)
    table[:, _MASS] = robot.mass
    table[:, _COM] = _rotate(R_ZL, robot.com)
    table[:, _INERTIA] = inertia[:, upper[0], upper[1]]
    table[:, _PARENT] = robot.parent
    table[:, _JOINT] = robot.joint_index
    table[:, _MULTIPLIER] = robot.multiplier
    table[:, _POSITION_OFFSET] = robot.offset
    table[:, _IS_PRISMATIC] = robot.is_prismatic
    table[0, _JOINT] = len(robot.joint_names)  # what every vector's length is checked against
    table[0, ACCEL] = -gravity  # LWP (31)
    return table


def _rotate(rotations: Floats, vectors: Floats) -> Floats:
    return np.asarray(np.einsum('kij,kj->ki', rotations, vectors))


def _rotation_of_z_to(axis: Floats) -> Floats:
    """Rotate z onto a unit vector; without rounding where the axis is x, y, z or its opposite."""
    if not axis.any():  # the base has no joint
        return np.eye(3)
    if (
        axis[2] < 0.0
    ):  # half a turn about x first, so that the formula below stays well conditioned
        half_turn = np.diag([1.0, -1.0, -1.0])
        return np.asarray(half_turn @ _rotation_of_z_to(half_turn @ axis))
    x, y, z = axis
    k = 1.0 / (1.0 + z)
    return np.array(
        [
            [1.0 - k * x * x, -k * x * y, x],
            [-k * x * y, 1.0 - k * y * y, y],
            [-x, -y, z],
        ]
    )


@compiled
def inverse_dynamics(
    q: Sequence[float],
    qd: Sequence[float],
    qdd: Sequence[float],
    tau: Any,
    robot: Any,
) -> int:
    """
    Compute the joint efforts that produce the joint accelerations, LWP (36)-(47).

    Parameters
    ----------
    q, qd, qdd : sequence of n floats
        Joint positions [rad or m], velocities [rad/s or m/s] and accelerations.
    tau : sequence of n floats
        Receives the joint efforts [N m or N].
    robot : table from `robot_table`
        The motion of the base stands in row 0.

    Returns
    -------
    status : int
        `OK`, `WRONG_SIZE` (then tau is untouched) or `NOT_FINITE`.

    """
    n = int(robot[0][_JOINT])
    if len(q) != n or len(qd) != n or len(qdd) != n or len(tau) != n:
        return WRONG_SIZE
    outward_pass(q, qd, qdd, robot)
    return inward_pass(tau, robot)


@compiled
def inverse_dynamics_batch(q: Any, qd: Any, qdd: Any, tau: Any, robot: Any) -> int:
    """Do `inverse_dynamics` for every row of the arguments; return the first failure."""
    for k in range(len(tau)):
        status = inverse_dynamics(q[k], qd[k], qdd[k], tau[k], robot)
        if status != OK:
            return status
    return OK


@compiled
def mass_matrix(
    q: Sequence[float],
    zeros: Sequence[float],
    unit: Any,
    matrix: Any,
    robot: Any,
) -> int:
    """
    Fill the mass matrix column by column: efforts of unit accelerations, at rest, weightless.

    Parameters
    ----------
    q : sequence of n floats
        Joint positions [rad or m].
    zeros, unit : sequence of n zeros
        The second is written to, and left as zeros.
    matrix : n sequences of n floats
        Receives the mass matrix, symmetric to the last bit.
    robot : table from `robot_table`
        Left as it was.

    Returns
    -------
    status : int
        As `inverse_dynamics`.

    """
    base = robot[0]
    a_x, a_y, a_z = base[45], base[46], base[47]
    base[45] = base[46] = base[47] = 0.0
    status = OK
    for j in range(len(matrix)):
        unit[j] = 1.0
        status = max(status, inverse_dynamics(q, zeros, unit, matrix[j], robot))
        unit[j] = 0.0
        for i in range(j):
            matrix[i][j] = matrix[j][i]
    base[45], base[46], base[47] = a_x, a_y, a_z
    return status


@compiled
def outward_pass(
    q: Sequence[float], qd: Sequence[float], qdd: Sequence[float], robot: Any
) -> None:
    """Carry the motion from base to tips, and find the net force and moment on every link."""
    base = robot[0]
    base[48] = base[49] = base[50] = base[51] = base[52] = base[53] = 0.0
    for i in range(1, len(robot)):
        link = robot[i]
        parent = robot[int(link[22])]
        joint, multiplier = int(link[23]), link[24]
        position = multiplier * q[joint] + link[25]
        rate = multiplier * qd[joint]
        rate_dot = multiplier * qdd[joint]

        # Where the link is: R_PL turns with a revolute joint, p_PL grows with a prismatic one.
        r_xx, r_xy, r_xz = link[0], link[1], link[2]
        r_yx, r_yy, r_yz = link[3], link[4], link[5]
        r_zx, r_zy, r_zz = link[6], link[7], link[8]
        p_x, p_y, p_z = link[9], link[10], link[11]
        slides = link[26] != 0.0
        if slides:
            p_x += r_xz * position
            p_y += r_yz * position
            p_z += r_zz * position
        else:
            c, s = cos(position), sin(position)
            r_xx, r_xy = c * r_xx + s * r_xy, c * r_xy - s * r_xx
            r_yx, r_yy = c * r_yx + s * r_yy, c * r_yy - s * r_yx
            r_zx, r_zy = c * r_zx + s * r_zy, c * r_zy - s * r_zx

        # The parent's motion, in the link's frame: R_LP omega_P, R_LP omega_dot_P
        v_x, v_y, v_z = parent[39], parent[40], parent[41]
        omega_x = r_xx * v_x + r_yx * v_y + r_zx * v_z
        omega_y = r_xy * v_x + r_yy * v_y + r_zy * v_z
        omega_z = r_xz * v_x + r_yz * v_y + r_zz * v_z
        w_x, w_y, w_z = parent[42], parent[43], parent[44]
        omega_dot_x = r_xx * w_x + r_yx * w_y + r_zx * w_z
        omega_dot_y = r_xy * w_x + r_yy * w_y + r_zy * w_z
        omega_dot_z = r_xz * w_x + r_yz * w_y + r_zz * w_z

        # and of the point of the parent where the joint is, the paper's (40) in the parent's
        # frame: accel_P + omega_dot_P x p + omega_P x (omega_P x p), with omega_P = v here
        u_x = v_y * p_z - v_z * p_y
        u_y = v_z * p_x - v_x * p_z
        u_z = v_x * p_y - v_y * p_x
        a_x = parent[45] + w_y * p_z - w_z * p_y + v_y * u_z - v_z * u_y
        a_y = parent[46] + w_z * p_x - w_x * p_z + v_z * u_x - v_x * u_z
        a_z = parent[47] + w_x * p_y - w_y * p_x + v_x * u_y - v_y * u_x
        accel_x = r_xx * a_x + r_yx * a_y + r_zx * a_z
        accel_y = r_xy * a_x + r_yy * a_y + r_zy * a_z
        accel_z = r_xz * a_x + r_yz * a_y + r_zz * a_z

        if slides:
            # (40): z qdd + 2 omega x z qd
            accel_x += 2.0 * omega_y * rate
            accel_y -= 2.0 * omega_x * rate
            accel_z += rate_dot
        else:
            # (37): z qdd + omega_P x z qd, then (36): z qd
            omega_dot_x += omega_y * rate
            omega_dot_y -= omega_x * rate
            omega_dot_z += rate_dot
            omega_z += rate

        # (44) accel_com = accel + omega_dot x c + omega x (omega x c)
        mass, c_x, c_y, c_z = link[12], link[13], link[14], link[15]
        u_x = omega_y * c_z - omega_z * c_y
        u_y = omega_z * c_x - omega_x * c_z
        u_z = omega_x * c_y - omega_y * c_x
        a_x = accel_x + omega_dot_y * c_z - omega_dot_z * c_y + omega_y * u_z - omega_z * u_y
        a_y = accel_y + omega_dot_z * c_x - omega_dot_x * c_z + omega_z * u_x - omega_x * u_z
        a_z = accel_z + omega_dot_x * c_y - omega_dot_y * c_x + omega_x * u_y - omega_y * u_x

        # (41) force_net = m accel_com
        force_x = mass * a_x
        force_y = mass * a_y
        force_z = mass * a_z

        # (42) moment_net = J omega_dot + omega x (J omega)
        j_xx, j_xy, j_xz = link[16], link[17], link[18]
        j_yy, j_yz, j_zz = link[19], link[20], link[21]
        h_x = j_xx * omega_x + j_xy * omega_y + j_xz * omega_z
        h_y = j_xy * omega_x + j_yy * omega_y + j_yz * omega_z
        h_z = j_xz * omega_x + j_yz * omega_y + j_zz * omega_z
        moment_x = (j_xx * omega_dot_x + j_xy * omega_dot_y + j_xz * omega_dot_z) + (
            omega_y * h_z - omega_z * h_y
        )
        moment_y = (j_xy * omega_dot_x + j_yy * omega_dot_y + j_yz * omega_dot_z) + (
            omega_z * h_x - omega_x * h_z
        )
        moment_z = (j_xz * omega_dot_x + j_yz * omega_dot_y + j_zz * omega_dot_z) + (
            omega_x * h_y - omega_y * h_x
        )

        link[27], link[28], link[29] = r_xx, r_xy, r_xz
        link[30], link[31], link[32] = r_yx, r_yy, r_yz
        link[33], link[34], link[35] = r_zx, r_zy, r_zz
        link[36], link[37], link[38] = p_x, p_y, p_z
        link[39], link[40], link[41] = omega_x, omega_y, omega_z
        link[42], link[43], link[44] = omega_dot_x, omega_dot_y, omega_dot_z
        link[45], link[46], link[47] = accel_x, accel_y, accel_z
        # The link's own share of (45) and (46): force_net, moment_net + c x force_net
        link[48], link[49], link[50] = force_x, force_y, force_z
        link[51] = moment_x + c_y * force_z - c_z * force_y
        link[52] = moment_y + c_z * force_x - c_x * force_z
        link[53] = moment_z + c_x * force_y - c_y * force_x


@compiled
def inward_pass(tau: Any, robot: Any) -> int:
    """Carry forces and moments from tips to base, and project them onto the joint axes."""
    for joint in range(len(tau)):
        tau[joint] = 0.0
    for i in range(len(robot) - 1, 0, -1):
        link = robot[i]
        parent = robot[int(link[22])]
        f_x, f_y, f_z = link[48], link[49], link[50]
        n_x, n_y, n_z = link[51], link[52], link[53]

        # (47), both kinds of joint. A mimic joint's effort folds into its master's: equal power.
        tau[int(link[23])] += link[24] * (f_z if link[26] != 0.0 else n_z)

        # (45) in the parent's frame: R_PL force. The parent sums over all its children: a tree.
        r_xx, r_xy, r_xz = link[27], link[28], link[29]
        r_yx, r_yy, r_yz = link[30], link[31], link[32]
        r_zx, r_zy, r_zz = link[33], link[34], link[35]
        force_x = r_xx * f_x + r_xy * f_y + r_xz * f_z
        force_y = r_yx * f_x + r_yy * f_y + r_yz * f_z
        force_z = r_zx * f_x + r_zy * f_y + r_zz * f_z
        parent[48] += force_x
        parent[49] += force_y
        parent[50] += force_z

        # (46) in the parent's frame, about the parent's origin: R_PL moment + p x (R_PL force)
        p_x, p_y, p_z = link[36], link[37], link[38]
        parent[51] += r_xx * n_x + r_xy * n_y + r_xz * n_z + p_y * force_z - p_z * force_y
        parent[52] += r_yx * n_x + r_yy * n_y + r_yz * n_z + p_z * force_x - p_x * force_z
        parent[53] += r_zx * n_x + r_zy * n_y + r_zz * n_z + p_x * force_y - p_y * force_x

    # A NaN or infinity in any input reaches some effort, and x - x is 0 for finite x only.
    for joint in range(len(tau)):
        if tau[joint] - tau[joint] != 0.0:
            return NOT_FINITE
    return OK
