"""The picture of `identify`: residuals, masses, and efforts of three models for unseen data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.identification import IdentificationResult
from . import style

_MOST_ROWS = 8
"""With more joints than this, only the joints with the largest residuals are drawn."""
_LOOKS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ('measured', 'measured', style.MEASURED),
    ('urdf', 'URDF', {'color': style.BLUE, 'linewidth': 0.9}),
    ('friction', 'URDF with fitted friction', {'color': style.ORANGE, 'linewidth': 0.9}),
    ('identified', 'identified', {'color': style.GREEN, 'linewidth': 1.2}),
)


def draw(result: IdentificationResult, source: str, path: Path) -> None:
    """Draw efforts, residuals and masses, and write the picture."""
    shown = _shown(result)
    with style.styled_pyplot() as pyplot:
        height = max(4.6, 1.3 + 1.15 * len(shown))
        figure = pyplot.figure(figsize=(style.WIDTH, height))
        grid = figure.add_gridspec(1, 2, width_ratios=(1.6, 1.0))
        left = grid[0].subgridspec(len(shown), 1)
        right = grid[1].subgridspec(2, 1)
        lines: list[Any] = []
        axes: list[Any] = []
        for row, joint in enumerate(shown):
            ax = figure.add_subplot(left[row], sharex=axes[0] if axes else None)
            lines = _draw_efforts(ax, result, joint)
            ax.tick_params(labelbottom=row == len(shown) - 1)
            axes.append(ax)
        axes[-1].set_xlabel('time in the unseen data [s]')
        figure.align_ylabels(axes)
        _draw_residuals(figure.add_subplot(right[0]), result)
        _draw_masses(figure.add_subplot(right[1]), result)
        style.set_title(figure, source, f'{result.verdict}.')
        style.legend_below(figure, lines, [label for _, label, _ in _LOOKS], ncols=4)
        figure.savefig(path)


def _shown(result: IdentificationResult) -> list[int]:
    """Return the indices of the joints to draw, in ascending order."""
    worst = sorted(range(len(result.joints)), key=lambda j: -result.joints[j].unseen.urdf)
    return sorted(worst[:_MOST_ROWS])


def _draw_efforts(ax: Any, result: IdentificationResult, joint: int) -> list[Any]:
    unseen, found = result.unseen, result.joints[joint]
    signals = [(getattr(unseen, name), look) for name, _, look in _LOOKS]
    lines = style.draw_signals(ax, unseen.times, joint, signals)
    ax.set_title(style.elided(found.name, 40), fontsize=9.5, pad=3)
    residuals = found.unseen
    text = (
        f'RMS residual: {residuals.urdf:.2g}, {residuals.friction:.2g}, {residuals.identified:.2g}'
    )
    ax.set_title(text, loc='right', fontsize=8.5, pad=3, color=style.GREY)
    ax.set_ylabel('[N]' if found.is_prismatic else '[N m]', fontsize=9)
    style.fewer_ticks(ax)
    return lines


def _draw_residuals(ax: Any, result: IdentificationResult) -> None:
    """Draw the residual of each model, relative to the measured effort."""
    joints = result.joints
    places = np.arange(len(joints))
    measured = np.array([max(joint.measured, 1e-9) for joint in joints])
    noise = np.array([joint.noise for joint in joints]) / measured
    ratios = [
        np.array([getattr(joint.unseen, name) for joint in joints]) / measured
        for name, _, _ in _LOOKS[1:]
    ]
    for k, (ratio, (_, _, look)) in enumerate(zip(ratios, _LOOKS[1:], strict=True)):
        ax.barh(places + 0.26 * (k - 1), ratio, 0.24, color=look['color'], log=True)
    ax.vlines(noise, places - 0.4, places + 0.4, color='black', linewidth=1.0)
    # The residuals of the models differ by powers of ten.
    ax.set_xlim(0.5 * max(1e-4, min(noise.min(), np.min(ratios))), 2.0 * max(1.0, np.max(ratios)))
    ax.set_yticks(places, style.all_elided([joint.name for joint in joints], 16), fontsize=8.5)
    ax.invert_yaxis()
    ax.grid(axis='y', visible=False)
    ax.set_title('RMS residual / measured (black: noise)', fontsize=9.5, pad=3)
    ax.tick_params(labelsize=8.5)


def _draw_masses(ax: Any, result: IdentificationResult) -> None:
    bodies = result.bodies
    places = np.arange(len(bodies))
    before = [body.mass_before for body in bodies]
    after = [body.mass for body in bodies]
    errors = [body.mass_error for body in bodies]
    ax.barh(places - 0.2, before, 0.36, color=style.BLUE)
    ax.barh(places + 0.2, after, 0.36, color=style.GREEN, alpha=1.0 if result.accepted else 0.35)
    ax.errorbar(after, places + 0.2, xerr=errors, fmt='none', ecolor='black', elinewidth=1.0,
                capsize=2.0)  # fmt: skip
    ax.set_xlim(0.0, 1.15 * max(*before, *after, 1e-9))
    names = style.all_elided([body.link for body in bodies], 16)
    ax.set_yticks(places, names, fontsize=8.5)
    ax.invert_yaxis()
    ax.grid(axis='y', visible=False)
    rejected = '' if result.accepted else ', not accepted'
    ax.set_title(f'Mass [kg]{rejected}', fontsize=9.5, pad=3)
    ax.tick_params(labelsize=8.5)
