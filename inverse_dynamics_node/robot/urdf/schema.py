"""
Rules for the contents of URDF elements, and checks of single links and joints.

The rules are stricter than those of urdfdom, which logs an invalid mass and continues with zero.
This module reports an error instead, because a lost mass causes wrong efforts.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
import re

import numpy as np

from ...errors import shortened, unknown_name
from ..limit_checks import limit_subject
from ..model import Floats, ModelWarning
from .xml import Element, is_xacro, tag

SUPPORTED_TYPES = ('revolute', 'continuous', 'prismatic', 'fixed')

CHILDREN = {
    'robot': ('link', 'joint'),
    'link': ('inertial',),
    'inertial': ('origin', 'mass', 'inertia'),
    'joint': ('parent', 'child', 'origin', 'axis', 'limit', 'dynamics', 'mimic'),
}
"""Child elements that are checked; only links and joints may occur more than once."""

READ_ONCE = 'origin'
"""Only the first element of this kind in a parent element is used."""

CHILDREN_OF_FIXED = ('parent', 'child', 'origin')
"""Child elements that have a meaning in a fixed joint."""


@dataclass(frozen=True)
class Rule:
    """The rule for the attributes of an element."""

    names: tuple[str, ...] = ()
    numbers: Mapping[str, int] = field(default_factory=dict)
    """How many numbers each numeric attribute contains."""
    required: tuple[str, ...] = ()
    not_negative: tuple[str, ...] = ()
    is_open: bool = False
    """Whether other attributes are accepted without a warning."""


def _scalars(*names: str) -> dict[str, int]:
    return dict.fromkeys(names, 1)


MOMENTS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')


def inertia_tensor(moments: Sequence[float]) -> Floats:
    """Return the inertia tensor, shape (3, 3), from six values in the order of `MOMENTS`."""
    ixx, ixy, ixz, iyy, iyz, izz = moments
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


RULES = {
    'robot': Rule(names=('name',)),
    'link': Rule(names=('name',)),
    'joint': Rule(names=('name', 'type')),
    'inertial': Rule(),
    'origin': Rule(numbers={'xyz': 3, 'rpy': 3, 'quat_xyzw': 4}),
    'mass': Rule(numbers=_scalars('value'), required=('value',), not_negative=('value',)),
    'inertia': Rule(numbers=_scalars(*MOMENTS), required=MOMENTS),
    'parent': Rule(names=('link',), required=('link',)),
    'child': Rule(names=('link',), required=('link',)),
    'axis': Rule(numbers={'xyz': 3}, required=('xyz',)),
    'limit': Rule(
        numbers=_scalars('lower', 'upper', 'effort', 'velocity'),
        required=('effort', 'velocity'),
        not_negative=('effort', 'velocity'),
        is_open=True,
    ),
    'dynamics': Rule(
        numbers=_scalars('damping', 'friction'),
        not_negative=('damping', 'friction'),
        is_open=True,
    ),
    'mimic': Rule(names=('joint',), numbers=_scalars('multiplier', 'offset'), required=('joint',)),
}


# Errors and warnings


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
        """Add an error about the whole description; it is listed after all other errors."""
        self._errors.append((math.inf, text))

    def warning(self, element: Element, subject: str, text: str, hint: str) -> None:
        """Add a warning at the line of an element."""
        warning = ModelWarning(text, hint, subject, element.sourceline)
        self._warnings.append((element.sourceline, warning))


def label(element: Element) -> str:
    """Return the name of a link or joint for messages, such as ``link 'hand'``."""
    return f"{tag(element)} '{element.get('name', '')}'"


def quoted(text: str) -> str:
    """Quote a value, or the start of a long value."""
    return f"'{shortened(text)}'"


# Children and attributes of one element

# Python's float() also accepts '1_000', 'nan', 'infinity' and the digits of other scripts.
_DECIMAL = re.compile(r'[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?')
_SPELLING = 'correct the spelling, or remove the element or attribute'


def check_children(
    element: Element, where: str, kinds: tuple[str, ...], problems: Problems
) -> dict[str, Element]:
    """
    Return the children of the given kinds; several children of one kind are an error.

    Several origins cause only a warning, because all ROS tools use the first origin.

    """
    found: defaultdict[str, list[Element]] = defaultdict(list)
    for child in element:
        kind = tag(child)
        found[kind].append(child)
        if kind.startswith('xacro:'):
            text = f'unprocessed xacro element <{kind}>; run xacro first'
            problems.error(child, f'{where}: {text}')
        warn_if_misspelt(child, where, kinds, problems)
    for kind in kinds:
        if len(found[kind]) < 2:
            continue
        count = f'{len(found[kind])} <{kind}> elements'
        if kind == READ_ONCE:
            hint = 'remove the other elements; ROS tools use the first one, too'
            problems.warning(found[kind][1], where, f'{count}; only the first one is used', hint)
        else:
            problems.error(found[kind][1], f'{where}: {count}, expected at most one')
    return {kind: found[kind][0] for kind in kinds if found[kind]}


def warn_if_misspelt(
    element: Element, where: str, kinds: tuple[str, ...], problems: Problems
) -> None:
    """Warn if the name of an element differs from a URDF name only in case."""
    kind = tag(element)
    if kind not in kinds and kind.lower() in kinds:
        text = f'<{kind}> is ignored; URDF spells it <{kind.lower()}>'
        problems.warning(element, where, text, _SPELLING)


def check_attributes(
    element: Element, where: str, problems: Problems
) -> dict[str, tuple[float, ...]]:
    """Check the attributes of an element; return the numbers in valid attributes."""
    kind = tag(element)
    rule = RULES[kind]
    values: dict[str, tuple[float, ...]] = {}
    missing = [name for name in rule.required if name not in element.attrib]
    if missing:
        problems.error(element, f'{where}: <{kind}> lacks {", ".join(missing)}')
    for name, text in element.attrib.items():
        # The value of <mass value="2"/> is called 'mass', not 'mass value'.
        what = kind if name == 'value' else f'{kind} {name}'
        if name not in rule.names and name not in rule.numbers:
            is_prefixed = ':' in name or name.startswith('{')
            if not rule.is_open and not is_prefixed:
                unknown = f"attribute '{name}' is unknown and ignored"
                problems.warning(element, f'{where} {kind}', unknown, _SPELLING)
        elif is_xacro(text):
            looks = f'{quoted(text)} looks like unprocessed xacro'
            problems.error(element, f'{where} {what}: {looks}; run xacro first')
        elif name in rule.numbers:
            numbers = _numbers(text, rule.numbers[name])
            if isinstance(numbers, str):
                problems.error(element, f'{where} {what}: {numbers}')
            elif name in rule.not_negative and numbers[0] < 0.0:
                negative = f'{shortened(text.strip())} is negative'
                hint = '; if there is no limit, write a large number' if kind == 'limit' else ''
                problems.error(element, f'{where}: {what} {negative}{hint}')
            else:
                values[name] = numbers
    return values


def _numbers(text: str, count: int) -> tuple[float, ...] | str:
    """Return the numbers in ``text``, or an error message if it is invalid."""
    words = text.split() if text.isascii() else [text]
    if count > 1 and len(words) != count:
        hint = ' (use spaces, not commas)' if ',' in text else ''
        return f'expected {count} numbers, got {len(words)} in {quoted(text)}{hint}'
    wrong = [word for word in words if not is_finite_decimal(word)]
    if wrong or len(words) != count:
        # If several numbers are expected, quote only the first wrong word.
        shown = wrong[0] if count > 1 else text
        return f'{quoted(shown)} is not a finite decimal number'
    return tuple(float(word) for word in words)


def is_finite_decimal(word: str) -> bool:
    """Return whether a word is a finite decimal number."""
    return bool(_DECIMAL.fullmatch(word)) and math.isfinite(float(word))


def written(element: Element, name: str) -> str:
    """Return the text of an attribute as a single line."""
    return ' '.join(element.get(name, '').split())


_QUATERNION_TOLERANCE = 0.1
"""Tolerated error of a quaternion's norm; larger errors are probably typos."""
_MAX_RPY = 7.0
"""Slightly more than one turn [rad]; a larger angle is probably in degrees."""


