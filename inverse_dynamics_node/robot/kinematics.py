"""Poses of the bodies of a robot, and rotation matrices. The dynamics do not use this module."""

from __future__ import annotations

import math

import numpy as np

from .model import Floats, RobotModel


def body_frames(robot: RobotModel, q: Floats) -> tuple[Floats, Floats]:
    """
    Return rotations and origins [m] of the frames of all b bodies, in the base frame.

    If the positions of n joints have the shape (..., n) [rad or m], the rotations have the shape
    (..., b, 3, 3), and the origins have the shape (..., b, 3).

    """
    b, shape = len(robot.parent), q.shape[:-1]
    rotations, positions = np.zeros((*shape, b, 3, 3)), np.zeros((*shape, b, 3))
    rotations[..., 0, :, :] = np.eye(3)
    for body in range(1, b):
        place = robot.multiplier[body] * q[..., robot.joint_index[body]] + robot.offset[body]
        parent, axis = robot.parent[body], robot.axis[body]
        R = rotations[..., parent, :, :] @ robot.R_PL[body]
        p = positions[..., parent, :] + rotations[..., parent, :, :] @ robot.p_PL[body]
        if robot.is_prismatic[body]:
            p = p + place[..., np.newaxis] * (R @ axis)
        else:
            R = R @ rotation_about(axis, place)
        rotations[..., body, :, :], positions[..., body, :] = R, p
    return rotations, positions


def rotation_about(axis: Floats, angle: float | Floats) -> Floats:
    """Return the matrices of rotations about a unit vector [rad], from Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle)[..., np.newaxis, np.newaxis]
    matrix: Floats = np.eye(3) + np.sin(angle) * cross
    matrix += (1.0 - np.cos(angle)) * (cross @ cross)
    return matrix


def rotation_of_rpy(roll: float, pitch: float, yaw: float) -> Floats:
    """Return the rotation about the fixed axes x, then y, then z, as in a URDF [rad]."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_of_quaternion(text: str) -> str:
    """
    Convert ``quat_xyzw`` to ``rpy``: roll, pitch and yaw about the fixed axes x, y, z [rad].

    The text contains four numbers x, y, z, w, which are not all zero. They are normalised.

    """
    values = [float(word) for word in text.split()]
    norm = math.hypot(*values)
    x, y, z, w = (value / norm for value in values)
    # R = Rz(yaw) Ry(pitch) Rx(roll). Near a pitch of 90 degrees, only the sum or the difference of
    # roll and yaw is well defined. Any yaw is correct there, because the roll is computed from the
    # rotation that remains without this yaw.
    r00, r10 = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    r01, r11 = 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z)
    r02, r12, r20 = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 2.0 * (x * z - w * y)
    yaw = math.atan2(r10, r00)
    cos, sin = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-r20, cos * r00 + sin * r10)
    roll = math.atan2(sin * r02 - cos * r12, cos * r11 - sin * r01)
    return f'{roll!r} {pitch!r} {yaw!r}'
