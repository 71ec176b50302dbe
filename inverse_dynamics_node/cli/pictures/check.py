"""The picture of `check`: gravity efforts over the workspace, and the worst pose."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.sizing import PayloadCapacity, Workspace
from ...dynamics.inverse_dynamics import InverseDynamics
from ...report.tables import effort_unit
from ...robot.kinematics import body_frames
from ...robot.model import Floats, RobotModel
from . import style

_BINS = 80
_HALF = 0.42
"""Half the height of a distribution at its peak, as a fraction of the row height."""
_REACH = 1.12
"""The effort axis ends at this multiple of the worst effort."""
_MAX_RATIO = 1.2
"""Bars are cut at this multiple of the limit."""
_MOST_BESIDE_ONE_VIEW = 14
"""With more joints than this, the picture contains a second view of the robot."""
_MOST_NUMBERS = 12
"""With more joints than this, only the highlighted joint has a number."""
_AROUND = ((0, 16), (0, -16), (24, 0), (-24, 0), (20, 14), (-20, 14), (0, 30), (0, -30))
"""Offsets for the label of a joint [points], in order of preference."""
_LARGEST_MASS = 260.0
"""Area of the disc that shows the largest mass [square points]."""


def draw(
    dynamics: InverseDynamics,
    workspace: Workspace,
    payload: PayloadCapacity,
    source: str,
    path: Path,
) -> None:
    """Draw the efforts beside the robot, and write the picture; `source` names the URDF."""
    count = len(workspace.robot.joint_names)
    height = min(40.0, max(4.6, 1.9 + 0.27 * count))
    with style.styled_pyplot() as pyplot:
        figure = pyplot.figure(figsize=(style.WIDTH, height))
        rows = 2 if count > _MOST_BESIDE_ONE_VIEW else 1
        grid = figure.add_gridspec(rows, 3, width_ratios=(1.0, 0.38, 1.25))
        _draw_efforts(figure.add_subplot(grid[:, 0]), workspace)
        _draw_ratios(figure.add_subplot(grid[:, 1]), workspace)
        worst = workspace.poses[workspace.worst[workspace.hardest]]
        views = [figure.add_subplot(grid[row, 2]) for row in range(rows)]
        style.set_title(figure, *_title(workspace, payload, source))
        for view, axes in enumerate(views):
            draw_arm(axes, dynamics, worst, workspace.hardest, payload.link, view)
        handles, labels = views[0].get_legend_handles_labels()
        style.legend_below(figure, handles, labels, loc='lower right', ncols=4)
        figure.savefig(path)


def _title(workspace: Workspace, payload: PayloadCapacity, source: str) -> list[str]:
    title = [f'{workspace.robot.name} ({source}): efforts that hold the robot against gravity']
    if payload.joint is not None:
        title.append(f"largest payload: {payload.mass:.3g} kg on link '{payload.link}'")
    return title


def _draw_efforts(axes: Any, workspace: Workspace) -> None:
    """Draw the distribution of the efforts, with a row and a scale for each joint."""
    names = workspace.robot.joint_names
    peaks = style.without_rounding(workspace.peaks)
    scale = np.where(peaks > 0.0, peaks, np.inf)
    marks = workspace.efforts[workspace.worst, range(len(peaks))] / scale
    for i, limit in enumerate(workspace.limits):
        colour = style.BLUE if np.isfinite(limit) else style.GREY
        axes.axhline(i, color=style.PALE, linewidth=0.7, zorder=0)
        if peaks[i] > 0.0:
            _draw_row(axes, i, workspace.efforts[workspace.sampled, i] / scale[i], colour)
        axes.plot(
            [marks[i]], [i], 'D', color=style.RED if peaks[i] > limit else colour, markersize=4.5
        )
    labels = [f'{name}  {i}' for i, name in enumerate(style.all_shortened(names, 26), 1)]
    axes.set_yticks(range(len(names)), labels)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(-_REACH, _REACH)
    axes.set_xticks([-1.0, 0.0, 1.0], ['-worst', '0', '+worst'])
    axes.grid(axis='y', visible=False)
    axes.set_title('distribution, scaled per joint', fontsize=9)
    axes.tick_params(axis='x', labelsize=8.5)


def _draw_row(axes: Any, row: int, values: Floats, colour: str) -> None:
    counts, edges = np.histogram(values, _BINS, (-_REACH, _REACH))
    half = _HALF * np.sqrt(
        counts / max(1, int(np.max(counts)))
    )  # the square root keeps the tails visible
    ends, outline = np.repeat(edges, 2)[1:-1], np.repeat(half, 2)
    # Separate bars for hundreds of joints would take a minute.
    axes.fill_between(ends, row - outline, row + outline, color=colour, alpha=0.45, linewidth=0)


def _draw_ratios(axes: Any, workspace: Workspace) -> None:
    """Draw a bar for each joint: the ratio of its worst effort to its limit."""
    count = len(workspace.limits)
    shown = style.without_rounding(workspace.peaks)
    for i, (peak, limit) in enumerate(zip(workspace.peaks, workspace.limits, strict=True)):
        is_beyond = bool(peak > limit)
        colour = style.RED if is_beyond else style.BLUE
        if np.isfinite(limit):
            axes.barh(i, 1.0, 0.6, color=style.PALE, zorder=0)
            axes.barh(i, min(peak / limit, _MAX_RATIO), 0.6, color=colour, alpha=0.7)
        axes.text(
            1.04,
            i,
            style.peak_in_words(shown[i], limit, effort_unit(workspace.robot, i).strip()),
            transform=axes.get_yaxis_transform(),
            va='center',
            fontsize=8.5,
            color=style.RED if is_beyond else style.DARK,
        )
    axes.set_yticks([])
    axes.set_ylim(count - 0.4, -0.6)
    axes.set_xlim(0.0, _MAX_RATIO)
    axes.grid(visible=False)
    axes.set_title('worst / limit', fontsize=9)
    axes.set_xticks([])
    if np.isfinite(workspace.limits).any():
        axes.axvline(1.0, color=style.RED, linewidth=1.2, linestyle='--')
        axes.set_xticks([1.0], ['100%'])
        axes.tick_params(axis='x', labelsize=8.5)


def draw_arm(
    axes: Any, dynamics: InverseDynamics, q: Floats, joint: int, link: str, view: int = 0
) -> None:
    """
    Draw the robot from the side, with gravity pointing down.

    The joint with the index `joint` is highlighted, and a triangle marks `link`. View 0 shows the
    widest side of the robot, and view 1 is turned by 90 degrees.
    """
    robot = dynamics.robot
    rotations, positions = body_frames(robot, q)
    links = positions[robot.link_body] + np.einsum(
        'kij,kj->ki', rotations[robot.link_body], robot.link_position
    )
    centres = positions + np.einsum('bij,bj->bi', rotations, robot.com)
    plane = _side_view(dynamics.gravity, np.concatenate([positions, links, centres]), view)
    flat, flat_links, flat_centres = positions @ plane, links @ plane, centres @ plane

    _draw_structure(axes, robot, flat, flat_links, flat_centres)
    _draw_masses(axes, robot, flat_centres)
    places = _draw_joints(axes, robot, flat, joint)
    mark = flat_links[robot.link_index(link)]
    axes.plot(
        *mark, 'v', color=style.GREEN, markersize=9, zorder=6, label=style.shortened(link, 22)
    )
    _frame(axes, np.concatenate([flat, flat_links, flat_centres]))
    axes.set_xlabel('across [m]')
    axes.set_ylabel('up [m]')
    title = 'the same, turned by 90°' if view else f'side view, worst pose for joint {joint + 1}'
    axes.set_title(title, fontsize=9)
    _number(axes, places)


def _frame(axes: Any, points: Floats) -> None:
    """Set the limits of the axes to a square that contains all points."""
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    half = 0.6 * max(0.1, float(np.max(high - low)))
    middle = 0.5 * (low + high)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect('equal', adjustable='box', anchor='N')
    axes.locator_params(nbins=6)


def _side_view(gravity: Floats, points: Floats, view: int) -> Floats:
    """Return the matrix that projects points to the directions across and up, shape (3, 2)."""
    size = float(np.linalg.norm(gravity))
    up = -gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
    spread = points - points[0]
    level = spread - np.outer(spread @ up, up)
    _, sizes, directions = np.linalg.svd(level)
    across = directions[0]
    if view == 1 and sizes[0] >= 1e-9:
        across = np.cross(up, across)
    elif sizes[0] < 1e-9:  # all points are on a vertical line
        across = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
        across /= np.linalg.norm(across)
    if np.sum(level @ across) < 0.0:
        across = -across
    plane: Floats = np.stack([across, up], axis=1)
    return plane


def _draw_structure(
    axes: Any, robot: RobotModel, flat: Floats, flat_links: Floats, centres: Floats
) -> None:
    for body in range(1, len(robot.parent)):
        ends = flat[[robot.parent[body], body]]
        axes.plot(*ends.T, color=style.GREY, linewidth=3.5, solid_capstyle='round', zorder=2)
    for body in set(range(1, len(robot.parent))) - set(robot.parent.tolist()):
        if robot.mass[body] > 0.0:  # the end is unknown: use the centre of mass
            axes.plot(
                *np.array([flat[body], centres[body]]).T, color=style.GREY, linewidth=1.5, zorder=1
            )
    for place, body in zip(flat_links, robot.link_body, strict=True):
        axes.plot(*np.array([flat[body], place]).T, color=style.GREY, linewidth=1.5, zorder=1)
    axes.plot(*flat[0], 's', color=style.DARK, markersize=11, zorder=3, label='base')


def _draw_masses(axes: Any, robot: RobotModel, centres: Floats) -> None:
    mass = robot.mass
    if not np.any(mass > 0.0):
        return
    sizes = _LARGEST_MASS * mass / np.max(mass)
    label = f'masses, up to {np.max(mass):.3g} kg'
    axes.scatter(
        *centres.T, s=sizes, color=style.ORANGE, alpha=0.55, linewidths=0, zorder=4, label=label
    )
    middle = mass @ centres / np.sum(mass)
    label = f'centre of mass, {np.sum(mass):.3g} kg'
    axes.plot(
        *middle, 'x', color=style.DARK, markersize=9, markeredgewidth=2.2, zorder=7, label=label
    )


def _draw_joints(
    axes: Any, robot: RobotModel, flat: Floats, joint: int
) -> list[tuple[Floats, list[int]]]:
    """Draw the joints; return the place and the joint numbers of each label."""
    many = len(robot.joint_names) > _MOST_NUMBERS
    apart = 0.07 * (float(np.max(np.ptp(flat, axis=0))) or 1.0)
    places: list[tuple[Floats, list[int]]] = []
    for body in range(1, len(robot.parent)):
        i, spot = int(robot.joint_index[body]), flat[body]
        is_highlighted = i == joint
        shape = 's' if robot.is_prismatic[body] else 'o'
        size = 9 if is_highlighted else 4 if many else 6.5
        colour = style.RED if is_highlighted else style.BLUE
        axes.plot(*spot, shape, color=colour, markersize=size, zorder=6 if is_highlighted else 5)
        if robot.body_names[body] != robot.joint_names[i] or (many and not is_highlighted):
            continue
        near = [numbers for place, numbers in places if np.linalg.norm(place - spot) < apart]
        if near:
            near[0].append(i + 1)
        else:
            places.append((spot, [i + 1]))
    return places


def _number(axes: Any, places: Sequence[tuple[Floats, list[int]]]) -> None:
    """
    Write the numbers of the joints without overlaps.

    A label that fits nowhere is omitted, because the rows beside the robot show all numbers.
    """
    figure = axes.figure
    figure.canvas.draw()  # the layout determines the free places
    renderer = figure.canvas.get_renderer()
    taken: list[Any] = []
    for place, numbers in places:
        for across, up in _AROUND:
            label = axes.annotate(style.runs_of(numbers), place, xytext=(across, up), fontsize=9,
                                  ha='center', va='center', textcoords='offset points',
                                  color=style.DARK, zorder=8)  # fmt: skip
            extent = label.get_window_extent(renderer).padded(2.0)
            if not any(extent.overlaps(other) for other in taken):
                taken.append(extent)
                break
            label.remove()