def check_rotation(
    origin: Element, where: str, values: Mapping[str, tuple[float, ...]], problems: Problems
) -> None:
    """Check the rotation of an origin, given as roll, pitch and yaw or as a quaternion."""
    if 'quat_xyzw' in origin.attrib:
        _check_quaternion(origin, where, values, problems)
    if any(abs(angle) > _MAX_RPY for angle in values.get('rpy', ())):
        text = f"'{origin.get('rpy')}' contains an angle of more than a turn; angles are in rad"
        problems.warning(origin, f'{where} rpy', text, 'convert the angles from degrees')


def _check_quaternion(
    origin: Element, where: str, values: Mapping[str, tuple[float, ...]], problems: Problems
) -> None:
    if origin.getroottree().getroot().get('version', '1.0') == '1.0':
        # In this version, urdfdom ignores the attribute, and therefore the rotation.
        text = 'quat_xyzw needs <robot version="1.1"> instead of 1.0; write 1.1, or use rpy'
        problems.error(origin, f'{where}: {text}')
    if 'rpy' in origin.attrib:
        problems.error(origin, f'{where} has both rpy and quat_xyzw, expected only one')
    if 'quat_xyzw' not in values:
        return
    norm = math.hypot(*values['quat_xyzw'])
    if abs(norm - 1.0) > _QUATERNION_TOLERANCE:
        text = f"'{written(origin, 'quat_xyzw')}' has norm {norm:g}, expected 1"
        problems.error(origin, f'{where} quat_xyzw: {text}')


