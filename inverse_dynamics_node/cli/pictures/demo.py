"""The picture of `demo`: errors and efforts of a run."""

from __future__ import annotations

from pathlib import Path
import textwrap
from typing import Any

import numpy as np

from ...simulation.demo import DemoRun, END, phases
from . import style

_SHADES = ('#ffffff', '#e3f2e1', '#fff1d6', '#e8ecf7')
_MOST_IN_LEGEND = 14
_LEAST_ERROR = 10.0  # [mrad, mm]: the axis shows at least this error


def draw(run: DemoRun, verdict: str, path: Path) -> None:
    """Draw the position errors and the commanded efforts, and write the picture."""
    robot, load = run.robot, run.load
    captions = phases(load)
    times = *captions, END
    errors = 1e3 * (run.desired - run.positions)
    efforts = run.commands / np.maximum(abs(run.commands).max(axis=0), 1e-9)
    slides = robot.is_prismatic_joint
    unit = 'mm' if slides.all() else 'mrad, mm' if slides.any() else 'mrad'
    with style.styled_pyplot() as pyplot:
        figure, (top, bottom) = pyplot.subplots(2, 1, sharex=True, figsize=(style.WIDTH, 5.4))
        style.draw_lines(top, *_thinned(run.times, errors), robot.joint_names)
        style.draw_lines(bottom, *_thinned(run.command_times, efforts), robot.joint_names)
        top.set_ylabel(f'position error [{unit}]')
        bottom.set_ylabel('command / its largest value')
        bottom.set_xlabel('time [s]')
        size = max(float(abs(errors).max()), _LEAST_ERROR)
        top.set_ylim(-1.15 * size, 1.7 * size)
        for axes in top, bottom:
            for k, shade in enumerate(_SHADES):
                axes.axvspan(times[k], times[k + 1], color=shade, zorder=0, linewidth=0.0)
        for k, text in enumerate(captions.values()):
            middle = 0.5 * (times[k] + times[k + 1])
            caption = textwrap.fill(text.removeprefix('the arm '), 19)
            top.text(middle, 1.62 * size, caption, ha='center', va='top', fontsize=9.5)
        style.set_title(figure, f'{robot.name}: the node moves a simulated arm', verdict)
        handles, labels = top.get_legend_handles_labels()
        style.legend_below(figure, handles[:_MOST_IN_LEGEND], labels[:_MOST_IN_LEGEND], ncols=7)
        figure.savefig(path)


def _thinned(times: Any, rows: Any) -> tuple[Any, Any]:
    step = max(1, len(times) // style.MOST_POINTS)
    return times[::step], rows[::step]
