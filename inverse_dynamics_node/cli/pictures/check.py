"""The picture of `check`: gravity efforts over the workspace, and the worst pose."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.sizing import PayloadCapacity, Workspace
from ...dynamics.inverse_dynamics import InverseDynamics
from ...report.quantities import effort_unit, number
from ...robot.model import Floats
from .arm import draw_arm
from .style import (
    BLUE,
    DARK,
    fitting,
    GREY,
    legend_below,
    PALE,
    RED,
    save,
    set_title,
    style,
    WIDTH,
)

_BINS = 80
_HALF = 0.42
"""Half of the largest height of a distribution, in rows."""
_REACH = 1.12
"""Ends of a row, as a multiple of the worst effort."""
_MAX_RATIO = 1.2
"""End of the bars, as a multiple of the limit; longer bars are cut."""
_NEGLIGIBLE = 1e-6
"""Efforts smaller than this fraction of the largest one are rounding errors."""
_MOST_BESIDE_ONE_VIEW = 14
"""Number of joints; with more, there is room for a second view of the robot."""


def draw(
    dynamics: InverseDynamics,
    workspace: Workspace,
    payload: PayloadCapacity,
    source: str,
    path: Path,
) -> None:
    """Draw efforts and robot side by side and write them as a PNG; source names the URDF."""
    count = len(workspace.robot.joint_names)
    height = min(40.0, max(4.6, 1.9 + 0.27 * count))
    with style() as pyplot:
        figure = pyplot.figure(figsize=(WIDTH, height))
        rows = 2 if count > _MOST_BESIDE_ONE_VIEW else 1
        grid = figure.add_gridspec(rows, 3, width_ratios=(1.0, 0.38, 1.25))
        _draw_efforts(figure.add_subplot(grid[:, 0]), workspace)
        _draw_ratios(figure.add_subplot(grid[:, 1]), workspace)
        worst = workspace.poses[workspace.worst[workspace.hardest]]
        views = [figure.add_subplot(grid[row, 2]) for row in range(rows)]
        set_title(figure, *_title(workspace, payload, source))
        for view, axes in enumerate(views):
            draw_arm(axes, dynamics, worst, workspace.hardest, payload.link, view)
        handles, labels = views[0].get_legend_handles_labels()
        legend_below(figure, handles, labels, loc='lower right', ncols=4)
        save(figure, path)


def _title(workspace: Workspace, payload: PayloadCapacity, source: str) -> list[str]:
    title = [f'{workspace.robot.name} ({source}): efforts that hold the robot against gravity']
    if payload.joint is not None:
        title.append(f"payload left: {payload.mass:.3g} kg on link '{payload.link}'")
    return title


def _draw_efforts(axes: Any, workspace: Workspace) -> None:
    """Draw the distribution of the efforts of each joint in a row with its own scale."""
    names = workspace.robot.joint_names
    peaks = workspace.peaks
    is_zero = peaks <= _NEGLIGIBLE * np.max(peaks)
    scale = np.where(is_zero, np.inf, peaks)
    marks = workspace.efforts[workspace.worst, range(len(peaks))] / scale
    for i, limit in enumerate(workspace.limits):
        colour = BLUE if np.isfinite(limit) else GREY
        axes.axhline(i, color=PALE, linewidth=0.7, zorder=0)
        if not is_zero[i]:
            _draw_row(axes, i, workspace.efforts[workspace.sampled, i] / scale[i], colour)
        axes.plot([marks[i]], [i], 'D', color=RED if peaks[i] > limit else colour, markersize=4.5)
    labels = [f'{name}  {i}' for i, name in enumerate(fitting(names), 1)]
    axes.set_yticks(range(len(names)), labels)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(-_REACH, _REACH)
    axes.set_xticks([-1.0, 0.0, 1.0], ['-worst', '0', '+worst'])
    axes.grid(axis='y', visible=False)
    axes.set_title('distribution, own scales', fontsize=9)
    axes.tick_params(axis='x', labelsize=8.5)


def _draw_row(axes: Any, row: int, values: Floats, colour: str) -> None:
    counts, edges = np.histogram(values, _BINS, (-_REACH, _REACH))
    half = _HALF * np.sqrt(
        counts / max(1, int(np.max(counts)))
    )  # the root keeps the tails visible
    ends, outline = np.repeat(edges, 2)[1:-1], np.repeat(half, 2)
    # One shape: a bar for each bin of hundreds of joints takes a minute to draw.
    axes.fill_between(ends, row - outline, row + outline, color=colour, alpha=0.45, linewidth=0)


def _draw_ratios(axes: Any, workspace: Workspace) -> None:
    """Draw the ratio of the worst effort of each joint to its limit, with both as text."""
    count = len(workspace.limits)
    for i, (peak, limit) in enumerate(zip(workspace.peaks, workspace.limits, strict=True)):
        is_beyond = bool(peak > limit)
        colour = RED if is_beyond else BLUE
        if np.isfinite(limit):
            axes.barh(i, 1.0, 0.6, color=PALE, zorder=0)
            axes.barh(i, min(peak / limit, _MAX_RATIO), 0.6, color=colour, alpha=0.7)
        axes.text(
            1.04,
            i,
            _in_words(workspace, i),
            transform=axes.get_yaxis_transform(),
            va='center',
            fontsize=8.5,
            color=RED if is_beyond else DARK,
        )
    axes.set_yticks([])
    axes.set_ylim(count - 0.4, -0.6)
    axes.set_xlim(0.0, _MAX_RATIO)
    axes.grid(visible=False)
    axes.set_title('worst / limit', fontsize=9)
    axes.set_xticks([])
    if np.isfinite(workspace.limits).any():
        axes.axvline(1.0, color=RED, linewidth=1.2, linestyle='--')
        axes.set_xticks([1.0], ['100%'])
        axes.tick_params(axis='x', labelsize=8.5)


def _in_words(workspace: Workspace, joint: int) -> str:
    unit, limit = effort_unit(workspace.robot, joint).strip(), float(workspace.limits[joint])
    peak = float(workspace.peaks[joint])
    if peak <= _NEGLIGIBLE * float(np.max(workspace.peaks)):
        peak = 0.0
    of = f'of {number(limit)} {unit}' if np.isfinite(limit) else f'{unit}, no limit'
    return f'{peak:.3g} {of}'
