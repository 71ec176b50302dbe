"""The picture of the scenario `calibrate`: tracking errors before and after."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...robot.model import Floats
from ...simulation.demo.commander import History
from .style import (
    BLUE,
    COLOURS,
    fitting,
    GREY,
    legend_below,
    ORANGE,
    save,
    set_title,
    style,
    WIDTH,
)

_DASHES = ('-', '--', ':', '-.')
_MOST_POINTS = 1500


def draw(
    names: tuple[str, ...],
    histories: tuple[History, History],
    errors: tuple[Floats, Floats],
    title: str,
    path: Path,
) -> None:
    """
    Draw the errors of all joints over time at one scale, and their root mean squares.

    Parameters
    ----------
    names : tuple of str
        The n joints.
    histories : tuple of two History
        Recorded with the URDF, and with the calibrated one.
    errors : tuple of two ndarrays, shape (n,)
        Root mean square errors of both [rad or m].
    title : str
        Title of the picture.
    path : pathlib.Path
        File to write.

    """
    with style() as pyplot:
        figure = pyplot.figure(figsize=(WIDTH, max(5.2, 2.6 + 0.3 * len(names))))
        halves = figure.add_gridspec(1, 2, width_ratios=(1.7, 1.0))
        rows = halves[0].subgridspec(2, 1)
        axes: Any = None
        for row, (history, label) in enumerate(
            zip(histories, ('with the URDF', 'with the calibrated URDF'), strict=True)
        ):
            axes = figure.add_subplot(rows[row], sharex=axes, sharey=axes)
            _draw_errors(axes, history, names)
            axes.set_title(label, fontsize=10)
            axes.set_ylabel('error [mrad, mm]', fontsize=9)
            axes.tick_params(labelbottom=row == 1, labelsize=8.5)
        axes.set_xlabel('time [s]')
        handles, labels = axes.get_legend_handles_labels()
        bars = figure.add_subplot(halves[1])
        _draw_bars(bars, names, errors)
        more = bars.get_legend_handles_labels()
        set_title(figure, title)
        legend_below(figure, [*handles, *more[0]], [*labels, *more[1]], ncols=5)
        save(figure, path)


def _draw_errors(axes: Any, history: History, names: tuple[str, ...]) -> None:
    times, rows = history.states.times, history.states.rows
    shown = slice(None, None, max(1, len(times) // _MOST_POINTS))
    errors = 1000.0 * (rows[shown, 1] - rows[shown, 0])
    for k, name in enumerate(fitting(names, 22)):
        axes.plot(
            times[shown],
            errors[:, k],
            color=COLOURS[k % len(COLOURS)],
            linestyle=_DASHES[k // len(COLOURS) % len(_DASHES)],
            linewidth=1.2,
            label=name,
        )
    axes.margins(x=0.0)


def _draw_bars(axes: Any, names: tuple[str, ...], errors: tuple[Floats, Floats]) -> None:
    """Draw the errors of every joint as two bars, with the ratio as text."""
    before, after = (1000.0 * values for values in errors)
    places = np.arange(len(names))
    axes.barh(places - 0.18, before, 0.34, color=ORANGE, label='RMS with the URDF')
    axes.barh(places + 0.18, after, 0.34, color=BLUE, label='RMS with the calibrated URDF')
    for place, first, second in zip(places, before, after, strict=True):
        text = f' {first / max(second, 1e-9):.3g} times'
        axes.text(first, place - 0.18, text, va='center', fontsize=8.5, color=GREY)
    axes.set_xscale('log')
    axes.set_xlim(0.5 * float(np.min(after)), 8.0 * float(np.max(before)))
    axes.set_yticks(places, fitting(names, 22), fontsize=8.5)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlabel('RMS error [mrad, mm]', fontsize=9)
    axes.grid(axis='y', visible=False)
