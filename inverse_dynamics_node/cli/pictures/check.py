"""The picture of `check`: gravity efforts over the workspace."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.sizing import PayloadCapacity, Workspace
from ...report.tables import effort_unit
from ...robot.model import Floats
from . import style

_BINS = 80
_HALF = 0.42
"""Half the height of a distribution at its peak, as a fraction of the row height."""
_REACH = 1.12
"""The effort axis ends at this multiple of the worst effort."""
_MAX_RATIO = 1.2
"""Bars are cut at this multiple of the limit."""


def draw(workspace: Workspace, payload: PayloadCapacity, source: str, path: Path) -> None:
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
    axes.set_yticks(range(len(names)), style.all_shortened(names, 26))
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
