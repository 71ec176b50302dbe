"""
Writes inertials and friction into the text of a URDF.

Comments and formatting do not change, so that a diff shows only the new values.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
import os
import re
from typing import NamedTuple
from xml.parsers import expat

import numpy as np

from ..kinematics import rotation_of_origin
from ..model import Floats
from ..rigid_body import RigidBody
from .schema import MOMENTS
from .xml import blank_declaration, read_source

_ROWS, _COLUMNS = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)  # of `MOMENTS`
_INDENT = b'  '


class Friction(NamedTuple):
    """Friction of a joint, as in ``<dynamics>``."""

    damping: float
    """Viscous friction [N m s/rad or N s/m]."""
    friction: float
    """Coulomb friction [N m or N]."""


@dataclass
class _Node:
    """An element, and the byte positions of its tags in the text."""

    kind: str
    attributes: dict[str, str]
    start: int
    tag_end: int
    """Position after the `>` of the start tag."""
    close: int = 0
    """Position of the end tag."""
    children: list[_Node] = field(default_factory=list)

    def first(self, kind: str) -> _Node | None:
        """Return the first child with this tag; `load_urdf` ignores any others."""
        return next((child for child in self.children if child.kind == kind), None)


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
    source = read_source(path_or_xml)
    text = source.data.decode(source.encoding).encode()
    edits: list[tuple[int, int, bytes]] = []
    for node in _parse(blank_declaration(text)).children:
        name = node.attributes.get('name', '')
        if node.kind == 'link' and name in inertials:
            edits += _inertial_edits(text, node, inertials[name])
        elif node.kind == 'joint' and name in friction:
            edits += _friction_edits(text, node, friction[name])
    for start, end, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[end:]
    return text.decode().encode(source.encoding)


def _parse(text: bytes) -> _Node:
    """Return the root element of an XML text."""
    roots: list[_Node] = []
    opened: list[_Node] = []
    parser = expat.ParserCreate('utf-8')

    def start(kind: str, attributes: dict[str, str]) -> None:
        begin = parser.CurrentByteIndex
        node = _Node(kind, attributes, begin, _end_of_tag(text, begin))
        (opened[-1].children if opened else roots).append(node)
        opened.append(node)

    def end(kind: str) -> None:
        opened.pop().close = parser.CurrentByteIndex

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(text, True)
    return roots[0]


def _end_of_tag(text: bytes, start: int) -> int:
    """Return the index after the `>` of a start tag; attribute values may contain `>`, too."""
    found = re.compile(rb'(?:[^>"\']|"[^"]*"|\'[^\']*\')*>').match(text, start)
    assert found is not None
    return found.end()


def _inertial_edits(text: bytes, link: _Node, body: RigidBody) -> Iterator[tuple[int, int, bytes]]:
    place, amount = {'xyz': _numbers(body.com)}, {'value': f'{body.mass:.17g}'}
    inertial = link.first('inertial')
    if inertial is None:
        parts = {'origin': place, 'mass': amount, 'inertia': _moments(body.inertia)}
        lines = [_INDENT + _element(kind, values) for kind, values in parts.items()]
        yield _inserted(text, link, [b'<inertial>', *lines, b'</inertial>'])
        return
    origin = inertial.first('origin')
    mass, inertia = inertial.first('mass'), inertial.first('inertia')
    assert mass is not None
    assert inertia is not None
    rotation = np.eye(3)
    if origin is None:
        indent = _indent(text, mass.start)
        yield mass.start, mass.start, _element('origin', place) + indent
    else:
        yield _attributes(text, origin, place)
        rotation = rotation_of_origin(origin.attributes)
    yield _attributes(text, mass, amount)
    yield _attributes(text, inertia, _moments(rotation.T @ body.inertia @ rotation))


def _friction_edits(
    text: bytes, joint: _Node, friction: Friction
) -> Iterator[tuple[int, int, bytes]]:
    values = {name: f'{value:.17g}' for name, value in friction._asdict().items()}
    dynamics = joint.first('dynamics')
    if dynamics is None:
        yield _inserted(text, joint, [_element('dynamics', values)])
    else:
        yield _attributes(text, dynamics, values)


def _inserted(text: bytes, parent: _Node, lines: list[bytes]) -> tuple[int, int, bytes]:
    """Return an edit that inserts lines after the children of an element, indented like them."""
    outer = _indent(text, parent.start)
    inner = outer + _INDENT if outer else b''
    if parent.children:
        inner = _indent(text, parent.children[-1].start)
    block = b''.join(inner + line for line in lines)
    if text[parent.tag_end - 2 : parent.tag_end] == b'/>':
        name = re.match(rb'<([^\s/>]+)', text[parent.start : parent.tag_end])
        assert name is not None
        return parent.tag_end - 2, parent.tag_end, b'>' + block + outer + b'</' + name[1] + b'>'
    begin = parent.close
    while text[begin - 1 : begin].isspace():  # the last line break belongs to the end tag
        begin -= 1
    return begin, begin, block


def _indent(text: bytes, start: int) -> bytes:
    """Return the line break and indentation before an element, or '' if text precedes it."""
    found = re.search(rb'\r?\n[ \t]*$', text[:start])
    return found[0] if found else b''


def _attributes(text: bytes, node: _Node, values: Mapping[str, str]) -> tuple[int, int, bytes]:
    """Return an edit that replaces the values of attributes, and adds missing attributes."""
    tag = text[node.start : node.tag_end]
    for name, value in values.items():
        pattern = rb'(\s' + name.encode() + rb'\s*=\s*)(?:"[^"]*"|\'[^\']*\')'
        new, count = re.subn(pattern, rb'\g<1>"' + value.encode() + b'"', tag, count=1)
        if not count:
            new = re.sub(rb'\s*(/?>)$', f' {name}="{value}"'.encode() + rb'\1', tag)
        tag = new
    return node.start, node.tag_end, tag


def _element(kind: str, values: Mapping[str, str]) -> bytes:
    attributes = ' '.join(f'{name}="{value}"' for name, value in values.items())
    return f'<{kind} {attributes}/>'.encode()


def _moments(inertia: Floats) -> dict[str, str]:
    values = inertia[_ROWS, _COLUMNS]
    return {name: f'{value:.17g}' for name, value in zip(MOMENTS, values, strict=True)}


def _numbers(values: Floats) -> str:
    return ' '.join(f'{value:.17g}' for value in values)
