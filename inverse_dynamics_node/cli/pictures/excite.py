"""The picture of `excite`: the path of the hand, and positions, speeds and efforts over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.excitation.clearance import Clearance, Extent
from ...analysis.excitation.limits import whole_positions
from ...analysis.excitation.search import Excitation
from ...dynamics.inverse_dynamics import InverseDynamics
from ...dynamics.trajectory import Trajectory
from ...robot.kinematics import body_frames, last_link
from ...robot.model import Floats, RobotModel
from . import style

_VIEWS = (('side view', 0, 2), ('from above', 0, 1))
_MOST_POINTS = 600
"""Largest number of states to draw; more states would not be visible."""


def draw(
    dynamics: InverseDynamics,
    excitation: Excitation,
    trajectory: Trajectory,
    efforts: Floats,
    box: Extent,
    source: str,
    path: Path,
) -> None:
    """Draw two views of the path, and the motion of all joints; `source` names the URDF."""
    robot, limits = dynamics.robot, excitation.limits
    nearest = excitation.nearest[0] if excitation.nearest else None
    shown = np.linspace(0, len(trajectory.times) - 1, _MOST_POINTS).round().astype(int)
    times, q, qd = (
        np.asarray(values)[shown]
        for values in (trajectory.times, trajectory.positions, trajectory.velocities)
    )
    whole = whole_positions(limits, q)
    with style.styled_pyplot() as pyplot:
        figure = pyplot.figure(figsize=(style.WIDTH, 6.6))
        halves = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.25))
        left, right = halves[0].subgridspec(2, 1), halves[1].subgridspec(3, 1)
        hand = last_link(robot)
        path_of_hand = dynamics.pose(whole, hand)[:, :3, 3]
        for view, (title, across, up) in enumerate(_VIEWS):
            axes = figure.add_subplot(left[view])
            _draw_view(axes, robot, whole[0], path_of_hand, box, across, up)
            if limits.clearance:
                _draw_surroundings(axes, limits.clearance, across, up)
            axes.set_title(title, fontsize=9)
        handles, labels = axes.get_legend_handles_labels()
        panels: list[tuple[str, Floats]] = [
            ('position\n[% of range]', (q - limits.middle) / limits.half * 100.0),
            ('speed\n[% of allowed speed]', qd / limits.speeds * 100.0),
            _efforts_panel(efforts[shown], limits.efforts[limits.index]),
        ]
        below: Any = None
        for row, (label, values) in enumerate(panels):
            below = figure.add_subplot(right[row], sharex=below)
            _draw_lines(below, times, values, trajectory.joint_names)
            below.set_ylabel(label, fontsize=9)
            below.tick_params(labelbottom=row == 2, labelsize=8.5)
        below.set_xlabel('time [s]')
        lines, names = below.get_legend_handles_labels()
        style.set_title(
            figure,
            f'{robot.name} ({source}): excitation motion of {trajectory.times[-1]:g} s, path of '
            f"link '{hand}'",
            f'Smallest distance {nearest.distance:.3f} m: {nearest.names[0]} and '
            f'{nearest.names[1]}.'
            if nearest
            else 'All distances are above 0.3 m.',
        )
        style.legend_below(figure, [*handles, *lines], [*labels, *names], ncols=5)
        figure.savefig(path)


def _draw_view(
    axes: Any,
    robot: RobotModel,
    start: Floats,
    path: Floats,
    box: Extent,
    across: int,
    up: int,
) -> None:
    """Draw the arm in its start pose, the path of the hand, and the box that all links stay in."""
    plane = [across, up]
    (left, bottom), (right, top) = box.lowest[plane], box.highest[plane]
    corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
    axes.fill(*corners.T, facecolor=style.ORANGE, alpha=0.12, linewidth=0)
    axes.fill(
        *corners.T, fill=False, edgecolor=style.ORANGE, linewidth=1.2, label='space of all links'
    )
    axes.plot(*path[:, plane].T, color=style.BLUE, linewidth=1.0, label='path of the hand')
    _, positions = body_frames(robot, start)
    for body in range(1, len(robot.parent)):
        ends = positions[[robot.parent[body], body]][:, plane]
        axes.plot(*ends.T, color=style.GREY, linewidth=3.5, solid_capstyle='round')
    last = int(robot.link_body[robot.link_index(last_link(robot))])
    axes.plot(*np.array([positions[last], path[0]])[:, plane].T, color=style.GREY, linewidth=2.0)
    axes.plot(*positions[0][plane], 's', color=style.DARK, markersize=8, label='base')
    axes.plot(*path[0, plane], 'o', color=style.GREEN, markersize=7, label='start and end')
    axes.set_aspect('equal', adjustable='datalim')
    axes.locator_params(nbins=6)
    axes.set_xlabel(f'{"xyz"[across]} [m]', fontsize=9)
    axes.set_ylabel(f'{"xyz"[up]} [m]', fontsize=9)
    axes.tick_params(labelsize=8.5)


def _draw_surroundings(axes: Any, clearance: Clearance, across: int, up: int) -> None:
    """Draw the obstacles, and draw the floor in views that show the height."""
    if up == 2 and np.isfinite(clearance.floor):
        axes.axhline(clearance.floor, color=style.DARK, linewidth=1.2, zorder=0)
    for lowest, highest in clearance.boxes[:, :, [across, up]]:
        (left, bottom), (right, top) = lowest, highest
        axes.fill([left, right, right, left], [bottom, bottom, top, top], facecolor=style.GREY)


def _efforts_panel(efforts: Floats, limits: Floats) -> tuple[str, Floats]:
    """Return a label, and efforts in percent of the limit, or of the peak if there is no limit."""
    peak = np.maximum(np.max(np.abs(efforts), axis=0), 1e-9)
    has_limit = np.isfinite(limits)
    of = 'of allowed effort' if has_limit.all() else 'of allowed effort, or of peak'
    return f'effort\n[% {of}]', efforts / np.where(has_limit, limits, peak) * 100.0


def _draw_lines(axes: Any, times: Floats, values: Floats, names: tuple[str, ...]) -> None:
    for end in (-100.0, 100.0):
        axes.axhline(end, color=style.RED, linewidth=0.9, linestyle='--')
    style.draw_lines(axes, times, values, names)
    axes.set_ylim(-112.0, 112.0)
