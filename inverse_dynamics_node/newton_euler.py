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
from math import cos, sin, tanh
from typing import Any

from .compilation import compiled, inlined

OK = 0
WRONG_SIZE = 1
NOT_FINITE = 2


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
    n = int(robot[0][23])
    if len(q) != n or len(qd) != n or len(qdd) != n or len(tau) != n:
        return WRONG_SIZE
    outward_pass(q, qd, qdd, robot)
    if robot[0][26] != 0.0:
        # Before the rest, and joint by joint: a caller may give qd or qdd as tau.
        joint_terms(qd, qdd, tau, robot)
    else:
        clear(tau)
    inward_pass(tau, robot)
    return check(tau)


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
    Fill the mass matrix column by column: the efforts of unit accelerations.

    Parameters
    ----------
    q : sequence of n floats
        Joint positions [rad or m].
    zeros, unit : sequence of n zeros
        The second is written to, and left as zeros.
    matrix : n sequences of n floats
        Receives the mass matrix, symmetric to the last bit.
    robot : table from `robot_table`
        Of the robot at rest and without weight, nothing acting on it but armature.

    Returns
    -------
    status : int
        As `inverse_dynamics`.

    """
    status = OK
    for j in range(len(matrix)):
        unit[j] = 1.0
        status = max(status, inverse_dynamics(q, zeros, unit, matrix[j], robot))
        unit[j] = 0.0
        for i in range(j):
            matrix[i][j] = matrix[j][i]
    return status


@compiled
def joint_wrenches(
    q: Sequence[float],
    qd: Sequence[float],
    qdd: Sequence[float],
    tau: Any,
    wrenches: Any,
    robot: Any,
) -> int:
    """
    Find the force and moment that every link gets from its parent, LWP (45), (46).

    Parameters
    ----------
    q, qd, qdd, tau, robot
        As for `inverse_dynamics`; tau is left without joint terms.
    wrenches : b sequences of 6 floats
        Receives force and moment, each in the link's own frame; the base first, whose parent is
        the mount.

    Returns
    -------
    status : int
        As `inverse_dynamics`.

    """
    outward_pass(q, qd, qdd, robot)
    link_wrench(robot[0])
    clear(tau)
    inward_pass(tau, robot)
    for i in range(len(robot)):
        for k in range(6):
            wrenches[i][k] = robot[i][58 + k]
    return check(tau)


@compiled
def outward_pass(
    q: Sequence[float], qd: Sequence[float], qdd: Sequence[float], robot: Any
) -> None:
    """Carry the motion from base to tips, and find the net force and moment on every link."""
    base = robot[0]
    base[58] = base[59] = base[60] = base[61] = base[62] = base[63] = 0.0
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
        v_x, v_y, v_z = parent[49], parent[50], parent[51]
        omega_x = r_xx * v_x + r_yx * v_y + r_zx * v_z
        omega_y = r_xy * v_x + r_yy * v_y + r_zy * v_z
        omega_z = r_xz * v_x + r_yz * v_y + r_zz * v_z
        w_x, w_y, w_z = parent[52], parent[53], parent[54]
        omega_dot_x = r_xx * w_x + r_yx * w_y + r_zx * w_z
        omega_dot_y = r_xy * w_x + r_yy * w_y + r_zy * w_z
        omega_dot_z = r_xz * w_x + r_yz * w_y + r_zz * w_z

        # and of the point of the parent where the joint is, the paper's (40) in the parent's
        # frame: accel_P + omega_dot_P x p + omega_P x (omega_P x p), with omega_P = v here
        u_x = v_y * p_z - v_z * p_y
        u_y = v_z * p_x - v_x * p_z
        u_z = v_x * p_y - v_y * p_x
        a_x = parent[55] + w_y * p_z - w_z * p_y + v_y * u_z - v_z * u_y
        a_y = parent[56] + w_z * p_x - w_x * p_z + v_z * u_x - v_x * u_z
        a_z = parent[57] + w_x * p_y - w_y * p_x + v_x * u_y - v_y * u_x
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

        link[37], link[38], link[39] = r_xx, r_xy, r_xz
        link[40], link[41], link[42] = r_yx, r_yy, r_yz
        link[43], link[44], link[45] = r_zx, r_zy, r_zz
        link[46], link[47], link[48] = p_x, p_y, p_z
        link[49], link[50], link[51] = omega_x, omega_y, omega_z
        link[52], link[53], link[54] = omega_dot_x, omega_dot_y, omega_dot_z
        link[55], link[56], link[57] = accel_x, accel_y, accel_z
        link_wrench(link)


@inlined
def link_wrench(link: Any) -> None:
    """Find the force and moment that a link needs for its own motion, and no other's."""
    omega_x, omega_y, omega_z = link[49], link[50], link[51]
    omega_dot_x, omega_dot_y, omega_dot_z = link[52], link[53], link[54]
    accel_x, accel_y, accel_z = link[55], link[56], link[57]

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

    # The link's own share of (45) and (46), less what the world does to it:
    # force_net and moment_net + c x force_net
    link[58] = force_x - link[27]
    link[59] = force_y - link[28]
    link[60] = force_z - link[29]
    link[61] = moment_x + c_y * force_z - c_z * force_y - link[30]
    link[62] = moment_y + c_z * force_x - c_x * force_z - link[31]
    link[63] = moment_z + c_x * force_y - c_y * force_x - link[32]


