"""
What must hold for a URDF before its numbers are used, as urdfdom reads the format.

Where urdfdom logs a line and goes on with a zero, this is an error: a lost mass means a wrong
effort. All problems are collected, each with its line, its place, and the value found.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
import math
import re

import numpy as np

from ...errors import listed
from .findings import Findings, label, quoted
from .rules import (
    CHILDREN,
    CHILDREN_OF_FIXED,
    MOMENTS,
    RULES,
    SUPPORTED_TYPES,
    VERSIONS,
    VERSIONS_WITH_QUATERNIONS,
)
from .tree import check_mimic, check_mimic_loops, check_tree
from .xml import (
    Element,
    is_xacro,
    shortened,
    tag,
)

_LIMITED_TYPES = ('revolute', 'prismatic')
_UNSUPPORTED_TYPES = {
    'planar': 'use two prismatic joints and a continuous one, with massless links between them',
    'floating': 'remove it: the base may move, its motion is an input',
}

# Python's float() would also take '1_000', 'nan', 'infinity' and the digits of other scripts.
_DECIMAL = re.compile(r'[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?')

MIN_AXIS_LENGTH = 1e-6
"""Below this, an axis is noise rather than a direction."""
_UNIT_TOLERANCE = 1e-3
"""An axis written with four digits is a unit vector; a longer or shorter one a surprise."""
_QUATERNION_TOLERANCE = 0.1
"""Rounding to one digit changes the norm of a quaternion by less; a typing error by more."""
_MOMENT_TOLERANCE = 1e-3
"""Rounded moments of a flat part miss the triangle inequality by this much of their sum."""
_MAX_GYRATION = 10.0
"""A radius of gyration [m] no link has: the inertia is in other units than kg m^2."""
_MAX_RPY = 7.0
"""Somewhat more than a turn [rad]: the angles are in degrees."""
_FEWEST_ALIKE = 3
"""Links; two that are alike may well be two equal parts."""
_SHARE_ALIKE = 0.8
"""Links with the same values, as a fraction of all links with mass, that nobody measured."""
_MAX_TURN = 50.0
"""A position limit [rad] no joint has: the limits are in degrees."""


def check(root: Element, needs_inertials: bool = False) -> Findings:
    """
    Check a <robot> element and everything in it that dynamics need.

    Where inertials are needed, a link that can be seen or touched, but has none, is a problem.

    """
    findings = Findings()
    _check_name(root, findings)
    _check_version(root, findings)
    links = _by_name(root, 'link')
    joints = _by_name(root, 'joint')
    for element in root:
        kind = tag(element)
        if kind.startswith('xacro:'):
            findings.problem(element, f'unprocessed xacro element <{kind}>; run xacro first')
        elif kind == 'link':
            _check_name(element, findings, links)
            _check_link(element, findings)
        elif kind == 'joint':
            _check_name(element, findings, joints)
            _check_joint(element, joints, findings)
        else:
            _warn_if_misspelt(element, 'robot', CHILDREN['robot'], findings)
    check_mimic_loops(joints, findings)
    check_tree(root, links, findings)
    _check_inertials(links, joints, findings.problem if needs_inertials else findings.warning)
    _warn_of_placeholders(links, findings)
    return findings


def _by_name(root: Element, kind: str) -> dict[str, Element]:
    found: dict[str, Element] = {}
    for element in root:
        if tag(element) == kind and element.get('name'):
            found.setdefault(element.get('name'), element)
    return found


# ---- Names and attributes ------------------------------------------------------------------


def _check_name(
    element: Element, findings: Findings, first_of: Mapping[str, Element] | None = None
) -> None:
    """Check that the element has a name, of its own, where a table of first holders is given."""
    kind, name = tag(element), element.get('name')
    if not name:
        findings.problem(element, f'<{kind}> without a name')
    elif is_xacro(name):
        findings.problem(element, f'{kind} name {quoted(name)} looks like unprocessed xacro')
    elif first_of is not None and first_of[name] is not element:
        findings.problem(element, f"duplicate {kind} name '{name}'")


def _check_version(root: Element, findings: Findings) -> None:
    version = _version(root)
    if version not in VERSIONS:
        expected = f'expected one of {", ".join(VERSIONS)}'
        findings.problem(root, f'robot version {quoted(version)} is not supported; {expected}')


def _version(element: Element) -> str:
    """Return the version of URDF that the document declares."""
    version: str = element.getroottree().getroot().get('version', '1.0')
    return version


def _is_prefixed(name: str) -> bool:
    return ':' in name or name.startswith('{')


def _check_children(
    element: Element, where: str, kinds: tuple[str, ...], findings: Findings
) -> dict[str, Element]:
    """Return the children of the given kinds, at most one of each."""
    found: defaultdict[str, list[Element]] = defaultdict(list)
    for child in element:
        kind = tag(child)
        found[kind].append(child)
        if kind.startswith('xacro:'):
            text = f'unprocessed xacro element <{kind}>; run xacro first'
            findings.problem(child, f'{where}: {text}')
        _warn_if_misspelt(child, where, kinds, findings)
    for kind in kinds:
        if len(found[kind]) > 1:
            count = f'{len(found[kind])} <{kind}> elements'
            findings.problem(found[kind][1], f'{where}: {count}, at most one allowed')
    return {kind: found[kind][0] for kind in kinds if found[kind]}


def _warn_if_misspelt(
    element: Element, where: str, kinds: tuple[str, ...], findings: Findings
) -> None:
    kind = tag(element)
    if kind not in kinds and kind.lower() in kinds:
        findings.warning(element, f'{where}: <{kind}> ignored; URDF spells it <{kind.lower()}>')


def _check_attributes(
    element: Element, where: str, findings: Findings
) -> dict[str, tuple[float, ...]]:
    """Check an element by its rule; return the numbers of the attributes that are right."""
    kind = tag(element)
    rule = RULES[kind]
    values: dict[str, tuple[float, ...]] = {}
    lacking = [name for name in rule.required if name not in element.attrib]
    if lacking:
        findings.problem(element, f'{where}: {_lacking(kind, lacking)}')
    for name, text in element.attrib.items():
        # <mass value="2"/> is all about its one number: 'mass', not 'mass value'.
        what = kind if name == 'value' else f'{kind} {name}'
        if name not in rule.names and name not in rule.numbers:
            if not rule.is_open and not _is_prefixed(name):
                text = f"{where} {kind}: attribute '{name}' is unknown and ignored"
                findings.warning(element, text)
        elif is_xacro(text):
            looks = f'{quoted(text)} looks like unprocessed xacro'
            findings.problem(element, f'{where} {what}: {looks}; run xacro first')
        elif name in rule.numbers:
            numbers = _numbers(text, rule.numbers[name])
            if isinstance(numbers, str):
                findings.problem(element, f'{where} {what}: {numbers}')
            elif name in rule.not_negative and numbers[0] < 0.0:
                negative = f'{shortened(text.strip())} is negative'
                hint = '; for no limit write a large number' if kind == 'limit' else ''
                findings.problem(element, f'{where}: {what} {negative}{hint}')
            else:
                values[name] = numbers
    return values


def _lacking(kind: str, names: list[str]) -> str:
    if kind in ('mass', 'parent', 'child'):
        return f'<{kind} {names[0]}="..."/> is missing'
    return f'<{kind}> lacks {", ".join(names)}' if kind != 'axis' else "<axis> lacks 'xyz'"


def _numbers(text: str, count: int) -> tuple[float, ...] | str:
    """Return the numbers in a text, or what is wrong with it."""
    words = text.split() if text.isascii() else [text]
    if count > 1 and len(words) != count:
        hint = ' (use spaces, not commas)' if ',' in text else ''
        return f'expected {count} numbers, got {len(words)} in {quoted(text)}{hint}'
    wrong = [word for word in words if not _is_finite_decimal(word)]
    if wrong or len(words) != count:
        # A wrong word of several is named alone: the eye finds it sooner.
        shown = wrong[0] if count > 1 else text
        return f'{quoted(shown)} is not a finite decimal number'
    return tuple(float(word) for word in words)


def _is_finite_decimal(word: str) -> bool:
    return bool(_DECIMAL.fullmatch(word)) and math.isfinite(float(word))


# ---- Links ---------------------------------------------------------------------------------


def _check_link(link: Element, findings: Findings) -> None:
    where = label(link)
    inertial = _check_children(link, where, CHILDREN['link'], findings).get('inertial')
    if inertial is None:
        return
    where += ' inertial'
    parts = _check_children(inertial, where, CHILDREN['inertial'], findings)
    values: dict[str, tuple[float, ...]] = {}
    for part in parts.values():
        values |= _check_attributes(part, where, findings)
    if 'mass' not in parts:
        findings.problem(inertial, f'{where}: <mass value="..."/> is missing')
    if 'inertia' not in parts:
        findings.problem(inertial, f'{where}: <inertia> is missing')
    if 'origin' in parts:
        _check_rotation(parts['origin'], f'{where} origin', values, findings)
    if 'value' in values and all(moment in values for moment in MOMENTS):
        mass = values['value'][0]
        _warn_of_odd_inertia(inertial, where, mass, [values[m][0] for m in MOMENTS], findings)


def _check_inertials(
    links: Mapping[str, Element],
    joints: Mapping[str, Element],
    tell: Callable[[Element, str], None],
) -> None:
    """
    Tell of links with a shape, but without mass.

    Links without either are frames, and the root may well be the ground.

    """
    children = {
        child.get('link') for joint in joints.values() for child in joint if tag(child) == 'child'
    }
    for name, link in links.items():
        parts = {tag(part) for part in link}
        if name in children and 'inertial' not in parts and parts & {'visual', 'collision'}:
            tell(link, f'{label(link)} has a shape, but no <inertial>: it counts as massless')


def _warn_of_placeholders(links: Mapping[str, Element], findings: Findings) -> None:
    """Warn of masses and inertias that an exporter or a person filled in without measuring."""
    masses: dict[str, float] = {}
    tensors: dict[str, tuple[float, ...]] = {}
    for name, link in links.items():
        mass, tensor = _numbers_of(link, 'mass', ['value']), _numbers_of(link, 'inertia', MOMENTS)
        if mass and tensor and mass[0] > 0.0:
            masses[name], tensors[name] = mass[0], tensor
    count = len(masses)
    unit = [name for name in masses if tensors[name] == (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)]
    if len(unit) > 1:
        text = f'{len(unit)} of {count} links with mass have the inertia 1 1 1 kg m^2'
        _placeholder(links[unit[0]], f'{text}: {listed(unit, 4)}', findings)
    if count < _FEWEST_ALIKE:
        return
    alike = _most_common(tensors)
    # Equal modules of a chain have equal masses too, and different principal moments.
    ixx, ixy, ixz, iyy, iyz, izz = tensors[alike[0]]
    is_sphere = ixx == iyy == izz and not (ixy or ixz or iyz)
    are_different = len({masses[name] for name in alike}) > 1
    if len(alike) >= _SHARE_ALIKE * count and not unit and (is_sphere or are_different):
        text = f'{len(alike)} of {count} links with mass have the same inertia'
        _placeholder(links[alike[0]], f'{text}, ixx {ixx:g} kg m^2', findings)
    heavy = [name for name, mass in masses.items() if mass == 1.0]
    if len(heavy) >= max(_FEWEST_ALIKE, _SHARE_ALIKE * count):
        text = f'{len(heavy)} of {count} links with mass have a mass of 1 kg'
        _placeholder(links[heavy[0]], text, findings)


def _placeholder(link: Element, text: str, findings: Findings) -> None:
    findings.warning(link, f'{text}: looks like a placeholder')


def _most_common(values: Mapping[str, tuple[float, ...]]) -> list[str]:
    """Return the names that share the most common value."""
    common = Counter(values.values()).most_common(1)[0][0]
    return [name for name, value in values.items() if value == common]


def _numbers_of(link: Element, kind: str, names: Sequence[str]) -> tuple[float, ...] | None:
    """Return attributes of the inertial of a link; None unless all of them are numbers."""
    part = link.find(f'inertial/{kind}')
    if part is None:
        return None
    texts = [part.get(name, '') for name in names]
    if not all(_is_finite_decimal(text.strip()) for text in texts):
        return None
    return tuple(float(text) for text in texts)


def _warn_of_odd_inertia(
    inertial: Element, where: str, mass: float, moments: list[float], findings: Findings
) -> None:
    largest = max(abs(moment) for moment in moments)
    if largest == 0.0:
        if mass > 0.0:
            findings.warning(inertial, f'{where}: mass {mass:g} kg with zero inertia')
        return
    if mass == 0.0:
        findings.warning(inertial, f'{where}: zero mass with inertia; the inertia is kept')
    ixx, ixy, ixz, iyy, iyz, izz = (moment / largest for moment in moments)
    principal = np.linalg.eigvalsh([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    slack = _MOMENT_TOLERANCE * float(np.abs(principal).sum())
    small, middle, large = (float(moment) for moment in principal)
    written = ', '.join(f'{moment * largest:.3g}' for moment in (small, middle, large))
    if small < -slack:
        text = f'inertia is not positive (principal moments {written} kg m^2)'
        findings.warning(inertial, f'{where}: {text}')
    elif small + middle < large - slack:
        text = f'of its principal moments {written} kg m^2 one exceeds the sum of the others'
        findings.warning(inertial, f'{where}: no body has this inertia: {text}')
    if mass > 0.0 and large * largest > _MAX_GYRATION**2 * mass:
        text = f'radius of gyration is more than {_MAX_GYRATION:g} m'
        findings.warning(inertial, f'{where}: {text}; the inertia should be in kg m^2')


def _check_rotation(
    origin: Element, where: str, values: Mapping[str, tuple[float, ...]], findings: Findings
) -> None:
    """Check the roll, pitch and yaw or the quaternion of an origin."""
    if 'quat_xyzw' in origin.attrib:
        _check_quaternion(origin, where, values, findings)
    if any(abs(angle) > _MAX_RPY for angle in values.get('rpy', ())):
        text = f"'{origin.get('rpy')}' is more than a turn; angles are in radians"
        findings.warning(origin, f'{where} rpy: {text}')


def _check_quaternion(
    origin: Element, where: str, values: Mapping[str, tuple[float, ...]], findings: Findings
) -> None:
    version = _version(origin)
    if version in VERSIONS and version not in VERSIONS_WITH_QUATERNIONS:
        # urdfdom ignores the attribute in these files, and the rotation with it.
        text = f'quat_xyzw needs <robot version="1.1">, found version {version}; or write rpy'
        findings.problem(origin, f'{where}: {text}')
    if 'rpy' in origin.attrib:
        findings.problem(origin, f'{where} has both rpy and quat_xyzw, expected one of them')
    if 'quat_xyzw' not in values:
        return
    norm = math.hypot(*values['quat_xyzw'])
    text = f"{where} quat_xyzw '{_written(origin, 'quat_xyzw')}' has norm {norm:g}"
    if abs(norm - 1.0) > _QUATERNION_TOLERANCE:
        findings.problem(origin, f'{text}, expected 1')
    elif abs(norm - 1.0) > _UNIT_TOLERANCE:
        findings.warning(origin, f'{text}; normalised')


# ---- Joints --------------------------------------------------------------------------------


def _check_joint(joint: Element, joints: Mapping[str, Element], findings: Findings) -> None:
    where, kind = label(joint), joint.get('type')
    if kind in _UNSUPPORTED_TYPES:
        text = f"joint type '{kind}' is not supported; {_UNSUPPORTED_TYPES[kind]}"
        findings.problem(joint, f'{where}: {text}')
    elif kind not in SUPPORTED_TYPES:
        found = '' if kind is None else f' {quoted(kind)}'
        text = f'type{found} is not one of {", ".join(SUPPORTED_TYPES)}'
        findings.problem(joint, f'{where}: {text}')

    kinds = CHILDREN_OF_FIXED if kind == 'fixed' else CHILDREN['joint']
    parts = _check_children(joint, where, kinds, findings)
    values = {name: _check_attributes(part, where, findings) for name, part in parts.items()}
    for end in ('parent', 'child'):
        if end not in parts:
            findings.problem(joint, f'{where}: <{end} link="..."/> is missing')
    if 'origin' in parts:
        _check_rotation(parts['origin'], f'{where} origin', values['origin'], findings)
    if kind in SUPPORTED_TYPES and kind != 'fixed':
        _check_axis(joint, parts.get('axis'), values.get('axis', {}), findings)
        _check_limit(joint, parts, values.get('limit', {}), findings)
        if 'mimic' in parts:
            check_mimic(joint, parts['mimic'], joints, findings)


def _check_axis(
    joint: Element,
    axis: Element | None,
    values: Mapping[str, tuple[float, ...]],
    findings: Findings,
) -> None:
    where = label(joint)
    if axis is None:
        findings.warning(joint, f'{where}: no <axis>; 1 0 0 is used')
    if 'xyz' not in values:
        return
    length = math.hypot(*values['xyz'])
    if length < MIN_AXIS_LENGTH:
        text = f"axis has (near) zero length: '{_written(axis, 'xyz')}'"
        findings.problem(axis, f'{where}: {text}')
    elif abs(length - 1.0) > _UNIT_TOLERANCE:
        text = f"axis '{_written(axis, 'xyz')}' has length {length:g}; normalised"
        findings.warning(axis, f'{where}: {text}')


def _written(element: Element, name: str) -> str:
    """Return the text of an attribute on one line."""
    return ' '.join(element.get(name, '').split())


def _check_limit(
    joint: Element,
    parts: Mapping[str, Element],
    values: Mapping[str, tuple[float, ...]],
    findings: Findings,
) -> None:
    where, kind, limit = label(joint), joint.get('type'), parts.get('limit')
    if limit is None:
        if kind in _LIMITED_TYPES:
            findings.problem(joint, f'{where}: <limit> is required for {kind} joints')
        return
    if 'mimic' not in parts:
        for name in ('effort', 'velocity'):
            if values.get(name) == (0.0,):
                text = f'limit {name} is 0, taken as not known: no {name} limit'
                findings.warning(limit, f'{where}: {text}')
    if kind in _LIMITED_TYPES:
        _check_range(joint, limit, values, findings)


def _check_range(
    joint: Element, limit: Element, values: Mapping[str, tuple[float, ...]], findings: Findings
) -> None:
    where, kind = label(joint), joint.get('type')
    missing = [name for name in ('lower', 'upper') if name not in limit.attrib]
    if any(name not in values for name in ('lower', 'upper') if name not in missing):
        return
    lower, upper = (values.get(name, (0.0,))[0] for name in ('lower', 'upper'))
    if lower > upper:
        hint = "; for a joint without limits write type 'continuous'" if kind == 'revolute' else ''
        findings.problem(limit, f'{where}: limit lower {lower:g} > upper {upper:g}{hint}')
    elif missing:
        findings.warning(limit, f'{where}: <limit> has no {" and no ".join(missing)}; 0 is used')
    elif lower == upper:
        findings.warning(limit, f'{where}: limit lower = upper = {lower:g}: it cannot move')
    if kind == 'revolute' and max(abs(lower), abs(upper)) > _MAX_TURN:
        text = f'limits {lower:g} to {upper:g} are many turns; angles are in radians'
        findings.warning(limit, f'{where}: {text}')
