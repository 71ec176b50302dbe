"""
Capsules around the bodies of a robot, computed from its collision shapes.

A capsule is the set of points within a given distance of a line segment. Distances between
capsules can be computed quickly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import listed
from .model import Floats, Integers, RobotModel
from .urdf.shapes import Shape

ASSUMED_RADIUS = 0.05
"""Assumed capsule radius if a shape is unknown, as a fraction of the longest chain's length."""
_SPACING = (0.008, 0.0125)
"""Spacing of surface points: minimum [m], and fraction of the longest side of the bounding box."""
_CELLS = 120
"""Number of grid cells along the bounding box's longest side; vertices in one cell are merged."""
_SMALLEST = 1e-6
"""Minimum of the bounding box's longest side [m], because cells must not have size 0."""
_DEPTH = 3
"""Maximum depth of the recursive cuts of a shape."""
_PRICE = 0.04
"""Cost of each piece, as a fraction of the size of the uncut shape; see `_best_cut`."""
_CUTS = (0.35, 0.65)
_STEPS = 10
"""Number of steps in the search for the centre line of a capsule."""


_Row = tuple[int, Floats, float, Floats]
"""Body index, segment ends, radius and surface points of a capsule."""


@dataclass(frozen=True, eq=False)
class Capsules:
    """The c capsules around the bodies of a robot; coordinates are in the body frames."""

    body: Integers
    """Index of the body of each capsule, shape (c,)."""
    ends: Floats
    """Ends of the line segment of each capsule, shape (c, 2, 3) [m]."""
    radii: Floats
    """Radius of each capsule, shape (c,) [m]."""
    names: tuple[str, ...]
    """For each capsule, the name of the first link of its body."""
    surfaces: tuple[Floats, ...]
    """Surface points inside each capsule, shape (k, 3) [m]; k is 0 if the radius is assumed."""
    notes: tuple[str, ...]
    """Sentences that name the bodies for which a radius is assumed."""


class _Piece(NamedTuple):
    """A part of a shape, and the capsule around it."""

    vertices: Floats
    faces: Integers
    ends: Floats
    radius: float

    @property
    def size(self) -> float:
        """Capsule volume over pi, but with half of each end cap, because pieces overlap there."""
        length = float(np.linalg.norm(self.ends[1] - self.ends[0]))
        return self.radius**2 * (length + 2.0 / 3.0 * self.radius)


def body_capsules(
    robot: RobotModel, shapes: Iterable[Shape], unreadable: Mapping[str, str]
) -> Capsules:
    """
    Return capsules around the bodies; ``shapes`` and ``unreadable`` are from `read_shapes`.

    A radius is assumed for bodies that have an unreadable shape, or no shape around their
    centre of mass. Capsules of this radius connect the origin of the body with the origins of its
    children and links, and with its centre of mass. A massless body without a shape gets
    no capsule, unless it is the base.

    """
    rows: list[_Row] = []
    shaped = set()
    for shape in shapes:
        k = robot.link_index(shape.link)
        rotation, position = robot.link_rotation[k], robot.link_position[k]
        points = _surface(shape)
        for piece in _pieces(shape):
            ends = piece.ends @ rotation.T + position
            inside = points[_distances(points, piece.ends) <= piece.radius]
            body = int(robot.link_body[k])
            shaped.add(k)
            rows.append((body, ends, piece.radius, inside @ rotation.T + position))
    reasons = _shapeless(robot, rows, shaped)
    reasons |= {int(robot.link_body[robot.link_index(x)]): why for x, why in unreadable.items()}
    radius = ASSUMED_RADIUS * _longest_chain(robot)
    for body in sorted(reasons):
        rows += [(body, ends, radius, np.empty((0, 3))) for ends in _bones(robot, body)]
    links = [
        robot.link_names[int(np.argmax(robot.link_body == b))] for b in range(len(robot.parent))
    ]
    why = [f'{links[body]} ({reasons[body]})' for body in sorted(reasons)]
    notes = [f'a radius of {radius:.2g} m is assumed for {listed(why)}'] if why else []
    bodies, ends, radii, surfaces = zip(*rows, strict=True)
    return Capsules(
        np.array(bodies),
        np.array(ends),
        np.array(radii),
        tuple(links[body] for body in bodies),
        surfaces,
        tuple(notes),
    )


def _shapeless(robot: RobotModel, rows: Sequence[_Row], shaped: set[int]) -> dict[int, str]:
    """Map bodies to reasons for an assumed radius; ``shaped`` contains the links with shapes."""
    reasons = {}
    for body in range(len(robot.parent)):
        points = [row[-1] for row in rows if row[0] == body]
        if not points and (robot.mass[body] > 0.0 or body == 0):
            reasons[body] = 'it has no collision shape'
        links = np.flatnonzero(robot.link_body == body)
        heaviest = int(links[robot.link_mass[links].argmax()])
        if points and robot.link_mass[heaviest] > 0.0 and heaviest not in shaped:
            # The shapes may belong to other links, such as a camera beside the mass.
            beyond = np.concatenate(points) - robot.com[body]
            if (beyond.min(axis=0) > 0.0).any() or (beyond.max(axis=0) < 0.0).any():
                reasons[body] = 'it has no shape around its centre of mass'
    return reasons


