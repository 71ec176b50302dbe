"""
Reads serialized joint states and writes serialized commands.

Deserializing a message takes longer than computing the efforts. Therefore only the first message
of a publisher is deserialized. Later messages usually have the same joint names and the
same layout. Their numbers are then read in place.
"""

from __future__ import annotations

from collections.abc import Callable
import struct
from typing import Any, NamedTuple

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from ..errors import JointStateError
from ..robot.model import Floats

_CDR_LITTLE_ENDIAN = b'\x00\x01\x00\x00'
_HEADER = len(_CDR_LITTLE_ENDIAN)  # alignment is relative to the end of the header
_STAMP = 8  # [bytes]
_NUMBER = np.dtype('<f8')
_MAX_LAYOUTS = 16  # if there are more layouts, the names change with every message


def stamp_of(data: bytes) -> int:
    """Return the stamp [ns] of a serialized message that starts with a header."""
    order = '<' if data[1] & 1 else '>'  # data[:4] is the encapsulation header of CDR
    seconds, nanoseconds = struct.unpack_from(f'{order}iI', data, _HEADER)
    return int(seconds) * 10**9 + int(nanoseconds)


class JointStateArrays(NamedTuple):
    """Contents of a joint state; lengths and values are not checked."""

    joints: Any
    """Joint names, or the object that `JointStateReader` has made from the names."""
    positions: Floats
    velocities: Floats
    efforts: Floats


class JointStateReader:
    """
    Reads serialized joint states, with a fast path for known message layouts.

    `prepare` makes `JointStateArrays.joints` from the names, usually once for each publisher.
    """

    def __init__(self, prepare: Callable[[tuple[str, ...]], Any] = tuple) -> None:
        self._prepare = prepare
        self._layouts: list[_Layout] = []

    def read(self, data: bytes) -> JointStateArrays:
        """
        Read one message from a raw subscription; the arrays are usually read-only views of `data`.

        Raise a JointStateError if `data` is not a JointState. `prepare` may raise the same error.
        """
        for layout in self._layouts:
            if layout.fits(data):
                return layout.arrays(data)
        return self._deserialize(data)

    def _deserialize(self, data: bytes) -> JointStateArrays:
        try:
            message = deserialize_message(data, JointState)
        except Exception:  # the type of the error depends on the middleware
            raise JointStateError(f'{len(data)} bytes cannot be read as a JointState') from None
        numbers = [np.asarray(x) for x in (message.position, message.velocity, message.effort)]
        arrays = JointStateArrays(self._prepare(tuple(message.name)), *numbers)
        if data.startswith(_CDR_LITTLE_ENDIAN):
            self._remember(data, arrays)
        return arrays

    def _remember(self, data: bytes, arrays: JointStateArrays) -> None:
        try:
            layout = _find_layout(data, arrays.joints)
        except struct.error:
            return
        # A middleware that aligns numbers differently gets no fast path.
        found = zip(arrays[1:], layout.arrays(data)[1:], strict=True)
        if all(expected.tobytes() == actual.tobytes() for expected, actual in found):
            if len(self._layouts) >= _MAX_LAYOUTS:
                self._layouts.clear()
            self._layouts.append(layout)


def serialize_numbers(numbers: Floats) -> bytes:
    """Serialize numbers, shape (m,), as a Float64MultiArray without dimensions."""
    # The header: no dimensions, data_offset 0, the number of values, and padding.
    head = struct.pack('<4s3I4x', _CDR_LITTLE_ENDIAN, 0, 0, len(numbers))
    return head + numbers.astype(_NUMBER, copy=False).tobytes()


class _Layout(NamedTuple):
    """Where a message stores its arrays, and how to recognize messages with the same layout."""

    pattern: struct.Struct
    """Unpacks strings and array lengths; skips the stamp, padding and numbers."""
    fixed: tuple[Any, ...]
    """Strings and array lengths that all messages with this layout contain."""
    joints: Any
    places: tuple[tuple[int, int], ...]
    """Lengths and byte offsets of positions, velocities and efforts."""

    def fits(self, data: bytes) -> bool:
        return len(data) == self.pattern.size and self.pattern.unpack(data) == self.fixed

    def arrays(self, data: bytes) -> JointStateArrays:
        positions, velocities, efforts = self.places
        return JointStateArrays(
            self.joints,
            np.frombuffer(data, _NUMBER, *positions),
            np.frombuffer(data, _NUMBER, *velocities),
            np.frombuffer(data, _NUMBER, *efforts),
        )


def _find_layout(data: bytes, joints: Any) -> _Layout:
    """Return the layout of a message that has been deserialized successfully."""
    pattern, at = [f'<{_HEADER}s{_STAMP}x'], _HEADER + _STAMP
    places = []

    def read_count() -> int:
        nonlocal at
        padding = -at % 4
        (count,) = struct.unpack_from('<I', data, at + padding)
        pattern.append(f'{padding}xI')
        at += padding + 4
        return int(count)

    def read_text() -> None:
        nonlocal at
        size = read_count()
        pattern.append(f'{size}s')
        at += size

    read_text()  # frame_id
    for _ in range(read_count()):
        read_text()  # names
    for _ in ('positions', 'velocities', 'efforts'):
        count = read_count()
        padding = (_HEADER - at) % _NUMBER.itemsize if count else 0
        places.append((count, at + padding))
        size = padding + count * _NUMBER.itemsize
        pattern.append(f'{size}x')
        at += size
    pattern.append(f'{len(data) - at}x')  # a serializer may append bytes
    whole = struct.Struct(''.join(pattern))
    return _Layout(whole, whole.unpack(data), joints, tuple(places))
