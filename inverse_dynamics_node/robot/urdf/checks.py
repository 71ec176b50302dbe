"""
Checks the elements and the link tree of a URDF.

All errors are collected, with line, element and value. The rules are stricter than those of
urdfdom, which logs an invalid mass and continues with zero. This module reports an error instead,
because a lost mass causes wrong efforts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
import math
import re
from typing import Any, NamedTuple

import numpy as np

from ...errors import listed, shortened, unknown_name
from ..limit_checks import limit_subject
from ..model import Floats, ModelWarning
from .xml import children, Element, is_xacro, tag

MAX_LINKS = 1000
"""Largest accepted number of links, and of joints; real robots have far fewer."""
_TYPES = ('revolute', 'continuous', 'prismatic', 'fixed')
_LIMITED_TYPES = ('revolute', 'prismatic')
_UNSUPPORTED_TYPES = {
    'planar': 'use two prismatic joints and a continuous one, with massless links between them',
    'floating': 'remove this joint; if the base moves, set the parameter base_motion of the node',
}
MOMENTS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
_CHILDREN = {
    'robot': ('link', 'joint'),
    'link': ('inertial',),
    'inertial': ('origin', 'mass', 'inertia'),
    'joint': ('parent', 'child', 'origin', 'axis', 'limit', 'dynamics', 'mimic'),
}
_CHILDREN_OF_FIXED = ('parent', 'child', 'origin')
_NUMBERS: Mapping[str, Mapping[str, int]] = {
    'origin': {'xyz': 3, 'rpy': 3},
    'mass': {'value': 1},
    'inertia': dict.fromkeys(MOMENTS, 1),
    'axis': {'xyz': 3},
    'limit': dict.fromkeys(('lower', 'upper', 'effort', 'velocity'), 1),
    'dynamics': dict.fromkeys(('damping', 'friction'), 1),
    'mimic': dict.fromkeys(('multiplier', 'offset'), 1),
}
"""How many numbers each numeric attribute contains."""
_REQUIRED = {
    'mass': ('value',),
    'inertia': MOMENTS,
    'parent': ('link',),
    'child': ('link',),
    'axis': ('xyz',),
    'limit': ('effort', 'velocity'),
    'mimic': ('joint',),
}
_NOT_NEGATIVE = ('value', 'effort', 'velocity', 'damping', 'friction')


def inertia_tensor(moments: Sequence[float]) -> Floats:
    """Return the inertia tensor, shape (3, 3), from six values in the order of `MOMENTS`."""
    ixx, ixy, ixz, iyy, iyz, izz = moments
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


def children_read(element: Element) -> tuple[str, ...]:
    """Return the tags of the child elements that the dynamics need."""
    is_fixed = element.tag == 'joint' and element.get('type') == 'fixed'
    return _CHILDREN_OF_FIXED if is_fixed else _CHILDREN.get(element.tag, ())


class Problems:
    """The errors and warnings of one robot description, in the order of the document."""

    def __init__(self) -> None:
        self._errors: list[tuple[float, str]] = []
        self._warnings: list[tuple[float, ModelWarning]] = []

    @property
    def errors(self) -> list[str]:
        return [text for _, text in sorted(self._errors, key=lambda entry: entry[0])]

    @property
    def warnings(self) -> list[ModelWarning]:
        return [warning for _, warning in sorted(self._warnings, key=lambda entry: entry[0])]

    def error(self, element: Element, text: str) -> None:
        """Add an error at the line of an element."""
        self._errors.append((element.sourceline, f'line {element.sourceline}: {text}'))

    def error_of_all(self, text: str) -> None:
        """Add an error that concerns the whole robot, after the errors of elements."""
        self._errors.append((math.inf, text))

    def warning(self, line: int, subject: str, text: str, hint: str) -> None:
        """Add a warning at a line."""
        self._warnings.append((line, ModelWarning(text, hint, subject, line)))


def _label(element: Element) -> str:
    """Return the name of a link or joint for messages, such as ``link 'hand'``."""
    return f"{element.tag} '{element.get('name', '')}'"


# ---- Children and attributes of one element ------------------------------------------------


class _Part(NamedTuple):
    """A child element, and the numbers in its valid attributes."""

    element: Element
    values: Mapping[str, tuple[float, ...]]


def _parts_of(element: Element, where: str, problems: Problems) -> dict[str, _Part]:
    """
    Check the children of an element that the dynamics need; return the first of each kind.

    Several children of one kind are an error. Several origins are permitted, because all tools of
    ROS use the first one.

    """
    kinds = children_read(element)
    for child in element:
        if child.tag not in kinds:
            _check_other(child, where, kinds, problems)
    found = {}
    for kind in kinds:
        same = element.findall(kind)
        if len(same) > 1 and kind != 'origin':
            text = f'{len(same)} <{kind}> elements, expected at most one'
            problems.error(same[1], f'{where}: {text}')
        if same:
            found[kind] = _Part(same[0], _values_of(same[0], where, problems))
    return found


def _check_other(element: Element, where: str, kinds: tuple[str, ...], problems: Problems) -> None:
    """Check an element that is not read: it may be xacro, or differ from a tag only in case."""
    kind = tag(element)
    if kind.startswith('xacro:'):
        text = f'unprocessed xacro element <{kind}>; run xacro first'
        problems.error(element, f'{where}: {text}' if where else text)
    elif kind.lower() in kinds:
        text = f'<{kind}> is ignored; URDF spells it <{kind.lower()}>'
        problems.warning(element.sourceline, where or 'robot', text, 'correct the spelling')


# Python's float() also accepts '1_000', 'nan', 'infinity' and the digits of other scripts.
_DECIMAL = re.compile(r'[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?')


def _values_of(element: Element, where: str, problems: Problems) -> dict[str, tuple[float, ...]]:
    """Check the attributes of an element; return the numbers in valid attributes."""
    kind, values = element.tag, {}
    required, numeric = _REQUIRED.get(kind, ()), _NUMBERS.get(kind, {})
    missing = [name for name in required if name not in element.attrib]
    if missing:
        problems.error(element, f'{where}: <{kind}> lacks {", ".join(missing)}')
    for name, text in element.items():
        # The value of <mass value="2"/> is called 'mass', not 'mass value'.
        what = kind if name == 'value' else f'{kind} {name}'
        if name == 'quat_xyzw':
            problems.error(element, f'{where} {what}: is not supported; write rpy="..."')
        elif name not in numeric and name not in required:
            continue
        elif is_xacro(text):
            looks = f"'{shortened(text)}' looks like unprocessed xacro; run xacro first"
            problems.error(element, f'{where} {what}: {looks}')
        elif name in numeric:
            numbers = _numbers(text, numeric[name])
            if isinstance(numbers, str):
                problems.error(element, f'{where} {what}: {numbers}')
            elif name in _NOT_NEGATIVE and numbers[0] < 0.0 and not _is_unknown(kind, numbers):
                hint = '; if there is no limit, write a large number' if kind == 'limit' else ''
                negative = f'{shortened(text.strip())} is negative{hint}'
                problems.error(element, f'{where}: {what} {negative}')
            else:
                values[name] = numbers
    return values


def _is_unknown(kind: str, numbers: tuple[float, ...]) -> bool:
    return kind == 'limit' and numbers[0] in (0.0, -1.0)


def _numbers(text: str, count: int) -> tuple[float, ...] | str:
    """Return the numbers in ``text``, or an error message if it is invalid."""
    words = text.split() if text.isascii() else [text]
    if count > 1 and len(words) != count:
        hint = ' (use spaces, not commas)' if ',' in text else ''
        return f"expected {count} numbers, got {len(words)} in '{shortened(text)}'{hint}"
    numbers = tuple(float(word) for word in words if _DECIMAL.fullmatch(word))
    if len(numbers) == count == len(words) and all(map(math.isfinite, numbers)):
        return numbers
    # If several numbers are expected, quote only the first wrong word.
    wrong = [x for x in words if not _DECIMAL.fullmatch(x) or math.isinf(float(x))]
    return f"'{shortened(wrong[0] if count > 1 else text)}' is not a finite decimal number"


def _written(element: Element, name: str) -> str:
    """Return the text of an attribute as a single line."""
    return ' '.join(element.get(name, '').split())


_MAX_RPY = 7.0
"""Slightly more than one turn [rad]; a larger angle is probably in degrees."""


def _check_angles(parts: Mapping[str, _Part], where: str, problems: Problems) -> None:
    """Warn about roll, pitch and yaw in degrees."""
    if 'origin' not in parts:
        return
    origin, values = parts['origin']
    if any(abs(angle) > _MAX_RPY for angle in values.get('rpy', ())):
        text = f"'{_written(origin, 'rpy')}' contains an angle of more than a turn"
        hint = 'angles are in rad; convert the angles from degrees'
        problems.warning(origin.sourceline, f'{where} origin rpy', text, hint)


# ---- Links ---------------------------------------------------------------------------------


class _Inertial(NamedTuple):
    """The numbers in an ``<inertial>``."""

    element: Element
    mass: float
    moments: tuple[float, ...]
    """In the order of `MOMENTS`."""


def _check_link(link: Element, problems: Problems) -> _Inertial | None:
    """Check the optional <inertial> of a link; return its numbers if it is complete."""
    where = _label(link)
    inertial = _parts_of(link, where, problems).get('inertial')
    if inertial is None:
        return None
    where += ' inertial'
    parts = _parts_of(inertial.element, where, problems)
    for kind, attribute in (('mass', ' value="..."/'), ('inertia', '')):
        if kind not in parts:
            problems.error(inertial.element, f'{where}: <{kind}{attribute}> is missing')
    _check_angles(parts, where, problems)
    values = {name: numbers for part in parts.values() for name, numbers in part.values.items()}
    if any(name not in values for name in ('value', *MOMENTS)):
        return None
    moments = tuple(values[name][0] for name in MOMENTS)
    return _Inertial(inertial.element, values['value'][0], moments)


# ---- Joints --------------------------------------------------------------------------------

_MIN_AXIS_LENGTH = 1e-6
"""Smallest length of an axis that has a reliable direction."""
_MAX_TURN = 50.0
"""Largest plausible position limit [rad]; larger limits are probably in degrees."""

_UNKNOWN_LIMIT_HINTS = {
    'effort': 'write the largest effort of the joint; without it, efforts are not limited',
    'velocity': 'write the largest speed of the joint',
}


def _check_joint(joint: Element, joints: Mapping[str, Element], problems: Problems) -> None:
    """Check a joint; ``joints`` contains all joints by name."""
    where, kind = _label(joint), joint.get('type')
    if kind in _UNSUPPORTED_TYPES:
        text = f"joint type '{kind}' is not supported; {_UNSUPPORTED_TYPES[kind]}"
        problems.error(joint, f'{where}: {text}')
    elif kind not in _TYPES:
        found = 'is missing, expected' if kind is None else f"'{shortened(kind)}' is not"
        problems.error(joint, f'{where}: type {found} one of {", ".join(_TYPES)}')

    parts = _parts_of(joint, where, problems)
    for end in ('parent', 'child'):
        if end not in parts:
            problems.error(joint, f'{where}: <{end} link="..."/> is missing')
    _check_angles(parts, where, problems)
    if kind in _TYPES and kind != 'fixed':
        _check_axis(joint, parts.get('axis'), problems)
        _check_limit(joint, parts, problems)
        if 'mimic' in parts:
            _check_mimic(joint, parts['mimic'].element, joints, problems)


def _check_axis(joint: Element, axis: _Part | None, problems: Problems) -> None:
    if axis is None:
        hint = 'write <axis xyz="..."/>, in the frame of the joint'
        text = '<axis> is missing; 1 0 0 is used'
        problems.warning(joint.sourceline, _label(joint), text, hint)
    elif math.hypot(*axis.values.get('xyz', (1.0,))) < _MIN_AXIS_LENGTH:
        text = f"the length of axis '{_written(axis.element, 'xyz')}' is almost zero"
        problems.error(axis.element, f'{_label(joint)}: {text}')


def _check_limit(joint: Element, parts: Mapping[str, _Part], problems: Problems) -> None:
    where, kind = _label(joint), joint.get('type')
    if 'limit' not in parts:
        if kind in _LIMITED_TYPES:
            problems.error(joint, f'{where}: <limit> is required for {kind} joints')
        return
    limit, values = parts['limit']
    for name, hint in {} if 'mimic' in parts else _UNKNOWN_LIMIT_HINTS.items():
        if values.get(name, (1.0,))[0] in (0.0, -1.0):
            subject = limit_subject(joint.get('name', ''), name)
            text = f'{values[name][0]:g} means unknown, so the {name} is not limited'
            problems.warning(limit.sourceline, subject, text, hint)
    missing = [name for name in ('lower', 'upper') if name not in limit.attrib]
    if kind not in _LIMITED_TYPES or len(missing) + ('lower' in values) + ('upper' in values) < 2:
        return
    lower, upper = (values.get(name, (0.0,))[0] for name in ('lower', 'upper'))
    if lower > upper:
        hint = "; if there are no limits, write type 'continuous'" if kind == 'revolute' else ''
        text = f'lower limit {lower:g} exceeds upper limit {upper:g}{hint}'
        problems.error(limit, f'{where}: {text}')
    elif missing:
        text = f'<limit> has no {" and no ".join(missing)}; 0 is used'
        problems.warning(limit.sourceline, where, text, 'write both limits, in rad or m')
    if kind == 'revolute' and max(abs(lower), abs(upper)) > _MAX_TURN:
        text = f'limits {lower:g} to {upper:g} are many turns; angles are in radians'
        problems.warning(limit.sourceline, where, text, 'convert the angles from degrees')


def _check_mimic(
    joint: Element, mimic: Element, joints: Mapping[str, Element], problems: Problems
) -> None:
    """Check that the mimicked joint exists, can move, and is not the mimic joint itself."""
    where, master = _label(joint), mimic.get('joint')
    if master is None or is_xacro(master):
        return
    if master not in joints:
        problems.error(mimic, f'{where} mimic: {unknown_name("joint", master, joints)}')
    elif master == joint.get('name'):
        problems.error(mimic, f'{where} mimics itself')
    elif joints[master].get('type') == 'fixed':
        problems.error(mimic, f"{where} mimics '{master}', which is fixed")


# ---- The robot -----------------------------------------------------------------------------


def check(root: Element) -> Problems:
    """Check a <robot> element and everything in it that the dynamics need."""
    problems = Problems()
    for kind in children_read(root):
        count = len(children(root, kind))
        if count > MAX_LINKS:
            problems.error(root, f'{count} {kind}s, expected at most {MAX_LINKS}')
    if problems.errors:
        return problems
    _check_name(root, problems)
    links, joints = (_by_name(root, kind, problems) for kind in ('link', 'joint'))
    inertials: dict[str, _Inertial] = {}
    for element in root:
        if element.tag == 'link':
            inertial = _check_link(element, problems)
            if inertial is not None:
                inertials.setdefault(element.get('name', ''), inertial)
        elif element.tag == 'joint':
            _check_joint(element, joints, problems)
        else:
            _check_other(element, '', children_read(root), problems)
    _check_mimic_loops(joints, problems)
    for name, joint in _check_tree(root, links, problems).items():
        _warn_of_massless_shape(links[name], joint, inertials.get(name), problems)
    _warn_of_odd_inertias(inertials, problems)
    _warn_of_placeholders(inertials, problems)
    return problems


def _by_name(root: Element, kind: str, problems: Problems) -> dict[str, Element]:
    """Return the elements of a kind by name; a repeated name is an error."""
    found: dict[str, Element] = {}
    for element in children(root, kind):
        name = _check_name(element, problems)
        if name and found.setdefault(name, element) is not element:
            problems.error(element, f"duplicate {kind} name '{name}'")
    return found


def _check_name(element: Element, problems: Problems) -> str | None:
    """Check that an element has a name without xacro; return the name."""
    kind, name = element.tag, element.get('name')
    if not name:
        problems.error(element, f'<{kind}> has no name')
    elif is_xacro(name):
        text = f"{kind} name '{shortened(name)}' looks like unprocessed xacro"
        problems.error(element, text)
    return name or None


# ---- The tree ------------------------------------------------------------------------------


def _check_tree(
    root: Element, links: Mapping[str, Element], problems: Problems
) -> dict[str, Element]:
    """Check that the joints connect all links into one tree; return the joint of each link."""
    holders: dict[str, Element] = {}
    below: dict[str, list[str]] = {name: [] for name in links}
    joints, all_ends_known = children(root, 'joint'), True
    for joint in joints:
        ends = _ends_of(joint, links, problems)
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
    elif len(links) == 1 and not joints:
        problems.error_of_all('the robot has one link and no joints: nothing to command')
    elif all_ends_known:  # otherwise a broken joint explains why a link is not connected
        _check_roots([name for name in links if name not in holders], below, problems)
    return holders


def _ends_of(
    joint: Element, links: Mapping[str, Element], problems: Problems
) -> tuple[str, str] | None:
    """Return the names of a joint's parent and child links, or None if they are invalid."""
    where, ends = _label(joint), list[str]()
    for end in ('parent', 'child'):
        element = joint.find(end)
        name: Any = element.get('link') if element is not None else None
        if name in links:
            ends.append(name)
        elif name is not None and not is_xacro(name):
            problems.error(element, f'{where}: {end} {unknown_name("link", name, links)}')
    if len(ends) < 2:
        return None
    if ends[0] == ends[1]:
        problems.error(joint, f"{where}: parent and child are the same link '{ends[0]}'")
        return None
    return ends[0], ends[1]


