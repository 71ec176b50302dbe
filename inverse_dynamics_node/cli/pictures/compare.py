"""The pictures of `compare` and `payload`: measured and modelled efforts over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...analysis.diagnosis import ComparisonResult
from ...analysis.payload import PayloadEstimate
from ...report.compare_report import percent
from ...report.diagnosis_text import amount
from . import style

_MOST_ROWS = 10
"""With more joints than this, every joint has a small panel instead of a row."""
_ACROSS = 3
_NAME_LETTERS = 18
"""Largest number of letters in a name above a small panel."""


def draw(result: ComparisonResult, source: str, title: str, path: Path) -> None:
    """Draw all joints, and write the picture."""
    count = len(result.joints)
    with style.styled_pyplot() as pyplot:
        if count <= _MOST_ROWS:
            figure, lines = _rows(pyplot, result)
        else:
            figure, lines = _small(pyplot, result)
        style.set_title(figure, source, title)
        style.legend_below(figure, lines, _labels(result), ncols=3)
        figure.savefig(path)


def _labels(result: ComparisonResult) -> list[str]:
    corrections = ' and corrections' if result.faults else ''
    return ['measured', 'modelled', f'modelled, with fitted friction{corrections}']


def _rows(pyplot: Any, result: ComparisonResult) -> tuple[Any, list[Any]]:
    """Draw a row for each joint, with the efforts and their difference."""
    count = len(result.joints)
    figure, axes = pyplot.subplots(
        count,
        2,
        sharex=True,
        squeeze=False,
        figsize=(style.WIDTH, 1.3 + max(1.15, 2.2 / count) * count),
        width_ratios=(1.6, 1.0),
    )
    names = style.all_elided([joint.name for joint in result.joints], 40)
    for c, (left, right) in enumerate(axes):
        joint = result.joints[c]
        lines = _draw_efforts(left, result, c)
        _draw_difference(right, result, c)
        left.set_ylabel('[N]' if joint.is_prismatic else '[N m]', fontsize=9)
        left.set_title(names[c], fontsize=9.5, pad=3)
        residuals = f'{joint.rms_residual:.3g}, {amount(joint.rms_corrected, joint.is_prismatic)}'
        explained = percent(joint.explained_corrected)
        left.set_title(
            f'RMS residual {residuals} (explained {explained})',
            loc='right',
            fontsize=8.5,
            pad=3,
            color=style.GREY,
        )
        style.fewer_ticks(left, right)
    axes[0, 1].set_title('measured minus modelled', fontsize=9.5, pad=3)
    for ax in axes[-1]:
        ax.set_xlabel('time [s]')
    figure.align_ylabels(axes[:, 0])
    return figure, lines


def _small(pyplot: Any, result: ComparisonResult) -> tuple[Any, list[Any]]:
    """Draw a small panel for each joint, with efforts only."""
    figure, panels = style.panels(pyplot, len(result.joints), _ACROSS, 1.15)
    names = style.all_elided([joint.name for joint in result.joints], _NAME_LETTERS)
    for c, ax in enumerate(panels):
        joint = result.joints[c]
        lines = _draw_efforts(ax, result, c)
        ax.set_title(f'{names[c]} [{"N" if joint.is_prismatic else "N m"}]', fontsize=8.5, pad=3)
        ax.set_title(
            f'RMS {joint.rms_corrected:.2g}', loc='right', fontsize=8, pad=3, color=style.GREY
        )
        style.fewer_ticks(ax)
    return figure, lines


def _draw_efforts(ax: Any, result: ComparisonResult, c: int) -> list[Any]:
    """Draw the measured efforts as a wide line, with the modelled efforts on top."""
    signals = (
        (result.measured, style.MEASURED),
        (result.modelled, {'color': style.BLUE, 'linewidth': 1.1}),
        (result.corrected, {'color': style.ORANGE, 'linewidth': 1.1}),
    )
    return style.draw_signals(ax, result.motion.times, c, signals)


def _draw_difference(ax: Any, result: ComparisonResult, c: int) -> None:
    measured, times = result.measured[:, c], result.motion.times
    for modelled, colour in ((result.modelled, style.BLUE), (result.corrected, style.ORANGE)):
        difference = style.thinned(times, measured - modelled[:, c])
        ax.plot(*difference, color=colour, linewidth=0.9)


def draw_payload(result: PayloadEstimate, source: str, title: str, path: Path) -> None:
    """Draw the efforts of all joints over time, and write the picture."""
    names = style.all_elided(result.joint_names, 40)
    signals = (
        (result.measured, style.MEASURED),
        (result.fitted, {'color': style.BLUE, 'linewidth': 1.1}),
    )
    with style.styled_pyplot() as pyplot:
        figure, panels = style.panels(pyplot, len(names), 1, 1.15)
        for j, ax in enumerate(panels):
            lines = style.draw_signals(ax, result.times, j, signals)
            ax.set_title(names[j], fontsize=9.5, pad=3)
            ax.set_ylabel('[N m, N]', fontsize=9)
        style.set_title(figure, source, title)
        labels = ['measured minus empty arm', 'fitted payload']
        style.legend_below(figure, lines, labels, ncols=2)
        figure.savefig(path)
