"""
Computes distances between links, and from links to the floor and to boxes, with gradients.

Capsules enclose the links. The floor and the boxes are called obstacles. A row is a pair of
capsules, the end of a capsule and the floor, or a capsule and a box. Each row has a minimum
distance. If the actual distance is smaller, the difference is called the missing distance.

Neighbouring links, and links that touch in almost all sampled poses, are not checked. If two links
are often near each other, points on their surfaces determine the minimum distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Any, NamedTuple

import numpy as np

from ...robot.capsules import Capsules
from ...robot.kinematics import body_frames
from ...robot.model import Floats, Integers, RobotModel

CLEARANCE = 0.02
"""Default minimum distance between links, and between a link and an obstacle [m]."""
TOUCH = 0.005
"""Surfaces touch if their distance is smaller than this value [m]."""
_ALWAYS = 0.01
"""Links are not checked if they are closer than this in almost all poses [m]."""
_MANY, _ALL = 0.3, 0.95
"""Fractions of the poses that are called 'many' and 'almost all'."""
_OFTEN = 0.02
"""Surfaces are compared if links are near each other in more than this fraction of poses."""
_MOST_LOOKS = 40
"""Largest number of poses in which the surfaces of two links are compared."""
_UNSEEN = 0.005
"""If surfaces are never close, the minimum distance is the smallest one seen minus this [m]."""
_ON_THE_WAY = 0.005
"""Links that are too close at the start of a path may approach each other by this value [m]."""
_FAR = 0.3
"""Distances are ignored if they exceed the minimum distance by more than this [m]."""
_SCALE = 0.05
"""Shortfall from the minimum distance [m] that gives a violation of 1."""
_PLACES = np.linspace(0.0, 1.0, 33)[:, np.newaxis]
"""Positions on a segment, 0 to 1, at which the distance to a box is computed."""
_CHUNK = 200
"""Number of poses that are processed together."""


class Extent(NamedTuple):
    """Lowest and highest corner of a box in the base frame, shape (3,) each [m]."""

    lowest: Floats
    highest: Floats


class Contacts(NamedTuple):
    """Capsules that are close to each other or to an obstacle."""

    pose: Integers
    row: Integers
    distance: Floats
    """Distances, shape (contacts,) [m]; negative for an overlap."""
    points: Floats
    """Nearest points on the axes of the capsules, shape (contacts, 2, 3) [m]."""
    normal: Floats
    """Unit vectors to the first capsule from the second or the obstacle, shape (contacts, 3)."""


class Nearest(NamedTuple):
    """Smallest distance between two links, or between a link and an obstacle."""

    names: tuple[str, str]
    """Name of a link, followed by 'floor', 'box' or the name of another link."""
    distance: float
    """Distance between surfaces or, if a surface is unknown, between capsules [m]."""
    pose: int
    """Index of the pose."""


@dataclass(frozen=True, eq=False)
class Clearance:
    """The minimum distances that links must keep from each other and from obstacles."""

    robot: RobotModel
    capsules: Capsules
    pairs: Integers
    """Indices of the two capsules of each pair, shape (pairs, 2)."""
    floor: float
    """Height of the floor in the base frame [m]; -inf without a floor."""
    boxes: Floats
    """Lowest and highest corner of each box, shape (boxes, 2, 3) [m]."""
    needed: Floats
    """
    Minimum distance of each row, shape (rows,) [m].

    The rows are the pairs, then all capsule ends against the floor, then, for each box, all
    capsules against the box.
    """
    unchecked: tuple[str, ...] = ()
    """Pairs that are not checked because they are close too often, such as 'wrist and floor'."""

    @property
    def bodies(self) -> Integers:
        """Indices of the two bodies of each row, shape (rows, 2). Obstacles belong to the base."""
        body = self.capsules.body
        single = np.tile(body, 2 + len(self.boxes))
        outside = np.stack([single, np.zeros_like(single)], axis=1)
        return np.asarray(np.concatenate([body[self.pairs], outside]))

    def contacts(self, q: Floats, margin: float = 0.0) -> Contacts:
        """Return the rows that are closer than the minimum distance plus a margin [m]."""
        parts = []
        for first in range(0, max(len(q), 1), _CHUNK):
            found = self._contacts(q[first : first + _CHUNK], margin)
            parts.append(found._replace(pose=found.pose + first))
        return _joined(parts)

    def _contacts(self, q: Floats, margin: float) -> Contacts:
        a, b = self._ends(q)
        radii, p, c = self.capsules.radii, len(self.pairs), len(self.capsules.radii)
        middle = 0.5 * (a + b)
        along = self.capsules.ends[:, 1] - self.capsules.ends[:, 0]
        reach = radii + 0.5 * np.linalg.norm(along, axis=1)
        limit = self.needed + margin
        parts = [self._between_capsules(a, b, middle, reach, limit)]
        if math.isfinite(self.floor):
            both = np.concatenate([a, b], axis=1)
            heights = both[..., 2] - np.tile(radii, 2) - self.floor
            pose, k = np.nonzero(heights < limit[p : p + 2 * c])
            normal = np.tile([0.0, 0.0, 1.0], (len(k), 1))
            parts.append(Contacts(pose, p + k, heights[pose, k], _twice(both[pose, k]), normal))
        for o, (low, high) in enumerate(self.boxes):
            first = p + c * (2 + o)
            apart = np.linalg.norm(middle - np.clip(middle, low, high), axis=2) - reach
            pose, k = np.nonzero(apart < limit[first : first + c])
            points = _nearest_to_box(a[pose, k], b[pose, k], low, high)
            distance, normal = _of_box(points, low, high)
            distance -= radii[k]
            parts.append(Contacts(pose, first + k, distance, _twice(points), normal))
        pose, row, distance, points, normal = _joined(parts)
        near = distance < limit[row]
        return Contacts(pose[near], row[near], distance[near], points[near], normal[near])

    def _between_capsules(
        self, a: Floats, b: Floats, middle: Floats, reach: Floats, limit: Floats
    ) -> Contacts:
        """Return contacts between capsules whose bounding spheres are near each other."""
        i, j = self.pairs.T
        near = np.maximum(reach[i] + reach[j] + limit[: len(i)], 0.0) ** 2
        x, y, z = np.ascontiguousarray(middle.transpose(2, 1, 0))  # contiguous: ten times as fast
        apart = (x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2 + (z[i] - z[j]) ** 2
        row, pose = np.nonzero(apart < near[:, np.newaxis])
        i, j = self.pairs[row].T
        first, second = _nearest(a[pose, i], b[pose, i], a[pose, j], b[pose, j])
        offset = first - second
        distance = np.linalg.norm(offset, axis=1)
        normal = offset / np.maximum(distance, 1e-9)[:, np.newaxis]
        distance -= self.capsules.radii[i] + self.capsules.radii[j]
        return Contacts(pose, row, distance, np.stack([first, second], axis=1), normal)

    def _ends(self, q: Floats) -> tuple[Floats, Floats]:
        """Return both ends of all capsules in the base frame, shape (poses, capsules, 3) each."""
        rotations, positions = body_frames(self.robot, q)
        body, ends = self.capsules.body, self.capsules.ends
        R, p = rotations[:, body], positions[:, body]
        first, second = (
            p + sum(R[..., axis] * ends[:, end, axis, np.newaxis] for axis in range(3))
            for end in (0, 1)
        )
        return first, second

    def _missing(self, q: Floats, margin: float, is_way: bool) -> tuple[Contacts, Floats]:
        """Return the contacts, and how far each is short of its required distance [m]."""
        found = self.contacts(q, margin)
        missing = self.needed[found.row] + margin - found.distance
        if is_way:
            is_first, permitted = found.pose == 0, np.zeros(len(self.needed))
            permitted[found.row[is_first]] = missing[is_first] + _ON_THE_WAY
            missing -= permitted[found.row] * (1.0 - found.pose / len(q))
        return found, np.maximum(missing, 0.0)

    def violation(
        self, q: Floats, aim: float = 1.0, is_way: bool = False
    ) -> tuple[Floats, Floats]:
        """
        Return the violation in each pose, and its gradient, shape (poses, joints).

        The violation is the sum of (missing distance / `_SCALE`)^2. An `aim` below 1 adds
        (1 - aim) * `_SCALE` to each minimum distance. If the poses form a path (`is_way`), links
        that are too close in the first pose must move apart gradually.

        """
        margin = (1.0 - aim) * _SCALE
        found, missing = self._missing(q, margin, is_way)
        missing /= _SCALE
        violation = np.zeros(len(q))
        np.add.at(violation, found.pose, missing**2)
        if not len(missing):
            return violation, np.zeros(q.shape)
        return violation, self._slopes(q, found, -2.0 * missing / _SCALE)

    def _slopes(self, q: Floats, contacts: Contacts, weights: Floats) -> Floats:
        """Return the gradient of the weighted distance sum, as joint efforts of contact forces."""
        robot, slopes = self.robot, np.zeros(q.shape)
        rotations, positions = body_frames(robot, q)
        wrenches = np.zeros((*positions.shape[:2], 6))
        bodies = self.bodies[contacts.row]
        for side, sign in ((0, 1.0), (1, -1.0)):
            force = sign * weights[:, np.newaxis] * contacts.normal
            moment = np.cross(contacts.points[:, side], force)
            np.add.at(wrenches, (contacts.pose, bodies[:, side]), np.hstack([force, moment]))
        for body in range(len(robot.parent) - 1, 0, -1):
            axis = rotations[:, body] @ robot.axis[body]
            force, moment = wrenches[:, body, :3], wrenches[:, body, 3:]
            if not robot.is_prismatic[body]:
                force = moment - np.cross(positions[:, body], force)
            work = robot.multiplier[body] * np.sum(axis * force, axis=1)
            slopes[:, robot.joint_index[body]] += work
            wrenches[:, robot.parent[body]] += wrenches[:, body]
        return slopes

    def is_kept(self, q: Floats, is_way: bool = False) -> bool:
        """Return whether all poses keep the minimum distances. A few poses are checked first."""
        return not any(self._missing(part, 0.0, is_way)[1].any() for part in (q[::16], q))

    def nearest(self, q: Floats) -> list[Nearest]:
        """Return the smallest distance for each pair of names, in ascending order."""
        found = self.contacts(q, _FAR)
        rotations, positions = body_frames(self.robot, q)
        nearest: dict[tuple[str, str], Nearest] = {}
        for k in np.argsort(found.distance):
            pose, row, distance = int(found.pose[k]), int(found.row[k]), float(found.distance[k])
            names = self.names(row)
            best = nearest[names].distance if names in nearest else math.inf
            # Surfaces lie inside capsules, so surfaces cannot be closer than their capsules.
            if distance >= best:
                continue
            if row < len(self.pairs):
                frames = rotations[pose], positions[pose]
                distance = self.between_surfaces(row, *frames, distance, best)
            if distance < best:
                nearest[names] = Nearest(names, distance, pose)
        return sorted(nearest.values(), key=lambda each: each.distance)

    @cached_property
    def _trees(self) -> list[Any]:
        """Search tree of the surface points in each capsule."""
        from scipy.spatial import cKDTree

        return [cKDTree(points) for points in self.capsules.surfaces]

    def between_surfaces(
        self, row: int, R: Floats, p: Floats, otherwise: float, below: float = math.inf
    ) -> float:
        """
        Return the distance between the surfaces of a pair [m].

        R and p are the rotations and positions of all bodies. If a surface is unknown, the result
        is `otherwise`. If the distance is at least `below`, the result is inf.

        """
        capsules = self.capsules
        if not self.has_surfaces(row):
            return otherwise
        few, many = sorted(self.pairs[row], key=lambda k: len(capsules.surfaces[k]))
        body, other = capsules.body[few], capsules.body[many]
        points = capsules.surfaces[few] @ R[body].T + p[body]
        points = (points - p[other]) @ R[other]
        return float(self._trees[many].query(points, distance_upper_bound=below)[0].min())

    def has_surfaces(self, row: int) -> bool:
        """Return whether the surfaces in both capsules of a pair are known."""
        return all(len(self.capsules.surfaces[k]) for k in self.pairs[row])

    def names(self, row: int) -> tuple[str, str]:
        """Return the name of a link, followed by 'floor', 'box' or the name of another link."""
        p, c, names = len(self.pairs), len(self.capsules.body), self.capsules.names
        if row < p:
            first, second = self.pairs[row]
            return names[first], names[second]
        return names[(row - p) % c], 'floor' if row < p + 2 * c else 'box'

    def extent(self, q: Floats) -> Extent:
        """Return the box that contains all moving links in all poses."""
        moves = self.capsules.body > 0
        radii = self.capsules.radii[moves, np.newaxis]
        first, second = (ends[:, moves] for ends in self._ends(q))
        lowest = (np.minimum(first, second) - radii).min(axis=(0, 1))
        return Extent(lowest, (np.maximum(first, second) + radii).max(axis=(0, 1)))


# Which links may come near each other


def find_clearance(
    robot: RobotModel,
    capsules: Capsules,
    poses: Floats,
    floor: float = -math.inf,
    boxes: Sequence[Floats] = (),
) -> Clearance:
    """
    Determine the minimum distances that links must keep from each other and from obstacles.

    `poses` are random poses within the limits, shape (poses, joints) [rad or m]. `floor` is the
    height of the floor in the base frame [m]. `boxes` contains the lowest and highest corner of
    each box in the base frame, shape (2, 3) [m].

    """
    body, c = capsules.body, len(capsules.body)
    i, j = np.triu_indices(c, 1)
    i, j = np.where(body[i] < body[j], i, j), np.where(body[i] < body[j], j, i)
    apart = (body[i] != body[j]) & (robot.parent[body[j]] != body[i])
    pairs = np.stack([i, j], axis=1)[apart]
    outside = np.where(body > 0, CLEARANCE, -math.inf)
    obstacles = np.array(boxes, float).reshape(-1, 2, 3)
    needed = np.concatenate([np.full(len(pairs), CLEARANCE), *[outside] * (2 + len(obstacles))])
    clearance = Clearance(robot, capsules, pairs, floor, obstacles, needed)
    found, p = clearance.contacts(poses), len(pairs)
    # A capsule end at a constant height near the floor is on a joint axis, and is ignored.
    for end in range(p, p + 2 * c):
        heights = found.distance[found.row == end]
        if len(heights) > _ALL * len(poses) and np.ptp(heights) < _ALWAYS:
            needed[end] = -math.inf
    both = body[pairs] @ [len(robot.parent), 1]
    is_pair = found.row < p
    pose, row, distance = found.pose[is_pair], found.row[is_pair], found.distance[is_pair]
    for each in np.unique(both[row]):
        of = both[row] == each
        for k, least in _needed(clearance, poses, pose[of], row[of], distance[of]).items():
            needed[k] = least
    kept = np.isfinite(needed)
    kept[p:] |= np.tile(body == 0, 2 + len(obstacles))
    checked = {clearance.names(row) for row in np.flatnonzero(kept).tolist()}
    dropped = {clearance.names(row): None for row in np.flatnonzero(~kept).tolist()}
    return replace(
        clearance,
        pairs=pairs[kept[:p]],
        needed=np.concatenate([needed[:p][kept[:p]], needed[p:]]),
        unchecked=tuple(' and '.join(names) for names in dropped if names not in checked),
    )


def _needed(
    clearance: Clearance, poses: Floats, pose: Integers, row: Integers, distance: Floats
) -> dict[int, float]:
    """
    Map the rows that belong to two given bodies to their minimum distances [m].

    `pose`, `row` and `distance` describe contacts between the two bodies. Rows that are not
    checked have a minimum distance of -inf. The result is empty if the bodies are rarely near each
    other.

    """
    near_poses = np.unique(pose)
    share = len(near_poses) / len(poses)
    if share <= _OFTEN:
        return {}
    is_known = np.array([clearance.has_surfaces(each) for each in row.tolist()])
    if share > _MANY and not is_known.all():
        others = _needed(clearance, poses, pose[is_known], row[is_known], distance[is_known])
        return {**dict.fromkeys(row[~is_known].tolist(), -math.inf), **others}
    looked = np.isin(pose, near_poses[:_MOST_LOOKS])
    rotations, positions = body_frames(clearance.robot, poses)
    surfaces = np.full(len(pose), math.inf)
    for k in np.flatnonzero(looked):
        surfaces[k] = clearance.between_surfaces(
            int(row[k]), rotations[pose[k]], positions[pose[k]], distance[k]
        )
    of_poses = np.array([surfaces[pose == k].min() for k in near_poses[:_MOST_LOOKS]])
    least = CLEARANCE
    if share > _MANY:  # close by design, so permit half the typical distance
        least = float(np.clip(0.5 * np.median(of_poses), TOUCH, CLEARANCE))
    if share * np.mean(of_poses < max(least, _ALWAYS)) > _ALL:
        return dict.fromkeys(row.tolist(), -math.inf)
    needed = {}
    for each in np.unique(row).tolist():
        of_row = looked & (row == each)
        is_near = of_row & (surfaces < least)
        if is_near.any():
            needed[each] = float(distance[is_near].max())
        elif of_row.any():
            needed[each] = float(distance[of_row].min()) - _UNSEEN
    return needed


# Nearest points


def _nearest(a: Floats, b: Floats, c: Floats, d: Floats) -> tuple[Floats, Floats]:
    """Return the nearest points of the segments ab and cd, shape (segments, 3) each."""
    u, v, r = b - a, d - c, a - c
    uu, uv, vv, ur, vr = (
        np.einsum('ij,ij->i', x, y) for x, y in ((u, u), (u, v), (v, v), (u, r), (v, r))
    )
    uu, vv = np.maximum(uu, 1e-12), np.maximum(vv, 1e-12)  # a point is a segment without length
    s = np.clip((uv * vr - vv * ur) / np.maximum(uu * vv - uv**2, 1e-9 * uu * vv), 0.0, 1.0)
    t = np.clip((uv * s + vr) / vv, 0.0, 1.0)
    s = np.clip((uv * t - ur) / uu, 0.0, 1.0)
    return a + s[:, np.newaxis] * u, c + t[:, np.newaxis] * v


def _nearest_to_box(start: Floats, end: Floats, low: Floats, high: Floats) -> Floats:
    """Return the point of each segment that is nearest to a box."""
    points: Floats = start[:, np.newaxis] + _PLACES * (end - start)[:, np.newaxis]
    distances, _ = _of_box(points.reshape(-1, 3), low, high)
    best = distances.reshape(points.shape[:2]).argmin(axis=1)
    return np.asarray(points[np.arange(len(points)), best])


def _of_box(points: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Return signed distances from points to a box, and directions away from the box."""
    beyond = np.concatenate([low - points, points - high], axis=1)
    deepest = beyond.argmax(axis=1)
    inside = np.concatenate([-np.eye(3), np.eye(3)])[deepest]
    offset = points - np.clip(points, low, high)
    distance = np.linalg.norm(offset, axis=1)
    is_outside = distance > 0.0
    distance = np.where(is_outside, distance, beyond[np.arange(len(points)), deepest])
    outside = offset / np.where(is_outside, distance, 1.0)[:, np.newaxis]
    return distance, np.where(is_outside[:, np.newaxis], outside, inside)


def _twice(points: Floats) -> Floats:
    """Pair each point with itself, because a contact with an obstacle also has two points."""
    return np.stack([points, points], axis=1)


def _joined(parts: Sequence[Contacts]) -> Contacts:
    return Contacts(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
