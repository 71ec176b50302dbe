"""Checks of one joint: type, axis and limits."""

from __future__ import annotations

from collections.abc import Mapping
import math

from ..limit_checks import limit_subject
from .elements import check_attributes, check_children, written
from .origins import check_rotation, UNIT_TOLERANCE
from .problems import label, Problems, quoted
from .rules import CHILDREN, CHILDREN_OF_FIXED, SUPPORTED_TYPES
from .tree import check_mimic
from .xml import Element

_LIMITED_TYPES = ('revolute', 'prismatic')
_UNSUPPORTED_TYPES = {
    'planar': 'use two prismatic joints and a continuous one, with massless links between them',
    'floating': 'remove it: the base may move, its motion is an input',
}

MIN_AXIS_LENGTH = 1e-6
"""A shorter axis does not have a reliable direction."""
_MAX_TURN = 50.0
"""Largest plausible position limit [rad]; larger limits are probably in degrees."""

_ZERO_LIMIT_HINTS = {
    'effort': 'write the largest effort of the joint; without it, efforts are not limited',
    'velocity': 'write the largest speed of the joint',
}


def check_joint(joint: Element, joints: Mapping[str, Element], problems: Problems) -> None:
    """Check a joint; of the other joints, only the names and types are used."""
    where, kind = label(joint), joint.get('type')
    if kind in _UNSUPPORTED_TYPES:
        text = f"joint type '{kind}' is not supported; {_UNSUPPORTED_TYPES[kind]}"
        problems.error(joint, f'{where}: {text}')
    elif kind not in SUPPORTED_TYPES:
        found = '' if kind is None else f' {quoted(kind)}'
        text = f'type{found} is not one of {", ".join(SUPPORTED_TYPES)}'
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
        problems.warning(joint, where, 'no <axis>; 1 0 0 is used', hint)
    if 'xyz' not in values:
        return
    length = math.hypot(*values['xyz'])
    if length < MIN_AXIS_LENGTH:
        text = f"axis has (near) zero length: '{written(axis, 'xyz')}'"
        problems.error(axis, f'{where}: {text}')
    elif abs(length - 1.0) > UNIT_TOLERANCE:
        text = f"axis '{written(axis, 'xyz')}' has length {length:g}; normalised"
        problems.warning(axis, where, text, 'harmless; write an axis of length 1')


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
                text = f'0 is read as unknown: the {name} is not limited'
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
        hint = "; for a joint without limits write type 'continuous'" if kind == 'revolute' else ''
        problems.error(limit, f'{where}: limit lower {lower:g} > upper {upper:g}{hint}')
    elif missing:
        text = f'<limit> has no {" and no ".join(missing)}; 0 is used'
        problems.warning(limit, where, text, 'write both ends, in rad or m')
    elif lower == upper:
        text = f'limit lower = upper = {lower:g}: it cannot move'
        problems.warning(limit, where, text, 'write a range, or make the joint fixed')
    if kind == 'revolute' and max(abs(lower), abs(upper)) > _MAX_TURN:
        text = f'limits {lower:g} to {upper:g} are many turns; angles are in radians'
        problems.warning(limit, where, text, 'convert the angles from degrees')
