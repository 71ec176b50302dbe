"""The picture of `payload`: the measured and the fitted efforts of the payload."""

from __future__ import annotations

from pathlib import Path

from ...analysis.payload import PayloadEstimate
from . import style

_POINTS = 1500


def draw(result: PayloadEstimate, source: str, title: str, path: Path) -> None:
    """Draw the efforts of all joints over time, and write the picture."""
    count = len(result.joint_names)
    names = style.fitting(list(result.joint_names), 40)
    marks = {'marker': 'o', 'linestyle': ''} if result.poses else {}
    with style.styled_pyplot() as pyplot:
        figure, axes = pyplot.subplots(
            count, sharex=True, squeeze=False, figsize=(style.WIDTH, 1.3 + 1.15 * count)
        )
        for j, ax in enumerate(axes[:, 0]):
            lines = [
                ax.plot(*style.thinned(result.times, values[:, j], _POINTS), **look, **marks)[0]
                for values, look in (
                    (result.measured, {'color': style.GREY, 'linewidth': 3.2, 'alpha': 0.55}),
                    (result.fitted, {'color': style.BLUE, 'linewidth': 1.1}),
                )
            ]
            ax.set_title(names[j], fontsize=9.5, pad=3)
            ax.set_ylabel('[N m, N]', fontsize=9)
        axes[-1, 0].set_xlabel('time [s]')
        style.set_title(figure, source, title)
        labels = ['measured minus empty arm', 'fitted payload']
        style.legend_below(figure, lines, labels, ncols=2)
        style.save(figure, path)
