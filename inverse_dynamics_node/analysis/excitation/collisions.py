"""
Finds poses in which links hit each other, the floor or a box, by means of the library coal.

The convex hull of a collision shape represents the shape, as in MuJoCo: it is larger and faster.
Links that a joint connects, or that do not move relative to each other, are not compared. Shapes
that touch in almost all random poses, or in many of them and in the default pose, cannot be
checked.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import product
import math
import os
from typing import Any, NamedTuple

import numpy as np

from ...robot.kinematics import body_frames
from ...robot.model import Booleans, Floats, Integers, RobotModel
from ...robot.urdf.shapes import read_shapes, Shape

CLEARANCE = 0.02
"""Minimum distance between a link and an obstacle [m]."""
APART = 0.005
"""Minimum distance between links [m]."""
_MANY, _ALMOST_ALL = 0.2, 0.95
"""Fractions of the random poses."""
_THICKNESS = 1e-3
"""Half thickness of a flat shape [m]."""
_FLOOR = 100.0
"""Half width, and depth, of the box that represents the floor [m]."""
_NAMED = 3
"""Number of pairs that are named if all poses have collisions."""


class _Solid(NamedTuple):
    """A collision shape in the frame of its body. Obstacles belong to the base."""

    link: str
    body: int
    hull: Any
    """The convex hull of the shape, an object of coal."""
    corners: Floats
    """Corners of a box around the shape, shape (8, 3) [m]."""


class Collisions:
    """
    Finds collisions of a robot with itself and with obstacles.

    `shapeless` names the links without a readable collision shape, which are not checked.
    `unchecked` names pairs that are not checked, such as 'wrist and hand'.

    """

    def __init__(
        self,
        robot: RobotModel,
        description: str | os.PathLike[str],
        poses: Floats,
        floor: float = -math.inf,
        boxes: Iterable[Floats] = (),
    ) -> None:
        """
        Read the collision shapes of a robot, and determine which pairs can be checked.

        `description` is the path or the text of the URDF. `poses` contains the default pose, and
        then random poses within the limits, shape (poses, joints) [rad or m]. `floor` is a height
        in the base frame [m]. `boxes` contains the lowest and highest corner of each box in the
        base frame, shape (2, 3) [m]. Raises ImportError if coal is not installed.

        """
        self.robot = robot
        shapes, unreadable = read_shapes(description)
        self._solids = [_of_link(robot, shape) for shape in shapes]
        self._links = len(self._solids)  # the obstacles follow
        self._floor = self._links if math.isfinite(floor) else -1
        if math.isfinite(floor):
            ends = np.array([[-_FLOOR, -_FLOOR, floor - _FLOOR], [_FLOOR, _FLOOR, floor]])
            self._solids.append(_solid('floor', 0, _corners(*ends)))
        self._solids += [_solid('box', 0, _corners(*box)) for box in boxes]
        self._body: Integers = np.array([solid.body for solid in self._solids], int)
        i, j = np.triu_indices(len(self._solids), 1)
        a, b = self._body[i], self._body[j]
        are_joined = (robot.parent[a] == b) | (robot.parent[b] == a)
        self._group = _rigid_groups(robot, np.ptp(poses, axis=0) > 0.0)
        move = self._group[a] != self._group[b]
        chosen = (i < self._links) & move & ~((j < self._links) & are_joined)
        self._pairs: Integers = np.stack([i, j], axis=1)[chosen]
        self._margins = np.where(self._pairs[:, 1] < self._links, APART, CLEARANCE)
        self.shapeless = _without_shape(robot, shapes, unreadable)
        touching = self._touching(poses)
        self.unchecked = self._named(touching)
        self._pairs, self._margins = self._pairs[~touching], self._margins[~touching]

    def _touching(self, poses: Floats) -> Booleans:
        """Return which pairs touch in too many poses to be checked."""
        first, second = self._pairs.T
        are_links = second < self._links
        # The first link may turn on the floor, and wheels stand on it.
        on_floor = (second == self._floor) & (self.robot.parent[self._body[first]] == 0)
        in_default_pose = are_links & (self._counts(poses[:1]) > 0)
        most = np.where(in_default_pose, _MANY, _ALMOST_ALL) * len(poses)
        return np.asarray((are_links | on_floor) & (self._counts(poses) > most))

    @property
    def has_pairs(self) -> bool:
        """Whether anything is checked."""
        return len(self._pairs) > 0

    def hits(self, q: Floats) -> Iterator[tuple[int, int]]:
        """Yield the indices of pose and pair for each collision; q has shape (poses, joints)."""
        import coal

        rotations, positions = body_frames(self.robot, q)
        low, high = self._bounds(rotations, positions)
        i, j = self._pairs.T
        gaps = np.maximum(low[:, i] - high[:, j], low[:, j] - high[:, i]).max(axis=2)
        request = coal.CollisionRequest()
        for pose, pair in zip(*np.nonzero(gaps < self._margins), strict=True):
            request.security_margin = self._margins[pair]
            first, second = (self._solids[k] for k in self._pairs[pair])
            places = [
                coal.Transform3s(rotations[pose, solid.body], positions[pose, solid.body])
                for solid in (first, second)
            ]
            result = coal.CollisionResult()
            if coal.collide(first.hull, places[0], second.hull, places[1], request, result):
                yield int(pose), int(pair)

    def is_free(self, q: Floats) -> bool:
        """Return whether no pose has a collision. A few poses are checked first."""
        return not any(True for part in (q[::16], q) for _ in self.hits(part))

    def is_way_free(self, q: Floats) -> bool:
        """Return whether only pairs that collide in the first pose collide, until they part."""
        hits = set(self.hits(q))
        return all(pose == 0 or (pose - 1, pair) in hits for pose, pair in hits)

    def most_frequent(self, q: Floats) -> str:
        """Return the pairs that collide in most poses, such as 'hand and floor'."""
        counts = self._counts(q)
        worst = np.argsort(-counts, kind='stable')[: np.count_nonzero(counts)]
        return ', '.join(self._named(worst)[:_NAMED])

    def extent(self, q: Floats) -> Floats | None:
        """Return the lowest and highest corner of the space of moving links, shape (2, 3) [m]."""
        moves = self._group[self._body] > 0
        if not moves.any():
            return None
        low, high = self._bounds(*body_frames(self.robot, q))
        return np.array([low[:, moves].min(axis=(0, 1)), high[:, moves].max(axis=(0, 1))])

    def _counts(self, q: Floats) -> Integers:
        """Return the number of poses in which each pair collides."""
        return np.bincount([pair for _, pair in self.hits(q)], minlength=len(self._pairs))

    def _named(self, chosen: Booleans | Integers) -> list[str]:
        """Return the different names of the chosen pairs, such as 'hand and floor'."""
        names = (' and '.join(self._solids[k].link for k in pair) for pair in self._pairs[chosen])
        return list(dict.fromkeys(names))

    def _bounds(self, rotations: Floats, positions: Floats) -> tuple[Floats, Floats]:
        """Return the lowest and highest corners of all shapes, shape (poses, shapes, 3) each."""
        corners = np.array([solid.corners for solid in self._solids]).reshape(-1, 8, 3)
        places = corners @ rotations[:, self._body].swapaxes(-1, -2)
        places += positions[:, self._body, np.newaxis]
        return places.min(axis=2), places.max(axis=2)


def _rigid_groups(robot: RobotModel, varies: Booleans) -> Integers:
    """Return a number for each body, equal for bodies between which no joint varies."""
    groups = np.arange(len(robot.parent))
    for body in range(1, len(groups)):
        if not varies[robot.joint_index[body]]:
            groups[body] = groups[robot.parent[body]]
    return groups


def _of_link(robot: RobotModel, shape: Shape) -> _Solid:
    k = robot.link_index(shape.link)
    vertices = shape.vertices @ robot.link_rotation[k].T + robot.link_position[k]
    return _solid(shape.link, int(robot.link_body[k]), vertices)


def _solid(name: str, body: int, vertices: Floats) -> _Solid:
    """Return the convex hull of vertices in the frame of a body; flat shapes become boxes."""
    import coal
    from scipy.spatial import ConvexHull, QhullError

    low, high = vertices.min(axis=0), vertices.max(axis=0)
    box = _corners(low - _THICKNESS, high + _THICKNESS)
    # Of vertices in one plane, Qhull makes no hull, and rarely one that coal can use.
    for corners, option in ((vertices, 'Qt'), (vertices, 'QJ'), (box, 'Qt')):
        with suppress(QhullError, RuntimeError):
            simplices = ConvexHull(corners, qhull_options=option).simplices
            used, index = np.unique(simplices, return_inverse=True)
            points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
            points.extend(list(corners[used]))
            triangles.extend([coal.Triangle(*face) for face in index.reshape(-1, 3).tolist()])
            return _Solid(name, body, coal.Convex(points, triangles), _corners(low, high))
    raise AssertionError('a box has a convex hull')


def _corners(low: Floats, high: Floats) -> Floats:
    """Return the eight corners of a box, shape (8, 3)."""
    return np.array(list(product(*zip(low, high, strict=True))))


def _without_shape(
    robot: RobotModel, shapes: Iterable[Shape], unreadable: Mapping[str, str]
) -> list[str]:
    """Return the links with an unreadable shape, and one link of each body without a shape."""
    shaped = {int(robot.link_body[robot.link_index(shape.link)]) for shape in shapes}
    links = [
        robot.link_names[int(np.argmax(robot.link_body == body))]
        for body in range(len(robot.parent))
        if body not in shaped and (robot.mass[body] > 0.0 or body == 0)
    ]
    names = [f'{link} ({why})' for link, why in unreadable.items()]
    return names + [link for link in links if link not in unreadable]
