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
_LEAST_OF_LIMIT, _LEAST_OF_PEAKS = 0.02, 1e-6
"""An axis covers at least this fraction of the limit, or else of the largest peak."""
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
    is_beyond = requirements.is_beyond['effort'][k]
    place = requirements.peak_time[k], requirements.peak[k]
    axes.plot(*place, 'D', color=style.RED if is_beyond else style.BLUE, markersize=5, zorder=5)
    # Distant limits are only in the title, because they would flatten the curves.
    if limit < 2.5 * peak:
        end = float(np.copysign(limit, requirements.peak[k]))
        axes.axhline(end, color=style.RED, linestyle='--', linewidth=1.2)
    is_limited = limit < math.inf
    least = _LEAST_OF_PEAKS * float(np.max(np.abs(requirements.peak))) or 1.0
    least = _LEAST_OF_LIMIT * limit if is_limited else least
    if peak < least:
        axes.set_ylim(-least, least)
    # The name has its own line, because it may be as wide as the panel.
    words = (
        f'{peak:.3g} of {number(limit)} {unit}' if is_limited else f'{peak:.3g} {unit}, no limit'
    )
    colour = style.RED if is_beyond else style.DARK
    axes.set_title(f'{name}\npeak {words}', fontsize=9, color=colour, pad=3)
    axes.tick_params(labelsize=8.5)
    axes.locator_params(axis='y', nbins=5)
