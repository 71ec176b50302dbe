"""
The robot table of the passes: a row for each body, the base first, and a name for each column.

The frame of every body is turned so that its joint's axis is z. A row holds the properties of the
body, the loads on it, and scratch space for the passes. A vector occupies three columns, of which
the first has the name.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..robot.model import Floats, RobotModel
from .jit import simd_inline

# The body and its joint
ROTATION = 0  # nine columns: R_PL at joint position 0, row by row
OFFSET = 9  # p_PL at joint position 0 [m]
MASS = 12
COM = 13
INERTIA = 16  # six columns: about the centre of mass: xx, xy, xz, yy, yz, zz
PARENT = 22
JOINT = 23
MULTIPLIER = 24
POSITION_OFFSET = 25
SLIDES = 26  # 1.0 for a prismatic joint, 0.0 for a revolute one
# External loads
EXTERNAL_FORCE = 27  # that the world exerts on the body [N]
EXTERNAL_MOMENT = 30  # about the body's origin [N m]
# Joint k, in row k + 1 because there are more bodies than joints
ARMATURE = 33
DAMPING = 34
COULOMB = 35
INVERSE_WIDTH = 36  # of the smoothed step of Coulomb friction [s/rad or s/m]
LOAD_FRICTION = 37  # Coulomb friction per effort that the links require
# The robot, in the row of the base
JOINT_COUNT = 38
HAS_DRIVE_TERMS = 39
# Scratch space of the passes, except for the motion of the base, which is an input
COSINE = 40  # of the angle by which the joint has turned
SINE = 41
LENGTH = 42  # by which the joint has slid [m]
OMEGA = 43
OMEGA_DOT = 46
ACCEL = 49
FORCE = 52
MOMENT = 55
RATE = 58  # of joint k
RATE_DOT = 59
COMPOSITE = 60  # ten columns, used by `mass_matrix` only
POSITION = 70  # of the frame's origin in the base; the passes use neither this nor the axes
X_AXIS = 73  # of the frame, in coordinates of the base
Y_AXIS = 76
Z_AXIS = 79
COLUMNS = 82

# Ranges of columns, to set them together
COM_COLUMNS = slice(COM, COM + 3)
INERTIA_COLUMNS = slice(INERTIA, INERTIA + 6)
EXTERNAL_COLUMNS = slice(EXTERNAL_FORCE, EXTERNAL_MOMENT + 3)
DRIVE_TERM_COLUMNS = slice(ARMATURE, LOAD_FRICTION + 1)
BASE_MOTION_COLUMNS = slice(OMEGA, ACCEL + 3)
BASE_ACCELERATION_COLUMNS = slice(OMEGA_DOT, ACCEL + 3)


@simd_inline
def vector(row: Any, first: int) -> Any:
    """Read three columns."""
    return row[first], row[first + 1], row[first + 2]


@simd_inline
def store(row: Any, first: int, v: Any) -> None:
    """Write three columns."""
    row[first], row[first + 1], row[first + 2] = v


@simd_inline
def rotation(row: Any) -> Any:
    """Read R_PL at joint position 0, row by row."""
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
    """Read the indices of parent and joint, the multiplier, and whether the body slides."""
    return int(row[PARENT]), int(row[JOINT]), row[MULTIPLIER], row[SLIDES]


@simd_inline
def frame_of(row: Any) -> Any:
    """Read R_PL and p_PL at joint position 0."""
    return rotation(row), vector(row, OFFSET)


@simd_inline
def body_of(row: Any) -> Any:
    """Read the mass, the centre of mass, and the inertia about it."""
    return row[MASS], vector(row, COM), inertia(row)


@simd_inline
def load_of(row: Any) -> Any:
    """Read the force and moment that the world exerts on the body."""
    return vector(row, EXTERNAL_FORCE), vector(row, EXTERNAL_MOMENT)


@simd_inline
def friction_of(row: Any) -> Any:
    """Read the damping, Coulomb friction, load friction, and inverse width of the step."""
    return row[DAMPING], row[COULOMB], row[LOAD_FRICTION], row[INVERSE_WIDTH]


@simd_inline
def place_of(row: Any) -> Any:
    """Read how far the link has turned and slid: cosine, sine, length."""
    return row[COSINE], row[SINE], row[LENGTH]


@simd_inline
def motion_of(row: Any) -> Any:
    """Read omega, omega_dot and accel."""
    return vector(row, OMEGA), vector(row, OMEGA_DOT), vector(row, ACCEL)


@simd_inline
def wrench_of(row: Any) -> Any:
    """Read force and moment."""
    return vector(row, FORCE), vector(row, MOMENT)


@simd_inline
def store_wrench(row: Any, force: Any, moment: Any) -> None:
    """Write force and moment."""
    store(row, FORCE, force)
    store(row, MOMENT, moment)


_UPPER = np.triu_indices(3)


def table_of(robot: RobotModel) -> Floats:
    """
    Make the table of a robot at rest, without gravity and without loads.

    Returns
    -------
    table : ndarray, shape (b, COLUMNS)
        The argument ``robot`` of the functions in `newton_euler`, and their scratch space.

    """
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
    return table


def write_inertial(row: Floats, R_ZL: Floats, mass: float, com: Floats, inertia: Floats) -> None:
    """Set a body's mass, centre of mass and inertia about it, given in the frame of the URDF."""
    row[MASS] = mass
    row[COM : COM + 3] = R_ZL @ com
    row[INERTIA : INERTIA + 6] = (R_ZL @ inertia @ R_ZL.T)[_UPPER]


def write_joints(table: Floats, column: int, values: Floats) -> None:
    """Set a column of all joints."""
    rows = table[1 : 1 + len(values)]
    rows[:, column] = values
    table[0, HAS_DRIVE_TERMS] = float(rows[:, [ARMATURE, DAMPING, COULOMB, LOAD_FRICTION]].any())


def write_friction(
    table: Floats, damping: Floats, coulomb: Floats, speeds: Floats, load_friction: Floats
) -> None:
    """Set the friction of all joints, with the speeds over which its step is smoothed."""
    write_joints(table, DAMPING, damping)
    write_joints(table, COULOMB, coulomb)
    # Zero where it has no effect, so that it does not look like a load to generated code.
    inverse = np.where((coulomb > 0.0) | (load_friction > 0.0), 1.0 / speeds, 0.0)
    write_joints(table, INVERSE_WIDTH, inverse)
    write_joints(table, LOAD_FRICTION, load_friction)


def write_base(row: Floats, motion: Floats, gravity: Floats) -> None:
    """Set the motion of the base: angular velocity, angular and linear acceleration."""
    row[BASE_MOTION_COLUMNS] = motion.ravel()
    row[ACCEL : ACCEL + 3] -= gravity  # LWP (31)


def write_external(row: Floats, R_ZL: Floats, wrenches: Sequence[tuple[Floats, Floats]]) -> None:
    """Set the sum of forces and moments on a body, given in the frame of the URDF."""
    store(row, EXTERNAL_FORCE, R_ZL @ sum((f for f, _ in wrenches), np.zeros(3)))
    store(row, EXTERNAL_MOMENT, R_ZL @ sum((n for _, n in wrenches), np.zeros(3)))


def rotations_to_z(robot: RobotModel) -> Floats:
    """Return R_ZL of every body: from the URDF's frame (L) to the one with z on the axis (Z)."""
    return np.array([_rotation_of_z_to(axis).T for axis in robot.axis])


def _rotation_of_z_to(axis: Floats) -> Floats:
    """Return a rotation of z onto a unit vector, exact if that is +-x, +-y or +-z."""
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
