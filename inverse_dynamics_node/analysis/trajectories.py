"""Trajectories from files: YAML as ROS 2 prints it, CSV, recordings of ROS 2."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
import csv
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.trajectory import Trajectory
from ..errors import TrajectoryError
from ..robot.model import Floats
from .csv_header import explain_missing_time

FORMATS = """\
trajectory files:
  .yaml .yml .json  a trajectory_msgs/JointTrajectory as `ros2 topic echo --full-length` prints it:
              joint_names, and points with positions, maybe velocities and accelerations, and
              time_from_start (sec and nanosec, or a number of seconds). Or plain lists:
              joint_names: [a, b]
              times: [0.0, 0.5]
              positions: [[0.0, 0.1], [0.2, 0.3]]    maybe velocities, accelerations
  .csv        a row of names, then a row of numbers for each time. The column `time` [s]; a column
              `<joint>` or `<joint>.position` for each joint [rad, m]; maybe `<joint>.velocity` and
              `<joint>.acceleration`; other columns are ignored
  a rosbag2   .mcap, .db3 or the directory: the JointTrajectory with the most points; if all have
              one point or there is none, all JointStates of /joint_states, or of the only such
              topic. --topic chooses another one"""

_KINDS = ('trajectory_msgs/msg/JointTrajectory', 'sensor_msgs/msg/JointState')
USUAL = '/joint_states'
"""The topic to take where there are several."""
_INNER = ('trajectory', 'joint_trajectory', 'goal')
_DERIVATIVES = ('velocities', 'accelerations')


class Source(NamedTuple):
    """A trajectory as it was found, and what to know about it."""

    trajectory: Trajectory
    remarks: tuple[str, ...] = ()


def read_trajectory(
    path: Path,
    known: Sequence[str],
    topic: str | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Source:
    """
    Read a trajectory, in whichever of the `FORMATS` it is.

    Parameters
    ----------
    path : Path
        A file, or the directory of a recording.
    known : sequence of str
        The robot's joints; joints that a measured state or a table names besides are left out.
    topic : str, optional
        The topic of a recording.
    progress : callable
        Is told the share that is read, 0 to 1.

    Returns
    -------
    source : Source

    Raises
    ------
    TrajectoryError
        If it holds no trajectory, or one that is not whole.
    OSError
        If it cannot be read.

    """
    if path.is_dir() or path.suffix in ('.mcap', '.db3'):
        return _from_recording(path, known, topic, progress)
    try:
        text = path.read_text(encoding='utf-8-sig')
    except UnicodeDecodeError:
        kinds = '.yaml, .json, .csv, .mcap or .db3'
        raise TrajectoryError(f'{path}: no text, expected {kinds}') from None
    try:
        if path.suffix == '.csv':
            return _from_csv(text, known)
        return _from_yaml(text)
    except TrajectoryError as error:
        raise TrajectoryError(f'{path}: {error}') from None


# ---- YAML ----------------------------------------------------------------------------------


def _from_yaml(text: str) -> Source:
    import yaml

    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)  # ten times as fast, where it is built
    try:
        documents = [each for each in yaml.load_all(text, loader) if each is not None]
    except yaml.YAMLError as error:
        raise TrajectoryError(f'not valid YAML: {" ".join(str(error).split())}') from None
    found = [each for each in map(_unwrapped, documents) if each is not None]
    if not found:
        raise TrajectoryError('no trajectory, expected joint_names and points')
    remarks = (f'the first of {len(found)} trajectories',) if len(found) > 1 else ()
    if 'points' in found[0]:
        trajectory, more = _of_points(found[0]['joint_names'], found[0]['points'])
        return Source(trajectory, remarks + more)
    return Source(_of_lists(found[0]), remarks)


def _unwrapped(document: Any) -> dict[str, Any] | None:
    """Find the trajectory in a message that holds one: an action's goal, a planner's answer."""
    while isinstance(document, dict) and 'joint_names' not in document:
        document = next((document[name] for name in _INNER if name in document), None)
    is_whole = isinstance(document, dict) and ('points' in document or 'positions' in document)
    return document if is_whole else None


def _of_points(names: Any, points: Any) -> tuple[Trajectory, tuple[str, ...]]:
    joints = _names(names)
    if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
        raise TrajectoryError("points are no list of points; with '...' in it, print them whole: "
                              'ros2 topic echo --full-length')  # fmt: skip
    times = [_seconds(point.get('time_from_start'), i) for i, point in enumerate(points)]
    rows: dict[str, list[Floats]] = {}
    for what in ('positions', *_DERIVATIVES):
        rows[what] = [
            _numbers(point[what], len(joints), f'{what} of point {i}')
            for i, point in enumerate(points)
            if point.get(what)
        ]
    if len(rows['positions']) < len(points):
        raise TrajectoryError(f'{len(points) - len(rows["positions"])} points have no positions')
    remarks = tuple(
        f'only {len(rows[what])} of {len(points)} points have {what}: not used'
        for what in _DERIVATIVES
        if 0 < len(rows[what]) < len(points)
    )
    given = [np.array(rows[w]) if len(rows[w]) == len(points) else None for w in _DERIVATIVES]
    positions = np.array(rows['positions']).reshape(len(points), len(joints))
    return Trajectory(joints, np.array(times, float), positions, *given), remarks


def _of_lists(document: dict[str, Any]) -> Trajectory:
    joints = _names(document['joint_names'])
    if not isinstance(document.get('times'), list):
        raise TrajectoryError('no list of times [s]')
    times = _numbers(document['times'], len(document['times']), 'times')
    arrays: list[Floats | None] = []
    for what in ('positions', *_DERIVATIVES):
        rows = document.get(what) or []
        if not rows:
            arrays.append(None)
            continue
        if not isinstance(rows, list) or len(rows) != len(times):
            raise TrajectoryError(f'{what}: expected {len(times)} lists, one for each time')
        arrays.append(
            np.array([_numbers(r, len(joints), f'{what}[{i}]') for i, r in enumerate(rows)])
        )
    if arrays[0] is None:
        raise TrajectoryError('no positions')
    return Trajectory(joints, times, arrays[0], *arrays[1:])


def _names(names: Any) -> tuple[str, ...]:
    if not isinstance(names, list) or not names:
        raise TrajectoryError(f'joint_names is {names!r}, expected a list of names')
    return tuple(map(str, names))


def _seconds(time: Any, point: int) -> float:
    if isinstance(time, dict):
        parts = time.get('sec', 0), time.get('nanosec', 0)
        if set(time) <= {'sec', 'nanosec'} and all(isinstance(part, int) for part in parts):
            return float(parts[0] + 1e-9 * parts[1])
    elif isinstance(time, (int, float)) and not isinstance(time, bool):
        return float(time)
    raise TrajectoryError(
        f'time_from_start of point {point} is {time!r}, expected sec and nanosec, or seconds'
    )


def _numbers(values: Any, count: int, what: str) -> Floats:
    hint = ''
    if isinstance(values, str) or (isinstance(values, list) and '...' in values):
        hint = '; print it whole: ros2 topic echo --full-length'
    if not isinstance(values, list) or len(values) != count:
        found = len(values) if isinstance(values, list) else repr(values)
        raise TrajectoryError(f'{what}: expected {count} numbers, got {found}{hint}')
    try:
        return np.array([float(value) for value in values])
    except (TypeError, ValueError) as error:
        raise TrajectoryError(f'{what}: {error}{hint}') from None


# ---- CSV -----------------------------------------------------------------------------------


def _from_csv(text: str, known: Sequence[str]) -> Source:
    rows = [row for row in csv.reader(text.splitlines()) if any(cell.strip() for cell in row)]
    if not rows:
        raise TrajectoryError('no rows')
    header = [cell.strip() for cell in rows[0]]
    if 'time' not in header:
        fields = ('position', 'velocity', 'acceleration')
        raise TrajectoryError(explain_missing_time(header, known, fields))
    header = [name.removesuffix('.position') for name in header]
    joints = tuple(name for name in header if name in known)
    if not joints:
        raise TrajectoryError(
            f'no column is named as a joint; the columns are {", ".join(header)}, the joints '
            f'{", ".join(known)}'
        )
    ends = ('.velocity', '.acceleration', '.effort')
    lost = [n for n in known if n not in header and any(n + end in header for end in ends)]
    if lost:
        raise TrajectoryError(
            f"joint '{lost[0]}' has no column of positions; expected '{lost[0]}' or "
            f"'{lost[0]}.position'"
        )
    twice = [name for name, count in Counter(header).items() if count > 1]
    if twice:
        raise TrajectoryError(f"two columns are named '{twice[0]}'")
    table = np.array([_row(row, header, line) for line, row in enumerate(rows[1:], 2)])
    table = table.reshape(-1, len(header))

    def columns(suffix: str) -> Floats | None:
        wanted = [name + suffix for name in joints]
        if not all(name in header for name in wanted):
            return None
        return table[:, [header.index(name) for name in wanted]]

    used = {'time', *(name + end for name in joints for end in ('', '.velocity', '.acceleration'))}
    ignored = [name for name in header if name not in used]
    remarks = (f'columns not used: {", ".join(ignored)}',) if ignored else ()
    positions = columns('')
    assert positions is not None
    return Source(
        Trajectory(
            joints,
            table[:, header.index('time')],
            positions,
            columns('.velocity'),
            columns('.acceleration'),
        ),
        remarks,
    )


def _row(row: list[str], header: list[str], line: int) -> list[float]:
    if len(row) != len(header):
        raise TrajectoryError(f'row {line} has {len(row)} cells, expected {len(header)}')
    values = []
    for name, cell in zip(header, row, strict=True):
        try:
            values.append(float(cell))
        except ValueError:
            raise TrajectoryError(f"row {line}, column '{name}': {cell!r} is no number") from None
    return values


# ---- Recordings ----------------------------------------------------------------------------


def _from_recording(
    path: Path, known: Sequence[str], topic: str | None, progress: Callable[[float], None]
) -> Source:
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import get_typestore, Stores

    # Recordings in SQLite from before Jazzy do not tell what their messages look like.
    types = get_typestore(Stores.ROS2_JAZZY)
    try:
        with AnyReader([path], default_typestore=types) as reader:
            usable = _usable(path, reader.connections, topic)
            planned = [each for each in usable if each.msgtype == _KINDS[0]]
            measured = [each for each in usable if each.msgtype == _KINDS[1]]
            found = _longest_trajectories(reader, planned, progress)
            is_single = all(len(each.message.points) == 1 for each in found)
            if measured and is_single:
                connection = _choose(path, measured)
                messages = _messages(reader, connection, progress)
                source = _of_states(path, messages, known)
                topics = ', '.join(each.topic for each in found)
                skipped = (f'not used, single points only: {topics}',) if found else ()
                remarks = (f'topic {connection.topic}', *source.remarks, *skipped)
                return source._replace(remarks=remarks)
            if not found:
                raise TrajectoryError(f'{path}: every trajectory in it is empty')
            source = _of_messages(found)
            others = {c.topic for c in reader.connections if c.msgtype in _KINDS}
            others -= {each.topic for each in found}
            if is_single and others:
                hint = f'a single point; --topic may be one of {", ".join(sorted(others))}'
                source = source._replace(remarks=(*source.remarks, hint))
            return source
    except AnyReaderError as error:
        raise TrajectoryError(f'{path}: {error}') from None


def _usable(path: Path, connections: Sequence[Any], topic: str | None) -> list[Any]:
    """List the connections with trajectories or joint states, of one topic if it is given."""
    usable = [each for each in connections if each.msgtype in _KINDS and each.msgcount]
    listed = ', '.join(f'{each.topic} ({each.msgtype})' for each in connections) or 'none'
    if topic is not None:
        usable = [each for each in usable if each.topic.strip('/') == topic.strip('/')]
        if not usable:
            raise TrajectoryError(
                f"{path}: no trajectory or joint state on topic '{topic}'; topics are {listed}"
            )
    if not usable:
        raise TrajectoryError(
            f'{path}: neither JointTrajectory nor JointState messages; topics are {listed}'
        )
    return usable


def _choose(path: Path, connections: Sequence[Any]) -> Any:
    """Return the usual topic of joint states, or the only one."""
    topics = {each.topic: each for each in connections}
    if USUAL in topics:
        return topics[USUAL]
    if len(topics) > 1:
        raise TrajectoryError(f'{path}: which --topic? There are {", ".join(topics)}')
    return next(iter(topics.values()))


def _messages(
    reader: Any, connection: Any, progress: Callable[[float], None]
) -> Iterator[tuple[float, Any]]:
    """Yield the messages of a topic, with the times at which they were recorded [s]."""
    wanted = [each for each in reader.connections if each.topic == connection.topic]
    count = sum(each.msgcount for each in wanted) or 1
    for k, (each, time, data) in enumerate(reader.messages(connections=wanted), 1):
        yield 1e-9 * time, reader.deserialize(data, each.msgtype)
        if k % 100 == 0:
            progress(k / count)


class _Longest(NamedTuple):
    """The longest trajectory of a topic: the first of those with the most points."""

    topic: str
    message: Any
    number: int
    """Which message of the topic it is, from 1; without empty ones."""
    total: int
    """How many trajectories the topic has, without empty ones."""


def _longest_trajectories(
    reader: Any, connections: Sequence[Any], progress: Callable[[float], None]
) -> list[_Longest]:
    """Find the longest trajectory of each topic, the topic with the longest one first."""
    found: dict[str, _Longest] = {}
    # Two publishers of one topic are two connections.
    for topic, connection in {each.topic: each for each in connections}.items():
        for _, message in _messages(reader, connection, progress):
            if not len(message.points):
                continue
            best = found.get(topic, _Longest(topic, message, 1, 0))
            best = best._replace(total=best.total + 1)
            if len(message.points) > len(best.message.points):
                best = best._replace(message=message, number=best.total)
            found[topic] = best
    return sorted(found.values(), key=lambda each: len(each.message.points), reverse=True)


def _of_messages(found: Sequence[_Longest]) -> Source:
    """Convert the first of the trajectories, and name the others."""
    first = found[0]
    points = [
        {
            **{w: np.asarray(getattr(p, w)).tolist() for w in ('positions', *_DERIVATIVES)},
            'time_from_start': {
                'sec': int(p.time_from_start.sec),
                'nanosec': int(p.time_from_start.nanosec),
            },
        }
        for p in first.message.points
    ]
    remarks: tuple[str, ...] = (f'topic {first.topic}',)
    if first.total > 1:
        remarks = (f'topic {first.topic}: trajectory {first.number} of {first.total}',)
    if len(found) > 1:
        others = (f'{each.topic} ({_points(len(each.message.points))})' for each in found[1:])
        remarks += (f'other topics: {", ".join(others)}; choose with --topic',)
    trajectory, more = _of_points(list(first.message.joint_names), points)
    return Source(trajectory, remarks + more)


def _points(count: int) -> str:
    return f'{count} point{"" if count == 1 else "s"}'


def _of_states(path: Path, messages: Iterator[tuple[float, Any]], known: Sequence[str]) -> Source:
    """Line up the joint states of one publisher: of those with the names that come most often."""
    states: dict[tuple[str, ...], list[tuple[float, Any]]] = {}
    for time, message in messages:
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if len(message.position) == len(message.name):
            states.setdefault(tuple(message.name), []).append((stamp or time, message))
    ours = {names: found for names, found in states.items() if set(names) & set(known)}
    if not ours:
        named = ', '.join(sorted({name for names in states for name in names})) or 'no joint'
        raise TrajectoryError(f'{path}: its joint states tell nothing of the robot; of {named}')
    names, found = max(ours.items(), key=lambda item: len(item[1]))
    rising = [found[0]]
    for state in found[1:]:
        if state[0] > rising[-1][0]:
            rising.append(state)
    kept = [k for k, name in enumerate(names) if name in known]
    remarks = [f'{len(rising)} joint states']
    dropped = len(found) - len(rising)
    if dropped:
        remarks.append(f'{dropped} joint states left out: no later than the one before')
    unknown = [name for name in names if name not in known]
    if unknown:
        remarks.append(f'not joints of the robot: {", ".join(unknown)}')
    if len(ours) > 1:
        others = {name for other in ours if other != names for name in other}
        remarks.append(f'states of other publishers not used: of {", ".join(sorted(others))}')
    times = np.array([time for time, _ in rising])
    positions = np.array([np.asarray(m.position)[kept] for _, m in rising])
    has_velocities = all(len(m.velocity) == len(names) for _, m in rising)
    velocities = np.array([np.asarray(m.velocity)[kept] for _, m in rising]) if has_velocities \
        else None  # fmt: skip
    if velocities is not None and not np.isfinite(velocities).all():
        velocities = None
    joints = tuple(names[k] for k in kept)
    return Source(Trajectory(joints, times - times[0], positions, velocities), tuple(remarks))
