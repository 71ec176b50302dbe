"""The link of a robot that carries a payload."""

from __future__ import annotations

from collections.abc import Sequence
import re

import numpy as np

from .model import RobotModel

_FINGER = re.compile('finger|thumb|gripper|knuckle|jaw|claw', re.IGNORECASE)
_FINGER_FRACTION = 0.3
"""A branch at the end of an arm is a finger if it is shorter than this fraction of the arm."""


def last_link(robot: RobotModel) -> str:
    """
    Return the link that probably carries a payload: ``tool0``, or the end of the longest chain.

    Fingers are ignored. If the chain ends in a gripper or a hand, the result is the link that
    carries the fingers.

    """
    if 'tool0' in robot.link_names:
        return 'tool0'
    depth = np.zeros(len(robot.parent), dtype=int)
    for body in range(1, len(robot.parent)):
        depth[body] = depth[robot.parent[body]] + 1
    chain = [int(np.argmax(depth))]
    while chain[-1] > 0:
        chain.append(int(robot.parent[chain[-1]]))
    body = _without_fingers(robot, chain[-2::-1]) if len(chain) > 1 else 0
    links = [robot.link_names[int(k)] for k in np.flatnonzero(robot.link_body == body)]
    return ([name for name in links if not _FINGER.search(name)] or links)[-1]


def _without_fingers(robot: RobotModel, chain: Sequence[int]) -> int:
    """Return the last body that is not part of a finger; ``chain`` starts at the base."""
    lengths = np.cumsum([float(np.linalg.norm(robot.p_PL[body])) for body in chain])
    end = len(chain) - 1
    for i in range(1, len(chain)):
        is_branch = np.count_nonzero(robot.parent == robot.parent[chain[i]]) > 1
        # Two arms also branch from a torso, but each arm is most of its chain.
        if is_branch and lengths[-1] - lengths[i - 1] < _FINGER_FRACTION * lengths[-1]:
            end = i - 1
            break
    arm = [body for body in chain[: end + 1] if not _moves_finger(robot, body)]
    return arm[-1] if arm else chain[end]  # the robot consists of a finger only


def _moves_finger(robot: RobotModel, body: int) -> bool:
    name = robot.body_names[body]
    return name not in robot.joint_names or bool(_FINGER.search(name))
