"""Parses URDF sources with a hardened parser, without DTDs or network access."""

from __future__ import annotations

import math
import os
import re
import stat
from typing import Any, NamedTuple

from lxml import etree

from ...errors import UrdfError

Element = Any
"""An lxml element; lxml has no type annotations."""

MAX_BYTES = 16 * 2**20
"""Largest accepted size of a robot description [bytes], ten times the largest real one."""

_FOREIGN_ROOTS = {'sdf': 'SDF', 'model': 'a part of SDF', 'mujoco': 'MJCF', 'html': 'HTML'}
_HARMLESS = (
    'NS_ERR_UNDEFINED_NAMESPACE',  # <drake:joint/>
    'ERR_UNKNOWN_VERSION',  # <?xml version="0.0"?>
    'ERR_RESERVED_XML_NAME',  # <?xml?>, or a declaration after an empty line
)
"""Errors of libxml2 in what all URDF tools of ROS accept."""
_PRINTED = 'String value is:'
_PRINTED_HINT = (
    f"begins with '{_PRINTED}', which `ros2 param get` prints before a value; use `ros2 param get "
    '--hide-type`'
)
_BROKEN_VALUE = re.compile(
    rb'<(origin|mass|inertia|axis|limit|dynamics|mimic)\b[^<>]*='
    rb'\s*(["\'])[^"\'<>]*[\r\n\t][^"\'<>]*\2'
)
_DOCTYPE = re.compile(rb'\s*(<\?[^>]*>\s*)?<!doctype', re.IGNORECASE)
_NO_DOCTYPE = 'DOCTYPE/DTD is not allowed in a URDF'
_COMMENT = re.compile(rb'<!--.*?-->', re.DOTALL)


class Source(NamedTuple):
    """The name and the bytes of a robot description."""

    name: str
    data: bytes
    encoding: str | None = None
    """The encoding of text; None for a file, whose bytes may declare an encoding."""


def read_source(path_or_xml: str | os.PathLike[str]) -> Source:
    """Return the bytes of a file or of XML text, or raise a UrdfError."""
    if isinstance(path_or_xml, str) and is_text(path_or_xml):
        # The declared encoding does not apply, because the text is decoded already.
        data = path_or_xml.lstrip('\ufeff').encode('utf-8', 'surrogatepass')
        source, kind, size = Source('URDF', data, 'utf-8'), 'text', len(data)
    else:
        data, size = _read_file(path_or_xml)
        source, kind = Source(os.fspath(path_or_xml), data), 'file'

    if len(source.data) > MAX_BYTES:
        found, limit = math.ceil(size / 2**20), MAX_BYTES // 2**20
        raise UrdfError([f'{kind} is {found} MiB, limit is {limit} MiB'], source.name)
    if not source.data.strip(b'\xef\xbb\xbf \t\r\n'):
        hint = ': expected a path or XML text' if kind == 'text' else ''
        raise UrdfError([f'{kind} is empty{hint}'], source.name)
    if source.data.lstrip().startswith(_PRINTED.encode()):
        raise UrdfError([_PRINTED_HINT], source.name)
    return source


def is_text(path_or_xml: str) -> bool:
    """Return whether a string is not a path: XML text, output of `ros2 param get`, or blank."""
    text = path_or_xml.lstrip('\ufeff \t\r\n')
    return not text or text.startswith(('<', _PRINTED))


def _read_file(path: str | os.PathLike[str]) -> tuple[bytes, int]:
    """Return at most `MAX_BYTES` + 1 bytes of a file, and the size of the file."""
    if not isinstance(os.fspath(path), str):
        raise TypeError(f'expected a path or XML text as str, got {type(path).__name__}')
    name = os.fspath(path)
    try:
        status = os.stat(path)
        if stat.S_ISDIR(status.st_mode):
            raise UrdfError(['is a directory, expected a URDF file'], name)
        if not stat.S_ISREG(status.st_mode):
            # Opening a pipe would wait for a writer, and reading a device may never end.
            raise UrdfError(['is not a regular file'], name)
        with open(path, 'rb') as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        hint = "; XML text must start with '<'" if isinstance(path, str) else ''
        raise UrdfError([f'cannot be read: {error.strerror}{hint}'], name) from error
    except ValueError as error:  # a NUL or a lone surrogate in the path
        raise UrdfError([f'cannot be read: {error}'], name) from error
    return data, max(status.st_size, len(data))


def parse(source: Source, keep_comments: bool = False) -> Element:
    """Parse XML; return the <robot> element without a default namespace, or raise a UrdfError."""
    parser = etree.XMLParser(
        encoding=source.encoding,
        recover=True,  # collects the errors, of which some are harmless
        resolve_entities=False,
        load_dtd=False,
        dtd_validation=False,
        attribute_defaults=False,
        no_network=True,
        huge_tree=False,  # keeps libxml2's limits on depth and entity expansion
        remove_comments=not keep_comments,
        remove_pis=not keep_comments,
    )
    try:
        root = etree.fromstring(source.data, parser)
    except etree.XMLSyntaxError as error:
        raise UrdfError([f'not well-formed XML: {error.msg}'], source.name) from error
    if _DOCTYPE.match(source.data):
        raise UrdfError([_NO_DOCTYPE], source.name)
    for entry in parser.error_log:
        if entry.level >= etree.ErrorLevels.ERROR and entry.type_name not in _HARMLESS:
            where = f'line {entry.line}, column {entry.column}'
            problem = f'not well-formed XML: {entry.message.strip()}, {where}'
            raise UrdfError([problem], source.name)
    if root.getroottree().docinfo.internalDTD is not None:
        raise UrdfError([_NO_DOCTYPE], source.name)

    if tag(root) != 'robot':
        known = _FOREIGN_ROOTS.get(tag(root).lower())
        hint = f' (this is {known})' if known else ''
        raise UrdfError([f'root element is <{tag(root)}>, expected <robot>{hint}'], source.name)
    for element in root.iter(etree.Element):
        # All URDF tools ignore a default namespace (<robot xmlns="...">).
        if element.prefix is None and '}' in element.tag:
            element.tag = tag(element)
    return root


def tag(element: Element) -> str:
    """Return the name of an element as in the file, with its prefix."""
    local_name = element.tag.rpartition('}')[2]
    return f'{element.prefix}:{local_name}' if element.prefix else local_name


def children(element: Element, kind: str) -> list[Element]:
    """Return the children with this tag, in file order."""
    return list(element.iterchildren(kind))


def is_xacro(text: str) -> bool:
    """Return whether an attribute contains unprocessed xacro."""
    return '${' in text or '$(' in text


def broken_values(source: Source) -> list[tuple[int, str]]:
    """
    Find line breaks and tabs inside the attributes of a description.

    The result contains the line and the name of each element that urdfdom, the parser of ROS,
    cannot read. An XML parser replaces these characters with spaces.

    """
    text = _COMMENT.sub(lambda found: b'\n' * found[0].count(b'\n'), source.data)
    return [
        (text.count(b'\n', 0, found.start()) + 1, found[1].decode())
        for found in _BROKEN_VALUE.finditer(text)
    ]