@compiled
def inward_pass(tau: Any, robot: Any) -> None:
    """Carry forces and moments from tips to base, and add what joints feel of them to tau."""
    for i in range(len(robot) - 1, 0, -1):
        link = robot[i]
        parent = robot[int(link[22])]
        f_x, f_y, f_z = link[58], link[59], link[60]
        n_x, n_y, n_z = link[61], link[62], link[63]

        # (47), both kinds of joint. A mimic joint's effort folds into its master's: equal power.
        tau[int(link[23])] += link[24] * (f_z if link[26] != 0.0 else n_z)

        # (45) in the parent's frame: R_PL force. The parent sums over all its children: a tree.
        r_xx, r_xy, r_xz = link[37], link[38], link[39]
        r_yx, r_yy, r_yz = link[40], link[41], link[42]
        r_zx, r_zy, r_zz = link[43], link[44], link[45]
        force_x = r_xx * f_x + r_xy * f_y + r_xz * f_z
        force_y = r_yx * f_x + r_yy * f_y + r_yz * f_z
        force_z = r_zx * f_x + r_zy * f_y + r_zz * f_z
        parent[58] += force_x
        parent[59] += force_y
        parent[60] += force_z

        # (46) in the parent's frame, about the parent's origin: R_PL moment + p x (R_PL force)
        p_x, p_y, p_z = link[46], link[47], link[48]
        parent[61] += r_xx * n_x + r_xy * n_y + r_xz * n_z + p_y * force_z - p_z * force_y
        parent[62] += r_yx * n_x + r_yy * n_y + r_yz * n_z + p_z * force_x - p_x * force_z
        parent[63] += r_zx * n_x + r_zy * n_y + r_zz * n_z + p_x * force_y - p_y * force_x


@compiled
def joint_terms(qd: Sequence[float], qdd: Sequence[float], tau: Any, robot: Any) -> None:
    """
    Start tau with what happens at a joint alone: rotor inertia, viscous and Coulomb friction.

    Friction is an internal pair at one joint, and does not reach the joints below it: the authors'
    1980 form, tau = n . z + b qd. LWP (22), (23) of 1979 would pass it on.

    """
    for joint in range(len(tau)):
        row = robot[joint + 1]
        rate = qd[joint]
        tau[joint] = row[33] * qdd[joint] + row[34] * rate
        if row[35] != 0.0:
            tau[joint] += row[35] * tanh(rate * row[36])


@compiled
def clear(tau: Any) -> None:
    """Start tau with nothing."""
    for joint in range(len(tau)):
        tau[joint] = 0.0


@compiled
def check(tau: Any) -> int:
    """Tell whether all efforts are finite; a NaN or infinity in any input reaches some effort."""
    for joint in range(len(tau)):
        if tau[joint] - tau[joint] != 0.0:  # 0 for finite numbers only
            return NOT_FINITE
    return OK
