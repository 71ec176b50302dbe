"""Where the bodies of a robot are, for pictures and words; the dynamics do without."""

from __future__ import annotations

import math

import numpy as np

from .model import Floats, RobotModel


def body_frames(robot: RobotModel, q: Floats) -> tuple[Floats, Floats]:
    """
    Compute where every body is.

    Parameters
    ----------
    robot : RobotModel
        With n joints and b bodies.
    q : ndarray, shape (n,)
        Joint positions [rad or m].

    Returns
    -------
    rotations : ndarray, shape (b, 3, 3)
        From the body's frame to the base's.
    positions : ndarray, shape (b, 3)
        Origins of the bodies in the base's frame [m].

    """
    b = len(robot.parent)
    rotations, positions = np.zeros((b, 3, 3)), np.zeros((b, 3))
    rotations[0] = np.eye(3)
    for body in range(1, b):
        place = robot.multiplier[body] * q[robot.joint_index[body]] + robot.offset[body]
        slide, turn = (place, 0.0) if robot.is_prismatic[body] else (0.0, place)
        parent, R_PL = robot.parent[body], robot.R_PL[body]
        moved = robot.p_PL[body] + R_PL @ (slide * robot.axis[body])
        positions[body] = positions[parent] + rotations[parent] @ moved
        rotations[body] = rotations[parent] @ R_PL @ rotation(robot.axis[body], turn)
    return rotations, positions


def rotation(axis: Floats, angle: float) -> Floats:
    """Return the matrix of a turn about a unit vector, by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Floats = np.eye(3) + math.sin(angle) * cross
    matrix += (1.0 - math.cos(angle)) * (cross @ cross)
    return matrix
