"""The picture of `check`: gravity efforts over the workspace, and the arm where they are worst."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..dynamics import InverseDynamics
from ..model import Floats
from ..report import decimals, effort_unit, number
from ..workspace import Payload, Workspace
from .arm_picture import draw_arm
from .pictures import BLUE, DARK, fitting, GREY, PALE, RED, save, style, WIDTH

_BINS = 80
_HALF = 0.42
"""Of the height of a row that a distribution may take."""
_FARTHEST = 1.6
"""Times the limit: what is further beyond is drawn there."""


def draw(dynamics: InverseDynamics, workspace: Workspace, payload: Payload, path: Path) -> None:
    """Draw both halves side by side and write them as a PNG."""
    robot = workspace.robot
    height = min(40.0, max(4.4, 1.6 + 0.27 * len(robot.joint_names)))
    with style() as pyplot:
        figure, (left, right) = pyplot.subplots(
            1, 2, figsize=(WIDTH, height), width_ratios=(1.15, 1.0)
        )
        _draw_efforts(left, workspace)
        worst = workspace.poses[workspace.worst[workspace.hardest]]
        draw_arm(right, dynamics, worst, workspace.hardest, payload.link)
        figure.suptitle(_title(workspace, payload), x=0.01, ha='left', fontsize=12)
        figure.legend(*right.get_legend_handles_labels(), loc='outside lower right', ncols=4)
        save(figure, path)


def _title(workspace: Workspace, payload: Payload) -> str:
    title = f'{workspace.robot.name}: what gravity asks of the joints'
    if payload.joint is None:
        return title
    return f'{title}; {payload.mass:.3g} kg payload left at {payload.link}'


def _draw_efforts(axes: Any, workspace: Workspace) -> None:
    """Draw a row for each joint: how often it needs how much of its limit."""
    robot, limits = workspace.robot, workspace.limits
    is_limited = np.isfinite(limits)
    numbered = [f'{name}  {i}' for i, name in enumerate(fitting(robot.joint_names), 1)]
    scale = np.ones_like(limits)
    if is_limited.any():  # else there is nothing to take shares of
        scale = np.where(is_limited, limits, np.maximum(workspace.peaks, 1e-300))
    peaks = workspace.efforts[workspace.worst, range(len(limits))] / scale
    shares = workspace.efforts[workspace.sampled] / scale
    furthest = max(1.05 if is_limited.any() else 0.0, 1.08 * float(np.max(np.abs(peaks))))
    reach = min(furthest, _FARTHEST) if is_limited.any() else max(furthest, 1e-3)
    for i, limit in enumerate(limits):
        colour = BLUE if np.isfinite(limit) else GREY
        is_beyond = abs(peaks[i]) * scale[i] > limit
        _draw_row(axes, i, shares[:, i], reach, colour)
        mark = np.clip(peaks[i], -0.99 * reach, 0.99 * reach)
        axes.plot([mark], [i], 'D', color=RED if is_beyond else colour, markersize=4.5)
        axes.text(
            1.02,
            i,
            _in_words(workspace, i),
            transform=axes.get_yaxis_transform(),
            va='center',
            fontsize=8.5,
            color=RED if is_beyond else DARK,
        )
    axes.set_yticks(range(len(limits)), numbered)
    axes.set_ylim(len(limits) - 0.4, -0.6)
    axes.set_xlim(-reach, reach)
    axes.grid(axis='y', visible=False)
    _draw_limits(axes, bool(is_limited.any()), bool(is_limited.all()))


def _draw_row(axes: Any, row: int, values: Floats, reach: float, colour: str) -> None:
    counts, edges = np.histogram(np.clip(values, -reach, reach), _BINS, (-reach, reach))
    half = _HALF * np.sqrt(counts / max(1, int(np.max(counts))))  # roots: tails stay visible
    middles = 0.5 * (edges[:-1] + edges[1:])
    axes.axhline(row, color=PALE, linewidth=0.7, zorder=0)
    width = edges[1] - edges[0]
    axes.bar(middles, 2.0 * half, width, row - half, color=colour, alpha=0.45, linewidth=0)


def _draw_limits(axes: Any, any_limit: bool, all_limits: bool) -> None:
    title = 'how often which effort (width), and the worst (◆)'
    axes.set_title(title, fontsize=9.5)
    if not any_limit:
        axes.set_xlabel('gravity effort [N m, N]; no effort limits in the URDF')
        return
    from matplotlib.ticker import PercentFormatter

    for end in (-1.0, 1.0):
        axes.axvline(end, color=RED, linewidth=1.2, linestyle='--')
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    rest = '' if all_limits else '; grey: of its worst, no limit'
    axes.set_xlabel(f'gravity effort [% of the effort limit{rest}]')


def _in_words(workspace: Workspace, joint: int) -> str:
    places = min(decimals(workspace.peaks, 3), 3)
    unit, limit = effort_unit(workspace.robot, joint).strip(), workspace.limits[joint]
    of = f' of {number(limit)}' if np.isfinite(limit) else ''
    return f'{workspace.peaks[joint]:.{places}f}{of} {unit}'
