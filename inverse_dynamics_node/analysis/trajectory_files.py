"""Reads trajectories from YAML, CSV and rosbag2 files, and writes them as CSV."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import csv
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..dynamics.trajectory import Trajectory
from ..errors import RecordingError, TrajectoryError
from ..robot.model import Floats
from .recordings.files import Bag, BAG_SUFFIXES, JOINT_STATE, JOINT_TRAJECTORY, open_bag, read_csv
from .trajectory_yaml import DERIVATIVES, DIGITS, trajectory_from_points, trajectory_from_yaml

FORMATS = """\
trajectory files:
  .yaml .yml .json  a trajectory_msgs/JointTrajectory as `ros2 topic echo --full-length` prints it:
              joint_names, and points with positions, optional velocities and accelerations, and
              time_from_start (sec and nanosec, or a number of seconds). Or plain lists:
              joint_names: [a, b]
              times: [0.0, 0.5]
              positions: [[0.0, 0.1], [0.2, 0.3]]    optional: velocities, accelerations
  .csv        a row of names, then a row of numbers for each time. The column `time` [s]; a column
              `<joint>` or `<joint>.position` for each joint [rad, m]; optional `<joint>.velocity`
              and `<joint>.acceleration`; other columns are ignored
  a rosbag2   .mcap, .db3 or the folder: the JointTrajectory with the most points; if all have
              one point or there is none, all JointStates of /joint_states, or of the only such
              topic. --topic chooses another one"""

_QUANTITIES = ('position', 'velocity', 'acceleration')
LATEST_START = 1e5
"""Time of the first point above which times are those of a clock [s]; a day has 86 400 s."""
_DEFAULT_TOPIC = '/joint_states'
"""The topic to read if several have joint states."""


class LoadedTrajectory(NamedTuple):
    """A trajectory read from a file."""

    trajectory: Trajectory
    notes: tuple[str, ...] = ()
    """Sentences about its source and about ignored data."""


def read_trajectory(
    path: Path,
    joint_names: Sequence[str],
    topic: str | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> LoadedTrajectory:
    """
    Read a trajectory in any of the `FORMATS`.

    Parameters
    ----------
    path : pathlib.Path
        A file, or the folder of a recording.
    joint_names : sequence of str
        The robot's joints; other joints in a CSV file or in joint states are ignored.
    topic : str, optional
        The topic of a recording.
    progress : callable
        Called now and then with the fraction read so far, 0 to 1.

    Returns
    -------
    loaded : LoadedTrajectory

    Raises
    ------
    TrajectoryError
        If the file contains no trajectory, or an incomplete one.
    OSError
        If the file cannot be opened.

    """
    return _from_first_point(_read(path, joint_names, topic, progress))


def _read(
    path: Path,
    joint_names: Sequence[str],
    topic: str | None,
    progress: Callable[[float], None],
) -> LoadedTrajectory:
    try:
        if path.is_dir() or path.suffix in BAG_SUFFIXES:
            with open_bag(path) as bag:
                return _from_bag(bag, joint_names, topic, progress)
        if path.suffix == '.csv':
            return _from_csv(path, joint_names)
    except RecordingError as error:
        raise TrajectoryError(str(error)) from None
    try:
        return LoadedTrajectory(*trajectory_from_yaml(path.read_text(encoding='utf-8-sig')))
    except UnicodeDecodeError:
        kinds = '.yaml, .json, .csv, .mcap or .db3'
        raise TrajectoryError(f'{path}: is not a text file, expected {kinds}') from None
    except TrajectoryError as error:
        raise TrajectoryError(f'{path}: {error}') from None


def _from_first_point(loaded: LoadedTrajectory) -> LoadedTrajectory:
    """Let times that are those of a clock begin at zero: tables have too few digits for them."""
    times = loaded.trajectory.times
    if not len(times) or not LATEST_START < times[0] < np.inf:
        return loaded
    trajectory = loaded.trajectory._replace(times=times - times[0])
    note = f'times count from the first point, at {times[0]:.3f} s'
    return LoadedTrajectory(trajectory, (*loaded.notes, note))


def write_table(path: Path, trajectory: Trajectory, efforts: Floats) -> None:
    """
    Write a CSV file that `read_trajectory` can read, with additional columns `<joint>.effort`.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    trajectory : Trajectory
        With velocities and accelerations, at k times of m joints.
    efforts : ndarray, shape (k, m)
        [N m or N].

    """
    velocities, accelerations = trajectory.velocities, trajectory.accelerations
    assert velocities is not None
    assert accelerations is not None
    values = np.hstack([trajectory.positions, velocities, accelerations, efforts])
    endings = ('', '.velocity', '.acceleration', '.effort')
    header = [name + ending for ending in endings for name in trajectory.joint_names]
    row = ','.join([f'%.{DIGITS}g'] * (1 + len(header))) + '\r\n'  # as the csv module ends rows
    with path.open('w', newline='', encoding='utf-8') as file:
        csv.writer(file).writerow(['time', *header])
        file.writelines(
            row % (time, *numbers)
            for time, numbers in zip(trajectory.times.tolist(), values.tolist(), strict=True)
        )


# ---- CSV -----------------------------------------------------------------------------------


def _from_csv(path: Path, joint_names: Sequence[str]) -> LoadedTrajectory:
    times, columns, others = read_csv(path, joint_names, _QUANTITIES)
    joints = tuple(
        joint for joint, quantity in columns if quantity == _QUANTITIES[0] and joint in joint_names
    )
    names = [*(f'{joint}.{quantity}' for joint, quantity in columns), *others]
    if not joints:
        raise TrajectoryError(
            f'{path}: no column has the positions of a joint of this robot; the columns are '
            f'{", ".join(["time", *names])}; the joints are {", ".join(joint_names)}'
        )
    for name in joint_names:
        if name not in joints and any(f'{name}.{q}' in names for q in (*_QUANTITIES, 'effort')):
            raise TrajectoryError(
                f"{path}: joint '{name}' has no column of positions; expected '{name}' or "
                f"'{name}.position'"
            )

    def values(quantity: str) -> Floats | None:
        found = [columns.get((joint, quantity)) for joint in joints]
        given = [column for column in found if column is not None]
        return np.stack(given, axis=1) if len(given) == len(joints) else None

    arrays = {quantity: values(quantity) for quantity in _QUANTITIES}
    unused = [
        *(f'{j}.{q}' for j, q in columns if j not in joints or arrays[q] is None),
        *others,
    ]
    positions = arrays.pop('position')
    assert positions is not None
    trajectory = Trajectory(joints, times, positions, *arrays.values())
    notes = (f'columns not used: {", ".join(unused)}',) if unused else ()
    return LoadedTrajectory(trajectory, notes)


# ---- rosbag2 -------------------------------------------------------------------------------


class _Longest(NamedTuple):
    """The first of the trajectories of a topic with the most points."""

    topic: str
    message: Any
    number: int
    """Its number among the trajectories of the topic that are not empty, from 1."""
    total: int
    """How many trajectories of the topic are not empty."""


def _from_bag(
    bag: Bag, joint_names: Sequence[str], topic: str | None, progress: Callable[[float], None]
) -> LoadedTrajectory:
    topics = _topics_with_data(bag, topic)
    found = _longest_trajectories(
        bag, [name for name in topics if bag.types[name] == JOINT_TRAJECTORY], progress
    )
    measured = [name for name in topics if bag.types[name] == JOINT_STATE]
    is_single = all(len(each.message.points) == 1 for each in found)
    if measured and is_single:
        chosen = _choose_topic(bag, measured)
        messages = bag.messages(chosen, progress)
        trajectory, notes = _from_states(bag.path, messages, joint_names)
        skipped = ', '.join(each.topic for each in found)
        notes = (f'topic {chosen}', *notes)
        notes += (f'not used, single points only: {skipped}',) if found else ()
        return LoadedTrajectory(trajectory, notes)
    if not found:
        raise TrajectoryError(f'{bag.path}: every trajectory in it is empty')
    trajectory, notes = _from_trajectories(found)
    others = {name for name, kind in bag.types.items() if kind in (JOINT_TRAJECTORY, JOINT_STATE)}
    others -= {each.topic for each in found}
    if is_single and others:
        notes += (f'a single point; --topic may be one of {", ".join(sorted(others))}',)
    return LoadedTrajectory(trajectory, notes)


def _topics_with_data(bag: Bag, requested: str | None) -> list[str]:
    """List the topics that have trajectories or joint states; only one if it was requested."""
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
                f"{bag.path}: no trajectory or joint state on topic '{requested}'; topics are "
                f'{listed}'
            )
        return [topic]
    if not topics:
        raise TrajectoryError(
            f'{bag.path}: no JointTrajectory or JointState messages; topics are {listed}'
        )
    return topics


def _choose_topic(bag: Bag, topics: Sequence[str]) -> str:
    if _DEFAULT_TOPIC in topics:
        return _DEFAULT_TOPIC
    if len(topics) > 1:
        raise TrajectoryError(
            f'{bag.path}: several topics have joint states, {", ".join(topics)}; choose one with '
            '--topic'
        )
    return topics[0]


def _longest_trajectories(
    bag: Bag, topics: Sequence[str], progress: Callable[[float], None]
) -> list[_Longest]:
    """Find the longest trajectory of each topic; sort by length, longest first."""
    found: dict[str, _Longest] = {}
    for topic in topics:
        for _, message in bag.messages(topic, progress):
            if not len(message.points):
                continue
            best = found.get(topic, _Longest(topic, message, 1, 0))
            best = best._replace(total=best.total + 1)
            if len(message.points) > len(best.message.points):
                best = best._replace(message=message, number=best.total)
            found[topic] = best
    return sorted(found.values(), key=lambda each: len(each.message.points), reverse=True)


def _from_trajectories(found: Sequence[_Longest]) -> tuple[Trajectory, tuple[str, ...]]:
    """Convert the first trajectory; mention the others in notes."""
    first = found[0]
    points = [
        {
            **{f: np.asarray(getattr(p, f)).tolist() for f in ('positions', *DERIVATIVES)},
            'time_from_start': {
                'sec': int(p.time_from_start.sec),
                'nanosec': int(p.time_from_start.nanosec),
            },
        }
        for p in first.message.points
    ]
    notes: tuple[str, ...] = (f'topic {first.topic}',)
    if first.total > 1:
        notes = (f'topic {first.topic}: trajectory {first.number} of {first.total}',)
    if len(found) > 1:
        others = (f'{each.topic} ({_points(len(each.message.points))})' for each in found[1:])
        notes += (f'other topics: {", ".join(others)}; choose with --topic',)
    trajectory, more = trajectory_from_points(list(first.message.joint_names), points)
    return trajectory, notes + more


def _points(count: int) -> str:
    return f'{count} point{"" if count == 1 else "s"}'


def _from_states(
    path: Path, messages: Iterable[tuple[int, Any]], joint_names: Sequence[str]
) -> tuple[Trajectory, tuple[str, ...]]:
    """Convert the joint states of one publisher: those with the most frequent list of names."""
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
            f'{path}: its joint states have no joint of this robot, only {found_names or "none"}'
        )
    names, found = max(known.items(), key=lambda item: len(item[1]))
    rising = [found[0]]
    for state in found[1:]:
        if state[0] > rising[-1][0]:
            rising.append(state)
    notes = [f'{len(rising)} joint states']
    dropped = len(found) - len(rising)
    if dropped:
        notes.append(f'ignored {dropped} joint states that are not later than the previous one')
    unknown = [name for name in names if name not in joint_names]
    if unknown:
        notes.append(f'not joints of the robot: {", ".join(unknown)}')
    if len(known) > 1:
        others = {name for other in known if other != names for name in other}
        notes.append(f'ignored joint states of other publishers: {", ".join(sorted(others))}')
    kept = [k for k, name in enumerate(names) if name in joint_names]
    times = np.array([time for time, _ in rising])
    positions = np.array([np.asarray(m.position)[kept] for _, m in rising])
    velocities = None
    if all(len(m.velocity) == len(names) for _, m in rising):
        recorded = np.array([np.asarray(m.velocity)[kept] for _, m in rising])
        velocities = recorded if np.isfinite(recorded).all() else None
    joints = tuple(names[k] for k in kept)
    return Trajectory(joints, times - times[0], positions, velocities), tuple(notes)
