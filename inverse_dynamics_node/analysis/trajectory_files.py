"""Trajectories with their efforts, written for spreadsheets and for ROS 2."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ..dynamics.trajectory import Trajectory
from ..robot.model import Floats

_DIGITS = 9


def write_table(path: Path, trajectory: Trajectory, efforts: Floats) -> None:
    """Write everything over time as CSV, in the form that is read too, with `<joint>.effort`."""
    values = _columns(trajectory, efforts)
    endings = ('', '.velocity', '.acceleration', '.effort')
    header = [name + ending for ending in endings for name in trajectory.joint_names]
    with path.open('w', newline='', encoding='utf-8') as file:
        rows = csv.writer(file)
        rows.writerow(['time', *header])
        for time, *row in zip(trajectory.times, *values, strict=True):
            rows.writerow([f'{x:.{_DIGITS}g}' for x in (time, *np.concatenate(row))])


def write_trajectory(path: Path, trajectory: Trajectory, efforts: Floats) -> None:
    """Write a trajectory_msgs/JointTrajectory as YAML, as `ros2 topic pub` takes it."""
    import yaml

    fields = ('positions', 'velocities', 'accelerations', 'effort')
    values = _columns(trajectory, efforts)
    points = []
    for time, *rows in zip(trajectory.times, *values, strict=True):
        sec, nanosec = divmod(round(1e9 * float(time)), 10**9)
        points.append(
            {
                **{what: _plain(row) for what, row in zip(fields, rows, strict=True)},
                'time_from_start': {'sec': sec, 'nanosec': nanosec},
            }
        )
    message = {'joint_names': list(trajectory.joint_names), 'points': points}
    with path.open('w', encoding='utf-8') as file:
        yaml.safe_dump(message, file, sort_keys=False, default_flow_style=None, width=10**6)


def _columns(trajectory: Trajectory, efforts: Floats) -> tuple[Floats, ...]:
    velocities, accelerations = trajectory.velocities, trajectory.accelerations
    assert velocities is not None  # a complete trajectory
    assert accelerations is not None
    return trajectory.positions, velocities, accelerations, efforts


def _plain(row: Floats) -> list[float]:
    return [float(f'{x:.{_DIGITS}g}') + 0.0 for x in row]
