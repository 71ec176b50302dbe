"""Records the joint states of a running node as a CSV file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import csv
import math
import time
from typing import TextIO

from ..errors import ConfigurationError, JointStateError
from ..robot.model import Floats
from .cdr import JointStateReader, stamp_of
from .observer import Observer

_QUANTITIES = 'position', 'velocity', 'effort'
_PATIENCE = 10.0  # [s]; longest wait for all joints; diagnostics come once a second
_LISTENING = 1.0  # [s]; time in which every publisher of joint states should publish
_SILENCE = 5.0  # [s]; the recording ends after this time without efforts
_POLL = 0.02  # [s]


class StateRows:
    """
    Converts serialized joint states to CSV rows, with columns for the joints seen by `note`.

    A joint state may contain only some of the joints. Cells without a value, or with NaN, are
    empty.
    """

    def __init__(self) -> None:
        self._reader = JointStateReader()
        self.joints: dict[str, bool] = {}
        """For each joint name, whether an effort has arrived."""

    def note(self, data: bytes) -> None:
        """Note the joints of a joint state, and whether they have efforts."""
        for joint, *_, effort in self._values(data):
            has_effort = effort is not None and math.isfinite(effort)
            self.joints[joint] = has_effort or self.joints.get(joint, False)

    def header(self) -> list[str]:
        """Return the names of the columns."""
        return ['time', *(f'{joint}.{x}' for joint in self.joints for x in _QUANTITIES)]

    def row(self, data: bytes, received: float) -> list[float | str | None] | None:
        """Return time stamp and values of a joint state; `received` replaces a zero stamp."""
        values = {joint: values for joint, *values in self._values(data)}
        if values.keys().isdisjoint(self.joints):
            return None
        nanoseconds = stamp_of(data) or round(1e9 * (received or time.time()))
        stamp = f'{nanoseconds // 10**9}.{nanoseconds % 10**9:09d}'
        return [stamp, *(x for joint in self.joints for x in values.get(joint, (None,) * 3))]

    def _values(self, data: bytes) -> list[tuple[str, float | None, float | None, float | None]]:
        try:
            names, *arrays = self._reader.read(data)
        except JointStateError:
            return []
        unknown = [None] * len(names)
        values = (_reported(x) if len(x) == len(names) else unknown for x in arrays)
        return list(zip(names, *values, strict=True))


def _reported(values: Floats) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values.tolist()]


class JointStateRecorder:
    """Records the joint states that an observed node uses; call `wait`, then `record`."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._rows = StateRows()
        self._joints: tuple[str, ...] = ()  # with efforts
        self.count = 0
        """Number of recorded states that contain an effort of a joint passed to `wait`."""
        self.duration = 0.0
        """Duration of the recording [s]."""

    @property
    def topic(self) -> str:
        """Topic of the joint states; empty if unknown."""
        status = self._observer.status
        return status.text('joint states', 'topic') if status else ''

    def wait(self, joints: Sequence[str]) -> None:
        """
        Wait until joint states have arrived for all joints of the node, or until a time limit.

        Raise a ConfigurationError if a joint of the node is missing, or if no effort has arrived
        for any of `joints`.
        """
        self._observer.on_joint_state = lambda data, _: self._rows.note(data)
        is_known, heard = False, math.inf
        due = time.monotonic() + _PATIENCE
        while (now := time.monotonic()) < due:
            self._observer.poll()
            if self.topic and not is_known:
                is_known, due = True, now + _PATIENCE
            if self._rows.joints:
                heard = min(heard, now)
            if self._has_all_joints() and now > heard + _LISTENING:
                break
            time.sleep(_POLL)
        problem = self._problem(joints)
        if problem:
            raise ConfigurationError(problem)
        self._joints = tuple(joint for joint in joints if self._rows.joints.get(joint))

    def record(
        self,
        file: TextIO,
        seconds: float,
        is_stopped: Callable[[], bool],
        progress: Callable[[float], None],
    ) -> str:
        """
        Write the arriving joint states to a file, and return why the recording ended early.

        The result is empty if the recording lasted `seconds`. `progress` is called with the
        elapsed fraction of `seconds`, 0 to 1.
        """
        began = last = time.monotonic()
        writer = csv.writer(file)
        header = self._rows.header()
        writer.writerow(header)
        efforts = [header.index(f'{joint}.effort') for joint in self._joints]

        def write(data: bytes, received: float) -> None:
            nonlocal last
            row = self._rows.row(data, received)
            if row:
                writer.writerow(row)
                if any(row[k] is not None for k in efforts):
                    self.count += 1
                    last = time.monotonic()

        self._observer.on_joint_state = write
        reason = ''
        while not reason and self.duration < seconds:
            time.sleep(_POLL)
            self._observer.poll()
            file.flush()
            now = time.monotonic()
            self.duration = now - began
            progress(min(1.0, self.duration / seconds))
            if is_stopped():
                reason = f'it ends before {seconds:g} s, because the recording was stopped'
            elif now > last + _SILENCE:
                reason = (
                    f'it ends before {seconds:g} s, because no efforts arrived on {self.topic} '
                    f'for {_SILENCE:g} s'
                )
        self._observer.on_joint_state = None
        return reason

    def _has_all_joints(self) -> bool:
        status = self._observer.status
        joints = status.names('model', 'joints') if status else []
        return bool(joints) and self._rows.joints.keys() >= {*joints}

    def _problem(self, joints: Sequence[str]) -> str:
        """Return why nothing can be recorded, or an empty string."""
        name, status, found = self._observer.name, self._observer.status, self._rows.joints
        if status is None:
            return (
                f'no diagnostics from {name} for {_PATIENCE:g} s: the node has ended, or cannot '
                'be reached'
            )
        if not self.topic:
            state = status.text('loop', 'state')
            return f'{name} is {state}, so it gets no joint states: configure the node'
        if not found:
            return (
                f'no joint states on {self.topic} for {_PATIENCE:g} s: start the driver of the '
                'robot'
            )
        if found.keys().isdisjoint(joints):
            return f'{self.topic} has joints {", ".join(found)}; expected {", ".join(joints)}'
        missing = [joint for joint in status.names('model', 'joints') if joint not in found]
        if missing:
            return f'no joint states of {", ".join(missing)} on {self.topic} for {_PATIENCE:g} s'
        if not any(found.get(joint) for joint in joints):
            return (
                f'the joint states on {self.topic} have no efforts; configure the driver to '
                'publish measured efforts, from which the payload is computed'
            )
        return ''
