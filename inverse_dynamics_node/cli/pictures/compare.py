"""The pictures of `compare` and `payload`: measured and modelled efforts over time."""

from __future__ import annotations

from pathlib import Path

from ...analysis.diagnosis import ComparisonResult
from ...analysis.payload import PayloadEstimate
from . import style

_ROW = 1.3  # [inch], height of the panels of a joint


def draw(result: ComparisonResult, source: str, title: str, path: Path) -> None:
    """Draw the efforts of all joints and their differences, and write the picture."""
    times, joints = result.motion.times, result.joints
    names = style.all_elided([joint.name for joint in joints], 40)
    looks = [{'color': colour, 'linewidth': 1.1} for colour in (style.BLUE, style.ORANGE)]
    modelled = result.modelled, result.corrected
    signals = [(result.measured, style.MEASURED), *zip(modelled, looks, strict=True)]
    with style.styled_pyplot() as pyplot:
        figure, panels = style.panels(pyplot, 2 * len(joints), 2, _ROW)
        for c, joint in enumerate(joints):
            left, right = panels[2 * c], panels[2 * c + 1]
            lines = style.draw_signals(left, times, c, signals)
            differences = [(result.measured - x, look) for x, look in signals[1:]]
            style.draw_signals(right, times, c, differences)
            left.set_title(f'{names[c]} [{"N" if joint.is_prismatic else "N m"}]', fontsize=9.5)
            right.set_title('measured minus modelled', fontsize=9.5)
            right.set_title(
                f'RMS {joint.rms_residual:.3g}, {joint.rms_corrected:.3g}',
                loc='right',
                fontsize=8.5,
                color=style.GREY,
            )
            style.fewer_ticks(left, right)
        style.set_title(figure, source, title)
        corrections = ' and corrections' if result.faults else ''
        labels = ['measured', 'modelled', f'modelled, with fitted friction{corrections}']
        style.legend_below(figure, lines, labels, ncols=3)
        figure.savefig(path)


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
