"""Poses of the bodies of a robot, and rotation matrices. The dynamics do not use them."""

from __future__ import annotations

import math

import numpy as np

from .model import Floats, RobotModel


def body_frames(robot: RobotModel, q: Floats) -> tuple[Floats, Floats]:
    """
    Compute the poses of all bodies.

    Parameters
    ----------
    robot : RobotModel
        With n joints and b bodies.
    q : ndarray, shape (n,)
        Joint positions [rad or m].

    Returns
    -------
    rotations : ndarray, shape (b, 3, 3)
        Rotations from the body frames to the base frame.
    positions : ndarray, shape (b, 3)
        Origins of the body frames in the base frame [m].

    """
    b = len(robot.parent)
    rotations, positions = np.zeros((b, 3, 3)), np.zeros((b, 3))
    rotations[0] = np.eye(3)
    for body in range(1, b):
        position = robot.multiplier[body] * q[robot.joint_index[body]] + robot.offset[body]
        distance, angle = (position, 0.0) if robot.is_prismatic[body] else (0.0, position)
        parent, R_PL = robot.parent[body], robot.R_PL[body]
        origin = robot.p_PL[body] + R_PL @ (distance * robot.axis[body])
        positions[body] = positions[parent] + rotations[parent] @ origin
        rotations[body] = rotations[parent] @ R_PL @ rotation_about(robot.axis[body], angle)
    return rotations, positions


def moving_points(robot: RobotModel, q: Floats, direction: Floats) -> Floats:
    """
    Compute the positions of links and centres of mass in many poses, along one direction.

    Parameters
    ----------
    robot : RobotModel
        With n joints.
    q : ndarray, shape (k, n)
        Joint positions [rad or m].
    direction : ndarray, shape (3,)
        Unit vector in the base frame.

    Returns
    -------
    distances : ndarray, shape (k, p)
        From the origin of the base frame along the direction [m]: of the origins of all links
        that joints move, and of the centres of mass of bodies with a mass.

    """
    # The direction in the frame of each body, and the distance of its origin
    directions: list[Floats] = [np.tile(direction, (len(q), 1))]
    distances: list[Floats] = [np.zeros(len(q))]
    points = []
    for body in range(1, len(robot.parent)):
        parent, axis = robot.parent[body], robot.axis[body]
        place = robot.multiplier[body] * q[:, robot.joint_index[body]] + robot.offset[body]
        x, y, z = axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        distance = distances[parent] + directions[parent] @ robot.p_PL[body]
        along = directions[parent] @ robot.R_PL[body]
        if robot.is_prismatic[body]:
            distance = distance + place * (along @ axis)
        else:
            across = along @ cross
            sine, cosine = np.sin(place)[:, np.newaxis], np.cos(place)[:, np.newaxis]
            along = along + sine * across + (1.0 - cosine) * (across @ cross)
        directions.append(along)
        distances.append(distance)
        places = [robot.link_position[robot.link_body == body]]
        if robot.mass[body] > 0.0:
            places.append(robot.com[body][np.newaxis])
        points.append(distance[:, np.newaxis] + along @ np.concatenate(places).T)
    return np.concatenate(points, axis=1)


def rotation_about(axis: Floats, angle: float) -> Floats:
    """Return the matrix of a rotation about a unit vector [rad], by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Floats = np.eye(3) + math.sin(angle) * cross
    matrix += (1.0 - math.cos(angle)) * (cross @ cross)
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
    Convert the value of ``quat_xyzw`` to the value of ``rpy`` that means the same rotation.

    Parameters
    ----------
    text : str
        Four numbers x, y, z, w; not all zero. They are normalised.

    Returns
    -------
    rpy : str
        Roll, pitch and yaw [rad] about the fixed axes x, y and z.

    """
    values = [float(word) for word in text.split()]
    norm = math.hypot(*values)
    x, y, z, w = (value / norm for value in values)
    # R = Rz(yaw) Ry(pitch) Rx(roll). Near a pitch of 90 degrees only the sum or the difference of
    # roll and yaw is well defined. Any yaw is correct there, provided that the roll is computed
    # from it: from the rotation that is left after turning back by yaw.
    r00, r10 = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    r01, r11 = 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z)
    r02, r12, r20 = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 2.0 * (x * z - w * y)
    yaw = math.atan2(r10, r00)
    cos, sin = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-r20, cos * r00 + sin * r10)
    roll = math.atan2(sin * r02 - cos * r12, cos * r11 - sin * r01)
    return f'{roll!r} {pitch!r} {yaw!r}'