def _check_roots(roots: list[str], below: Mapping[str, list[str]], problems: Problems) -> None:
    if not roots:
        problems.error_of_all('no root link: the links form a cycle')
        return
    if len(roots) > 1:
        names = listed([f"'{name}'" for name in roots])
        problems.error_of_all(f'{len(roots)} root links: {names}; expected one')
    reached = list(roots)
    for name in reached:  # grows: a link has at most one parent, so it is reached once
        reached += below[name]
    adrift = [f"'{name}'" for name in below if name not in set(reached)]
    if adrift:
        text = f"{len(adrift)} links are not connected to root '{roots[0]}', because of a cycle"
        problems.error_of_all(f'{text}: {listed(adrift)}')


def _check_mimic_loops(joints: Mapping[str, Element], problems: Problems) -> None:
    """Check that no chain of mimic joints forms a loop."""
    masters = {}
    for name, joint in joints.items():
        mimic = joint.find('mimic') if joint.get('type') != 'fixed' else None
        if mimic is not None and mimic.get('joint') not in (None, name):
            masters[name] = mimic.get('joint')
    settled: set[str] = set()
    for start in masters:
        path: list[str] = []
        name = start
        while name in masters and name not in settled:
            settled.add(name)
            path.append(name)
            name = masters[name]
        if name in path:
            loop = [*path[path.index(name) :], name]
            problems.error(joints[name], f'mimic loop: {" -> ".join(loop)}')