def _longest_chain(robot: RobotModel) -> float:
    lengths = [0.0]
    for body in range(1, len(robot.parent)):
        lengths.append(lengths[robot.parent[body]] + float(np.linalg.norm(robot.p_PL[body])))
    return max(lengths)


def _bones(robot: RobotModel, body: int) -> list[Floats]:
    """Return segments from a body's origin to its children, links and centre of mass."""
    tips = [robot.p_PL[child] for child in np.flatnonzero(robot.parent == body)]
    tips += [*robot.link_position[robot.link_body == body], robot.com[body]]
    return [np.array([np.zeros(3), tip]) for tip in np.unique(np.round(tips, 6), axis=0)]


# From shapes to capsules


def _surface(shape: Shape) -> Floats:
    """Return points on the surface of a shape."""
    import trimesh

    spacing = max(_SPACING[0], _SPACING[1] * float(np.ptp(shape.vertices, axis=0).max()))
    vertices, _ = trimesh.remesh.subdivide_to_size(shape.vertices, shape.faces, spacing, 20)
    _, first = np.unique(np.round(vertices / spacing), axis=0, return_index=True)
    return np.asarray(vertices)[first]


def _distances(points: Floats, ends: Floats) -> Floats:
    """Return the distances of k points, shape (k, 3), to a segment."""
    along = ends[1] - ends[0]
    places = np.clip((points - ends[0]) @ along / max(along @ along, 1e-12), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - ends[0] - np.outer(places, along), axis=1))


def _pieces(shape: Shape) -> list[_Piece]:
    """Cut a shape into pieces whose capsules together contain the shape."""
    # Rounding moves a vertex by at most half the diagonal of a cell: the radii grow by as much.
    cell = max(float(np.ptp(shape.vertices, axis=0).max()), _SMALLEST) / _CELLS
    rounded, index = np.unique(np.round(shape.vertices / cell), axis=0, return_inverse=True)
    faces = np.unique(np.sort(index.ravel()[shape.faces], axis=1), axis=0)
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2])]
    if not len(faces):  # as thin as a wire
        return [_piece(shape.vertices, shape.faces)]
    whole = _piece(rounded * cell, faces)
    _, pieces = _best_cut(whole, _DEPTH, _PRICE * whole.size)
    return [p._replace(radius=p.radius + 0.5 * 3.0**0.5 * cell) for p in pieces]


def _best_cut(piece: _Piece, depth: int, price: float) -> tuple[float, list[_Piece]]:
    """
    Cut a piece recursively if this lowers the total cost; return this cost and the pieces.

    The cost of a piece is its size plus ``price``, because every piece is one more capsule.

    """
    one = piece.size + price, [piece]
    if depth == 0 or piece.size < 2.0 * price:
        return one
    halves = min(_cuts(piece), key=lambda pair: sum(p.size for p in pair), default=())
    if not halves:
        return one
    costs, pieces = zip(*(_best_cut(half, depth - 1, price) for half in halves), strict=True)
    return min(one, (sum(costs), [*pieces[0], *pieces[1]]), key=lambda result: result[0])


def _cuts(piece: _Piece) -> list[tuple[_Piece, _Piece]]:
    """Cut a piece along each of several planes; return the two parts for each such cut."""
    import trimesh

    found = []
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    for normal in np.eye(3):
        for fraction in _CUTS:
            origin = low + fraction * (high - low)
            halves = [
                trimesh.intersections.slice_faces_plane(
                    piece.vertices, piece.faces, sign * normal, origin
                )[:2]
                for sign in (1.0, -1.0)
            ]
            if all(len(faces) for _, faces in halves):
                first, second = (_piece(*half) for half in halves)
                found.append((first, second))
    return found


def _piece(vertices: Floats, faces: Integers) -> _Piece:
    """Return a piece with the given triangles and a small capsule around the triangles."""
    from scipy.spatial import ConvexHull, QhullError

    used, index = np.unique(faces, return_inverse=True)
    vertices = vertices[used]
    points = vertices
    with suppress(QhullError):  # raised for points in a plane
        points = vertices[ConvexHull(vertices).vertices]
    principal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    tried = [
        _Piece(vertices, index.reshape(-1, 3), *_capsule_along(points, axis))
        for axis in (principal[0], *np.eye(3))
    ]
    return min(tried, key=lambda piece: piece.size)


def _capsule_along(points: Floats, axis: Floats) -> tuple[Floats, float]:
    """Return the ends and radius of a small capsule around ``points``, parallel to ``axis``."""
    along = points @ axis
    across = points - along[:, np.newaxis] * axis
    centre = 0.5 * (across.max(axis=0) + across.min(axis=0))
    for k in range(_STEPS):  # towards the farthest point, in ever smaller steps
        offsets = across - centre
        squares = np.einsum('ij,ij->i', offsets, offsets)
        centre = centre + offsets[squares.argmax()] / (k + 2.0)
    squares = np.sum((across - centre) ** 2, axis=1)
    reach = np.sqrt(squares.max() - squares)
    low, high = np.min(along + reach), np.max(along - reach)
    if low > high:
        low = high = 0.5 * (low + high)
    radius = np.sqrt(np.max(squares + (along - np.clip(along, low, high)) ** 2))
    return centre + np.outer([low, high], axis), float(radius)
