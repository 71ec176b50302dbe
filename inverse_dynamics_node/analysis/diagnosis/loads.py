"""Links that may carry an unknown payload, and limits of credible payloads."""

from __future__ import annotations

import numpy as np

from ...robot.kinematics import path_to
from ...robot.model import Booleans, Floats, RobotModel

PARAMETERS = 10  # one for m, three for m c, six for m c c^T
MOST_LINKS = 6  # largest number of links to try
MOVED = 0.02  # [rad or m]; a joint that moved less does not reveal a load
MAX_REACH = 0.5  # [m], largest distance from the link to the centre of mass of a payload
MAX_COM_ERROR = 0.05  # [m]; coordinates with a larger standard error are reported as unknown


def tip_links(robot: RobotModel) -> tuple[str, ...]:
    """Return one link of each branching body, and then one link of each tip of the tree."""
    children = np.bincount(robot.parent[1:], minlength=len(robot.parent))
    # Branching bodies are included because a load on a palm does not act on the fingers.
    bodies = [body for body in range(1, len(children)) if children[body] != 1]
    bodies.sort(key=lambda body: (children[body] == 0, -len(path_to(robot, body))))
    links = []
    for body in bodies[:MOST_LINKS]:
        on_body = np.flatnonzero(robot.link_body == body)
        reach = np.linalg.norm(robot.link_position[on_body], axis=1)
        # Choose the last outermost link, because tool frames are listed after their parents.
        furthest = on_body[reach >= np.max(reach) - 1e-9][-1]
        links.append(robot.link_names[int(furthest)])
    return tuple(links)


def loaded_links(robot: RobotModel, q: Floats, link: str | None = None) -> tuple[str, ...]:
    """
    Return `link`, or the links from `tip_links` if `link` is None.

    Links that did not move are left out, unless the whole robot was at rest.
    """
    links = (link,) if link is not None else tip_links(robot)
    moved: Booleans = np.ptp(q, axis=0) > MOVED
    if not moved.any():
        return links
    paths = (path_to(robot, int(robot.link_body[robot.link_index(link)])) for link in links)
    moves = [moved[robot.joint_index[path]].any() for path in paths]
    return tuple(link for link, is_moved in zip(links, moves, strict=True) if is_moved)


def point_mass_parameters(mass: float, com: Floats) -> Floats:
    """Return the parameters of a point mass in the order of `payload_columns`, shape (10,)."""
    x, y, z = com
    return mass * np.array([1.0, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])
