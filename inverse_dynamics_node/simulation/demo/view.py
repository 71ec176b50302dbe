"""What a run looks like while it lasts: a live table on a terminal, plain lines elsewhere."""

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
from ..trajectory import slides

LIVE_PERIOD = 0.2  # [s]: drawing takes some milliseconds, which the loop has to do without
PLAIN_PERIOD = 1.0  # [s]
FULL_ERROR = 0.1  # [rad or m] at the end of the bar; each tenth of the bar is a factor of 2.5
WIDTH = 12  # of a bar


@dataclass(frozen=True, eq=False)
class Snapshot:
    """
    How things stand.

    Attributes
    ----------
    time : float
        Since the motion began [s].
    rate : float
        At which commands come [Hz].
    words : str
        What is happening.
    q, desired, effort : ndarray, shape (n,)
        Measured and desired positions [rad or m], measured efforts [N m or N].
    brakes_on : bool
        Whether the brakes are on.

    """

    time: float
    rate: float
    words: str
    q: Floats
    desired: Floats
    effort: Floats
    brakes_on: bool


class View:
    """
    Shows a run to whoever looks, live or in lines.

    Parameters
    ----------
    robot : RobotModel
        Whose joints.
    title : str
        What the run is.
    console : rich.console.Console, optional
        Where to; without it, standard output.

    """

    def __init__(self, robot: RobotModel, title: str, console: Console | None = None) -> None:
        self._robot, self.title = robot, title
        self._units = [('m', 'mm', 'N') if s else ('rad', 'mrad', 'N m') for s in slides(robot)]
        self._console = console or Console(file=sys.stdout)
        self._live: Live | None = None
        self._due = -math.inf

    @contextmanager
    def open(self) -> Iterator[None]:
        """Draw on the terminal for as long as this lasts; what was drawn last stays."""
        if not self.is_live:
            yield
            return
        with Live(console=self._console, auto_refresh=False) as self._live:
            yield

    @property
    def is_due(self) -> bool:
        """Whether it is time to draw again; lines are due with the run's own seconds."""
        return self.is_live and time.monotonic() >= self._due

    @property
    def is_live(self) -> bool:
        """Whether a terminal shows it as it goes."""
        return bool(self._console.is_terminal)

    def draw(self, moment: Snapshot) -> None:
        """Draw how things stand, over what was drawn before."""
        assert self._live is not None
        self._due = time.monotonic() + LIVE_PERIOD
        self._live.update(self.render(moment), refresh=True)

    def render(self, moment: Snapshot) -> Group:
        """Lay out how things stand."""
        head = Text.assemble(
            (self.title, 'bold'),
            f'   t = {moment.time:5.1f} s   {moment.rate:6.1f} commands/s   ',
            ('BRAKES ON', 'bold red') if moment.brakes_on else ('brakes open', 'green'),
        )
        table = Table(box=None, pad_edge=False)
        # Numbers come laid out, units below each other: to the right, their spaces would go.
        for name, width in (
            *(('joint', 0), ('position', 12), ('desired', 12), ('error', 13), ('', 0)),
            *(('effort', 14), ('of its limit', 0)),
        ):
            table.add_column(f'{name:>{width}}', no_wrap=True)
        limits = self._robot.effort_limits
        for i, (name, units) in enumerate(zip(self._robot.joint_names, self._units, strict=True)):
            q, desired, effort = moment.q[i], moment.desired[i], moment.effort[i]
            share = abs(effort) / limits[i] if limits[i] > 0.0 else 0.0
            table.add_row(
                name,
                f'{q:8.4f} {units[0]:3}',
                f'{desired:8.4f} {units[0]:3}',
                f'{1000.0 * (desired - q):8.3f} {units[1]:4}',
                bar(error_share(desired - q), 0.35, 0.65),
                f'{effort:10.3f} {units[2]:3}',
                bar(share, 0.7, 0.9),
            )
        return Group(head, Text(moment.words, 'yellow'), table)

    def log(self, line: str) -> None:
        """Print a line of a log above the table; from any thread."""
        self._console.print(line, style='bright_black', highlight=False, markup=False)

    def tell(self, time_: float, words: str) -> None:
        """Say in a line what happens; live, it stands above the table anyway."""
        if not self.is_live:
            print(f'\n{time_:.1f} s: {words}', flush=True)

    def print_progress(self, moment: Snapshot) -> None:
        """Print where the joints are, should be, and the efforts that take them there."""
        print(f'\nt = {moment.time:.1f} s   {moment.rate:.1f} commands/s')
        wide = name_width(self._robot)
        print(f'{"joint":{wide}}{"position":>15}{"desired":>15}{"error":>13}{"effort":>14}')
        for i, (name, units) in enumerate(zip(self._robot.joint_names, self._units, strict=True)):
            q, desired, effort = moment.q[i], moment.desired[i], moment.effort[i]
            print(
                f'{name:{wide}}{q:11.4f} {units[0]:3}{desired:11.4f} {units[0]:3}'
                f'{1000.0 * (desired - q):8.3f} {units[1]:4}{effort:10.3f} {units[2]:3}'
            )
        sys.stdout.flush()


def name_width(robot: RobotModel) -> int:
    """Return how wide a column of joint names is."""
    return max(24, *(len(name) + 1 for name in robot.joint_names))


def error_share(error: float) -> float:
    """Place an error [rad or m] on a bar, in factors: 0 for 0.01 mrad and less, 1 for 100."""
    return 1.0 + math.log10(max(abs(error), 1e-9) / FULL_ERROR) / 4.0


def bar(share: float, warn: float, alarm: float) -> Text:
    """Draw a bar of a share from 0 to 1, coloured by where it ends."""
    filled = round(WIDTH * float(np.clip(share, 0.0, 1.0)))
    colour = 'red' if share >= alarm else 'yellow' if share >= warn else 'green'
    return Text.assemble(('█' * filled, colour), ('·' * (WIDTH - filled), 'bright_black'))
