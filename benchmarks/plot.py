"""The plot of computing time over the number of joints."""

from __future__ import annotations

from pathlib import Path

from .growth import FROM_PYTHON, Growth, KEPT, MULTIPLIED, NEWTON_EULER
from .peers import REFERENCE

# Colours (of Okabe and Ito's palette, which colour-blind readers can distinguish) and labels.
LINES = {
    MULTIPLIED: ('#CC79A7', 'Lagrange,\nmultiplied out'),
    KEPT: ('#D55E00', 'Lagrange,\nderivatives kept'),
    REFERENCE: ('#0072B2', 'pin.rnea, from Python'),
    FROM_PYTHON: ('#56B4E9', 'ours, from Python'),
    NEWTON_EULER: ('#009E73', 'Newton-Euler (ours),\nno call'),
}
END = {REFERENCE: 10, FROM_PYTHON: 6, NEWTON_EULER: -16}  # label offsets [points]


def draw(growth: dict[str, Growth], path: Path) -> None:
    """Draw time over the number of joints on logarithmic axes."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot, ticker

    figure, axes = pyplot.subplots(figsize=(9, 5.5), layout='constrained')
    for name, (colour, label) in LINES.items():
        if name not in growth:
            continue
        n, seconds, _ = growth[name]
        axes.loglog(n, seconds, 'o-', color=colour, markersize=4, linewidth=1.8)
        axes.annotate(
            label,
            (n[-1], seconds[-1]),
            xytext=(8, END.get(name, 0)),
            textcoords='offset points',
            color=colour,
            va='center',
        )
    axes.set_xlim(1.8, 1500)
    axes.set_xticks([2, 6, 12, 24, 50, 100, 200, 400])
    axes.xaxis.set_major_formatter(ticker.ScalarFormatter())
    axes.xaxis.set_minor_locator(ticker.NullLocator())
    axes.set_yticks([10.0**k for k in range(-7, 0)])
    axes.set_yticklabels(['0.1 µs', '1 µs', '10 µs', '0.1 ms', '1 ms', '10 ms', '0.1 s'])
    axes.set_xlabel('joints of a chain, every third of them sliding')
    axes.set_title('Time of one evaluation', loc='left')
    axes.grid(color='#dddddd')
    axes.spines[['top', 'right']].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
