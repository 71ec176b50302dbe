"""The pictures of `demo`: a run with its events, and the errors before and after a calibration."""

from __future__ import annotations

from itertools import pairwise
import math
from pathlib import Path
from typing import Any

import numpy as np

from ...report.tables import effort_unit
from ...robot.model import Floats, RobotModel
from ...simulation.demo.commander import History
from ...simulation.demo.scenarios import Timeline
from . import style

LEAST_ERROR = 0.01  # [mrad, mm]; the error axis shows at least this error
ACROSS = 115  # letters that fit on a line above the axes
LEGEND, KEY = 120, 8  # widths of the legend and of a line sample [letters]
MOST_IN_ONE = 10
"""With more joints than this, the efforts of each joint have a separate row."""
LEAST_FRACTION = 1e-3
"""Smallest scale of a joint, as a fraction of its limit, or of the largest effort if unlimited."""
LINE = 0.19  # height of a line of text [inch]
SHADES = ('#ffffff', '#fff1d6', '#e3f2e1', '#e8ecf7')


def draw(robot: RobotModel, title: str, timeline: Timeline, history: History, path: Path) -> None:
    """Draw a run with its events, and write the picture."""
    from matplotlib.figure import Figure

    panels = [_errors, _efforts] + ([_contact] if timeline.expected else [])
    lines = style.title_lines(*title.splitlines())
    count = len(robot.joint_names)
    columns = max(1, min(4, LEGEND // (max(map(len, _labels(robot, history))) + KEY)))
    heights = [2.2] * len(panels)
    rows = len(lines)
    if count > MOST_IN_ONE:
        heights[1] = LINE * (count + 2)
    else:
        rows += math.ceil(count / columns)
    height = 2.2 + sum(heights) + LINE * max(0, rows - 4)
    figure: Any = Figure(figsize=(style.WIDTH, height), dpi=style.DPI, layout='constrained')
    all_axes = np.atleast_1d(figure.subplots(len(panels), sharex=True, height_ratios=heights))
    for panel, axes in zip(panels, all_axes, strict=True):
        panel(axes, robot, timeline, history)
        _shade(axes, timeline, history)
        axes.grid(alpha=0.3)
        axes.margins(x=0.0)
    all_axes[-1].set_xlabel('time [s]')
    _explain(all_axes[0], timeline)
    figure.suptitle('\n'.join(lines), fontsize=11)
    handles, labels = all_axes[1].get_legend_handles_labels()
    if handles:
        style.legend_below(figure, handles, labels, ncols=columns, fontsize=9)
    figure.savefig(path)


def _largest(history: History) -> Floats:
    """Return the largest magnitude of each joint's commanded effort [N m or N]."""
    largest: Floats = np.max(np.abs(np.nan_to_num(history.commands.rows)), axis=0, initial=0.0)
    return largest


def _labels(robot: RobotModel, history: History) -> list[str]:
    """Return the name, the largest effort and the limit of each joint."""
    largest = _largest(history)
    return [
        f'{name}: '
        + style.peak_in_words(largest[i], robot.effort_limits[i], effort_unit(robot, i).strip())
        for i, name in enumerate(robot.joint_names)
    ]


def _position_errors(history: History) -> tuple[Floats, Floats]:
    """Return times [s], and the position errors of all joints [mrad or mm]."""
    times, rows = style.thinned(history.states.times, history.states.rows)
    return times, 1000.0 * (rows[:, 1] - rows[:, 0])


def _errors(axes: Any, robot: RobotModel, timeline: Timeline, history: History) -> None:
    times, errors = _position_errors(history)
    for i in range(len(robot.joint_names)):
        axes.plot(times, errors[:, i], lw=1.4, **style.look_of(i))
    if timeline.without is not None:
        times, errors = style.thinned(*timeline.without)
        for i, column in enumerate(1000.0 * errors.T):
            axes.plot(times, column, color=style.look_of(i)['color'], lw=1.0, ls=':')
        axes.plot([], [], color='gray', lw=1.0, ls=':', label='without the IMU (calculated)')
        axes.plot([], [], color='gray', lw=1.4, label='with the IMU')
        axes.legend(loc='upper left', fontsize=9)
    axes.set_ylabel('error [mrad, mm]')
    axes.update_datalim([(0.0, -LEAST_ERROR), (0.0, LEAST_ERROR)])
    axes.autoscale_view()


def _efforts(axes: Any, robot: RobotModel, timeline: Timeline, history: History) -> None:
    """
    Draw all commanded efforts, with a separate scale for each joint.

    The separate scales make small efforts legible. The labels contain the largest efforts and the
    limits.
    """
    times, rows = style.thinned(history.commands.times, history.commands.rows)
    largest = _largest(history)
    least = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, np.max(largest))
    scale = np.maximum(largest, LEAST_FRACTION * least)
    scale[scale == 0.0] = 1.0
    count = len(robot.joint_names)
    labels = _labels(robot, history)
    if count > MOST_IN_ONE:
        # One row per joint, because this many lines in one frame are illegible.
        for i in range(count):
            axes.plot(times, i - 0.45 * rows[:, i] / scale[i], lw=1.2, **style.look_of(i))
        axes.set_yticks(range(count), labels, fontsize=8)
        axes.set_ylim(count - 0.4, -0.6)
        axes.set_title('commanded efforts (labels: largest efforts)', fontsize=9, loc='left')
        return
    for i, label in enumerate(labels):
        axes.plot(times, 100.0 * rows[:, i] / scale[i], lw=1.2, label=label, **style.look_of(i))
    axes.set_ylabel('commanded effort\n[% of the largest, see legend]')


def _contact(axes: Any, robot: RobotModel, timeline: Timeline, history: History) -> None:
    assert timeline.expected is not None
    times, rows = style.thinned(history.external.times, history.external.rows)
    for i in range(len(robot.joint_names)):
        axes.plot(times, rows[:, i], lw=1.4, **style.look_of(i))
    times, states = style.thinned(history.states.times, history.states.rows)
    known = ~np.isnan(states[:, 0]).any(axis=1)
    times = times[known]
    expected = timeline.expected(times, states[known, 0])
    axes.plot(times, expected, color='black', lw=0.9, ls='--')
    axes.plot([], [], color='gray', lw=1.4, label='found by the node')
    axes.plot([], [], color='black', lw=0.9, ls='--', label='$-J^T F$')
    axes.legend(loc='upper left', fontsize=9)
    axes.set_ylabel('external efforts\n[N m, N]')


def _edges(timeline: Timeline) -> list[float]:
    return [0.0, *(event.time for event in timeline.events)]


def _shade(axes: Any, timeline: Timeline, history: History) -> None:
    edges = [*_edges(timeline), float(history.states.times[-1])]
    for i, (begin, end) in enumerate(pairwise(edges)):
        axes.axvspan(begin, end, color=SHADES[i % len(SHADES)], zorder=-10, lw=0)
        if i:
            axes.axvline(begin, color='black', lw=0.8)


def _explain(axes: Any, timeline: Timeline) -> None:
    """Describe each event above the first panel, at the time of the event."""
    words = [timeline.begins, *(event.words for event in timeline.events)]
    end = axes.get_xlim()[1]
    for i, (time, text) in enumerate(zip(_edges(timeline), words, strict=True)):
        fits = time / end + len(text) / ACROSS < 1.0
        axes.annotate(
            text,
            (time if fits else end, 1.0),
            (2 if fits else 0, 4 + 13 * (len(words) - 1 - i)),
            xycoords=('data', 'axes fraction'),
            textcoords='offset points',
            fontsize=9,
            horizontalalignment='left' if fits else 'right',
        )


def draw_identification(
    names: tuple[str, ...],
    histories: tuple[History, History],
    errors: tuple[Floats, Floats],
    title: str,
    path: Path,
) -> None:
    """Draw the position errors of both runs on the same scale, and the RMS error of each joint."""
    with style.styled_pyplot() as pyplot:
        figure = pyplot.figure(figsize=(style.WIDTH, max(5.2, 2.6 + 0.3 * len(names))))
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
        style.set_title(figure, title)
        style.legend_below(figure, [*handles, *more[0]], [*labels, *more[1]], ncols=5)
        figure.savefig(path)


def _draw_errors(axes: Any, history: History, names: tuple[str, ...]) -> None:
    style.draw_lines(axes, *_position_errors(history), names)


def _draw_bars(axes: Any, names: tuple[str, ...], errors: tuple[Floats, Floats]) -> None:
    """Draw the RMS errors of each joint in both runs as bars, and their ratio as text."""
    before, after = (1000.0 * values for values in errors)
    places = np.arange(len(names))
    axes.barh(places - 0.18, before, 0.34, color=style.ORANGE, label='RMS with the URDF')
    axes.barh(places + 0.18, after, 0.34, color=style.BLUE, label='RMS with the calibrated URDF')
    for place, first, second in zip(places, before, after, strict=True):
        text = f' {first / max(second, 1e-9):.3g} times better'
        axes.text(first, place - 0.18, text, va='center', fontsize=8.5, color=style.GREY)
    axes.set_xscale('log')
    axes.set_xlim(0.5 * float(np.min(after)), 8.0 * float(np.max(before)))
    axes.set_yticks(places, style.all_shortened(names, 22), fontsize=8.5)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlabel('RMS error [mrad, mm]', fontsize=9)
    axes.grid(axis='y', visible=False)
