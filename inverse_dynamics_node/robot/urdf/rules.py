"""The part of URDF that the dynamics need, as tables of elements and their attributes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .xml import Element

SUPPORTED_TYPES = ('revolute', 'continuous', 'prismatic', 'fixed')

VERSIONS = ('1.0', '1.1', '1.2')
"""
Versions of the format that are read, as in urdfdom 6.

1.1 adds quaternions and capsules, 1.2 adds limits that inverse dynamics does not need.
"""
VERSIONS_WITH_QUATERNIONS = ('1.1', '1.2')


def version_of(element: Element) -> str:
    """Return the version of URDF that the document of an element declares."""
    version: str = element.getroottree().getroot().get('version', '1.0')
    return version


CHILDREN = {
    'robot': ('link', 'joint'),
    'link': ('inertial',),
    'inertial': ('origin', 'mass', 'inertia'),
    'joint': (
        'parent',
        'child',
        'origin',
        'axis',
        'limit',
        'dynamics',
        'mimic',
        'safety_controller',
    ),
}
"""The elements that the dynamics need; at most one of each, except links and joints."""

READ_ONCE = 'origin'
"""The element of which the first one is used if there are several."""

CHILDREN_OF_FIXED = ('parent', 'child', 'origin')
"""Other elements have no meaning on a fixed joint and are not checked there."""


@dataclass(frozen=True)
class Rule:
    """The attributes of an element."""

    names: tuple[str, ...] = ()
    numbers: Mapping[str, int] = field(default_factory=dict)
    """Attributes with numbers, and how many numbers each of them holds."""
    required: tuple[str, ...] = ()
    not_negative: tuple[str, ...] = ()
    is_open: bool = False
    """Whether other attributes are allowed; if not, an unknown one is probably misspelt."""


def _scalars(*names: str) -> dict[str, int]:
    return dict.fromkeys(names, 1)


MOMENTS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
_SAFETY = ('soft_lower_limit', 'soft_upper_limit', 'k_position', 'k_velocity')

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
    'safety_controller': Rule(numbers=_scalars(*_SAFETY), required=('k_velocity',)),
}