# ---- Masses and inertias -------------------------------------------------------------------

_NEGLIGIBLE = 1e-6
"""Smaller fractions of the robot's mass have no effect; exporters write 1e-9 kg for a frame."""
_MOMENT_TOLERANCE = 1e-3
"""Tolerated error of principal moments, as a fraction of the sum of the moments."""
_MAX_GYRATION = 10.0
"""Largest plausible radius of gyration [m]; a larger radius indicates wrong units of inertia."""
_FEWEST_ALIKE = 3
"""
Fewer links with equal values cause no warning, because two links may be identical parts.

Two unit inertias suffice for a warning.
"""
_FRACTION_ALIKE = 0.8
"""If at least this fraction of the links with mass have equal values, warn of placeholders."""


def _warn_of_massless_shape(
    link: Element, joint: Element, inertial: _Inertial | None, problems: Problems
) -> None:
    """
    Warn of a link that has a shape but neither mass nor inertia.

    Links without a shape are assumed to be mere frames. A mass of zero may be intended if a fixed
    joint holds the link. The root link is not checked, because it may be the ground.

    """
    if link.find('visual') is None and link.find('collision') is None:
        return
    is_empty = inertial is not None and not (inertial.mass or any(inertial.moments))
    if link.find('inertial') is None:
        lacks = 'no <inertial>'
    elif is_empty and joint.get('type') != 'fixed':
        lacks = 'a mass of zero'
    else:
        return
    text = f'has a shape but {lacks}; it is treated as massless'
    hint = 'add an <inertial> from CAD; without it, the weight of this link is not compensated'
    problems.warning(link.sourceline, _label(link), text, hint)


