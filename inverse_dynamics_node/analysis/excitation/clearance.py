"""
Distances of a robot to itself, to the floor and to boxes, and their slopes.

Which parts may come near is decided as planning tools do, from sampled poses: neighbours are left
out, and parts that touch in almost all poses. Capsules are larger than the parts; where they say
that parts are often near each other, points on the surfaces of the parts tell how near the
capsules may come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np

from ...robot.capsules import Capsules, first_links
from ...robot.kinematics import body_frames
from ...robot.model import Floats, Integers, RobotModel

CLEARANCE = 0.02
"""Least distance of the parts of a robot to each other, to the floor and to boxes [m]."""
_NEARER = 0.01
"""The same for parts that are near each other in many poses [m]."""
TOUCH = 0.005
"""Surfaces are regarded as touching when their points are nearer than this [m]."""
_MANY, _ALL = 0.3, 0.95
"""Fractions of the sampled poses."""
_OFTEN = 0.02
"""Fraction of the sampled poses from which on surfaces are looked at."""
_MOST_SURFACES = 80
"""Poses in which they are looked at."""
_ON_THE_WAY = 0.005
"""What is near in the first pose of a way may come nearer on the way by this [m]."""
_FAR = 0.3
"""Larger distances are of no interest [m]."""
_SCALE = 0.1
"""A distance that is this much too short is as bad as twice the limit of a speed [m]."""
_SECTIONS = 30
"""Steps to the point of a segment that is nearest to a box; each leaves two thirds."""
_CHUNK = 200
"""Poses for which distances are computed together."""


class Extent(NamedTuple):
    """A box in the frame of the base, each end of shape (3,) [m]."""

    lowest: Floats
    highest: Floats


class Contacts(NamedTuple):
    """Where something is near something else in some poses; c of them."""

    pose: Integers
    row: Integers
    distance: Floats
    """Shape (c,) [m]; negative inside each other."""
    points: Floats
    """The nearest points of both, on the axes of capsules, shape (c, 2, 3) [m]."""
    normal: Floats
    """Unit vectors from the second to the first, shape (c, 3)."""


class Nearest(NamedTuple):
    """Where two things are nearest to each other in some poses."""

    names: tuple[str, str]
    """A link, and another link, 'floor' or 'box'."""
    distance: float
    """Of links, between points on their surfaces if their shapes are known [m]."""
    pose: int


@dataclass(frozen=True, eq=False)
class Clearance:
    """What a robot must keep clear of: rows of two capsules, then of a capsule and an obstacle."""

    robot: RobotModel
    capsules: Capsules
    pairs: Integers
    """Two capsules each, shape (p, 2)."""
    floor: float
    """Height [m]; -inf without a floor."""
    boxes: Floats
    """Lowest and highest corners, shape (o, 2, 3) [m]."""
    needed: Floats
    """Least distance: of the pairs, of each capsule to the floor, then to each box [m]."""
    unchecked: tuple[str, ...] = ()
    """What touches in almost all poses, such as 'wrist and floor'."""

    @property
    def bodies(self) -> Integers:
        """Return both bodies of each row, shape (rows, 2); the base for floor and boxes."""
        body = self.capsules.body
        single = np.tile(body, 1 + len(self.boxes))
        outside = np.stack([single, np.zeros_like(single)], axis=1)
        both: Integers = np.concatenate([body[self.pairs], outside])
        return both

    def contacts(self, q: Floats, margin: float = 0.0) -> Contacts:
        """
        Return what is nearer than needed plus a margin.

        Parameters
        ----------
        q : ndarray, shape (k, n)
            Joint positions [rad or m].
        margin : float
            [m].

        """
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
            heights = np.minimum(a[..., 2], b[..., 2]) - radii - self.floor
            pose, k = np.nonzero(heights < limit[p : p + c])
            is_first = (a[pose, k, 2] < b[pose, k, 2])[:, np.newaxis]
            lower = np.where(is_first, a[pose, k], b[pose, k])
            normal = np.tile([0.0, 0.0, 1.0], (len(k), 1))
            parts.append(Contacts(pose, p + k, heights[pose, k], _twice(lower), normal))
        for o, (low, high) in enumerate(self.boxes):
            first = p + c * (1 + o)
            apart = np.linalg.norm(middle - np.clip(middle, low, high), axis=2) - reach
            pose, k = np.nonzero(apart < limit[first : first + c])
            points = _nearest_to_box(a[pose, k], b[pose, k], low, high)
            distance, normal = _of_box(points, low, high)
            distance -= radii[k]
            parts.append(Contacts(pose, first + k, distance, _twice(points), normal))
        found = _joined(parts)
        near = found.distance < limit[found.row]
        return Contacts(*(part[near] for part in found))

    def _between_capsules(
        self, a: Floats, b: Floats, middle: Floats, reach: Floats, limit: Floats
    ) -> Contacts:
        """Return contacts of pairs whose surrounding spheres are near each other."""
        i, j = self.pairs.T
        near = np.full((len(reach), len(reach)), -1.0)
        near[i, j] = np.maximum(reach[i] + reach[j] + limit[: len(i)], 0.0) ** 2
        rows = np.zeros(near.shape, int)
        rows[i, j] = np.arange(len(i))
        squares = np.einsum('kcx,kcx->kc', middle, middle)
        products = middle @ middle.transpose(0, 2, 1)
        apart = squares[:, :, np.newaxis] + squares[:, np.newaxis] - 2.0 * products
        pose, i, j = np.nonzero(apart < near)
        first, second = _nearest(a[pose, i], b[pose, i], a[pose, j], b[pose, j])
        offset = first - second
        distance = np.linalg.norm(offset, axis=1)
        normal = offset / np.maximum(distance, 1e-9)[:, np.newaxis]
        distance -= self.capsules.radii[i] + self.capsules.radii[j]
        return Contacts(pose, rows[i, j], distance, np.stack([first, second], axis=1), normal)

    def _ends(self, q: Floats) -> tuple[Floats, Floats]:
        """Return both ends of the capsules in the frame of the base, each of shape (k, c, 3)."""
        rotations, positions = body_frames(self.robot, q)
        body, ends = self.capsules.body, self.capsules.ends
        R, p = rotations[:, body], positions[:, body]
        first, second = (
            p + sum(R[..., axis] * ends[:, end, axis, np.newaxis] for axis in range(3))
            for end in (0, 1)
        )
        return first, second

    def violation(self, q: Floats, aim: float = 1.0) -> tuple[Floats, Floats]:
        """
        Return by how much poses are too near something, and the slopes of that.

        Parameters
        ----------
        q : ndarray, shape (k, n)
            Joint positions [rad or m].
        aim : float
            Fraction of the limits that is regarded as the limit.

        Returns
        -------
        violation : ndarray, shape (k,)
            Sum of the squares of what is missing, relative to `_SCALE`.
        slopes : ndarray, shape (k, n)
            Its derivatives by the joint positions.

        """
        margin = (1.0 - aim) * _SCALE
        found = self.contacts(q, margin)
        missing = (self.needed[found.row] + margin - found.distance) / _SCALE
        violation: Floats = np.bincount(found.pose, missing**2, len(q))
        return violation, self._slopes(q, found, -2.0 * missing / _SCALE)

    def _slopes(self, q: Floats, contacts: Contacts, weights: Floats) -> Floats:
        """Return derivatives of distances times weights: the work of forces along the normals."""
        robot, slopes = self.robot, np.zeros(q.shape)
        if not len(weights):
            return slopes
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

    def is_kept(self, q: Floats) -> bool:
        """Return whether all poses are as clear as needed; a few of them are looked at first."""
        return not any(len(self.contacts(part).row) for part in (q[::16], q))

    def nearest(self, q: Floats) -> list[Nearest]:
        """
        Return the smallest distances in poses, of each two bodies that are not far apart.

        Parameters
        ----------
        q : ndarray, shape (k, n)
            Joint positions [rad or m].

        Returns
        -------
        nearest : list of Nearest
            The smallest first.

        """
        found = self.contacts(q, _FAR)
        groups = _group_of_rows(self)
        nearest = []
        for group, (pose, distance) in _nearest_by_pose(found, groups).items():
            order = np.argsort(distance)
            pose, distance = pose[order], distance[order]
            if group < len(self.robot.parent) ** 2:
                # Surfaces are within capsules: where these are farther, they need no look.
                distance = distance[: 1 + _MOST_SURFACES]
                for k in range(len(distance)):
                    if distance[k] >= distance[:k].min(initial=math.inf):
                        distance = distance[:k]
                        break
                    distance[k : k + 1] = _surface_distances(
                        self, group, q[pose[k : k + 1]], distance[k : k + 1]
                    )
            k = int(distance.argmin())
            nearest.append(Nearest(self.names(group), float(distance[k]), int(pose[k])))
        return sorted(nearest, key=lambda each: each.distance)

    def names(self, group: int) -> tuple[str, str]:
        """Return what a group of `_group_of_rows` consists of."""
        first, second = divmod(group, len(self.robot.parent))
        b, names = len(self.robot.parent), first_links(self.robot)
        if first < b:
            return names[first], names[second]
        return names[second], 'floor' if first == b else 'box'

    def from_pose(self, q: Floats) -> Clearance:
        """Return what is needed on a way from a pose, shape (n,), near which something may be."""
        needed = self.needed.copy()
        found = self.contacts(q[np.newaxis])
        np.minimum.at(needed, found.row, found.distance - _ON_THE_WAY)
        return replace(self, needed=needed)

    def extent(self, q: Floats) -> Extent:
        """Return the box that contains the parts that move, in all poses, shape (k, n)."""
        moves = self.capsules.body > 0
        radii = self.capsules.radii[moves, np.newaxis]
        first, second = (ends[:, moves] for ends in self._ends(q))
        lowest = (np.minimum(first, second) - radii).min(axis=(0, 1))
        return Extent(lowest, (np.maximum(first, second) + radii).max(axis=(0, 1)))


# Which parts may come near


def find_clearance(
    robot: RobotModel,
    capsules: Capsules,
    poses: Floats,
    floor: float = -math.inf,
    boxes: Sequence[Floats] = (),
) -> Clearance:
    """
    Find out which parts of a robot may come near each other, the floor and boxes.

    Parameters
    ----------
    robot : RobotModel
        With n joints.
    capsules : Capsules
        Those of the robot.
    poses : ndarray, shape (k, n)
        Random poses within the limits [rad or m].
    floor : float
        Height of the floor in the frame of the base [m].
    boxes : sequence of ndarray, shape (2, 3)
        Lowest and highest corner of boxes in the frame of the base [m].

    """
    body, c = capsules.body, len(capsules.body)
    i, j = np.triu_indices(c, 1)
    i, j = np.where(body[i] < body[j], i, j), np.where(body[i] < body[j], j, i)
    apart = (body[i] != body[j]) & (robot.parent[body[j]] != body[i])
    pairs = np.stack([i, j], axis=1)[apart]
    outside = np.where(body > 0, CLEARANCE, -math.inf)
    obstacles = np.array(boxes, float).reshape(-1, 2, 3)
    needed = np.concatenate([np.full(len(pairs), CLEARANCE), *[outside] * (1 + len(obstacles))])
    clearance = Clearance(robot, capsules, pairs, floor, obstacles, needed)
    groups, unchecked = _group_of_rows(clearance), []
    for group, (pose, distance) in _nearest_by_pose(clearance.contacts(poses), groups).items():
        share = len(pose) / len(poses)
        kind = group // len(robot.parent) - len(robot.parent)
        if kind < 0 and share > _OFTEN:
            looked = slice(_MOST_SURFACES)
            true = _surface_distances(clearance, group, poses[pose[looked]], distance[looked])
            needed[groups == group] = _needed(distance, true, share)
        elif kind == 0 and share > _ALL:
            needed[groups == group] = -math.inf
        if not np.isfinite(needed[groups == group]).any():
            unchecked.append(' and '.join(clearance.names(group)))
    kept = np.isfinite(needed[: len(pairs)])
    needed = np.concatenate([needed[: len(pairs)][kept], needed[len(pairs) :]])
    return replace(clearance, pairs=pairs[kept], needed=needed, unchecked=tuple(unchecked))


def _needed(distance: Floats, surfaces: Floats, share: float) -> float:
    """
    Return how near the capsules of two parts may come.

    Parameters
    ----------
    distance : ndarray
        Distances of the capsules in the poses in which they are near [m].
    surfaces : ndarray
        Those of the surfaces, in the first of these poses [m].
    share : float
        Fraction of all poses in which the capsules are near.

    """
    is_near = surfaces < CLEARANCE
    if share * np.mean(is_near) > _MANY:
        is_near = surfaces < _NEARER
    if share * np.mean(is_near) > _ALL:
        return -math.inf
    return float(distance[: len(surfaces)][is_near].max() if is_near.any() else distance.min())


def _group_of_rows(clearance: Clearance) -> Integers:
    """
    Return a number for each row that is the same for the same two bodies.

    With b bodies, it is b i + j for the bodies i and j, b b + i for body i and the floor, and
    b (b + 1) + i for body i and boxes.

    """
    p, bodies = len(clearance.pairs), clearance.bodies
    b, c = len(clearance.robot.parent), len(clearance.capsules.body)
    groups: Integers = bodies[:, 0] * b + bodies[:, 1]
    groups[p:] = b * (b + 1) + bodies[p:, 0]
    groups[p : p + c] -= b
    return groups


def _nearest_by_pose(contacts: Contacts, groups: Integers) -> dict[int, tuple[Integers, Floats]]:
    """Return by group the poses with contacts, and the smallest distance in each of them."""
    nearest = {}
    group = groups[contacts.row]
    for each in np.unique(group):
        of_group = group == each
        pose, index = np.unique(contacts.pose[of_group], return_inverse=True)
        distance = np.full(len(pose), math.inf)
        np.minimum.at(distance, index, contacts.distance[of_group])
        nearest[int(each)] = pose, distance
    return nearest


def _surface_distances(
    clearance: Clearance, group: int, poses: Floats, distance: Floats
) -> Floats:
    """Return the distances of points on the surfaces of two bodies; else those of capsules."""
    from scipy.spatial import cKDTree

    robot, surfaces = clearance.robot, clearance.capsules.surfaces
    small, large = sorted(divmod(group, len(robot.parent)), key=lambda body: len(surfaces[body]))
    if not len(surfaces[small]):
        return distance
    tree = cKDTree(surfaces[large])
    rotations, positions = body_frames(robot, poses)
    found = []
    for R, p in zip(rotations, positions, strict=True):
        points = surfaces[small] @ R[small].T + p[small]
        found.append(float(tree.query((points - p[large]) @ R[large])[0].min()))
    return np.array(found)


# Nearest points


def _nearest(a: Floats, b: Floats, c: Floats, d: Floats) -> tuple[Floats, Floats]:
    """Return the nearest points of segments from a to b and from c to d, each of shape (k, 3)."""
    u, v, r = b - a, d - c, a - c
    uu, uv, vv, ur, vr = (
        np.einsum('ij,ij->i', x, y) for x, y in ((u, u), (u, v), (v, v), (u, r), (v, r))
    )
    uu, vv = np.maximum(uu, 1e-12), np.maximum(vv, 1e-12)  # points are segments too
    s = np.clip((uv * vr - vv * ur) / np.maximum(uu * vv - uv**2, 1e-9 * uu * vv), 0.0, 1.0)
    t = np.clip((uv * s + vr) / vv, 0.0, 1.0)
    s = np.clip((uv * t - ur) / uu, 0.0, 1.0)
    return a + s[:, np.newaxis] * u, c + t[:, np.newaxis] * v


def _nearest_to_box(start: Floats, end: Floats, low: Floats, high: Floats) -> Floats:
    """Return the points of segments that are nearest to a box; the distance is convex."""
    along = end - start
    left, right = np.zeros(len(start)), np.ones(len(start))
    for _ in range(_SECTIONS):
        third = (right - left) / 3.0
        at = [start + t[:, np.newaxis] * along for t in (left + third, right - third)]
        first, second = (_of_box(points, low, high)[0] for points in at)
        left, right = (
            np.where(first < second, left, left + third),
            np.where(first < second, right - third, right),
        )
    points: Floats = start + (0.5 * (left + right))[:, np.newaxis] * along
    return points


def _of_box(points: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Return distances of points to a box, negative in it, and the directions away from it."""
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
    """Return points of capsules also as those of what does not move, where they do not matter."""
    return np.stack([points, points], axis=1)


def _joined(parts: Sequence[Contacts]) -> Contacts:
    return Contacts(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
