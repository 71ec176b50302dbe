"""
Checks of a URDF before its numbers are used.

The format is read as urdfdom reads it, but stricter: where urdfdom logs a line and continues with
a zero, this is an error, because a lost mass means a wrong effort. All errors are collected, each
with its line, its place, and the value found.
"""

from __future__ import annotations

from collections.abc import Mapping

from .elements import warn_if_misspelt
from .inertials import check_link, check_missing_inertials
from .joints import check_joint
from .placeholders import warn_of_placeholders
from .problems import Problems, quoted
from .rules import CHILDREN, version_of, VERSIONS
from .tree import check_mimic_loops, check_tree
from .xml import Element, is_xacro, MAX_LINKS, tag


def check(root: Element, needs_inertials: bool = False) -> Problems:
    """
    Check a <robot> element and everything in it that the dynamics need.

    If inertials are needed, a link that has a shape but no inertial is an error.

    """
    problems = Problems()
    _check_size(root, problems)
    if problems.errors:
        return problems
    _check_name(root, problems)
    _check_version(root, problems)
    links = _by_name(root, 'link')
    joints = _by_name(root, 'joint')
    for element in root:
        kind = tag(element)
        if kind.startswith('xacro:'):
            problems.error(element, f'unprocessed xacro element <{kind}>; run xacro first')
        elif kind == 'link':
            _check_name(element, problems, links)
            check_link(element, problems)
        elif kind == 'joint':
            _check_name(element, problems, joints)
            check_joint(element, joints, problems)
        else:
            warn_if_misspelt(element, 'robot', CHILDREN['robot'], problems)
    check_mimic_loops(joints, problems)
    check_tree(root, links, problems)
    check_missing_inertials(links, joints, problems, needs_inertials)
    warn_of_placeholders(links, problems)
    return problems


def _check_size(root: Element, problems: Problems) -> None:
    for kind in ('link', 'joint'):
        count = sum(tag(element) == kind for element in root)
        if count > MAX_LINKS:
            problems.error(root, f'{count} {kind}s, expected at most {MAX_LINKS}')


def _by_name(root: Element, kind: str) -> dict[str, Element]:
    """Return the elements of a kind by name; the first of several with the same name."""
    found: dict[str, Element] = {}
    for element in root:
        if tag(element) == kind and element.get('name'):
            found.setdefault(element.get('name'), element)
    return found


def _check_name(
    element: Element, problems: Problems, by_name: Mapping[str, Element] | None = None
) -> None:
    """Check that the element has a name and that, with a table of names, it is unique."""
    kind, name = tag(element), element.get('name')
    if not name:
        problems.error(element, f'<{kind}> without a name')
    elif is_xacro(name):
        problems.error(element, f'{kind} name {quoted(name)} looks like unprocessed xacro')
    elif by_name is not None and by_name[name] is not element:
        problems.error(element, f"duplicate {kind} name '{name}'")


def _check_version(root: Element, problems: Problems) -> None:
    version = version_of(root)
    if version not in VERSIONS:
        expected = f'expected one of {", ".join(VERSIONS)}'
        problems.error(root, f'robot version {quoted(version)} is not supported; {expected}')
