"""The kinematic tree of a robot: paths, frames, and the link that carries a payload."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
import re

import numpy as np

from .model import Booleans, Floats, RobotModel

_FINGER = re.compile('finger|thumb|gripper|knuckle|jaw|claw', re.IGNORECASE)
_TOOL = re.compile('tool|tcp|gripper|hand|flange|eef|effector|(^|_)ee($|_)', re.IGNORECASE)
_SENSOR = re.compile('camera|optical|imu|lidar|laser|sensor|depth', re.IGNORECASE)
_FINGER_FRACTION = 0.3
"""A branch shorter than this fraction of the whole chain is a finger."""


def whole_turns(way: Floats, is_continuous: Booleans) -> Floats:
    """Return the whole turns in ways of joints [rad]; 0 for joints that are not continuous."""
    turns: Floats = np.where(is_continuous, 2.0 * math.pi * np.round(way / (2.0 * math.pi)), 0.0)
    return turns


def path_to(robot: RobotModel, body: int) -> list[int]:
    """Return the bodies on the path from the base to a body, without the base."""
    path: list[int] = []
    while body > 0:
        path.insert(0, body)
        body = int(robot.parent[body])
    return path


def body_frames(robot: RobotModel, q: Floats) -> tuple[Floats, Floats]:
    """
    Return the rotations and the origins of all b body frames, in the base frame.

    The positions ``q`` of the joints have shape (..., n) [rad or m]. The rotations have shape
    (..., b, 3, 3), and the origins have shape (..., b, 3) [m].

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
    """Return rotation matrices for angles [rad] about a unit vector (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle)[..., np.newaxis, np.newaxis]
    matrix: Floats = np.eye(3) + np.sin(angle) * cross
    matrix += (1.0 - np.cos(angle)) * (cross @ cross)
    return matrix


def rotation_of_rpy(roll: float, pitch: float, yaw: float) -> Floats:
    """Return the rotation matrix for roll, pitch and yaw [rad] as in a URDF."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotation_of_origin(attributes: Mapping[str, str]) -> Floats:
    """Return the rotation matrix for the attributes of an ``<origin>``."""
    return rotation_of_rpy(*(float(word) for word in attributes.get('rpy', '0 0 0').split()))


# ---- The link that carries a payload -------------------------------------------------------


def last_link(robot: RobotModel) -> str:
    """
    Return the link that probably carries a payload.

    The result is ``tool0`` if this link exists. Otherwise, the result is a link of the last body
    in the longest chain: preferably a gripper or tool by its name, and not a camera or other
    sensor. Fingers at the end of the chain are ignored.

    """
    if 'tool0' in robot.link_names:
        return 'tool0'
    chain = max((path_to(robot, body) for body in range(len(robot.parent))), key=len)
    body = _without_fingers(robot, chain) if chain else 0
    links = [robot.link_names[int(k)] for k in np.flatnonzero(robot.link_body == body)]
    links = [name for name in links if not _SENSOR.search(name)] or links
    tools = [name for name in links if _TOOL.search(name)]
    return (tools or [name for name in links if not _FINGER.search(name)] or links)[-1]


def _without_fingers(robot: RobotModel, chain: Sequence[int]) -> int:
    """Return the last body before the fingers; ``chain`` is from `path_to`."""
    lengths = np.cumsum([float(np.linalg.norm(robot.p_PL[body])) for body in chain])
    end = len(chain) - 1
    for i in range(1, len(chain)):
        is_branch = np.count_nonzero(robot.parent == robot.parent[chain[i]]) > 1
        # The arms of a torso are branches, too, but an arm makes up most of its chain.
        if is_branch and lengths[-1] - lengths[i - 1] < _FINGER_FRACTION * lengths[-1]:
            end = i - 1
            break
    arm = [body for body in chain[: end + 1] if not _moves_finger(robot, body)]
    return arm[-1] if arm else chain[end]  # every body is part of a finger


def _moves_finger(robot: RobotModel, body: int) -> bool:
    name = robot.body_names[body]
    return name not in robot.joint_names or bool(_FINGER.search(name))
