"""The part of URDF that dynamics need, as tables: elements, their attributes, what these hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

SUPPORTED_TYPES = ('revolute', 'continuous', 'prismatic', 'fixed')

VERSIONS = ('1.0', '1.1', '1.2')
"""
Versions of the format that are read, as in urdfdom 6.

1.1 adds quaternions and capsules, 1.2 adds limits that inverse dynamics do not need.
"""
VERSIONS_WITH_QUATERNIONS = ('1.1', '1.2')

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
"""The elements that dynamics need; at most one of each, links and joints aside."""

CHILDREN_OF_FIXED = ('parent', 'child', 'origin')
"""Nothing else means anything on a fixed joint, so nothing else is looked at there."""


@dataclass(frozen=True)
class Rule:
    """The attributes of an element."""

    names: tuple[str, ...] = ()
    numbers: Mapping[str, int] = field(default_factory=dict)
    """How many numbers each attribute holds."""
    required: tuple[str, ...] = ()
    not_negative: tuple[str, ...] = ()
    is_open: bool = False
    """Whether makers add attributes of their own: others are a slip of the pen."""


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