# Links

_MOMENT_TOLERANCE = 1e-3
"""Tolerated error of principal moments, as a fraction of the sum of the moments."""
_MAX_GYRATION = 10.0
"""Largest plausible radius of gyration [m]; a larger radius indicates wrong units of inertia."""

_TENSOR_HINT = (
    'take the inertia about the centre of mass from CAD, in kg m^2; gravity efforts do not '
    'depend on the inertia'
)


def check_link(link: Element, problems: Problems) -> None:
    """Check the optional <inertial> of a link."""
    where = label(link)
    inertial = check_children(link, where, CHILDREN['link'], problems).get('inertial')
    if inertial is None:
        return
    where += ' inertial'
    parts = check_children(inertial, where, CHILDREN['inertial'], problems)
    values: dict[str, tuple[float, ...]] = {}
    for part in parts.values():
        values |= check_attributes(part, where, problems)
    if 'mass' not in parts:
        problems.error(inertial, f'{where}: <mass value="..."/> is missing')
    if 'inertia' not in parts:
        problems.error(inertial, f'{where}: <inertia> is missing')
    if 'origin' in parts:
        check_rotation(parts['origin'], f'{where} origin', values, problems)
    if 'value' in values and all(moment in values for moment in MOMENTS):
        mass = values['value'][0]
        _warn_of_odd_inertia(inertial, where, mass, [values[m][0] for m in MOMENTS], problems)


def _warn_of_odd_inertia(
    inertial: Element, where: str, mass: float, moments: Sequence[float], problems: Problems
) -> None:
    """Warn about an inertia that is impossible, or implausible for the mass."""
    largest = max(abs(moment) for moment in moments)
    if largest == 0.0:
        if mass > 0.0:
            text = f'the mass is {mass:g} kg, but the inertia is zero'
            problems.warning(inertial, where, text, _TENSOR_HINT)
        return
    if mass == 0.0:
        text = 'the mass is zero, but the inertia is not; the inertia is kept'
        hint = 'harmless for the rotor of a motor; otherwise write the mass'
        problems.warning(inertial, where, text, hint)
    principal = np.linalg.eigvalsh(inertia_tensor([moment / largest for moment in moments]))
    slack = _MOMENT_TOLERANCE * float(np.abs(principal).sum())
    small, middle, large = (float(moment) for moment in principal)
    if small < -slack or small + middle < large - slack:
        values = ', '.join(f'{moment * largest:.3g}' for moment in (small, middle, large))
        text = f'no body has the principal moments of inertia {values} kg m^2'
        problems.warning(inertial, where, text, _TENSOR_HINT)
    if mass > 0.0 and large * largest > _MAX_GYRATION**2 * mass:
        text = (
            f'radius of gyration is more than {_MAX_GYRATION:g} m; a URDF has inertias in kg m^2'
        )
        hint = 'convert the inertia to kg m^2: numbers from CAD in g mm^2 are 1e9 times larger'
        problems.warning(inertial, where, text, hint)


# Joints

_LIMITED_TYPES = ('revolute', 'prismatic')
_UNSUPPORTED_TYPES = {
    'planar': 'use two prismatic joints and a continuous one, with massless links between them',
    'floating': 'remove this joint; if the base moves, set the parameter base_motion of the node',
}

MIN_AXIS_LENGTH = 1e-6
"""Smallest length of an axis that has a reliable direction."""
_MAX_TURN = 50.0
"""Largest plausible position limit [rad]; larger limits are probably in degrees."""

_ZERO_LIMIT_HINTS = {
    'effort': 'write the largest effort of the joint; without it, efforts are not limited',
    'velocity': 'write the largest speed of the joint',
}


