"""
Reads the first point of a serialized trajectory.

Deserializing a trajectory of thousands of points takes longer than a control period, and only its
first point is a reference. The bytes behind that point are cut off before.
"""

from __future__ import annotations

import struct

from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from ..errors import JointStateError

_HEADER = 4  # [bytes]; the second one is the byte order of CDR, and the rest is aligned to its end
_STAMP = 8  # [bytes]
_DURATION = 8
_ARRAYS = 4  # positions, velocities, accelerations, effort
_NUMBER = 8


def read_first_point(data: bytes) -> JointTrajectory:
    """
    Deserialize a trajectory up to its first point.

    Parameters
    ----------
    data : bytes
        The message as received by a raw subscription.

    Returns
    -------
    message : JointTrajectory
        With one point, or with none if there is none.

    Raises
    ------
    JointStateError
        If `data` is not a JointTrajectory.

    """
    try:
        return deserialize_message(_without_later_points(data), JointTrajectory)
    except Exception:  # the type depends on the middleware
        raise JointStateError(f'{len(data)} bytes are not a JointTrajectory') from None


def _without_later_points(data: bytes) -> bytes:
    if data[:1] != b'\0' or data[1] not in (0, 1):
        return data  # another encoding than plain CDR; rare
    integer = struct.Struct('<I' if data[1] else '>I')
    at = _HEADER + _STAMP

    def read_count() -> int:
        nonlocal at
        at += -at % integer.size
        (count,) = integer.unpack_from(data, at)
        at += integer.size
        return int(count)

    def skip_text() -> None:
        nonlocal at
        size = read_count()
        at += size

    skip_text()  # frame_id
    for _ in range(read_count()):
        skip_text()  # joint_names
    point_count = read_count()
    start = at
    for _ in range(_ARRAYS if point_count else 0):
        count = read_count()
        if count:
            at += (_HEADER - at) % _NUMBER + count * _NUMBER
    at += -at % integer.size + _DURATION if point_count else 0
    if at > len(data):
        raise ValueError('the message ends too early')
    if point_count < 2:
        return data
    return data[: start - integer.size] + integer.pack(1) + data[start:at]
