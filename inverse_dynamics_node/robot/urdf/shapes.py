"""Reads the collision shapes of a URDF as triangles."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..kinematics import rotation_of_origin
from ..model import Floats, Integers
from .xml import children, Element, parse, read_source, tag


class Shape(NamedTuple):
    """One collision shape of a link, in the frame of the link."""

    link: str
    vertices: Floats
    """Positions of the vertices, shape (v, 3) [m]."""
    faces: Integers
    """Indices of the vertices of each triangle, shape (f, 3)."""


def read_shapes(path_or_xml: str | os.PathLike[str]) -> tuple[list[Shape], dict[str, str]]:
    """
    Read the collision shapes of a robot, including those in mesh files.

    Call this function only with a description that `load_urdf` accepts. The first result contains
    the readable shapes. The second result maps the name of each link that has an unreadable shape
    to an error message.

    """
    source = read_source(path_or_xml)
    folder = None if source.name == 'URDF' else Path(path_or_xml).resolve().parent
    shapes: list[Shape] = []
    unreadable: dict[str, str] = {}
    for link in children(parse(source), 'link'):
        name = link.get('name')
        for collision in children(link, 'collision'):
            try:
                shapes.append(_shape(name, collision, folder))
            except Exception as error:  # trimesh raises the errors of many file readers
                reason = str(error).partition('\n')[0] or type(error).__name__
                unreadable.setdefault(name, reason)
    return shapes, unreadable


def _shape(link: str, collision: Element, folder: Path | None) -> Shape:
    rotation, position = np.eye(3), np.zeros(3)
    for origin in children(collision, 'origin')[:1]:
        position = _numbers(origin, 'xyz', '0 0 0')
        rotation = rotation_of_origin(origin.attrib)
    (geometry,) = children(collision, 'geometry')
    (solid,) = [child for child in geometry if isinstance(child.tag, str)]
    mesh = _mesh(solid, folder)
    vertices = np.asarray(mesh.vertices, float) @ rotation.T + position
    if not len(mesh.faces) or not np.isfinite(vertices).all():
        raise ValueError(f'<{tag(solid)}> has no triangles, or its coordinates are not finite')
    return Shape(link, vertices, np.asarray(mesh.faces))


def _mesh(solid: Element, folder: Path | None) -> Any:
    """Return a solid as triangles; all vertices are on the surface of the solid."""
    import trimesh  # takes a third of a second to import

    kind = tag(solid)
    if kind == 'box':
        return trimesh.creation.box(_numbers(solid, 'size'))
    if kind == 'sphere':
        return trimesh.creation.icosphere(2, *_numbers(solid, 'radius'))
    if kind in ('cylinder', 'capsule'):
        (radius,), (length,) = _numbers(solid, 'radius'), _numbers(solid, 'length')
        create = trimesh.creation.cylinder if kind == 'cylinder' else trimesh.creation.capsule
        return create(radius=radius, height=length)
    if kind != 'mesh':
        raise ValueError(f'<{kind}> is not a URDF shape')
    path = _mesh_file(solid.get('filename', ''), folder)
    mesh = trimesh.load(path, force='mesh', process=False)
    mesh.vertices = mesh.vertices * _numbers(solid, 'scale', '1 1 1')
    return mesh


def _mesh_file(name: str, folder: Path | None) -> Path:
    """Find a mesh file by its path, in an installed package, or in a parent folder of the URDF."""
    scheme, _, rest = name.rpartition('://')
    if scheme not in ('package', 'model'):
        paths = [Path(rest) if folder is None else folder / rest]
    else:
        package, _, inside = rest.partition('/')
        shares = [
            Path(prefix) / 'share' for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(':')
        ]
        paths = [share / rest for share in shares]
        for parent in folder.parents if folder else ():
            paths += [parent / rest, *([parent / inside] if parent.name == package else [])]
        if folder:
            # The folder of a checkout may not have the name of the package.
            paths += [parent / inside for parent in (folder, *folder.parents)]
    for path in paths:
        if path.is_file():
            return path
    raise ValueError(f"mesh '{name}' not found")


def _numbers(element: Element, name: str, default: str | None = None) -> Floats:
    text = element.get(name, default)
    if text is None:
        raise ValueError(f'<{tag(element)}> lacks {name}')
    return np.array([float(word) for word in text.split()])
