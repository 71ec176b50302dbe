"""Reads trajectories from YAML, CSV and rosbag2 files, and writes YAML and CSV files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
import csv
from pathlib import Path
import reprlib
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.trajectory import Trajectory
from ..errors import RecordingError, shortened, TrajectoryError
from ..robot.model import Floats
from .recordings.files import Bag, BAG_SUFFIXES, JOINT_STATE, JOINT_TRAJECTORY, open_bag, read_csv

FORMATS = """\
trajectory files:
  .yaml .yml .json  a trajectory_msgs/JointTrajectory as `ros2 topic echo --full-length` prints it:
              joint_names, and points with positions, optional velocities and accelerations, and
              time_from_start (sec and nanosec, or a number of seconds). Or plain lists:
              joint_names: [a, b]
              times: [0.0, 0.5]
              positions: [[0.0, 0.1], [0.2, 0.3]]    optional: velocities, accelerations
  .csv        a row of names, then a row of numbers for each time. Columns: `time` [s]; `<joint>`
              or `<joint>.position` for each joint [rad, m]; optional `<joint>.velocity` and
              `<joint>.acceleration`; other columns are ignored
  a rosbag2   .mcap, .db3 or the folder: the JointTrajectory with the most points. If no trajectory
              has more than one point, the JointStates of /joint_states, or of the only topic with
              joint states. --topic chooses another topic"""

LATEST_START = 1e5
"""Times are clock times if the first one exceeds this value [s] (a little over one day)."""
_FIELDS = ('positions', 'velocities', 'accelerations')
_QUANTITIES = ('position', 'velocity', 'acceleration')
_DIGITS = 9
"""Significant digits of written numbers."""
_DEFAULT_TOPIC = '/joint_states'
"""The topic to read if several topics have joint states."""
_ENCLOSING = ('trajectory', 'joint_trajectory', 'goal')
"""Names of fields that contain a trajectory in other messages."""
_DEEPEST = 20
"""Largest accepted nesting depth of a file. A trajectory in an action goal has six levels."""
_WHOLE_OUTPUT = 'print the whole message with `ros2 topic echo --full-length`'


class LoadedTrajectory(NamedTuple):
    """A trajectory read from a file."""

    trajectory: Trajectory
    notes: tuple[str, ...] = ()
    """Notes on the source of the trajectory and on ignored data."""


def read_trajectory(
    path: Path,
    joint_names: Sequence[str],
    topic: str | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> LoadedTrajectory:
    """
    Read a trajectory in any of the `FORMATS`.

    `path` is a file, or the folder of a recording. `topic` selects a topic of the recording. In
    CSV files and joint states, joints that are not in `joint_names` are ignored. `progress` is
    called regularly with the fraction read so far, 0 to 1. Raises TrajectoryError if the file
    contains no complete trajectory. Raises OSError if the file cannot be opened.

    """
    try:
        if path.is_dir() or path.suffix in BAG_SUFFIXES:
            with open_bag(path) as bag:
                trajectory, notes = _from_bag(bag, joint_names, topic, progress)
        elif path.suffix == '.csv':
            trajectory, notes = _from_csv(path, joint_names)
        else:
            trajectory, notes = _from_yaml(path.read_text(encoding='utf-8-sig'))
    except UnicodeDecodeError:
        kinds = '.yaml, .json, .csv, .mcap or .db3'
        raise TrajectoryError(
            f'{path}: is neither text nor a recording, expected {kinds}'
        ) from None
    except RecordingError as error:  # the message already contains the path
        raise TrajectoryError(str(error)) from None
    except TrajectoryError as error:
        raise TrajectoryError(f'{path}: {error}') from None
    times = trajectory.times
    if len(times) and LATEST_START < times[0] < np.inf:
        # Printed and written tables have too few digits for clock times.
        notes += (f'times are counted from the first point, which was at {times[0]:.3f} s',)
        trajectory = trajectory._replace(times=times - times[0])
    return LoadedTrajectory(trajectory, notes)


def write_table(path: Path, trajectory: Trajectory, efforts: Floats) -> None:
    """
    Write a CSV file that `read_trajectory` can read, with additional columns `<joint>.effort`.

    The trajectory must have velocities and accelerations. `efforts` has the shape (times, joints)
    [N m or N].

    """
    table = np.column_stack([trajectory.times, *_arrays(trajectory), efforts])
    endings = ('', '.velocity', '.acceleration', '.effort')
    header = [name + ending for ending in endings for name in trajectory.joint_names]
    with path.open('w', newline='', encoding='utf-8') as file:
        csv.writer(file).writerow(['time', *header])
        np.savetxt(file, table, f'%.{_DIGITS}g', ',', '\r\n')  # line ends as in the csv module


def write_trajectory(path: Path, trajectory: Trajectory, efforts: Floats | None = None) -> None:
    """
    Write a trajectory_msgs/JointTrajectory as YAML that `ros2 topic pub` accepts.

    The trajectory must have velocities and accelerations. `efforts` has the shape (times, joints)
    [N m or N]. A controller without an effort interface rejects a trajectory with efforts.

    """
    import yaml

    fields, arrays = [*_FIELDS], _arrays(trajectory)
    if efforts is not None:
        fields.append('effort')
        arrays.append(efforts)
    names = {'joint_names': list(trajectory.joint_names)}
    with path.open('w', encoding='utf-8') as file:
        yaml.safe_dump(names, file, default_flow_style=None, width=10**6)
        file.write('points:\n')  # PyYAML would be a hundred times slower
        for time, *rows in zip(trajectory.times, *arrays, strict=True):
            sec, nanosec = divmod(round(1e9 * float(time)), 10**9)
            lines = [f'{field}: {_plain(row)}' for field, row in zip(fields, rows, strict=True)]
            lines.append(f'time_from_start: {{sec: {sec}, nanosec: {nanosec}}}')
            file.write('- ' + '\n  '.join(lines) + '\n')


def _arrays(trajectory: Trajectory) -> list[Floats]:
    assert trajectory.velocities is not None
    assert trajectory.accelerations is not None
    return [trajectory.positions, trajectory.velocities, trajectory.accelerations]


def _plain(row: Floats) -> str:
    """Format a row as a YAML 1.1 list, in which numbers with exponents need a decimal point."""
    numbers = (repr(float(f'{x:.{_DIGITS}g}') + 0.0) for x in row)
    points = (x if '.' in x else x.replace('e', '.0e') for x in numbers)
    return f'[{", ".join(points)}]'


# ---- YAML ----------------------------------------------------------------------------------


def _from_yaml(text: str) -> LoadedTrajectory:
    """Read the first trajectory in a YAML text."""
    import yaml

    try:
        documents = [_unwrapped(document) for document in _documents(text)]
    except yaml.YAMLError as error:
        raise TrajectoryError(f'not valid YAML: {" ".join(str(error).split())}') from None
    found = [document for document in documents if document is not None]
    if not found:
        raise TrajectoryError('no trajectory, expected joint_names and points')
    times, rows = _points(found[0]['points']) if 'points' in found[0] else _lists(found[0])
    trajectory, notes = _trajectory(found[0]['joint_names'], times, rows)
    if len(found) > 1:
        notes = (f'only the first of {len(found)} trajectories is used', *notes)
    return LoadedTrajectory(trajectory, notes)


def _documents(text: str) -> Iterator[Any]:
    """
    Yield the documents of a YAML text as lists, dicts and strings.

    Unlike the loaders of PyYAML, this parser neither recurses nor converts values. Therefore, a
    file cannot exhaust the stack or create other objects, and numbers remain strings. The parser
    is also several times faster than the loaders.

    """
    import yaml

    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)  # ten times as fast, if available
    opened: list[tuple[Any, str | None, list[Any]]] = []  # kind of event, anchor, content
    anchors: dict[str, Any] = {}
    content: list[Any] = []
    for event in yaml.parse(text, loader):
        if isinstance(event, yaml.ScalarEvent):
            value, anchor = event.value, event.anchor
        elif isinstance(event, yaml.CollectionStartEvent):
            if len(opened) == _DEEPEST:
                line = event.start_mark.line + 1
                raise TrajectoryError(
                    f'line {line}: lists are nested more than {_DEEPEST} levels deep'
                )
            opened.append((type(event), event.anchor, content))
            content = []
            continue
        elif isinstance(event, yaml.CollectionEndEvent):
            kind, anchor, outer = opened.pop()
            value, content = content, outer
            if kind is yaml.MappingStartEvent:
                names = (name if isinstance(name, str) else '' for name in value[::2])
                value = dict(zip(names, value[1::2], strict=True))
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor not in anchors:  # this also happens if a list contains itself
                line = event.start_mark.line + 1
                raise TrajectoryError(
                    f'line {line}: alias *{event.anchor} is used before it is defined'
                )
            value, anchor = anchors[event.anchor], None
        elif isinstance(event, yaml.DocumentEndEvent):
            yield from content
            content, anchors = [], {}
            continue
        else:
            continue
        if anchor:
            anchors[anchor] = value
        content.append(value)


def _unwrapped(document: Any) -> dict[str, Any] | None:
    """Return the trajectory in a document such as an action goal, or None if it is absent."""
    while isinstance(document, dict) and 'joint_names' not in document:
        document = next((document[name] for name in _ENCLOSING if name in document), None)
    is_complete = isinstance(document, dict) and ('points' in document or 'positions' in document)
    return document if is_complete else None


def _points(points: Any) -> tuple[list[float], dict[str, list[Any]]]:
    """Return the times, positions, velocities and accelerations of the points."""
    if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
        raise TrajectoryError(
            f'points is not a list of points; if it contains "...", {_WHOLE_OUTPUT}'
        )
    times = [_seconds(point.get('time_from_start'), i) for i, point in enumerate(points)]
    return times, {field: [point.get(field) for point in points] for field in _FIELDS}


def _lists(document: dict[str, Any]) -> tuple[Floats, dict[str, list[Any]]]:
    """Do the same as `_points`, but for a document that contains plain lists."""
    if not isinstance(document.get('times'), list):
        raise TrajectoryError('no list of times; expected times [s], joint_names and positions')
    times = _numbers(document['times'], len(document['times']), 'times')
    rows: dict[str, list[Any]] = dict.fromkeys(_FIELDS, [None] * len(times))
    for field in _FIELDS:
        given = document.get(field)
        if _is_given(given):
            if not isinstance(given, list) or len(given) != len(times):
                raise TrajectoryError(f'{field}: expected {len(times)} lists, one for each time')
            rows[field] = given
    return times, rows


def _trajectory(names: Any, times: Any, rows: dict[str, list[Any]]) -> LoadedTrajectory:
    """Check the joint names and rows of values, and build a trajectory."""
    if not isinstance(names, list) or not names or not all(isinstance(x, str) for x in names):
        raise TrajectoryError(f'joint_names is {_short(names)}, expected a list of names')
    arrays: list[Any] = []
    notes = []
    for field in _FIELDS:
        given = [
            _numbers(row, len(names), f'{field} of point {i}')
            for i, row in enumerate(rows[field])
            if _is_given(row)
        ]
        is_complete = len(given) == len(times)
        if field == 'positions' and not is_complete:
            raise TrajectoryError(
                f'positions are missing at {len(times) - len(given)} of {len(times)} points'
            )
        if given and not is_complete:
            notes.append(
                f'{field} are not used, because only {len(given)} of {len(times)} points have them'
            )
        arrays.append(np.array(given).reshape(-1, len(names)) if is_complete else None)
    trajectory = Trajectory(tuple(names), np.array(times, float), *arrays)
    return LoadedTrajectory(trajectory, tuple(notes))


def _is_given(values: Any) -> bool:
    return bool(values) and values not in ('~', 'null')


def _seconds(time: Any, point: int) -> float:
    try:
        if not isinstance(time, dict):
            return float(time)
        if set(time) <= {'sec', 'nanosec'}:
            return float(time.get('sec', 0)) + 1e-9 * float(time.get('nanosec', 0))
    except (TypeError, ValueError):
        pass
    raise TrajectoryError(
        f'time_from_start of point {point} is {_short(time)}, expected sec and nanosec, or a '
        'number of seconds'
    )


def _numbers(values: Any, count: int, where: str) -> Floats:
    is_list = isinstance(values, list)
    hint = f'; {_WHOLE_OUTPUT}' if not is_list or '...' in values else ''
    if not is_list or len(values) != count:
        found = len(values) if is_list else _short(values)
        raise TrajectoryError(f'{where}: expected {count} numbers, got {found}{hint}')
    try:
        return np.array([float(value) for value in values])
    except TypeError:
        raise TrajectoryError(f'{where} contain a list, expected numbers{hint}') from None
    except ValueError as error:
        raise TrajectoryError(f'{where}: {shortened(str(error), 100)}{hint}') from None


def _short(value: Any) -> str:
    return shortened(reprlib.repr(value))


# ---- CSV -----------------------------------------------------------------------------------


def _from_csv(path: Path, joint_names: Sequence[str]) -> LoadedTrajectory:
    times, columns, others = read_csv(path, joint_names, _QUANTITIES)
    names = [*(f'{joint}.{quantity}' for joint, quantity in columns), *others]
    joints = [joint for joint, kind in columns if kind == 'position' and joint in joint_names]
    if not joints:
        raise TrajectoryError(
            'no column contains positions of a joint of this robot; the columns are '
            f'{", ".join(["time", *names])}; the joints are {", ".join(joint_names)}'
        )
    for name in joint_names:
        if name not in joints and any(f'{name}.{q}' in names for q in (*_QUANTITIES, 'effort')):
            raise TrajectoryError(
                f"joint '{name}' has no position column; expected '{name}' or '{name}.position'"
            )
    complete = [q for q in _QUANTITIES if all((joint, q) in columns for joint in joints)]
    arrays: list[Any] = [
        np.stack([columns[joint, q] for joint in joints], axis=1) if q in complete else None
        for q in _QUANTITIES
    ]
    unused = [f'{j}.{q}' for j, q in columns if j not in joints or q not in complete]
    unused += others
    notes = (f'columns not used: {", ".join(unused)}',) if unused else ()
    return LoadedTrajectory(Trajectory(tuple(joints), times, *arrays), notes)


# ---- rosbag2 -------------------------------------------------------------------------------


class _Longest(NamedTuple):
    """The trajectory with the most points on a topic."""

    topic: str
    message: Any
    number: int
    """Index among the non-empty trajectories on the topic, starting at 1."""
    total: int
    """Number of non-empty trajectories on the topic."""


def _from_bag(
    bag: Bag, joint_names: Sequence[str], topic: str | None, progress: Callable[[float], None]
) -> LoadedTrajectory:
    topics = _topics_with_data(bag, topic)
    planned = [name for name in topics if bag.types[name] == JOINT_TRAJECTORY]
    measured = [name for name in topics if bag.types[name] == JOINT_STATE]
    found = _longest_trajectories(bag, planned, progress)
    is_single = all(len(each.message.points) == 1 for each in found)
    if measured and is_single:
        chosen = _DEFAULT_TOPIC if _DEFAULT_TOPIC in measured else measured[0]
        if len(measured) > 1 and chosen != _DEFAULT_TOPIC:
            several = ', '.join(measured)
            raise TrajectoryError(
                f'several topics have joint states: {several}; choose one with --topic'
            )
        trajectory, notes = _from_states(bag.messages(chosen, progress), joint_names)
        skipped = ', '.join(each.topic for each in found)
        if found:
            notes += (f'topics whose trajectories have a single point are not used: {skipped}',)
        return LoadedTrajectory(trajectory, (f'topic {chosen}', *notes))
    if not found:
        raise TrajectoryError('all trajectories in the recording are empty')
    trajectory, notes = _from_trajectories(found)
    others = {name for name, kind in bag.types.items() if kind in (JOINT_TRAJECTORY, JOINT_STATE)}
    others -= {each.topic for each in found}
    if is_single and others:
        notes += (
            'the trajectory has a single point; --topic can select other topics: '
            f'{", ".join(sorted(others))}',
        )
    return LoadedTrajectory(trajectory, notes)


def _topics_with_data(bag: Bag, requested: str | None) -> list[str]:
    """List the topics with trajectories or joint states, or only the requested topic."""
    topics = [
        name
        for name, kind in bag.types.items()
        if kind in (JOINT_TRAJECTORY, JOINT_STATE) and bag.message_count(name)
    ]
    listed = ', '.join(f'{name} ({kind})' for name, kind in bag.types.items()) or 'none'
    if requested is not None:
        topic = bag.find_topic(requested)
        if topic not in topics:
            raise TrajectoryError(
                f"no trajectory or joint state on topic '{requested}'; topics: {listed}"
            )
        return [topic]
    if not topics:
        raise TrajectoryError(f'no JointTrajectory or JointState messages; topics: {listed}')
    return topics


def _longest_trajectories(
    bag: Bag, topics: Sequence[str], progress: Callable[[float], None]
) -> list[_Longest]:
    """Return the trajectory with the most points on each topic, most points first."""
    found: list[_Longest] = []
    for topic in topics:
        longest, number, total = None, 0, 0
        for _, message in bag.messages(topic, progress):
            total += len(message.points) > 0
            if len(message.points) > (len(longest.points) if longest else 0):
                longest, number = message, total
        if longest:
            found.append(_Longest(topic, longest, number, total))
    return sorted(found, key=lambda each: len(each.message.points), reverse=True)


def _from_trajectories(found: Sequence[_Longest]) -> LoadedTrajectory:
    """Convert the first trajectory, and list the topics of the others in the notes."""
    first = found[0]
    points = first.message.points
    durations = [point.time_from_start for point in points]
    times = [float(each.sec) + 1e-9 * float(each.nanosec) for each in durations]
    rows = {
        field: [np.asarray(getattr(point, field)).tolist() for point in points]
        for field in _FIELDS
    }
    trajectory, more = _trajectory(list(first.message.joint_names), times, rows)
    note = f'topic {first.topic}'
    if first.total > 1:
        note += f': trajectory {first.number} of {first.total}'
    notes = [note]
    if len(found) > 1:
        counts = [(each.topic, len(each.message.points)) for each in found[1:]]
        others = (f'{topic} ({count} point{"s" if count > 1 else ""})' for topic, count in counts)
        notes.append(f'other topics: {", ".join(others)}; choose one with --topic')
    return LoadedTrajectory(trajectory, (*notes, *more))


def _from_states(
    messages: Iterable[tuple[int, Any]], joint_names: Sequence[str]
) -> LoadedTrajectory:
    """Build a trajectory from the joint states that have the most frequent list of names."""
    by_names: dict[tuple[str, ...], list[tuple[float, Any]]] = {}
    for received, message in messages:
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if len(message.position) == len(message.name):
            states = by_names.setdefault(tuple(message.name), [])
            states.append((stamp or 1e-9 * received, message))
    known = {names: found for names, found in by_names.items() if set(names) & set(joint_names)}
    if not known:
        found_names = ', '.join(sorted({name for names in by_names for name in names}))
        raise TrajectoryError(
            f'the joint states contain no joint of this robot, only {found_names}'
            if found_names
            else 'the joint states contain no joint names'
        )
    names, found = max(known.items(), key=lambda item: len(item[1]))
    rising = [found[0]]
    for state in found[1:]:
        if state[0] > rising[-1][0]:
            rising.append(state)
    notes = [f'{len(rising)} joint states']
    dropped = len(found) - len(rising)
    if dropped:
        notes.append(f'ignored {dropped} joint states that are not later than the previous state')
    unknown = [name for name in names if name not in joint_names]
    if unknown:
        notes.append(f'ignored joints that the robot does not have: {", ".join(unknown)}')
    if len(known) > 1:
        others = {name for other in known if other != names for name in other}
        notes.append(f'ignored joint states with other joint names: {", ".join(sorted(others))}')
    kept = [k for k, name in enumerate(names) if name in joint_names]
    times = np.array([time for time, _ in rising])
    positions = np.array([np.asarray(m.position)[kept] for _, m in rising])
    velocities = None
    if all(len(m.velocity) == len(names) for _, m in rising):
        recorded = np.array([np.asarray(m.velocity)[kept] for _, m in rising])
        velocities = recorded if np.isfinite(recorded).all() else None
    joints = tuple(names[k] for k in kept)
    trajectory = Trajectory(joints, times - times[0], positions, velocities)
    return LoadedTrajectory(trajectory, tuple(notes))
