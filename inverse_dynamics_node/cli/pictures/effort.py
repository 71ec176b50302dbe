"""The picture of `effort`: the efforts of each joint over time, with their terms."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.sizing import EffortRequirements
from ...report.tables import effort_unit, number
from ...robot.model import RobotModel
from . import style

_TERMS = {
    'gravity': style.GREEN,
    'inertia': style.ORANGE,
    'velocity': style.PINK,
    'friction': style.GREY,
}
_NEGLIGIBLE = 1e-6
"""Peaks smaller than this fraction of the largest peak are rounding errors."""
_NAME_LETTERS = {1: 80, 2: 50, 3: 32}
"""Largest number of letters in a name above a panel, for each number of columns."""


def draw_requirements(
    robot: RobotModel, requirements: EffortRequirements, title: str, path: Path
) -> None:
    """Draw a panel for each joint, and write the picture."""
    joints = requirements.trajectory.joint_names
    m = len(joints)
    columns = 1 if m == 1 else 2 if m <= 12 else 3
    names = style.all_elided(joints, _NAME_LETTERS[columns])
    with style.styled_pyplot() as pyplot:
        figure, panels = style.panels(pyplot, m, columns, 1.7 if m > 2 else 2.3)
        for k, axes in enumerate(panels):
            unit = effort_unit(robot, robot.joint_names.index(joints[k])).strip()
            _draw_joint(axes, requirements, k, names[k], unit)
        style.legend_below(figure, *panels[0].get_legend_handles_labels(), ncols=6)
        style.set_title(figure, *title.splitlines())
        figure.savefig(path)


def _draw_joint(axes: Any, requirements: EffortRequirements, k: int, name: str, unit: str) -> None:
    times, terms = requirements.trajectory.times, requirements.terms
    shown = slice(None, None, max(1, len(times) // style.MOST_POINTS))
    parts = terms.gravity, terms.inertial, terms.coriolis, terms.friction
    for (label, colour), part in zip(_TERMS.items(), parts, strict=True):
        if label != 'friction' or np.any(part):
            axes.plot(times[shown], part[shown, k], color=colour, linewidth=1.1, label=label)
    efforts = requirements.efforts[shown, k]
    axes.plot(times[shown], efforts, color=style.BLUE, linewidth=2.0, label='effort')
    limit = float(requirements.effort_limits[k])
    peak = abs(float(requirements.peak[k]))
    if peak <= _NEGLIGIBLE * np.max(np.abs(requirements.peak)):
        peak = 0.0
    colour = style.RED if requirements.is_beyond['effort'][k] else style.BLUE
    axes.plot(
        requirements.peak_time[k], requirements.peak[k], 'D', color=colour, markersize=5, zorder=5
    )
    # Distant limits are only in the title, because they would flatten the curves.
    if limit < 2.5 * peak:
        end = float(np.copysign(limit, requirements.peak[k]))
        axes.axhline(end, color=style.RED, linestyle='--', linewidth=1.2)
    if peak == 0.0:
        axes.set_ylim(-1.0, 1.0)
    # The name has its own line, because it may be as wide as the panel.
    words = f'{peak:.3g} {unit}, no limit'
    if limit < math.inf:
        words = f'{peak:.3g} of {number(limit)} {unit}'
    axes.set_title(f'{name}\npeak {words}', fontsize=9, color=colour, pad=3)
    axes.tick_params(labelsize=8.5)
    axes.locator_params(axis='y', nbins=5)
