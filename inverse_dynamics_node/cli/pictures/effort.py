"""The picture of `effort`: efforts of every joint over time, and their limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.sizing import EffortRequirements
from ...dynamics.trajectory import Trajectory
from ...report.tables import effort_unit
from ...robot.model import RobotModel
from . import style

_PARTS = {
    'gravity': style.GREEN,
    'inertial': style.ORANGE,
    'coriolis': style.PINK,
    'friction': style.GREY,
}
_LABELS = {'inertial': 'inertia', 'coriolis': 'velocity'}
_NAME_LETTERS = {1: 80, 2: 50, 3: 32}
"""Largest number of letters in a name above a panel, for each number of columns."""


def draw(
    robot: RobotModel, fine: Trajectory, requirements: EffortRequirements, title: str, path: Path
) -> None:
    """Draw a panel for each joint, and write the picture."""
    m = len(fine.joint_names)
    columns = 1 if m == 1 else 2 if m <= 12 else 3
    names = style.all_shortened(fine.joint_names, _NAME_LETTERS[columns])
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
