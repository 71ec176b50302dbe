"""Records the joint states that a running node uses as a CSV file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import csv
from itertools import product
import math
from pathlib import Path
import time

from ..errors import ConfigurationError, JointStateError, RecordingError
from .cdr import JointStateReader, stamp_of
from .diagnostics import NodeStatus
from .observer import Observer

_QUANTITIES = 'position', 'velocity', 'effort'
_PATIENCE = 10.0  # [s]; longest wait for an effort; diagnostics come once a second
_SILENCE = 5.0  # [s]; the recording ends after this time without efforts
_POLL = 0.02  # [s]


class StateRows:
    """
    Converts serialized joint states to CSV rows with the values of each of `joints`.

    A joint state may contain only some of the joints. Cells without a value, or with NaN, are
    empty.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self._joints = joints
        self._reader = JointStateReader()
        self.header = ['time', *map('.'.join, product(joints, _QUANTITIES))]
        """Names of the columns."""

    def row(self, data: bytes, received: float) -> list[float | str | None] | None:
        """
        Return time stamp and values of a joint state; `received` replaces a zero stamp.

        Return None if the joint state has none of the joints.
        """
        try:
            names, *arrays = self._reader.read(data)
        except JointStateError:
            return None
        found = {}
        for k, name in enumerate(names):
            values = (float(x[k]) if len(x) == len(names) else math.nan for x in arrays)
            found[name] = [None if math.isnan(value) else value for value in values]
        if found.keys().isdisjoint(self._joints):
            return None
        nanoseconds = stamp_of(data) or round(1e9 * (received or time.time()))
        stamp = f'{nanoseconds // 10**9}.{nanoseconds % 10**9:09d}'
        return [stamp, *(x for joint in self._joints for x in found.get(joint, (None,) * 3))]


class JointStateRecorder:
    """Records the joint states that an observed node uses; call `wait`, then `record`."""

    def __init__(self, observer: Observer, joints: Sequence[str]) -> None:
        self._observer = observer
        self._joints = joints
        self._rows = StateRows(joints)
        self._last = -math.inf  # time of the last effort on the steady clock [s]
        self.count = 0
        """Number of recorded states that contain an effort."""
        self.positions: dict[str, float] = {}
        """Latest positions of the joints [rad or m]."""

    @property
    def topic(self) -> str:
        """Topic of the joint states; empty if unknown."""
        status = self._observer.status
        return status.text('joint states', 'topic') if status else ''

    def wait(self) -> NodeStatus:
        """
        Wait for an effort of any of the joints; return the status of the node.

        Raise a ConfigurationError that says what is missing if no effort arrives within 10 s, or
        if the node uses another robot description.
        """
        has_arrived = False

        def note(data: bytes, received: float) -> None:
            nonlocal has_arrived
            has_arrived = True
            self._row(data, received)

        self._observer.on_joint_state = note
        due = time.monotonic() + _PATIENCE
        while self._last < 0.0:
            if time.monotonic() > due:
                raise ConfigurationError(self._problem(has_arrived))
            time.sleep(_POLL)
            self._observer.poll()
        self._observer.on_joint_state = None
        status = self._observer.status
        assert status is not None  # it names the topic of the joint states
        joints = status.names('model', 'joints')
        if not set(joints) <= set(self._joints):
            raise ConfigurationError(
                f'{self._observer.name} uses another robot description, with joints '
                f'{", ".join(joints)}; the URDF of the command line has {", ".join(self._joints)}'
            )
        return status

    def record(self, path: Path, is_done: Callable[[], bool]) -> None:
        """
        Write the arriving joint states to a new file until `is_done` returns True.

        The rows are in the file soon after their arrival, so that it contains what was recorded if
        this function raises an error. Raise a FileExistsError if the file exists, and a
        RecordingError if no efforts arrive for 5 s.
        """
        with path.open('x', newline='', encoding='utf-8') as file:
            writer = csv.writer(file)
            writer.writerow(self._rows.header)

            def write(data: bytes, received: float) -> None:
                if row := self._row(data, received):
                    writer.writerow(row)

            self._last, self.count = time.monotonic(), 0
            self._observer.on_joint_state = write
            try:
                while not is_done():
                    time.sleep(_POLL)
                    self._observer.poll()
                    file.flush()
                    if time.monotonic() > self._last + _SILENCE:
                        raise RecordingError(
                            f'{path}: the recording has ended early, because no efforts arrived '
                            f'on {self.topic} for {_SILENCE:g} s'
                        )
            finally:
                self._observer.on_joint_state = None

    def _row(self, data: bytes, received: float) -> list[float | str | None] | None:
        """Return the row of a joint state, and note whether it contains an effort."""
        row = self._rows.row(data, received)
        if row:
            positions = zip(self._joints, row[1::3], strict=True)
            self.positions |= {name: float(q) for name, q in positions if q is not None}
            if any(effort is not None for effort in row[3::3]):
                self._last = time.monotonic()
                self.count += 1
        return row

    def _problem(self, has_arrived: bool) -> str:
        """Return why nothing can be recorded."""
        name, status = self._observer.name, self._observer.status
        if status is None:
            return (
                f'no diagnostics from {name} for {_PATIENCE:g} s: the node has ended, or cannot '
                'be reached'
            )
        if not self.topic:
            state = status.text('loop', 'state')
            return f'{name} is {state}, so it gets no joint states: configure the node'
        if not has_arrived:
            return f'no joint states on {self.topic} for {_PATIENCE:g} s: start the driver'
        return (
            f'the joint states on {self.topic} have no efforts of {", ".join(self._joints)}: '
            'configure the driver to publish measured efforts'
        )
