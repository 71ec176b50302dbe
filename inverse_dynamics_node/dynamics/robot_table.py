"""
The robot as a table with named columns and one row for each body.

The first row belongs to the base. A row contains the properties of the body, the loads on the
body, and scratch memory for the passes. The frame of every body is rotated so that z is the axis
of the body's joint. A vector occupies three columns. The constant named after the vector is the
index of the first column.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..robot.model import Floats, Integers, RobotModel
from .jit import simd_inline

# The body and its joint
ROTATION = 0  # nine columns: R_PL at joint position 0, row by row
OFFSET = 9  # p_PL at joint position 0 [m]
MASS = 12
COM = 13
INERTIA = 16  # six columns, about the centre of mass: xx, xy, xz, yy, yz, zz
PARENT = 22
JOINT = 23
MULTIPLIER = 24
POSITION_OFFSET = 25
SLIDES = 26  # 1.0 for a prismatic joint, 0.0 for a revolute joint
# External loads
EXTERNAL_FORCE = 27  # force that the world exerts on the body [N]
EXTERNAL_MOMENT = 30  # moment that the world exerts about the body's origin [N m]
# Properties of joint k, in row k + 1, because row 0 belongs to the base
STIFFNESS = 33  # stiffness of the spring at the joint [N m/rad or N/m]
PRELOAD = 34  # effort that balances the spring at joint position 0 [N m or N]
COUPLING = 35  # turns of the drive per turn of the previous joint
ARMATURE = 36
DAMPING = 37
COULOMB = 38
INVERSE_WIDTH = 39  # 1 / smoothing width of Coulomb friction [s/rad or s/m]
LOAD_FRICTION = 40  # Coulomb friction per unit of load on the gear
JOINT_BEFORE = 41  # index of the previous joint, from `joints_before`
# Properties of the whole robot, in the row of the base
JOINT_COUNT = 42
HAS_DRIVE_TERMS = 43
HAS_SPRINGS = 44
# Scratch memory of the passes; the row of the base contains the motion of the base
COSINE = 45  # cosine of the angle by which the joint has turned
SINE = 46
LENGTH = 47  # distance by which the joint has slid [m]
OMEGA = 48
OMEGA_DOT = 51
ACCEL = 54
FORCE = 57
MOMENT = 60
RATE = 63  # velocity of joint k, in row k + 1
RATE_DOT = 64
COMPOSITE = 65  # ten columns, used by `mass_matrix` only
POSITION = 75  # origin of the frame, in base coordinates [m]
X_AXIS = 78  # axis of the frame, in base coordinates
Y_AXIS = 81
Z_AXIS = 84
COLUMNS = 87

# Ranges of columns that are set together
EXTERNAL_COLUMNS = slice(EXTERNAL_FORCE, EXTERNAL_MOMENT + 3)
SPRING_COLUMNS = slice(STIFFNESS, PRELOAD + 1)
FRICTION_COLUMNS = slice(DAMPING, LOAD_FRICTION + 1)
LOAD_COLUMNS = slice(EXTERNAL_FORCE, LOAD_FRICTION + 1)  # wrenches, springs, friction, armature
BASE_MOTION_COLUMNS = slice(OMEGA, ACCEL + 3)
BASE_ACCELERATION_COLUMNS = slice(OMEGA_DOT, ACCEL + 3)


@simd_inline
def vector(row: Any, first: int) -> Any:
    """Read a vector from three columns."""
    return row[first], row[first + 1], row[first + 2]


@simd_inline
def store(row: Any, first: int, v: Any) -> None:
    """Write a vector into three columns."""
    row[first], row[first + 1], row[first + 2] = v


@simd_inline
def rotation(row: Any) -> Any:
    """Read the matrix R_PL at joint position 0, in row-major order."""
    k = ROTATION
    return (
        row[k], row[k + 1], row[k + 2],
        row[k + 3], row[k + 4], row[k + 5],
        row[k + 6], row[k + 7], row[k + 8],
    )  # fmt: skip


@simd_inline
def inertia(row: Any) -> Any:
    """Read the inertia about the centre of mass: xx, xy, xz, yy, yz, zz."""
    k = INERTIA
    return row[k], row[k + 1], row[k + 2], row[k + 3], row[k + 4], row[k + 5]


@simd_inline
def joint_of(row: Any) -> Any:
    """Read the indices of parent and joint, the mimic multiplier, and whether the body slides."""
    return int(row[PARENT]), int(row[JOINT]), row[MULTIPLIER], row[SLIDES]


@simd_inline
def frame_of(row: Any) -> Any:
    """Read R_PL and p_PL at joint position 0."""
    return rotation(row), vector(row, OFFSET)


@simd_inline
def body_of(row: Any) -> Any:
    """Read the mass, the centre of mass, and the inertia about the centre of mass."""
    return row[MASS], vector(row, COM), inertia(row)


@simd_inline
def load_of(row: Any) -> Any:
    """Read the force and moment that the world exerts on the body."""
    return vector(row, EXTERNAL_FORCE), vector(row, EXTERNAL_MOMENT)


@simd_inline
def friction_of(row: Any) -> Any:
    """Read viscous, Coulomb and load friction, and the inverse smoothing width."""
    return row[DAMPING], row[COULOMB], row[LOAD_FRICTION], row[INVERSE_WIDTH]


@simd_inline
def coupling_of(row: Any) -> Any:
    """Read the drive coupling, and the index of the previous joint."""
    return row[COUPLING], int(row[JOINT_BEFORE])


@simd_inline
def motion_of(row: Any) -> Any:
    """Read omega, omega_dot and accel of a body."""
    return vector(row, OMEGA), vector(row, OMEGA_DOT), vector(row, ACCEL)


@simd_inline
def wrench_of(row: Any) -> Any:
    """Read the force and moment that the parent exerts on a body."""
    return vector(row, FORCE), vector(row, MOMENT)


@simd_inline
def store_wrench(row: Any, force: Any, moment: Any) -> None:
    """Write the force and moment that the parent exerts on a body."""
    store(row, FORCE, force)
    store(row, MOMENT, moment)


_UPPER = np.triu_indices(3)


def table_of(robot: RobotModel) -> Floats:
    """Make a table, shape (b, COLUMNS), with the base at rest and without gravity or loads."""
    table = np.zeros((len(robot.parent), COLUMNS))
    R_ZL = rotations_to_z(robot)
    R_ZL_of_parent = R_ZL[robot.parent]
    table[:, ROTATION : ROTATION + 9] = (
        R_ZL_of_parent @ robot.R_PL @ R_ZL.transpose(0, 2, 1)
    ).reshape(-1, 9)
    table[:, OFFSET : OFFSET + 3] = np.einsum('kij,kj->ki', R_ZL_of_parent, robot.p_PL)
    for i in range(len(table)):
        write_inertial(table[i], R_ZL[i], robot.mass[i], robot.com[i], robot.inertia[i])
    table[:, PARENT] = robot.parent
    table[:, JOINT] = robot.joint_index
    table[0, JOINT_COUNT] = len(robot.joint_names)
    table[:, MULTIPLIER] = robot.multiplier
    table[:, POSITION_OFFSET] = robot.offset
    table[:, SLIDES] = robot.is_prismatic
    table[1 : 1 + len(robot.joint_names), JOINT_BEFORE] = joints_before(robot)
    return table


def write_inertial(row: Floats, R_ZL: Floats, mass: float, com: Floats, inertia: Floats) -> None:
    """Set the mass, centre of mass and inertia of a body from values in its URDF frame."""
    row[MASS] = mass
    row[COM : COM + 3] = R_ZL @ com
    row[INERTIA : INERTIA + 6] = (R_ZL @ inertia @ R_ZL.T)[_UPPER]


def write_joints(table: Floats, column: int, values: Floats) -> None:
    """Set a column for all joints, and the flags that depend on this column."""
    rows = table[1 : 1 + len(values)]
    rows[:, column] = values
    acting = [ARMATURE, DAMPING, COULOMB, LOAD_FRICTION]
    table[0, HAS_DRIVE_TERMS] = float(rows[:, acting].any())
    table[0, HAS_SPRINGS] = float(rows[:, SPRING_COLUMNS].any())


def write_friction(
    table: Floats,
    damping: Floats,
    coulomb: Floats,
    speeds: Floats,
    load_friction: Floats,
) -> None:
    """Set the friction of all joints; ``speeds`` are the smoothing widths."""
    write_joints(table, DAMPING, damping)
    write_joints(table, COULOMB, coulomb)
    write_joints(table, INVERSE_WIDTH, 1.0 / speeds)
    write_joints(table, LOAD_FRICTION, load_friction)


def write_base(row: Floats, motion: Floats, gravity: Floats) -> None:
    """Set the motion of the base: angular velocity, angular acceleration, linear acceleration."""
    row[BASE_MOTION_COLUMNS] = motion.ravel()
    row[ACCEL : ACCEL + 3] -= gravity  # LWP (31)


def write_external(row: Floats, R_ZL: Floats, wrenches: Sequence[tuple[Floats, Floats]]) -> None:
    """Set the total external force and moment on a body from wrenches in its URDF frame."""
    force, moment = np.sum(wrenches, axis=0)
    row[EXTERNAL_FORCE : EXTERNAL_FORCE + 3] = R_ZL @ force
    row[EXTERNAL_MOMENT : EXTERNAL_MOMENT + 3] = R_ZL @ moment


def joints_before(robot: RobotModel) -> Integers:
    """
    Return the index of the previous joint for each of the n joints, shape (n,).

    The previous joint of joint k moves the parent of the body that joint k moves. The index is -1
    if the parent is the base. The index is also -1 if the parent moves with a mimic joint whose
    master is joint k or a later joint.

    """
    before = np.full(len(robot.joint_names), -1)
    # The first body of a joint with mimic joints decides, because the loop runs backwards.
    for body in range(len(robot.parent) - 1, 0, -1):
        parent, joint = int(robot.parent[body]), int(robot.joint_index[body])
        carrier = int(robot.joint_index[parent]) if parent > 0 else -1
        before[joint] = carrier if carrier < joint else -1
    return before


def rotations_to_z(robot: RobotModel) -> Floats:
    """Return the rotation R_ZL from each body's URDF frame to a frame with z on the joint axis."""
    return np.array([_rotation_of_z_to(axis).T for axis in robot.axis])


def _rotation_of_z_to(axis: Floats) -> Floats:
    """Return a rotation that turns z onto a unit vector; it is exact for +-x, +-y and +-z."""
    if not axis.any():  # the base has no joint
        return np.eye(3)
    if axis[2] < 0.0:  # half a turn about x, because the formula below divides by 1 + z
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
