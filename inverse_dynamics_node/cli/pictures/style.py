"""The style and the common functions of all pictures."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...report.tables import wrapped
from ...robot.model import Floats
from ..console import new_file

BLUE, ORANGE, GREEN = '#0072B2', '#E69F00', '#009E73'
PINK, SKY, RED = '#CC79A7', '#56B4E9', '#D55E00'
"""The palette of Okabe and Ito, which is suitable for colour-blind readers."""
GREY, PALE, DARK = '#8a8a8a', '#dddddd', '#333333'
MEASURED = {'color': GREY, 'linewidth': 3.2, 'alpha': 0.55}
"""Look of measured values: a wide line, because other lines are drawn over it."""
_COLOURS = (BLUE, ORANGE, GREEN, PINK, SKY, RED, DARK)
_DASHES = ('-', '--', ':', '-.')
"""Together with seven colours, four line styles distinguish 28 joints."""
WIDTH = 9.0
"""Width of a picture [inch]; at 100 dots per inch, the text is legible in a README."""
_MOST_HEIGHT = 60.0  # [inch]
DPI = 100
MOST_POINTS = 1500
"""Approximate number of points in a line; more points would not be visible."""
_SHORTEST_GAP = 0.2
"""Shortest gap in time that breaks a line [s]."""
_TITLE_LETTERS = 105
"""Largest number of letters in a line of the title."""
_TITLE_LINES = 5
"""Largest number of lines in the title; an ellipsis replaces the rest."""

_HOW_TO_GET_PICTURES = (
    "To get pictures, run 'sudo apt install python3-matplotlib', or 'pip install matplotlib' in a "
    'virtual environment; --no-picture turns this note off.'
)

_STYLE = {
    'axes.edgecolor': GREY,
    'axes.grid': True,
    'axes.labelcolor': DARK,
    'axes.spines.right': False,
    'axes.spines.top': False,
    'axes.titlelocation': 'left',
    'axes.titlesize': 11,
    'figure.constrained_layout.use': True,
    'font.size': 10,
    'grid.color': PALE,
    'grid.linewidth': 0.7,
    'legend.fontsize': 9,
    'legend.frameon': False,
    'lines.linewidth': 1.6,
    'savefig.dpi': DPI,
    'text.color': DARK,
    'xtick.color': DARK,
    'ytick.color': DARK,
}


@contextmanager
def styled_pyplot() -> Iterator[Any]:
    """Apply the style in the ``with`` block; yield pyplot, set up to open no windows."""
    from cycler import cycler
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    cycle = cycler(linestyle=_DASHES) * cycler(color=_COLOURS)
    with matplotlib.rc_context({**_STYLE, 'axes.prop_cycle': cycle}):
        try:
            yield pyplot
        finally:
            pyplot.close('all')


def panels(pyplot: Any, count: int, columns: int, row_height: float) -> tuple[Any, Any]:
    """Return a figure, and `count` panels with a common time axis; `row_height` is in inches."""
    rows = -(-count // columns)
    figure, grid = pyplot.subplots(
        rows,
        columns,
        sharex=True,
        squeeze=False,
        figsize=(WIDTH, min(_MOST_HEIGHT, 1.3 + row_height * rows)),
    )
    for axes in grid.flat[count:]:
        axes.set_visible(False)
    for axes in grid.flat[max(0, count - columns) : count]:
        axes.tick_params(labelbottom=True)
    for axes in grid[-1]:
        axes.set_xlabel('time [s]')
    return figure, grid.flat[:count]


def elided(text: str, size: int) -> str:
    """Replace the middle of a long text with "…", because names differ at the start or end."""
    head = (size - 1) // 2
    return text if len(text) <= size else f'{text[:head]}…{text[len(text) - (size - 1 - head) :]}'


def all_elided(names: Sequence[str], size: int) -> list[str]:
    """Shorten names, unless two of them would become equal."""
    short = [elided(name, size) for name in names]
    return short if len(set(short)) == len(set(names)) else list(names)


def set_title(figure: Any, *paragraphs: str) -> None:
    """Wrap the paragraphs of a title, and write the title of a figure."""
    lines = [line for text in paragraphs for line in wrapped(text, _TITLE_LETTERS)]
    shown = [*lines[:_TITLE_LINES], *['...'] * (len(lines) > _TITLE_LINES)]
    figure.suptitle('\n'.join(shown), x=0.01, ha='left', fontsize=11)


def try_to_draw(
    draw: Callable[[Path], None], options: argparse.Namespace, default: str
) -> Path | None:
    """
    Draw a picture unless --no-picture is given; return the path of the picture, or None.

    Without matplotlib, print a note, or raise ModuleNotFoundError if --picture is given.
    """
    if options.no_picture:
        return None
    path = options.picture or Path(default)
    try:
        write_picture(draw, path)
    except ModuleNotFoundError as error:
        if options.picture:
            raise
        print(f'no picture: matplotlib cannot be imported ({error}). {_HOW_TO_GET_PICTURES}')
        return None
    return path


def write_picture(draw: Callable[[Path], None], path: Path) -> None:
    """Draw a picture and write it; without matplotlib, raise ModuleNotFoundError."""
    try:
        with new_file(path) as temporary:
            draw(temporary)
    except ImportError as error:  # matplotlib may be built for another version of numpy
        raise ModuleNotFoundError(str(error), name='matplotlib') from error


def draw_lines(axes: Any, times: Floats, values: Floats, names: Sequence[str]) -> None:
    """Draw a labelled line over time for each column of `values`."""
    axes.plot(times, values, linewidth=1.2, label=all_elided(names, 22))
    axes.margins(x=0.0)


def draw_signals(
    axes: Any, times: Floats, column: int, signals: Iterable[tuple[Floats, dict[str, Any]]]
) -> list[Any]:
    """Draw one column of each array in `signals`, each with its own look; return the lines."""
    return [axes.plot(*thinned(times, values[:, column]), **look)[0] for values, look in signals]


def thinned(times: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Reduce the number of points, and break the line at every gap in time."""
    step = max(1, len(times) // MOST_POINTS)
    t, y = times[::step], values[::step].copy()
    gap = max(_SHORTEST_GAP, 1.5 * step * np.median(np.diff(times)))
    y[np.flatnonzero(np.diff(t) > gap)] = np.nan
    return t, y


def fewer_ticks(*axes: Any) -> None:
    """Use small labels, few ticks and narrow margins."""
    for ax in axes:
        ax.tick_params(labelsize=8.5)
        ax.locator_params(axis='y', nbins=4)
        ax.margins(x=0.01)


def legend_below(
    figure: Any, handles: Sequence[Any], labels: Sequence[str], **options: Any
) -> None:
    """Place a legend below all axes, and make room for it, because matplotlib 3.6 does not."""
    legend = figure.legend(handles, labels, **{'loc': 'lower center', **options})
    height = legend.get_window_extent().height / figure.bbox.height
    figure.get_layout_engine().set(rect=(0.0, height, 1.0, 1.0 - height))
