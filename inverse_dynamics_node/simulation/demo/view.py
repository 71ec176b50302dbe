"""The progress of a run: a live table on a terminal, otherwise plain lines."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import math
import sys
import time

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ...robot.model import Floats, RobotModel

LIVE_PERIOD = 0.2  # [s]: period of drawing, which delays the control loop by milliseconds
FULL_ERROR = 0.1  # [rad or m]: error that fills a bar; the scale is logarithmic
WIDTH = 12  # characters in a bar


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state of a run at one time."""

    time: float
    """Time since the start of the motion [s]."""
    rate: float
    """Rate of the commands [Hz]."""
    words: str
    """Description of the current event."""
    q: Floats
    """Measured joint positions, shape (n,) [rad or m]."""
    desired: Floats
    """Desired joint positions, shape (n,) [rad or m]."""
    effort: Floats
    """Measured joint efforts, shape (n,) [N m or N]."""
    brakes_on: bool
    """Whether the brakes are on."""


class View:
    """Shows the progress of a run, as a live table on a terminal or as plain lines."""

    def __init__(self, robot: RobotModel, title: str, console: Console | None = None) -> None:
        self.robot, self.title = robot, title
        self._units = [
            ('m', 'mm', 'N') if s else ('rad', 'mrad', 'N m') for s in robot.is_prismatic_joint
        ]
        self._console = console or Console(file=sys.stdout)
        self._live: Live | None = None
        self._due = -math.inf

    @contextmanager
    def open(self) -> Iterator[None]:
        """Draw on the terminal within this context; the last table remains visible."""
        if not self.is_live:
            yield
            return
        with Live(console=self._console, auto_refresh=False) as self._live:
            yield

    @property
    def is_due(self) -> bool:
        """Whether it is time to draw the live table again."""
        return self.is_live and time.monotonic() >= self._due

    @property
    def is_live(self) -> bool:
        """Whether the view is a live table on a terminal."""
        return bool(self._console.is_terminal)

    def draw(self, snapshot: Snapshot) -> None:
        """Draw a snapshot in place of the previous snapshot."""
        assert self._live is not None
        self._due = time.monotonic() + LIVE_PERIOD
        self._live.update(self.render(snapshot), refresh=True)

    def render(self, snapshot: Snapshot) -> Group:
        """Lay out a snapshot as a table."""
        head = Text.assemble(
            (self.title, 'bold'),
            f'   t = {snapshot.time:5.1f} s   {snapshot.rate:6.1f} commands/s   ',
            ('BRAKES ON', 'bold red') if snapshot.brakes_on else ('brakes open', 'green'),
        )
        table = Table(box=None, pad_edge=False)
        # Cells are padded here, because right alignment would strip the spaces after units.
        for name, width in (
            *(('joint', 0), ('position', 12), ('desired', 12), ('error', 13), ('', 0)),
            *(('effort', 14), ('of its limit', 0)),
        ):
            table.add_column(f'{name:>{width}}', no_wrap=True)
        limits = self.robot.effort_limits
        for i, (name, *values, effort) in enumerate(self._cells(snapshot)):
            error = error_fraction(snapshot.desired[i] - snapshot.q[i])
            fraction = abs(snapshot.effort[i]) / limits[i] if limits[i] > 0.0 else 0.0
            table.add_row(name, *values, bar(error, 0.35, 0.65), effort, bar(fraction, 0.7, 0.9))
        return Group(head, Text(snapshot.words, 'yellow'), table)

    def _cells(self, snapshot: Snapshot) -> list[tuple[str, str, str, str, str]]:
        """Return name, position, desired position, error and effort of each joint as strings."""
        joints = (self.robot.joint_names, self._units, snapshot.q, snapshot.desired)
        return [
            (
                name,
                f'{q:8.4f} {unit:3}',
                f'{desired:8.4f} {unit:3}',
                f'{1000.0 * (desired - q):8.3f} {small_unit:4}',
                f'{effort:10.3f} {effort_unit:3}',
            )
            for name, (unit, small_unit, effort_unit), q, desired, effort in zip(
                *joints, snapshot.effort, strict=True
            )
        ]

    def log(self, line: str) -> None:
        """Print a log line above the table; any thread may call this method."""
        self._console.print(line, style='bright_black', highlight=False, markup=False)

    def announce(self, time_: float, words: str) -> None:
        """Print a line about an event, unless the live table already shows the event."""
        if not self.is_live:
            print(f'\n{time_:.1f} s: {words}', flush=True)

    def print_progress(self, snapshot: Snapshot) -> None:
        """Print positions, desired positions, errors and efforts."""
        print(f'\nt = {snapshot.time:.1f} s   {snapshot.rate:.1f} commands/s')
        wide = name_width(self.robot)
        print(f'{"joint":{wide}}{"position":>15}{"desired":>15}{"error":>14}{"effort":>14}')
        for name, position, desired, error, effort in self._cells(snapshot):
            print(f'{name:{wide}}{position:>15}{desired:>15} {error}{effort}')
        sys.stdout.flush()


def name_width(robot: RobotModel) -> int:
    """Return the width of a column of joint names."""
    return max(24, *(len(name) + 1 for name in robot.joint_names))


def error_fraction(error: float) -> float:
    """Return how full the bar for an error is: 0 at 0.01 mrad, 1 at 100 mrad (log scale)."""
    return 1.0 + math.log10(max(abs(error), 1e-9) / FULL_ERROR) / 4.0


def bar(fraction: float, warn: float, alarm: float) -> Text:
    """Draw a bar for a fraction from 0 to 1; the bar changes colour at ``warn`` and ``alarm``."""
    filled = round(WIDTH * float(np.clip(fraction, 0.0, 1.0)))
    colour = 'red' if fraction >= alarm else 'yellow' if fraction >= warn else 'green'
    return Text.assemble(('█' * filled, colour), ('·' * (WIDTH - filled), 'bright_black'))
