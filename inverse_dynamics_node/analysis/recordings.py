"""
Recorded joint states, from a rosbag2 recording or a CSV file, as arrays by joint name.

Bags are read without ROS: mcap or sqlite3, a folder or one file of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
import csv
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import RecordingError
from ..robot.model import Floats
from .csv_header import explain_missing_time
from .identification import Recording

JOINT_STATE = 'sensor_msgs/msg/JointState'
BAGS = ('.mcap', '.db3')
_FIELDS = ('position', 'velocity', 'effort')
_LOOKED_AT = 100  # messages of a topic, to see whether it has efforts
_BETWEEN_REPORTS = 500  # messages


class Sample(NamedTuple):
    """One message: some joints at one time."""

    stamp: int
    """Of its header [ns]; 0 if the driver does not stamp."""
    logged: int
    """When it reached the recorder [ns]."""
    names: tuple[str, ...]
    values: tuple[Any, Any, Any]
    """Position, velocity and effort: of as many numbers as names, or of none."""


def read_recording(
    path: Path,
    joint_names: Sequence[str],
    topic: str | None = None,
    tell: Callable[[float], None] = lambda share: None,
) -> tuple[Recording, tuple[str, ...]]:
    """
    Read the joint states of a robot.

    Parameters
    ----------
    path : pathlib.Path
        A rosbag2 folder, an .mcap or .db3 file, or a .csv file.
    joint_names : sequence of str
        The robot's joints; others are left out.
    topic : str, optional
        Of type sensor_msgs/msg/JointState; without it, the only one with efforts.
    tell : callable
        Is told the share read so far, now and then.

    Returns
    -------
    recording : Recording
        Of the joints that were recorded, in the order of ``joint_names``; times from the first.
    notes : tuple of str
        What was left out, in words.

    Raises
    ------
    RecordingError
        If it cannot be read, or has no efforts of any of these joints.

    """
    if not path.exists():
        raise RecordingError(f'{path}: no such file or folder, expected a recording')
    if path.suffix == '.csv':
        if topic is not None:
            raise RecordingError(f'{path}: a CSV file has no topic {topic}')
        return _read_csv(path, joint_names)
    if path.is_file() and path.suffix not in BAGS:
        raise RecordingError(
            f"{path}: is a '{path.suffix or path.name}' file, expected a rosbag2 folder, .mcap, "
            '.db3 or .csv'
        )
    return _read_bag(path, joint_names, topic, tell)


# ---- Bags ----------------------------------------------------------------------------------


def _read_bag(
    path: Path, joint_names: Sequence[str], topic: str | None, tell: Callable[[float], None]
) -> tuple[Recording, tuple[str, ...]]:
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import get_typestore, Stores

    if path.is_dir() and not (path / 'metadata.yaml').exists():
        inside = sorted(file.name for file in path.iterdir() if file.suffix in BAGS)
        raise RecordingError(
            f'{path}: has no metadata.yaml, expected a rosbag2 folder'
            + (f'; or give one of its files, {", ".join(inside)}' if inside else '')
        )
    try:
        # Bags of ROS before Iron carry no definitions of their messages.
        store = get_typestore(Stores.ROS2_JAZZY)
        with AnyReader([path], default_typestore=store) as reader:
            chosen = _choose(path, reader, topic)
            count = max(1, sum(connection.msgcount for connection in chosen))
            samples = _reporting(_samples(reader, chosen), count, tell)
            return _gather(f'{path} {chosen[0].topic}', samples, joint_names)
    except RecordingError:
        raise
    except (AnyReaderError, OSError) as error:
        raise RecordingError(f'{path}: cannot be read as rosbag2: {error}') from None
    except Exception as error:  # what half a file makes its decoders raise is any of dozens
        kind = type(error).__name__
        raise RecordingError(f'{path}: is damaged or cut short: {kind}: {error}') from None


def _choose(path: Path, reader: Any, topic: str | None) -> list[Any]:
    """Return the connections of the topic to read."""
    found = {c.topic: c.msgtype for c in reader.connections}
    states = sorted(name for name, kind in found.items() if kind == JOINT_STATE)
    if topic is not None:
        name = topic if topic in found or topic.startswith('/') else f'/{topic}'
        if name not in found:
            raise RecordingError(
                f'{path}: has no topic {name}; of type {JOINT_STATE} are '
                f'{", ".join(states) or "none"}'
            )
        if found[name] != JOINT_STATE:
            raise RecordingError(f'{path}: {name} is of type {found[name]}, not {JOINT_STATE}')
        states = [name]
    if not states:
        topics = ', '.join(f'{name} ({kind})' for name, kind in sorted(found.items())) or 'nothing'
        raise RecordingError(f'{path}: has no topic of type {JOINT_STATE}; it has {topics}')
    if len(states) > 1:
        states = _with_efforts(path, reader, states)
    return [c for c in reader.connections if c.topic == states[0]]


def _with_efforts(path: Path, reader: Any, topics: list[str]) -> list[str]:
    """Find the only topic whose messages have positions and efforts."""
    useful = []
    for topic in topics:
        connections = [c for c in reader.connections if c.topic == topic]
        first = islice(_samples(reader, connections), _LOOKED_AT)
        if any(len(sample.values[0]) and len(sample.values[2]) for sample in first):
            useful.append(topic)
    if len(useful) == 1:
        return useful
    which = 'of them have' if useful else 'none of them has'
    raise RecordingError(
        f'{path}: several topics of type {JOINT_STATE}, {", ".join(topics)}; '
        + (f'{", ".join(useful)} {which} efforts' if useful else f'{which} efforts')
        + '; choose one with --topic'
    )


def _samples(reader: Any, connections: list[Any]) -> Iterator[Sample]:
    for connection, logged, data in reader.messages(connections=connections):
        message = reader.deserialize(data, connection.msgtype)
        stamp = message.header.stamp
        values = message.position, message.velocity, message.effort
        nanoseconds = stamp.sec * 1_000_000_000 + stamp.nanosec
        yield Sample(nanoseconds, logged, tuple(message.name), values)


def _reporting(
    samples: Iterable[Sample], count: int, tell: Callable[[float], None]
) -> Iterator[Sample]:
    for k, sample in enumerate(samples):
        if k % _BETWEEN_REPORTS == 0:
            tell(k / count)
        yield sample
    tell(1.0)


def _gather(
    where: str, samples: Iterable[Sample], joint_names: Sequence[str]
) -> tuple[Recording, tuple[str, ...]]:
    """Sort messages of any joints in any order into arrays."""
    index = {name: j for j, name in enumerate(joint_names)}
    layouts: dict[tuple[str, ...], tuple[list[int], list[int]]] = {}
    stamps: list[tuple[int, int]] = []
    rows: list[Floats] = []
    for k, sample in enumerate(samples):
        layout = layouts.get(sample.names)
        if layout is None:
            theirs = [i for i, name in enumerate(sample.names) if name in index]
            layout = layouts[sample.names] = theirs, [index[sample.names[i]] for i in theirs]
        theirs, ours = layout
        row = np.full((3, len(joint_names)), np.nan)
        for field, values, into in zip(_FIELDS, sample.values, row, strict=True):
            if len(values) == 0:
                continue
            if len(values) != len(sample.names):
                raise RecordingError(
                    f'{where}: message {k} has {len(values)} values of {field} for '
                    f'{len(sample.names)} names'
                )
            into[ours] = np.asarray(values, dtype=float)[theirs]
        stamps.append((sample.stamp, sample.logged))
        rows.append(row)
    if not rows:
        raise RecordingError(f'{where}: no messages')
    seen = dict.fromkeys(name for names in layouts for name in names)
    both = np.array(stamps)
    is_stamped = bool(both[:, 0].any())
    nanoseconds = both[:, 0 if is_stamped else 1]
    # From the first on: seconds since 1970 leave no digits for microseconds.
    times = 1e-9 * (nanoseconds - nanoseconds[0])
    recording, notes = _recording(where, times, np.array(rows), joint_names, seen)
    if not is_stamped:
        notes += ('messages have no stamp: times are those of the recorder',)
    return recording, notes


def _recording(
    where: str, times: Floats, values: Floats, joint_names: Sequence[str], seen: Iterable[str]
) -> tuple[Recording, tuple[str, ...]]:
    """Leave out what cannot be compared: joints never seen, and say so."""
    seen = list(seen)
    known = [j for j, name in enumerate(joint_names) if name in seen]
    if not known:
        found = f'no joint of this robot, only {", ".join(seen)}' if seen else 'no joint names'
        raise RecordingError(f'{where}: has {found}; expected some of {", ".join(joint_names)}')
    finite = np.isfinite(values)
    if not finite[:, 2, known].any():
        raise RecordingError(
            f'{where}: no message has an effort of any joint of this robot (empty, or NaN); '
            'expected measured efforts to compare with'
        )
    still = [j for j in known if not finite[:, 0, j].any()]
    if still:
        raise RecordingError(
            f"{where}: joint '{joint_names[still[0]]}' never has a position (empty, or NaN)"
        )
    velocities = values[:, 1, known] if finite[:, 1, known].any() else None
    recording = Recording(
        tuple(joint_names[j] for j in known),
        times - times[0],
        values[:, 0, known],
        velocities,
        values[:, 2, known],
    )
    notes = []
    others = [name for name in seen if name not in joint_names]
    if others:
        notes.append(f'joints that the robot does not have, left out: {", ".join(others)}')
    unseen = [name for name in joint_names if name not in seen]
    if unseen:
        notes.append(f'joints that were not recorded, taken to rest at zero: {", ".join(unseen)}')
    without = [joint_names[j] for j in known if not finite[:, 2, j].any()]
    if without:
        notes.append(f'joints without a measured effort, not compared: {", ".join(without)}')
    return recording, tuple(notes)


# ---- CSV -----------------------------------------------------------------------------------


def _read_csv(path: Path, joint_names: Sequence[str]) -> tuple[Recording, tuple[str, ...]]:
    with path.open(newline='', encoding='utf-8-sig') as file:
        rows = csv.reader(file)
        head = [name.strip() for name in next(rows, [])]
        columns = _columns(path, head, joint_names)
        numbers = []
        for row in rows:
            if row:
                numbers.append(_numbers(path, rows.line_num, row, head))
    if not numbers:
        raise RecordingError(f'{path}: no rows below its header')
    table = np.array(numbers)
    values = np.full((len(table), 3, len(joint_names)), np.nan)
    index = {name: j for j, name in enumerate(joint_names)}
    for (joint, field), column in columns.items():
        if joint in index:
            values[:, _FIELDS.index(field), index[joint]] = table[:, column]
    times = table[:, head.index('time')]
    seen = dict.fromkeys(joint for joint, _ in columns)
    return _recording(str(path), times, values, joint_names, seen)


def _columns(
    path: Path, head: list[str], joint_names: Sequence[str]
) -> dict[tuple[str, str], int]:
    """Find which column holds what of which joint; what is neither is ignored."""
    if 'time' not in head:
        raise RecordingError(f'{path}: {explain_missing_time(head, joint_names, _FIELDS)}')
    columns: dict[tuple[str, str], int] = {}
    for k, name in enumerate(head):
        joint, _, field = (name, '', _FIELDS[0]) if name in joint_names else name.rpartition('.')
        if not joint or field not in _FIELDS:
            continue
        if (joint, field) in columns:
            raise RecordingError(f"{path}: has the {field} of joint '{joint}' twice")
        columns[joint, field] = k
    return columns


def _numbers(path: Path, line: int, row: list[str], head: list[str]) -> list[float]:
    """Read one row; empty cells are NaN."""
    if len(row) != len(head):
        raise RecordingError(
            f'{path}: line {line} has {len(row)} values, the header {len(head)} columns'
        )
    try:
        return [float(cell) if cell.strip() else np.nan for cell in row]
    except ValueError:
        for cell, name in zip(row, head, strict=True):
            try:
                float(cell or 'nan')
            except ValueError:
                raise RecordingError(
                    f"{path}: line {line}, column '{name}': '{cell}' is not a number"
                ) from None
        raise
