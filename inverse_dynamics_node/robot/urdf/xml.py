"""Parses URDF sources with a hardened parser, without DTDs or network access."""

from __future__ import annotations

import math
import os
import re
import stat
from typing import Any, NamedTuple

from lxml import etree

from ...errors import shortened, UrdfError

Element = Any
"""An lxml element; lxml has no type annotations."""

MAX_BYTES = 16 * 2**20
"""Largest accepted size of a robot description [bytes], ten times the largest real one."""

MAX_LINKS = 1000
"""Largest accepted number of links, and of joints; real robots have far fewer."""

_FOREIGN_ROOTS = {'sdf': 'SDF', 'model': 'a part of SDF', 'mujoco': 'MJCF', 'html': 'HTML'}

_BOM = '\ufeff'
_DECLARATION = re.compile(rb'(?:\xef\xbb\xbf)?\s*<\?xml(?:\s[^>]*)?\?>')
_ENCODING = re.compile(rb'encoding\s*=\s*["\']([^"\']*)')
_FIRST_START_TAG = re.compile(rb'<[A-Za-z_]')


class Source(NamedTuple):
    """The name and the bytes of a robot description."""

    name: str
    data: bytes
    encoding: str


def read_source(path_or_xml: str | os.PathLike[str]) -> Source:
    """Return the bytes of a file or of XML text, or raise a UrdfError."""
    if isinstance(path_or_xml, str) and path_or_xml.lstrip(f'{_BOM} \t\r\n').startswith('<'):
        # The declared encoding does not apply, because the text is decoded already.
        data = path_or_xml.lstrip(_BOM).encode('utf-8', 'surrogatepass')
        source, kind, size = Source('URDF', data, 'utf-8'), 'text', len(data)
    elif isinstance(path_or_xml, str) and not path_or_xml.strip():
        raise UrdfError(['the robot description is empty: expected a path or XML text'])
    else:
        data, size = _read_file(path_or_xml)
        name = shortened(os.fspath(path_or_xml), 250)
        source, kind = Source(name, data, _declared_encoding(data)), 'file'

    if len(source.data) > MAX_BYTES:
        found, limit = math.ceil(size / 2**20), MAX_BYTES // 2**20
        raise UrdfError([f'{kind} is {found} MiB, limit is {limit} MiB'], source.name)
    if not source.data.strip(b'\xef\xbb\xbf \t\r\n'):
        raise UrdfError([f'{kind} is empty'], source.name)
    return source


def _read_file(path: str | os.PathLike[str]) -> tuple[bytes, int]:
    """Return at most `MAX_BYTES` + 1 bytes of a file, and the size of the file."""
    if not isinstance(os.fspath(path), str):
        raise TypeError(f'expected a path or XML text as str, got {type(path).__name__}')
    name = shortened(os.fspath(path), 250)
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


def parse(source: Source) -> Element:
    """Parse XML; return the <robot> element, or raise a UrdfError."""
    # libxml2 rejects declarations such as version="0.0", which other URDF tools accept.
    data = blank_declaration(source.data)
    try:
        parser = _hardened_parser(source.encoding)
        root = etree.fromstring(data, parser)
    except LookupError:
        problem = f"not well-formed XML: unknown encoding '{source.encoding}', line 1"
        raise UrdfError([problem], source.name) from None
    except etree.XMLSyntaxError as error:
        errors = (e for e in parser.error_log if e.level >= etree.ErrorLevels.ERROR)
        if any(each.type != etree.ErrorTypes.NS_ERR_UNDEFINED_NAMESPACE for each in errors):
            raise UrdfError(_syntax_problems(source, error), source.name) from error
        # All URDF tools of ROS accept undeclared prefixes, so these elements are not essential.
        root = etree.fromstring(data, _hardened_parser(source.encoding, recover=True))

    if root.getroottree().docinfo.internalDTD is not None:
        raise UrdfError([_NO_DOCTYPE], source.name)
    if tag(root) != 'robot':
        known = _FOREIGN_ROOTS.get(tag(root).lower())
        hint = f' (this is {known})' if known else ''
        raise UrdfError([f'root element is <{tag(root)}>, expected <robot>{hint}'], source.name)
    return root


def tag(element: Element) -> str:
    """Return the name of an element as in the file, with its prefix."""
    # All URDF tools ignore a default namespace (<robot xmlns="...">).
    local_name = element.tag.rpartition('}')[2]
    return f'{element.prefix}:{local_name}' if element.prefix else local_name


def children(element: Element, kind: str) -> list[Element]:
    """Return the children with this tag, in file order."""
    return [child for child in element if tag(child) == kind]


def is_xacro(text: str) -> bool:
    """Return whether an attribute contains unprocessed xacro."""
    return '${' in text or '$(' in text


def _hardened_parser(encoding: str, recover: bool = False) -> Any:
    return etree.XMLParser(
        encoding=encoding,
        recover=recover,
        resolve_entities=False,
        load_dtd=False,
        dtd_validation=False,
        attribute_defaults=False,
        no_network=True,
        huge_tree=False,  # keeps libxml2's limits on depth and entity expansion
        remove_comments=True,
        remove_pis=True,
    )


def _declared_encoding(data: bytes) -> str:
    """Return the encoding that the byte order mark or the declaration states, or UTF-8."""
    if data.startswith((b'\xff\xfe', b'\xfe\xff')):
        return 'utf-16'
    if data.startswith((b'<\0', b'\0<')):  # UTF-16 without a byte order mark
        return 'UTF-16LE' if data.startswith(b'<') else 'UTF-16BE'
    found = _DECLARATION.match(data)
    declared = _ENCODING.search(found[0]) if found else None
    return declared[1].decode('ascii', 'replace') if declared else 'utf-8'


def blank_declaration(data: bytes) -> bytes:
    """Replace every character of an XML declaration, except line breaks, with a space."""
    found = _DECLARATION.match(data)
    if not found:
        return data
    return re.sub(rb'[^\r\n]', b' ', found[0]) + data[found.end() :]


_NO_DOCTYPE = 'DOCTYPE/DTD is not allowed in a URDF'


def _syntax_problems(source: Source, error: Any) -> list[str]:
    problems = [f'not well-formed XML: {error.msg}']
    start_tag = _FIRST_START_TAG.search(source.data)
    head = source.data[: start_tag.start()] if start_tag else source.data
    if b'<!doctype' in head.lower():
        problems.insert(0, _NO_DOCTYPE)
    return problems
