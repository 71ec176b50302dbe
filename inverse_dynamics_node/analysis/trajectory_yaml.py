"""Trajectories as YAML, in the form in which ROS 2 prints them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import reprlib
from typing import Any

import numpy as np

from ..dynamics.trajectory import Trajectory
from ..errors import shortened, TrajectoryError
from ..robot.model import Floats

DERIVATIVES = ('velocities', 'accelerations')
DIGITS = 9
"""Significant digits of written numbers."""
_ENCLOSING = ('trajectory', 'joint_trajectory', 'goal')
"""Fields of other messages that hold a trajectory."""
_DEEPEST = 20
"""Levels of lists and mappings; a trajectory inside an action goal has six."""
_NULL = ('', '~', 'null')


def trajectory_from_yaml(text: str) -> tuple[Trajectory, tuple[str, ...]]:
    """
    Find the first trajectory in YAML text.

    Parameters
    ----------
    text : str
        Documents, one of which is or contains a trajectory.

    Returns
    -------
    trajectory : Trajectory
    notes : tuple of str
        Sentences about ignored data.

    Raises
    ------
    TrajectoryError
        If there is no trajectory, or it is incomplete.

    """
    import yaml

    try:
        documents = [each for each in _documents(text) if each is not None]
    except yaml.YAMLError as error:
        raise TrajectoryError(f'not valid YAML: {" ".join(str(error).split())}') from None
    found = [each for each in map(_unwrapped, documents) if each is not None]
    if not found:
        raise TrajectoryError('no trajectory, expected joint_names and points')
    notes = (f'the first of {len(found)} trajectories',) if len(found) > 1 else ()
    first = found[0]
    if 'points' in first:
        trajectory, more = trajectory_from_points(first['joint_names'], first['points'])
        return trajectory, notes + more
    return _trajectory_from_lists(first), notes


def _documents(text: str) -> Iterator[Any]:
    """
    Yield the documents as lists, mappings and text; numbers are text, too.

    Unlike the loader of PyYAML, this neither recurses nor converts: no file can use up the stack,
    contain itself, or create other objects.

    """
    import yaml

    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)  # ten times as fast, if it was built
    opened: list[tuple[Any, str | None, list[Any]]] = []  # kind of event, anchor, content
    anchors: dict[str, Any] = {}
    content: list[Any] = []
    for event in yaml.parse(text, loader):
        if isinstance(event, yaml.ScalarEvent):
            value = None if not event.style and event.value in _NULL else event.value
            anchor = event.anchor
        elif isinstance(event, yaml.CollectionStartEvent):
            if len(opened) == _DEEPEST:
                line = event.start_mark.line + 1
                raise TrajectoryError(f'line {line}: more than {_DEEPEST} levels of lists')
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
            if event.anchor not in anchors:  # also if the alias is inside of what it refers to
                line = event.start_mark.line + 1
                raise TrajectoryError(f'line {line}: alias *{event.anchor} is not defined before')
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


def trajectory_from_points(names: Any, points: Any) -> tuple[Trajectory, tuple[str, ...]]:
    """
    Convert the fields of a trajectory_msgs/JointTrajectory.

    Parameters
    ----------
    names : list of str
        Field joint_names.
    points : list of dict
        Field points, each with positions and time_from_start; numbers may be text.

    Returns
    -------
    trajectory : Trajectory
    notes : tuple of str
        Sentences about ignored data.

    Raises
    ------
    TrajectoryError
        If a field is missing or has the wrong type or size.

    """
    joints = _names(names)
    if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
        raise TrajectoryError(
            'points is not a list of points; if it contains "...", print all of it: '
            'ros2 topic echo --full-length'
        )
    times = [_seconds(point.get('time_from_start'), i) for i, point in enumerate(points)]
    rows: dict[str, list[Floats]] = {}
    for field in ('positions', *DERIVATIVES):
        rows[field] = [
            _numbers(point[field], len(joints), f'{field} of point {i}')
            for i, point in enumerate(points)
            if point.get(field)
        ]
    if len(rows['positions']) < len(points):
        raise TrajectoryError(f'{len(points) - len(rows["positions"])} points have no positions')
    notes = tuple(
        f'only {len(rows[field])} of {len(points)} points have {field}: not used'
        for field in DERIVATIVES
        if 0 < len(rows[field]) < len(points)
    )
    derivatives = [np.array(rows[f]) if len(rows[f]) == len(points) else None for f in DERIVATIVES]
    positions = np.array(rows['positions']).reshape(len(points), len(joints))
    return Trajectory(joints, np.array(times, float), positions, *derivatives), notes


def write_trajectory(path: Path, trajectory: Trajectory, efforts: Floats | None = None) -> None:
    """
    Write a trajectory_msgs/JointTrajectory as YAML that `ros2 topic pub` accepts.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    trajectory : Trajectory
        With velocities and accelerations, at k times of m joints.
    efforts : ndarray, shape (k, m), optional
        [N m or N]; without them, a controller that does not use efforts accepts the trajectory.

    """
    import yaml

    velocities, accelerations = trajectory.velocities, trajectory.accelerations
    assert velocities is not None
    assert accelerations is not None
    fields: tuple[str, ...] = ('positions', *DERIVATIVES)
    values: tuple[Floats, ...] = trajectory.positions, velocities, accelerations
    if efforts is not None:
        fields, values = (*fields, 'effort'), (*values, efforts)
    names = {'joint_names': list(trajectory.joint_names)}
    with path.open('w', encoding='utf-8') as file:
        yaml.safe_dump(names, file, default_flow_style=None, width=10**6)
        file.write('points:\n')  # written without PyYAML, which is a hundred times as slow
        for time, *rows in zip(trajectory.times, *values, strict=True):
            sec, nanosec = divmod(round(1e9 * float(time)), 10**9)
            lines = [f'{field}: {_plain(row)}' for field, row in zip(fields, rows, strict=True)]
            lines.append(f'time_from_start: {{sec: {sec}, nanosec: {nanosec}}}')
            file.write('- ' + '\n  '.join(lines) + '\n')


def _unwrapped(document: Any) -> dict[str, Any] | None:
    """Return the trajectory inside an action goal or the answer of a planner."""
    while isinstance(document, dict) and 'joint_names' not in document:
        document = next((document[name] for name in _ENCLOSING if name in document), None)
    is_complete = isinstance(document, dict) and ('points' in document or 'positions' in document)
    return document if is_complete else None


def _trajectory_from_lists(document: dict[str, Any]) -> Trajectory:
    joints = _names(document['joint_names'])
    if not isinstance(document.get('times'), list):
        raise TrajectoryError('no list of times [s]')
    times = _numbers(document['times'], len(document['times']), 'times')
    arrays: list[Floats | None] = []
    for field in ('positions', *DERIVATIVES):
        rows = document.get(field) or []
        if not rows:
            arrays.append(None)
            continue
        if not isinstance(rows, list) or len(rows) != len(times):
            raise TrajectoryError(f'{field}: expected {len(times)} lists, one for each time')
        arrays.append(
            np.array([_numbers(r, len(joints), f'{field}[{i}]') for i, r in enumerate(rows)])
        )
    if arrays[0] is None:
        raise TrajectoryError('no positions')
    return Trajectory(joints, times, arrays[0], *arrays[1:])


def _names(names: Any) -> tuple[str, ...]:
    is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
    if not is_list or not names:
        raise TrajectoryError(f'joint_names is {_short(names)}, expected a list of names')
    return tuple(names)


def _seconds(time: Any, point: int) -> float:
    try:
        if not isinstance(time, dict):
            return float(time)
        if set(time) <= {'sec', 'nanosec'}:
            return float(time.get('sec', 0)) + 1e-9 * float(time.get('nanosec', 0))
    except (TypeError, ValueError):
        pass
    raise TrajectoryError(
        f'time_from_start of point {point} is {_short(time)}, expected sec and nanosec, or seconds'
    )


def _numbers(values: Any, count: int, where: str) -> Floats:
    hint = ''
    if isinstance(values, str) or (isinstance(values, list) and '...' in values):
        hint = '; print all of it: ros2 topic echo --full-length'
    if not isinstance(values, list) or len(values) != count:
        found = len(values) if isinstance(values, list) else _short(values)
        raise TrajectoryError(f'{where}: expected {count} numbers, got {found}{hint}')
    try:
        return np.array([float(value) for value in values])
    except TypeError:
        raise TrajectoryError(f'{where}: contains a list, expected numbers{hint}') from None
    except ValueError as error:
        raise TrajectoryError(f'{where}: {shortened(str(error), 100)}{hint}') from None


def _short(value: Any) -> str:
    return shortened(reprlib.repr(value))


def _plain(row: Floats) -> str:
    """Return a list as YAML 1.1, in which a number with an exponent needs a point."""
    numbers = (repr(float(f'{x:.{DIGITS}g}') + 0.0) for x in row)
    points = (x if '.' in x else x.replace('e', '.0e') for x in numbers)
    return f'[{", ".join(points)}]'
