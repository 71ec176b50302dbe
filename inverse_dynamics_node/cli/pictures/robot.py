"""The pictures of `check` and `effort`: efforts over the workspace, and over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.sizing import EffortRequirements, PayloadCapacity, Workspace
from ...dynamics.trajectory import Trajectory
from ...report.tables import effort_unit
from ...robot.model import Floats, RobotModel
from . import style

_BINS = 80
_HALF = 0.42
"""Half the height of a distribution at its peak, as a fraction of the row height."""
_REACH = 1.12
"""The effort axis ends at this multiple of the worst effort."""
_MAX_RATIO = 1.2
"""Bars are cut at this multiple of the limit."""
_PARTS = {
    'gravity': style.GREEN,
    'inertial': style.ORANGE,
    'coriolis': style.PINK,
    'friction': style.GREY,
}
_LABELS = {'inertial': 'inertia', 'coriolis': 'velocity'}
_NAME_LETTERS = {1: 80, 2: 50, 3: 32}
"""Largest number of letters in a name above a panel, for each number of columns."""


def draw_workspace(
    workspace: Workspace, payload: PayloadCapacity, source: str, path: Path
) -> None:
    """Draw the efforts and their ratios to the limits; `source` names the URDF."""
    count = len(workspace.robot.joint_names)
    height = min(40.0, max(2.8, 1.5 + 0.27 * count))
    with style.styled_pyplot() as pyplot:
        figure = pyplot.figure(figsize=(style.WIDTH, height))
        grid = figure.add_gridspec(1, 2, width_ratios=(1.0, 0.6))
        _draw_efforts(figure.add_subplot(grid[0]), workspace)
        _draw_ratios(figure.add_subplot(grid[1]), workspace)
        style.set_title(figure, *_title(workspace, payload, source))
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
    axes.set_yticks(range(len(names)), style.all_elided(names, 26))
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


def draw_requirements(
    robot: RobotModel, fine: Trajectory, requirements: EffortRequirements, title: str, path: Path
) -> None:
    """Draw a panel for each joint, and write the picture."""
    m = len(fine.joint_names)
    columns = 1 if m == 1 else 2 if m <= 12 else 3
    names = style.all_elided(fine.joint_names, _NAME_LETTERS[columns])
    with style.styled_pyplot() as pyplot:
        figure, panels = style.panels(pyplot, m, columns, 1.7 if m > 2 else 2.3)
        for k, axes in enumerate(panels):
            _draw_joint(axes, robot, fine, requirements, k, names[k])
        style.legend_below(figure, *panels[0].get_legend_handles_labels(), ncols=6)
        style.set_title(figure, *title.splitlines())
        figure.savefig(path)


def _draw_joint(
    axes: Any,
    robot: RobotModel,
    fine: Trajectory,
    requirements: EffortRequirements,
    k: int,
    name: str,
) -> None:
    shown = _shown(fine, requirements, k)
    times = fine.times[shown]
    for part, colour in _PARTS.items():
        term = getattr(requirements.terms, part)
        if part != 'friction' or np.any(requirements.terms.friction):
            label = _LABELS.get(part, part)
            axes.plot(times, term[shown, k], color=colour, linewidth=1.1, label=label)
    colour = style.RED if requirements.is_too_strong[k] else style.BLUE
    axes.plot(
        times, requirements.efforts[shown, k], color=style.BLUE, linewidth=2.0, label='effort'
    )
    axes.plot(
        requirements.peak_time[k], requirements.peak[k], 'D', color=colour, markersize=5, zorder=5
    )

    limit = float(requirements.effort_limits[k])
    peak = style.without_rounding(np.abs(requirements.peak))[k]
    low, high = axes.get_ylim()
    # Distant limits are only in the title, because they would flatten the curves.
    if limit < 2.5 * peak:
        for end in (-limit, limit):
            if low - limit < end < high + limit and end * requirements.peak[k] >= 0.0:
                axes.axhline(end, color=style.RED, linestyle='--', linewidth=1.2)
    if peak == 0.0:
        axes.set_ylim(-1.0, 1.0)
    unit = effort_unit(robot, robot.joint_names.index(fine.joint_names[k])).strip()
    words = style.peak_in_words(peak, limit, unit)
    # The name has its own line, because it may be as wide as the panel.
    axes.set_title(f'{name}\npeak {words}', fontsize=9, color=colour, pad=3)
    axes.tick_params(labelsize=8.5)
    axes.locator_params(axis='y', nbins=5)


def _shown(fine: Trajectory, requirements: EffortRequirements, k: int) -> Any:
    """Select the states to draw: evenly spaced states and the peak."""
    count = len(fine.times)
    if count <= style.MOST_POINTS:
        return slice(None)
    peak = int(np.argmax(np.abs(requirements.efforts[:, k])))
    return np.unique(np.append(np.linspace(0, count - 1, style.MOST_POINTS).astype(int), peak))
