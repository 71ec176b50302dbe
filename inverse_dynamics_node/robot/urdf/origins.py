"""Checks of the rotation of an <origin>."""

from __future__ import annotations

from collections.abc import Mapping
import math

from .elements import written
from .problems import Problems
from .rules import version_of, VERSIONS, VERSIONS_WITH_QUATERNIONS
from .xml import Element

UNIT_TOLERANCE = 1e-3
"""A vector rounded to four digits is still a unit vector."""
_QUATERNION_TOLERANCE = 0.1
"""Rounding to one digit changes the norm of a quaternion by less; a typing error by more."""
_MAX_RPY = 7.0
"""Slightly more than a turn [rad]: a larger angle is probably in degrees."""


def check_rotation(
    origin: Element, where: str, values: Mapping[str, tuple[float, ...]], problems: Problems
) -> None:
    """Check the roll, pitch and yaw or the quaternion of an origin."""
    if 'quat_xyzw' in origin.attrib:
        _check_quaternion(origin, where, values, problems)
    if any(abs(angle) > _MAX_RPY for angle in values.get('rpy', ())):
        text = f"'{origin.get('rpy')}' is more than a turn; angles are in radians"
        problems.warning(origin, f'{where} rpy', text, 'convert the angles from degrees')


def _check_quaternion(
    origin: Element, where: str, values: Mapping[str, tuple[float, ...]], problems: Problems
) -> None:
    version = version_of(origin)
    if version in VERSIONS and version not in VERSIONS_WITH_QUATERNIONS:
        # urdfdom ignores the attribute in these files, and the rotation with it.
        text = f'quat_xyzw needs <robot version="1.1">, found version {version}; or write rpy'
        problems.error(origin, f'{where}: {text}')
    if 'rpy' in origin.attrib:
        problems.error(origin, f'{where} has both rpy and quat_xyzw, expected one of them')
    if 'quat_xyzw' not in values:
        return
    norm = math.hypot(*values['quat_xyzw'])
    subject = f'{where} quat_xyzw'
    text = f"'{written(origin, 'quat_xyzw')}' has norm {norm:g}"
    if abs(norm - 1.0) > _QUATERNION_TOLERANCE:
        problems.error(origin, f'{subject}: {text}, expected 1')
    elif abs(norm - 1.0) > UNIT_TOLERANCE:
        hint = 'harmless; write a quaternion of norm 1'
        problems.warning(origin, subject, f'{text}; normalised', hint)