def _warn_of_odd_inertias(inertials: Mapping[str, _Inertial], problems: Problems) -> None:
    """Warn about inertias that are impossible, or implausible for their masses."""
    least = _NEGLIGIBLE * sum(each.mass for each in inertials.values())
    for name, (element, mass, moments) in inertials.items():
        if max(mass, *map(abs, moments)) >= least:
            for text, hint in _oddities(mass, moments):
                problems.warning(element.sourceline, f"link '{name}' inertial", text, hint)


def _oddities(mass: float, moments: Sequence[float]) -> Iterator[tuple[str, str]]:
    """Yield a text and a hint for each oddity of a mass and its moments of inertia."""
    hint = (
        'take the inertia about the centre of mass from CAD, in kg m^2; gravity efforts do not '
        'depend on the inertia'
    )
    largest = max(map(abs, moments))
    if largest == 0.0:
        if mass > 0.0:
            yield f'the mass is {mass:g} kg, but the inertia is zero', hint
        return
    if mass == 0.0:
        yield (
            'the mass is zero, but the inertia is not; the inertia is kept',
            'harmless for the rotor of a motor; otherwise write the mass',
        )
    principal = np.linalg.eigvalsh(inertia_tensor([moment / largest for moment in moments]))
    slack = _MOMENT_TOLERANCE * float(np.abs(principal).sum())
    small, middle, large = principal.tolist()
    if small < -slack or small + middle < large - slack:
        values = ', '.join(f'{moment * largest:.3g}' for moment in (small, middle, large))
        yield f'no body has the principal moments of inertia {values} kg m^2', hint
    if mass > 0.0 and large * largest > _MAX_GYRATION**2 * mass:
        yield (
            f'radius of gyration is more than {_MAX_GYRATION:g} m; a URDF has inertias in kg m^2',
            'convert the inertia to kg m^2: numbers from CAD in g mm^2 are 1e9 times larger',
        )