def check_joint(joint: Element, joints: Mapping[str, Element], problems: Problems) -> None:
    """Check a joint; ``joints`` contains all joints by name."""
    where, kind = label(joint), joint.get('type')
    if kind in _UNSUPPORTED_TYPES:
        text = f"joint type '{kind}' is not supported; {_UNSUPPORTED_TYPES[kind]}"
        problems.error(joint, f'{where}: {text}')
    elif kind not in SUPPORTED_TYPES:
        found = 'is missing, expected' if kind is None else f'{quoted(kind)} is not'
        text = f'type {found} one of {", ".join(SUPPORTED_TYPES)}'
        problems.error(joint, f'{where}: {text}')

    kinds = CHILDREN_OF_FIXED if kind == 'fixed' else CHILDREN['joint']
    parts = check_children(joint, where, kinds, problems)
    values = {name: check_attributes(part, where, problems) for name, part in parts.items()}
    for end in ('parent', 'child'):
        if end not in parts:
            problems.error(joint, f'{where}: <{end} link="..."/> is missing')
    if 'origin' in parts:
        check_rotation(parts['origin'], f'{where} origin', values['origin'], problems)
    if kind in SUPPORTED_TYPES and kind != 'fixed':
        _check_axis(joint, parts.get('axis'), values.get('axis', {}), problems)
        _check_limit(joint, parts, values.get('limit', {}), problems)
        if 'mimic' in parts:
            check_mimic(joint, parts['mimic'], joints, problems)


def _check_axis(
    joint: Element,
    axis: Element | None,
    values: Mapping[str, tuple[float, ...]],
    problems: Problems,
) -> None:
    where = label(joint)
    if axis is None:
        hint = 'write <axis xyz="..."/>, in the frame of the joint'
        problems.warning(joint, where, '<axis> is missing; 1 0 0 is used', hint)
    if 'xyz' not in values:
        return
    if math.hypot(*values['xyz']) < MIN_AXIS_LENGTH:
        text = f"the length of axis '{written(axis, 'xyz')}' is almost zero"
        problems.error(axis, f'{where}: {text}')


def _check_limit(
    joint: Element,
    parts: Mapping[str, Element],
    values: Mapping[str, tuple[float, ...]],
    problems: Problems,
) -> None:
    kind, limit = joint.get('type'), parts.get('limit')
    if limit is None:
        if kind in _LIMITED_TYPES:
            problems.error(joint, f'{label(joint)}: <limit> is required for {kind} joints')
        return
    if 'mimic' not in parts:
        for name, hint in _ZERO_LIMIT_HINTS.items():
            if values.get(name) == (0.0,):
                subject = limit_subject(joint.get('name', ''), name)
                text = f'0 means unknown, so the {name} is not limited'
                problems.warning(limit, subject, text, hint)
    if kind in _LIMITED_TYPES:
        _check_range(joint, limit, values, problems)


def _check_range(
    joint: Element, limit: Element, values: Mapping[str, tuple[float, ...]], problems: Problems
) -> None:
    where, kind = label(joint), joint.get('type')
    missing = [name for name in ('lower', 'upper') if name not in limit.attrib]
    if any(name not in values for name in ('lower', 'upper') if name not in missing):
        return
    lower, upper = (values.get(name, (0.0,))[0] for name in ('lower', 'upper'))
    if lower > upper:
        hint = "; if there are no limits, write type 'continuous'" if kind == 'revolute' else ''
        text = f'lower limit {lower:g} exceeds upper limit {upper:g}{hint}'
        problems.error(limit, f'{where}: {text}')
    elif missing:
        text = f'<limit> has no {" and no ".join(missing)}; 0 is used'
        problems.warning(limit, where, text, 'write both limits, in rad or m')
    if kind == 'revolute' and max(abs(lower), abs(upper)) > _MAX_TURN:
        text = f'limits {lower:g} to {upper:g} are many turns; angles are in radians'
        problems.warning(limit, where, text, 'convert the angles from degrees')


def check_mimic(
    joint: Element, mimic: Element, joints: Mapping[str, Element], problems: Problems
) -> None:
    """Check that the mimicked joint exists, can move, and is not the mimic joint itself."""
    where, master = label(joint), mimic.get('joint')
    if master is None or is_xacro(master):
        return
    if master not in joints:
        problems.error(mimic, f'{where} mimic: {unknown_name("joint", master, joints)}')
    elif master == joint.get('name'):
        problems.error(mimic, f'{where} mimics itself')
    elif joints[master].get('type') == 'fixed':
        problems.error(mimic, f"{where} mimics '{master}', which is fixed")
