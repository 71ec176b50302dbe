"""Reads trajectories from YAML, CSV and rosbag2 files, and writes YAML and CSV files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import csv
from pathlib import Path
import reprlib
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.trajectory import Trajectory
from ..errors import RecordingError, shortened, TrajectoryError
from ..robot.model import Floats
from .recordings.files import Bag, BAG_SUFFIXES, JOINT_TRAJECTORY, open_bag, read_csv

FORMATS = """\
trajectory files:
  .yaml .yml .json  a trajectory_msgs/JointTrajectory as `ros2 topic echo --full-length` prints it:
              joint_names: [a, b]
              points:
              - {positions: [0.0, 0.1], time_from_start: {sec: 0, nanosec: 0}}
              - {positions: [0.2, 0.3], time_from_start: {sec: 0, nanosec: 500000000}}
              Points may also have velocities and accelerations. time_from_start may be a number of
              seconds
  .csv        a row of names, then a row of numbers for each time. Columns: `time` [s]; `<joint>`
              or `<joint>.position` for each joint [rad, m]; optional `<joint>.velocity` and
              `<joint>.acceleration`; other columns are ignored. Also joint states as PlotJuggler
              exports them, or as `ros2 topic echo --csv --full-length` prints them
  a rosbag2   .mcap, .db3 or the folder: the JointTrajectory with the most points"""

LATEST_START = 1e5
"""Times are clock times if the first one exceeds this value [s] (a little over one day)."""
_FIELDS = ('positions', 'velocities', 'accelerations')
_QUANTITIES = ('position', 'velocity', 'acceleration')
_DIGITS = 9
"""Significant digits of written numbers."""
_LARGEST = 64 * 2**20
"""Largest number of characters in a YAML file."""
_WHOLE_OUTPUT = 'print the whole message with `ros2 topic echo --full-length`'


class LoadedTrajectory(NamedTuple):
    """A trajectory read from a file."""

    trajectory: Trajectory
    notes: tuple[str, ...] = ()
    """Notes on the source of the trajectory and on ignored data."""


def read_trajectory(
    path: Path,
    joint_names: Sequence[str],
    progress: Callable[[float], None] = lambda fraction: None,
) -> LoadedTrajectory:
    """
    Read a trajectory in any of the `FORMATS`.

    `path` is a file, or the folder of a recording. In CSV files, joints that are not in
    `joint_names` are ignored. `progress` is called regularly with the fraction of a recording read
    so far, 0 to 1. Raises TrajectoryError if the file contains no complete trajectory. Raises
    OSError if the file cannot be opened.

    """
    try:
        if path.is_dir() or path.suffix in BAG_SUFFIXES:
            with open_bag(path) as bag:
                trajectory, notes = _from_bag(bag, progress)
        elif path.suffix == '.csv':
            trajectory, notes = _from_csv(path, joint_names)
        else:
            trajectory, notes = _from_yaml(path)
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


def write_trajectory(path: Path, trajectory: Trajectory) -> None:
    """
    Write a trajectory_msgs/JointTrajectory as YAML that `ros2 topic pub` accepts.

    The trajectory must have velocities and accelerations.

    """
    import yaml

    names = {'joint_names': list(trajectory.joint_names)}
    with path.open('w', encoding='utf-8') as file:
        yaml.safe_dump(names, file, default_flow_style=None, width=10**6)
        file.write('points:\n')  # PyYAML would be a hundred times slower
        for time, *rows in zip(trajectory.times, *_arrays(trajectory), strict=True):
            sec, nanosec = divmod(round(1e9 * float(time)), 10**9)
            lines = [f'{field}: {_plain(row)}' for field, row in zip(_FIELDS, rows, strict=True)]
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


def _from_yaml(path: Path) -> LoadedTrajectory:
    """Read the first trajectory in a YAML file."""
    import yaml

    with path.open(encoding='utf-8-sig') as file:
        text = file.read(_LARGEST + 1)
    if len(text) > _LARGEST:
        raise TrajectoryError(f'has more than {_LARGEST} characters; write a CSV file or a bag')
    try:
        # This loader keeps numbers as strings, and shares the values of aliases.
        documents = list(yaml.load_all(text, yaml.CBaseLoader))
    except yaml.YAMLError as error:
        raise TrajectoryError(f'not valid YAML: {" ".join(str(error).split())}') from None
    except RecursionError:
        raise TrajectoryError('lists are nested too deeply') from None
    found = [each for each in documents if isinstance(each, dict) and 'points' in each]
    if not found:
        raise TrajectoryError('no trajectory, expected joint_names and points')
    points = found[0]['points']
    if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
        raise TrajectoryError(
            f'points is not a list of points; if it contains "...", {_WHOLE_OUTPUT}'
        )
    times = [_seconds(point.get('time_from_start'), i) for i, point in enumerate(points)]
    rows = {field: [point.get(field) for point in points] for field in _FIELDS}
    trajectory, notes = _trajectory(found[0].get('joint_names'), times, rows)
    if len(found) > 1:
        notes = (f'only the first of {len(found)} trajectories is used', *notes)
    return LoadedTrajectory(trajectory, notes)


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
    times, columns, others = read_csv(path, joint_names, _QUANTITIES, allow_empty=True)
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
    arrays: dict[str, Any] = dict.fromkeys(_QUANTITIES)
    for kind in _QUANTITIES:
        if all((joint, kind) in columns for joint in joints):
            arrays[kind] = np.stack([columns[joint, kind] for joint in joints], axis=1)
    unused = [f'{j}.{q}' for j, q in columns if j not in joints or arrays[q] is None]
    unused += others
    notes = (f'columns not used: {", ".join(unused)}',) if unused else ()
    return LoadedTrajectory(Trajectory(tuple(joints), times, *arrays.values()), notes)


# ---- rosbag2 -------------------------------------------------------------------------------


def _from_bag(bag: Bag, progress: Callable[[float], None]) -> LoadedTrajectory:
    """Read the trajectory with the most points."""
    found = [
        (message, topic)
        for topic, kind in bag.types.items()
        if kind == JOINT_TRAJECTORY
        for _, message in bag.messages(topic, progress)
        if len(message.points)
    ]
    if not found:
        topics = ', '.join(f'{name} ({kind})' for name, kind in bag.types.items()) or 'none'
        raise TrajectoryError(f'no JointTrajectory message with points; topics: {topics}')
    message, topic = max(found, key=lambda each: len(each[0].points))
    durations = [point.time_from_start for point in message.points]
    times = [float(each.sec) + 1e-9 * float(each.nanosec) for each in durations]
    rows = {
        field: [getattr(point, field).tolist() for point in message.points] for field in _FIELDS
    }
    trajectory, notes = _trajectory(list(message.joint_names), times, rows)
    note = f'topic {topic}'
    if len(found) > 1:
        note += f': the first with the most points among {len(found)} trajectories'
    return LoadedTrajectory(trajectory, (note, *notes))
