"""Rotations that a URDF gives as a quaternion, written as roll, pitch and yaw."""

from __future__ import annotations

import math


def rpy_of_quaternion(text: str) -> str:
    """
    Convert the value of ``quat_xyzw`` to the value of ``rpy`` that means the same rotation.

    Parameters
    ----------
    text : str
        Four numbers x, y, z, w; not all zero. They are normalised.

    Returns
    -------
    rpy : str
        Roll, pitch and yaw [rad] about the fixed axes x, y and z.

    """
    values = [float(word) for word in text.split()]
    norm = math.hypot(*values)
    x, y, z, w = (value / norm for value in values)
    # R = Rz(yaw) Ry(pitch) Rx(roll). Near a pitch of 90 degrees only the sum or the difference of
    # roll and yaw is well defined. Any yaw is correct there, provided that the roll is computed
    # from it: from the rotation that is left after turning back by yaw.
    r00, r10 = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    r01, r11 = 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z)
    r02, r12, r20 = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 2.0 * (x * z - w * y)
    yaw = math.atan2(r10, r00)
    cos, sin = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-r20, cos * r00 + sin * r10)
    roll = math.atan2(sin * r02 - cos * r12, cos * r11 - sin * r01)
    return f'{roll!r} {pitch!r} {yaw!r}'
