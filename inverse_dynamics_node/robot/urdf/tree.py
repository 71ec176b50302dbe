"""Checks of references: the links form one tree, and mimicking joints have a master."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from ...errors import listed, unknown_name
from .problems import label, Problems
from .xml import Element, is_xacro, tag


def check_tree(root: Element, links: Mapping[str, Element], problems: Problems) -> None:
    """Check that the joints connect the links to one tree."""
    holders: dict[str, Element] = {}
    children: defaultdict[str, list[str]] = defaultdict(list)
    all_ends_known = True
    for joint in root:
        if tag(joint) != 'joint':
            continue
        ends = _check_ends(joint, links, problems)
        if ends is None:
            all_ends_known = False
            continue
        parent, child = ends
        if child in holders:
            pair = f"'{holders[child].get('name')}' and '{joint.get('name')}'"
            problems.error(joint, f"link '{child}' has two parent joints: {pair}")
            continue
        holders[child] = joint
        children[parent].append(child)

    if not links:
        problems.error_of_all('the robot has no links')
    elif len(links) == 1 and not any(tag(element) == 'joint' for element in root):
        problems.error_of_all('the robot has one link and no joints: nothing to command')
    elif all_ends_known:  # otherwise a broken joint explains why a link is not connected
        _check_roots([name for name in links if name not in holders], links, children, problems)


def _check_ends(
    joint: Element, links: Mapping[str, Element], problems: Problems
) -> tuple[str, str] | None:
    """Return the names of parent and child link, if both exist."""
    where, ends = label(joint), []
    for end in ('parent', 'child'):
        element = _only_child(joint, end)
        name = None if element is None else element.get('link')
        if name is None:
            continue
        if name in links:
            ends.append(name)
        elif not is_xacro(name):
            text = f'{where}: {end} {unknown_name("link", name, links)}'
            problems.error(element, text)
    if len(ends) < 2:
        return None
    if ends[0] == ends[1]:
        problems.error(joint, f"{where}: parent and child are the same link '{ends[0]}'")
        return None
    return ends[0], ends[1]


def _check_roots(
    roots: list[str],
    links: Mapping[str, Element],
    children: Mapping[str, list[str]],
    problems: Problems,
) -> None:
    if not roots:
        problems.error_of_all('no root link: the links form a cycle')
        return
    if len(roots) > 1:
        names = listed([f"'{name}'" for name in roots])
        problems.error_of_all(f'{len(roots)} root links: {names}; expected one')
    reached, waiting = set(roots), list(roots)
    while waiting:
        found = [name for name in children.get(waiting.pop(), ()) if name not in reached]
        reached.update(found)
        waiting += found
    adrift = [f"'{name}'" for name in links if name not in reached]
    if adrift:
        text = f"{len(adrift)} links are not connected to root '{roots[0]}' (cycle)"
        problems.error_of_all(f'{text}: {listed(adrift)}')


def check_mimic(
    joint: Element, mimic: Element, joints: Mapping[str, Element], problems: Problems
) -> None:
    """Check that the master exists and moves."""
    where, master = label(joint), mimic.get('joint')
    if master is None or is_xacro(master):
        return
    if master not in joints:
        problems.error(mimic, f'{where} mimic: {unknown_name("joint", master, joints)}')
    elif master == joint.get('name'):
        problems.error(mimic, f'{where} mimics itself')
    elif joints[master].get('type') == 'fixed':
        problems.error(mimic, f"{where} mimics '{master}' of type fixed")


def check_mimic_loops(joints: Mapping[str, Element], problems: Problems) -> None:
    """Check that every chain of mimicking joints ends."""
    masters = {}
    for name, joint in joints.items():
        mimic = _only_child(joint, 'mimic') if joint.get('type') != 'fixed' else None
        if mimic is not None and mimic.get('joint') not in (None, name):
            masters[name] = mimic.get('joint')
    settled: set[str] = set()
    for start in masters:
        path: dict[str, None] = {}
        name = start
        while name in masters and name not in settled and name not in path:
            path[name] = None
            name = masters[name]
        if name in path:
            members = list(path)
            loop = [*members[members.index(name) :], name]
            problems.error(joints[name], f'mimic loop: {" -> ".join(loop)}')
        settled.update(path)


def _only_child(element: Element, kind: str) -> Element | None:
    """Return the first child of a kind."""
    return next((child for child in element if tag(child) == kind), None)
