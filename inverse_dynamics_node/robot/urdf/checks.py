"""
Checks the elements and the link tree of a URDF.

All errors are collected, with line, element and value.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

from ...errors import listed, unknown_name
from .schema import (
    check_joint,
    check_link,
    CHILDREN,
    is_finite_decimal,
    label,
    MOMENTS,
    Problems,
    quoted,
    warn_if_misspelt,
)
from .xml import children, Element, is_xacro, MAX_LINKS, tag


def check(root: Element) -> Problems:
    """Check a <robot> element and everything in it that the dynamics need."""
    problems = Problems()
    _check_size(root, problems)
    if problems.errors:
        return problems
    _check_name(root, problems)
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
    check_missing_inertials(links, joints, problems)
    warn_of_placeholders(links, problems)
    return problems


def _check_size(root: Element, problems: Problems) -> None:
    for kind in ('link', 'joint'):
        count = len(children(root, kind))
        if count > MAX_LINKS:
            problems.error(root, f'{count} {kind}s, expected at most {MAX_LINKS}')


def _by_name(root: Element, kind: str) -> dict[str, Element]:
    """Return the elements of a kind by name; a repeated name refers to the first element."""
    found: dict[str, Element] = {}
    for element in children(root, kind):
        if element.get('name'):
            found.setdefault(element.get('name'), element)
    return found


def _check_name(
    element: Element, problems: Problems, by_name: Mapping[str, Element] | None = None
) -> None:
    """Check that an element has a name, which must be unique if ``by_name`` is given."""
    kind, name = tag(element), element.get('name')
    if not name:
        problems.error(element, f'<{kind}> has no name')
    elif is_xacro(name):
        problems.error(element, f'{kind} name {quoted(name)} looks like unprocessed xacro')
    elif by_name is not None and by_name[name] is not element:
        problems.error(element, f"duplicate {kind} name '{name}'")


def check_tree(root: Element, links: Mapping[str, Element], problems: Problems) -> None:
    """Check that the joints connect all links into one tree."""
    holders: dict[str, Element] = {}
    below: defaultdict[str, list[str]] = defaultdict(list)
    all_ends_known = True
    for joint in children(root, 'joint'):
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
        below[parent].append(child)

    if not links:
        problems.error_of_all('the robot has no links')
    elif len(links) == 1 and not children(root, 'joint'):
        problems.error_of_all('the robot has one link and no joints: nothing to command')
    elif all_ends_known:  # otherwise a broken joint explains why a link is not connected
        _check_roots([name for name in links if name not in holders], links, below, problems)


def _check_ends(
    joint: Element, links: Mapping[str, Element], problems: Problems
) -> tuple[str, str] | None:
    """Return the names of a joint's parent and child links, or None if they are invalid."""
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
    below: Mapping[str, list[str]],
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
        found = [name for name in below.get(waiting.pop(), ()) if name not in reached]
        reached.update(found)
        waiting += found
    adrift = [f"'{name}'" for name in links if name not in reached]
    if adrift:
        text = f"{len(adrift)} links are not connected to root '{roots[0]}', because of a cycle"
        problems.error_of_all(f'{text}: {listed(adrift)}')


def check_mimic_loops(joints: Mapping[str, Element], problems: Problems) -> None:
    """Check that no chain of mimic joints forms a loop."""
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
    """Return the first child of a kind, or None."""
    return next(iter(children(element, kind)), None)


def check_missing_inertials(
    links: Mapping[str, Element], joints: Mapping[str, Element], problems: Problems
) -> None:
    """
    Warn of links that have a shape but no inertial.

    Links without a shape are assumed to be mere frames. The root link is not checked, because it
    may be the ground.

    """
    held = {end.get('link') for joint in joints.values() for end in children(joint, 'child')}
    text = 'has a shape but no <inertial>; it is treated as massless'
    hint = 'add an <inertial> from CAD; without it, the weight of this link is not compensated'
    for name, link in links.items():
        parts = {tag(part) for part in link}
        if name in held and 'inertial' not in parts and parts & {'visual', 'collision'}:
            problems.warning(link, label(link), text, hint)


_FEWEST_ALIKE = 3
"""
Fewer links with equal values cause no warning, because two links may be identical parts.

Two unit inertias suffice for a warning.
"""
_FRACTION_ALIKE = 0.8
"""If at least this fraction of the links with mass have equal values, warn of placeholders."""


def warn_of_placeholders(links: Mapping[str, Element], problems: Problems) -> None:
    """Warn about unit masses and about unit or equal inertias, which are probably placeholders."""
    masses: dict[str, float] = {}
    tensors: dict[str, tuple[float, ...]] = {}
    for name, link in links.items():
        mass, tensor = _numbers_of(link, 'mass', ['value']), _numbers_of(link, 'inertia', MOMENTS)
        if mass and tensor and mass[0] > 0.0:
            masses[name], tensors[name] = mass[0], tensor
    count = len(masses)
    unit = [name for name in masses if tensors[name] == (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)]
    if len(unit) > 1:
        text = f'{len(unit)} of {count} links with mass have ixx = iyy = izz = 1 kg m^2'
        names = listed(unit[:4]) + ', ...' * (len(unit) > 4)
        _warn(links[unit[0]], f'{text} ({names})', problems)
    if count < _FEWEST_ALIKE:
        return
    ((common, _),) = Counter(tensors.values()).most_common(1)
    alike = [name for name, tensor in tensors.items() if tensor == common]
    # Identical modules of a chain have equal inertias and masses, but are not spheres.
    ixx, ixy, ixz, iyy, iyz, izz = common
    is_sphere = ixx == iyy == izz and not (ixy or ixz or iyz)
    are_different = len({masses[name] for name in alike}) > 1
    if len(alike) >= _FRACTION_ALIKE * count and not unit and (is_sphere or are_different):
        text = f'{len(alike)} of {count} links with mass have the same inertia'
        _warn(links[alike[0]], f'{text} (ixx = {ixx:g} kg m^2)', problems)
    heavy = [name for name, mass in masses.items() if mass == 1.0]
    if len(heavy) >= max(_FEWEST_ALIKE, _FRACTION_ALIKE * count):
        text = f'{len(heavy)} of {count} links with mass have a mass of 1 kg'
        _warn(links[heavy[0]], text, problems)


def _warn(link: Element, text: str, problems: Problems) -> None:
    hint = 'take mass, centre of mass and inertia from CAD'
    problems.warning(link, '', f'{text}, which looks like a placeholder', hint)


def _numbers_of(link: Element, kind: str, names: Sequence[str]) -> tuple[float, ...] | None:
    """Return numbers from the inertial of a link, or None if a number is missing or invalid."""
    part = link.find(f'inertial/{kind}')
    if part is None:
        return None
    texts = [part.get(name, '') for name in names]
    if not all(is_finite_decimal(text.strip()) for text in texts):
        return None
    return tuple(float(text) for text in texts)
