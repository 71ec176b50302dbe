"""Reads rosbag2 recordings and CSV files with joint data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import csv
from itertools import chain, takewhile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import RecordingError
from ...robot.model import Floats

BAG_SUFFIXES = ('.mcap', '.db3')
JOINT_STATE = 'sensor_msgs/msg/JointState'
JOINT_TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'
_PROGRESS_INTERVAL = 200  # messages


# ---- rosbag2 -------------------------------------------------------------------------------


class Bag:
    """An open rosbag2 folder or file, with the message types of all topics."""

    def __init__(self, path: Path, reader: Any) -> None:
        self.path = path
        self.types: dict[str, str] = {c.topic: c.msgtype for c in reader.connections}
        self._reader = reader

    def find_topic(self, name: str) -> str | None:
        """Return the full name of a topic, or None if not found; outer slashes are optional."""
        matches = (topic for topic in self.types if topic.strip('/') == name.strip('/'))
        return next(matches, None)

    def message_count(self, topic: str) -> int:
        """Return the number of messages of a topic."""
        return sum(c.msgcount for c in self._connections(topic))

    def messages(
        self, topic: str, progress: Callable[[float], None] = lambda fraction: None
    ) -> Iterator[tuple[int, Any]]:
        """
        Yield the recording time [ns] and the content of each message of a topic, in order.

        `topic` is a full name. `progress` is called regularly with the fraction read so far, 0 to
        1. Raise RecordingError if the recording is damaged.
        """
        count = max(1, self.message_count(topic))
        connections = self._connections(topic)
        try:
            received = self._reader.messages(connections=connections)
            for k, (connection, time, data) in enumerate(received):
                if k % _PROGRESS_INTERVAL == 0:
                    progress(k / count)
                yield time, self._reader.deserialize(data, connection.msgtype)
        except Exception as error:  # decoders raise various exceptions for damaged data
            raise _damaged(self.path, error) from None
        progress(1.0)

    def _connections(self, topic: str) -> list[Any]:
        """List the connections of a topic, one for each publisher."""
        return [c for c in self._reader.connections if c.topic == topic]


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """
    Open a rosbag2 folder, or an .mcap or .db3 file, without ROS.

    Raise RecordingError if the file cannot be read, or if the folder has no metadata.yaml.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import get_typestore, Stores

    if path.is_dir() and not (path / 'metadata.yaml').exists():
        files = sorted(file.name for file in path.iterdir() if file.suffix in BAG_SUFFIXES)
        hint = f', or one of these files: {", ".join(files)}' if files else ''
        raise RecordingError(f'{path}: has no metadata.yaml, expected a rosbag2 folder{hint}')
    try:
        # Bags recorded before ROS 2 Iron contain no message definitions.
        types = get_typestore(Stores.ROS2_JAZZY)
        reader = AnyReader([path], default_typestore=types)
        reader.open()
    except (AnyReaderError, OSError) as error:
        raise RecordingError(f'{path}: cannot be read as a rosbag2 recording: {error}') from None
    except Exception as error:  # decoders raise various exceptions for damaged data
        raise _damaged(path, error) from None
    try:
        yield Bag(path, reader)
    finally:
        reader.close()


def _damaged(path: Path, error: Exception) -> RecordingError:
    return RecordingError(f'{path}: is damaged or incomplete ({type(error).__name__}: {error})')


# ---- CSV -----------------------------------------------------------------------------------


class CsvRecording(NamedTuple):
    """Joint data in the k rows of a CSV file."""

    times: Floats
    """Column `time`, shape (k,) [s]."""
    columns: dict[tuple[str, str], Floats]
    """One column of shape (k,) for each joint and quantity."""
    others: tuple[str, ...]
    """Names of all other columns."""


