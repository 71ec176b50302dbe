"""Trajectories as YAML, in the form in which ROS 2 prints them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..dynamics.trajectory import Trajectory
from ..errors import TrajectoryError
from ..robot.model import Floats

DERIVATIVES = ('velocities', 'accelerations')
DIGITS = 9
"""Significant digits of written numbers."""
_ENCLOSING = ('trajectory', 'joint_trajectory', 'goal')
"""Fields of other messages that hold a trajectory."""


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

    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)  # ten times as fast, if it was built
    try:
        documents = [each for each in yaml.load_all(text, loader) if each is not None]
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


def trajectory_from_points(names: Any, points: Any) -> tuple[Trajectory, tuple[str, ...]]:
    """
    Convert the fields of a trajectory_msgs/JointTrajectory.

    Parameters
    ----------
    names : list of str
        Field joint_names.
    points : list of dict
        Field points, each with positions and time_from_start.

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
    points = []
    for time, *rows in zip(trajectory.times, *values, strict=True):
        sec, nanosec = divmod(round(1e9 * float(time)), 10**9)
        points.append(
            {
                **{field: _plain(row) for field, row in zip(fields, rows, strict=True)},
                'time_from_start': {'sec': sec, 'nanosec': nanosec},
            }
        )
    message = {'joint_names': list(trajectory.joint_names), 'points': points}
    with path.open('w', encoding='utf-8') as file:
        yaml.safe_dump(message, file, sort_keys=False, default_flow_style=None, width=10**6)


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


def _numbers(values: Any, count: int, where: str) -> Floats:
    hint = ''
    if isinstance(values, str) or (isinstance(values, list) and '...' in values):
        hint = '; print all of it: ros2 topic echo --full-length'
    if not isinstance(values, list) or len(values) != count:
        found = len(values) if isinstance(values, list) else repr(values)
        raise TrajectoryError(f'{where}: expected {count} numbers, got {found}{hint}')
    try:
        return np.array([float(value) for value in values])
    except (TypeError, ValueError) as error:
        raise TrajectoryError(f'{where}: {error}{hint}') from None


def _plain(row: Floats) -> list[float]:
    return [float(f'{x:.{DIGITS}g}') + 0.0 for x in row]
