"""
Joint states as they come off the wire, read where they lie; commands as they go onto it.

To make a message of the bytes takes longer than the dynamics. But a publisher sends the same names
forever: only its first message is deserialized. It tells where the numbers are in those that are
like it in all but numbers and time.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from ..errors import JointStateError
from ..robot.model import Floats

_CDR_LITTLE_ENDIAN = b'\x00\x01\x00\x00'
_HEADER = len(_CDR_LITTLE_ENDIAN)  # what follows is aligned from here on
_STAMP = 8  # bytes
_NUMBER = np.dtype('<f8')
_MOST_LAYOUTS = 16  # more publishers than that are no publishers


class JointStateArrays(NamedTuple):
    """What a joint state says; lengths and values are not checked."""

    names: tuple[str, ...]
    positions: Floats
    velocities: Floats
    efforts: Floats


class JointStateReader:
    """Reads serialized joint states, fast if they are like one of the last."""

    def __init__(self) -> None:
        self._layouts: list[_Layout] = []

    def read(self, data: bytes) -> JointStateArrays:
        """
        Read one message.

        Parameters
        ----------
        data : bytes
            As a raw subscription gets them.

        Returns
        -------
        arrays : JointStateArrays
            Not to be written to: views of the data, most often.

        Raises
        ------
        JointStateError
            If it is no joint state.

        """
        for layout in self._layouts:
            if layout.fits(data):
                return layout.arrays(data)
        return self._read_anew(data)

    def _read_anew(self, data: bytes) -> JointStateArrays:
        try:
            message = deserialize_message(data, JointState)
        except Exception:  # each middleware has its own
            raise JointStateError(f'{len(data)} bytes that are no JointState') from None
        numbers = [np.asarray(x) for x in (message.position, message.velocity, message.effort)]
        arrays = JointStateArrays(tuple(message.name), *numbers)
        layout = _layout(message.header.frame_id, arrays, len(data))
        if layout.fits(data) and all(
            here.tobytes() == there.tobytes()
            for here, there in zip(layout.arrays(data)[1:], numbers, strict=True)
        ):
            if len(self._layouts) >= _MOST_LAYOUTS:
                self._layouts.clear()
            self._layouts.append(layout)
        return arrays


def serialize_numbers(numbers: Floats) -> bytes:
    """
    Serialize a Float64MultiArray without dimensions.

    Parameters
    ----------
    numbers : ndarray, shape (m,)
        Its data.

    Returns
    -------
    data : bytes
        For a publisher of that type.

    """
    # No dimensions, no offset, a count, a gap.
    head = struct.pack('<4s3I4x', _CDR_LITTLE_ENDIAN, 0, 0, len(numbers))
    return head + numbers.astype(_NUMBER, copy=False).tobytes()


class _Layout(NamedTuple):
    """Where the numbers are, and all else that a message of this kind holds."""

    size: int
    mask: int
    """Of the message as one large number: the bits that are always the same."""
    fixed: int
    names: tuple[str, ...]
    places: tuple[tuple[int, int], ...]
    """Count and offset of positions, velocities and efforts."""

    def fits(self, data: bytes) -> bool:
        return len(data) == self.size and int.from_bytes(data, 'little') & self.mask == self.fixed

    def arrays(self, data: bytes) -> JointStateArrays:
        positions, velocities, efforts = self.places
        return JointStateArrays(
            self.names,
            np.frombuffer(data, _NUMBER, *positions),
            np.frombuffer(data, _NUMBER, *velocities),
            np.frombuffer(data, _NUMBER, *efforts),
        )


def _layout(frame_id: str, arrays: JointStateArrays, size: int) -> _Layout:
    """Lay a message out as little-endian CDR does, and mask stamp, numbers and gaps."""
    fixed = bytearray(_CDR_LITTLE_ENDIAN)
    mask = bytearray(b'\xff' * _HEADER)

    def align(size: int) -> None:
        add(bytes((_HEADER - len(fixed)) % size), b'\x00')

    def add(content: bytes, keep: bytes = b'\xff') -> None:
        fixed.extend(content)
        mask.extend(keep * len(content))

    def add_count(count: int) -> None:
        align(4)
        add(struct.pack('<I', count))

    def add_text(text: str) -> None:
        content = text.encode() + b'\x00'
        add_count(len(content))
        add(content)

    add(bytes(_STAMP), b'\x00')
    add_text(frame_id)
    add_count(len(arrays.names))
    for name in arrays.names:
        add_text(name)
    places = []
    for numbers in arrays[1:]:
        add_count(len(numbers))
        if len(numbers):
            align(_NUMBER.itemsize)
        places.append((len(numbers), len(fixed)))
        add(bytes(_NUMBER.itemsize * len(numbers)), b'\x00')
    add(bytes(max(0, size - len(fixed))), b'\x00')  # a serializer may leave more than it needs
    return _Layout(
        len(fixed),
        int.from_bytes(mask, 'little'),
        int.from_bytes(fixed, 'little'),
        arrays.names,
        tuple(places),
    )
