"""
A robot laid out for the passes of `newton_euler`: one table, a row a body, the base first.

The frame of every body is turned so that its joint's axis is z. A row holds what the body is, what
acts on it, and room for what the passes find. The passes name columns by number; here is what the
numbers mean.
"""

from __future__ import annotations

import numpy as np

from .model import Floats, RobotModel

ROTATION = slice(0, 9)  # R_PL at position 0, row by row
OFFSET = slice(9, 12)  # p_PL at position 0 [m]
MASS = 12
COM = slice(13, 16)
INERTIA = slice(16, 22)  # about the centre of mass: xx, xy, xz, yy, yz, zz
PARENT = 22
JOINT = 23  # of the base: how many joints there are
MULTIPLIER = 24
POSITION_OFFSET = 25
IS_PRISMATIC = 26
EXTERNAL_FORCE = slice(27, 30)  # that the world exerts on the body [N]
EXTERNAL_MOMENT = slice(30, 33)  # about the body's origin [N m]
EXTERNAL = slice(27, 33)
# Of joint k in row k + 1, for there are more bodies than joints:
ARMATURE = 33
DAMPING = 34
COULOMB = 35
INVERSE_WIDTH = 36  # of the smoothed step of Coulomb friction [s/rad or s/m]
JOINT_TERMS = slice(33, 37)
HAS_JOINT_TERMS = 26  # of the base, which has no joint to slide along
# What the passes find: R_PL 37-45 and p_PL 46-48 now, and
OMEGA = slice(49, 52)
OMEGA_DOT = slice(52, 55)
ACCEL = slice(55, 58)
BASE_MOTION = slice(49, 58)  # of the base they are inputs
FORCE = slice(58, 61)
MOMENT = slice(61, 64)
COLUMNS = 64  # 512 bytes

_UPPER = np.triu_indices(3)


def robot_table(robot: RobotModel) -> Floats:
    """
    Lay out a robot at rest and without weight, nothing acting on it.

    Returns
    -------
    table : ndarray, shape (b, 64)
        The argument ``robot`` of the functions in `newton_euler`, and their scratch space.

    """
    table = np.zeros((len(robot.parent), COLUMNS))
    R_ZL = rotations_to_z(robot)
    R_ZL_of_parent = R_ZL[robot.parent]
    table[:, ROTATION] = (R_ZL_of_parent @ robot.R_PL @ R_ZL.transpose(0, 2, 1)).reshape(-1, 9)
    table[:, OFFSET] = rotate(R_ZL_of_parent, robot.p_PL)
    for i in range(len(table)):
        write_inertial(table[i], R_ZL[i], robot.mass[i], robot.com[i], robot.inertia[i])
    table[:, PARENT] = robot.parent
    table[:, JOINT] = robot.joint_index
    table[0, JOINT] = len(robot.joint_names)
    table[:, MULTIPLIER] = robot.multiplier
    table[:, POSITION_OFFSET] = robot.offset
    table[:, IS_PRISMATIC] = robot.is_prismatic
    return table


def write_inertial(row: Floats, R_ZL: Floats, mass: float, com: Floats, inertia: Floats) -> None:
    """Give a body its mass, centre of mass and inertia about that, both in the URDF's frame."""
    row[MASS] = mass
    row[COM] = R_ZL @ com
    row[INERTIA] = (R_ZL @ inertia @ R_ZL.T)[_UPPER]


def rotations_to_z(robot: RobotModel) -> Floats:
    """Return R_ZL of every body: from the URDF's frame (L) to the one with z on the axis (Z)."""
    return np.array([_rotation_of_z_to(axis).T for axis in robot.axis])


def rotate(rotations: Floats, vectors: Floats) -> Floats:
    """Turn every vector by its rotation: shapes (b, 3, 3) and (b, 3)."""
    return np.asarray(np.einsum('kij,kj->ki', rotations, vectors))


def _rotation_of_z_to(axis: Floats) -> Floats:
    """Turn z onto a unit vector; without rounding where the axis is x, y, z or its opposite."""
    if not axis.any():  # the base has no joint
        return np.eye(3)
    if axis[2] < 0.0:  # half a turn about x first keeps the formula below well conditioned
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