def _warn_of_placeholders(inertials: Mapping[str, _Inertial], problems: Problems) -> None:
    """Warn about unit masses and about unit or equal inertias, which are probably placeholders."""
    heavy = [(name, *each) for name, each in inertials.items() if each.mass > 0.0]
    fewest = max(_FEWEST_ALIKE, _FRACTION_ALIKE * len(heavy))
    unit = [each for each in heavy if each[3] == (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)]
    found = []
    if len(unit) > 1:
        names = ', '.join(shortened(name) for name, *_ in unit[:4]) + ', ...' * (len(unit) > 4)
        found.append((unit, f'ixx = iyy = izz = 1 kg m^2 ({names})'))
    light = [each for each in heavy if each[2] == 1.0]
    if len(light) >= fewest:
        found.append((light, 'a mass of 1 kg'))
    for moments, count in Counter(each[3] for each in heavy).most_common(1):
        alike = [each for each in heavy if each[3] == moments]
        # Identical modules of a chain have equal inertias and masses, but are not spheres.
        ixx, ixy, ixz, iyy, iyz, izz = moments
        is_sphere = ixx == iyy == izz and not (ixy or ixz or iyz)
        if count >= fewest and not unit and (is_sphere or len({each[2] for each in alike}) > 1):
            found.append((alike, f'the same inertia (ixx = {ixx:g} kg m^2)'))
    hint = 'take mass, centre of mass and inertia from CAD'
    for links, text in found:
        text = f'{len(links)} of {len(heavy)} links with mass have {text}'
        line = links[0][1].sourceline
        problems.warning(line, '', f'{text}, which looks like a placeholder', hint)