def read_csv(
    path: Path, joint_names: Sequence[str], quantities: Sequence[str], allow_empty: bool = False
) -> CsvRecording:
    """
    Read a CSV file with a column `time` and columns `<joint>.<quantity>`.

    A column `<joint>` contains the first of `quantities`, such as 'position'. Columns of other
    joints are permitted. Files that PlotJuggler exports, and JointState messages as `ros2 topic
    echo --csv` prints them, are read, too. With `allow_empty`, empty cells become NaN, and rows
    without any value of these joints are left out. Raise RecordingError if the column `time` is
    missing or if a cell is not a number. Raise OSError if the file cannot be opened.
    """
    try:
        with path.open(newline='', encoding='utf-8-sig') as file:
            rows = csv.reader(file)
            filled: Iterator[tuple[int, list[str]]] = (
                (rows.line_num, row) for row in rows if any(map(str.strip, row))
            )
            line, row = next(filled, (1, []))
            first = [cell.strip() for cell in row]
            if not first:
                raise RecordingError(f'{path}: has no rows')
            if first[0].isdecimal():
                header, filled = _echoed(path, chain([(line, row)], filled))
            else:
                header = [_plain(name, joint_names, quantities) for name in first]
            if 'time' not in header:
                problem = _missing_time(header, joint_names, quantities)
                raise RecordingError(f'{path}: {problem}')
            if header.count('time') > 1:
                raise RecordingError(
                    f"{path}: has {header.count('time')} columns 'time', expected one"
                )
            rows_of_numbers = (
                _numbers(f'{path}: line {line}', row, header, allow_empty) for line, row in filled
            )
            # Rows of Python floats would need four times the memory.
            values = np.fromiter(chain.from_iterable(rows_of_numbers), float)
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f'{path}: is not a CSV file ({error})') from None
    values = values.reshape(-1, len(header))
    columns: dict[tuple[str, str], Floats] = {}
    others = []
    for k, name in enumerate(header):
        joint, _, quantity = name.rpartition('.')
        if name in joint_names:
            joint, quantity = name, quantities[0]
        if not joint or quantity not in quantities:
            others += [name] if name != 'time' else []
        elif (joint, quantity) in columns:
            raise RecordingError(f"{path}: two columns contain the {quantity} of joint '{joint}'")
        else:
            columns[joint, quantity] = values[:, k]
    times = values[:, header.index('time')]
    known = [column for (joint, _), column in columns.items() if joint in joint_names]
    if allow_empty and known:
        # PlotJuggler also writes a row for each time at which only other topics have values.
        is_used = np.any(np.isfinite(known), axis=0)
        times, columns = times[is_used], {key: each[is_used] for key, each in columns.items()}
    return CsvRecording(times, columns, tuple(others))


def _plain(name: str, joint_names: Sequence[str], quantities: Sequence[str]) -> str:
    """Convert a name of PlotJuggler, such as `/joint_states/<joint>/position`."""
    if name == '__time':
        return 'time'
    rest, _, quantity = name.rpartition('/')
    if quantity not in quantities:
        return name
    known = (joint for joint in joint_names if f'/{rest}'.endswith(f'/{joint}'))
    return f'{next(known, rest.rpartition("/")[2])}.{quantity}'


def _echoed(
    path: Path, rows: Iterator[tuple[int, list[str]]]
) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """
    Convert JointState messages as `ros2 topic echo --csv` prints them; return header and rows.

    A row contains the stamp, the frame, the names, and all positions, velocities and efforts. An
    empty list is one empty cell.
    """

    def converted() -> Iterator[tuple[list[str], list[str], int]]:
        for line, row in rows:
            names = list(takewhile(_is_name, row[3:]))
            header, cells, rest = ['time'], [''], row[3 + len(names) :]
            for quantity in ('position', 'velocity', 'effort'):
                count = 0 if rest[:1] == [''] else len(names)
                header += [f'{name}.{quantity}' for name in names[:count]]
                cells, rest = cells + rest[:count], rest[max(1, count) :]
            if not names or rest or len(cells) != len(header):
                raise RecordingError(
                    f"{path}: line {line} is neither a header with the column 'time' nor a "
                    'JointState of `ros2 topic echo --csv --full-length`'
                )
            cells[0] = f'{row[0]}.{row[1]:0>9}'
            yield header, cells, line

    messages = converted()
    header, cells, line = next(messages)

    def same_columns() -> Iterator[tuple[int, list[str]]]:
        yield line, cells
        for other, row, number in messages:
            if other != header:
                raise RecordingError(
                    f'{path}: line {number} has other joints or values than the first line; '
                    'record the messages of one publisher'
                )
            yield number, row

    return header, same_columns()


def _is_name(cell: str) -> bool:
    """Return whether a cell contains neither a number nor nothing."""
    try:
        float(cell)
    except ValueError:
        return cell.strip() not in ('', '...')
    return False


def _numbers(where: str, row: list[str], header: list[str], allow_empty: bool) -> list[float]:
    if len(row) != len(header):
        raise RecordingError(
            f'{where} has {len(row)} values, but the header has {len(header)} columns'
        )
    try:
        return list(map(float, row))  # fast, and nearly always sufficient
    except ValueError:
        numbers = []
    for cell, name in zip(row, header, strict=True):
        try:
            numbers.append(np.nan if allow_empty and not cell.strip() else float(cell))
        except ValueError:
            raise RecordingError(f"{where}, column '{name}': '{cell}' is not a number") from None
    return numbers


def _missing_time(
    header: Sequence[str], joint_names: Sequence[str], quantities: Sequence[str]
) -> str:
    """Return an error message that lists the actual and the expected columns."""
    problem, found = "has no column 'time'", list(header)
    separator = next((mark for mark in ';\t' if len(header) == 1 and mark in header[0]), None)
    if separator:
        name = 'tabs' if separator == '\t' else f"'{separator}'"
        problem = f"cells are separated by {name}, expected ','"
        found = [cell.strip() for cell in header[0].split(separator)]
    first, *others = quantities
    columns = [f"'<joint>' or '<joint>.{first}'", *(f"'<joint>.{each}'" for each in others)]
    return (
        f"{problem}; the columns are {', '.join(found)}; expected 'time' [s] and, for each "
        f'joint, {", ".join(columns)}; the joints are {", ".join(joint_names)}'
    )
