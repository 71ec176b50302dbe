"""Writes inertials and friction into a URDF; all other elements and comments stay."""

from __future__ import annotations

from collections.abc import Mapping
import os
from typing import NamedTuple

from lxml import etree

from ..kinematics import rotation_of_origin
from ..rigid_body import RigidBody
from .checks import MOMENTS
from .xml import children, Element, parse, read_source

_ROWS, _COLUMNS = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)  # of `MOMENTS`
_LINE_END = '\n'


class Friction(NamedTuple):
    """Friction of a joint, as in ``<dynamics>``."""

    damping: float
    """Viscous friction [N m s/rad or N s/m]."""
    friction: float
    """Coulomb friction [N m or N]."""


def rewrite(
    path_or_xml: str | os.PathLike[str],
    inertials: Mapping[str, RigidBody],
    friction: Mapping[str, Friction],
) -> bytes:
    """
    Replace inertials and friction in a valid URDF; return the new text.

    ``inertials`` maps link names to bodies, each in the link frame. An existing inertial frame
    keeps its axes. ``friction`` maps joint names to friction. Missing elements are added. The
    result has the encoding of the original. New numbers have 17 significant digits.

    """
    root = parse(read_source(path_or_xml), keep_comments=True)
    for link in children(root, 'link'):
        if link.get('name') in inertials:
            _write_inertial(link, inertials[link.get('name')])
    for joint in children(root, 'joint'):
        if joint.get('name') in friction:
            values = friction[joint.get('name')]._asdict()
            _write(_child(joint, 'dynamics', len(joint)), **values)
    encoding = root.getroottree().docinfo.encoding or 'utf-8'
    around = [*root.itersiblings(preceding=True)][::-1], [root], root.itersiblings()
    nodes = [etree.tostring(node, encoding='unicode') for group in around for node in group]
    text = '\n'.join([f'<?xml version="1.0" encoding="{encoding}"?>', *nodes, ''])
    return text.encode(encoding)


def _write_inertial(link: Element, body: RigidBody) -> None:
    inertial = _child(link, 'inertial', len(link))
    origin = _child(inertial, 'origin', 0)
    rotation = rotation_of_origin(origin.attrib)
    origin.set('xyz', ' '.join(f'{x:.17g}' for x in body.com))
    _write(_child(inertial, 'mass', len(inertial)), value=body.mass)
    moments = (rotation.T @ body.inertia @ rotation)[_ROWS, _COLUMNS]
    inertia = _child(inertial, 'inertia', len(inertial))
    _write(inertia, **dict(zip(MOMENTS, moments, strict=True)))


def _write(element: Element, **values: float) -> None:
    for name, value in values.items():
        element.set(name, f'{value:.17g}')


def _child(parent: Element, kind: str, index: int) -> Element:
    """Return the first child of a kind, or insert one at an index and indent it."""
    child = parent.find(kind)
    if child is not None:
        return child
    child = etree.Element(kind)
    if not len(parent):
        before = parent.getprevious()
        text = (parent.getparent().text if before is None else before.tail) or ''
        indent = f'{_LINE_END}{text.rpartition(_LINE_END)[2]}' if _LINE_END in text else ''
        parent.text, child.tail = indent + '  ' * bool(indent), indent
    elif index:
        child.tail, parent[-1].tail = parent[-1].tail, parent.text
    else:
        child.tail = parent.text
    parent.insert(index, child)
    return child
