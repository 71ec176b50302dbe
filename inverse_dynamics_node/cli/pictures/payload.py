"""The picture of `payload`: the measured and the fitted efforts of the payload."""

from __future__ import annotations

from pathlib import Path

from ...analysis.payload import PayloadEstimate
from . import style


def draw(result: PayloadEstimate, source: str, title: str, path: Path) -> None:
    """Draw the efforts of all joints over time, and write the picture."""
    names = style.all_shortened(result.joint_names, 40)
    marks = {'marker': 'o', 'linestyle': ''} if result.poses else {}
    signals = (
        (result.measured, {**style.MEASURED, **marks}),
        (result.fitted, {'color': style.BLUE, 'linewidth': 1.1, **marks}),
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
