"""The command `watch`: shows a running node, and checks whether model and robot agree."""

from __future__ import annotations

import argparse
from collections.abc import Callable
import gc
import json
import math
import sys
import time
from typing import Any, TYPE_CHECKING

import numpy as np

from ..analysis.diagnosis.gate import Gate
from ..analysis.diagnosis.live import (
    Agreement,
    check_agreement,
    DURATION,
    LiveWindow,
    Obstacle,
    StateRate,
)
from ..report.diagnosis_text import agreement_sentence
from . import arguments
from .arguments import choose_node, MOST_DISCOVERY, only_one
from .console import handled_signals
from .live_view import as_json, as_line, CODES, live_view
from .recordings import reported_convention

if TYPE_CHECKING:
    from ..ros.observer import Observer, Sample

EPILOG = """\
examples:
  inverse_dynamics watch
  inverse_dynamics watch /left/inverse_dynamics
  inverse_dynamics watch --for 10 && ros2 param set /inverse_dynamics dry_run false
  inverse_dynamics watch --for 60 --unchecked gripper_joint
  inverse_dynamics watch --json | jq .sentence
  inverse_dynamics watch --ros-args --enclave /watch

exit code of --for:
    0  all commanded joints were checked, and model and robot agree
    3  model and robot differ, or joint states are slow
    4  model and robot cannot be compared
    5  efforts are cut to their limits: the arm cannot hold itself or follow a motion
    6  model and robot agree, but not all commanded joints were checked
    1  the node was not found, or there are several nodes
    2  invalid arguments
  130  ended by Ctrl-C"""

_POLL = 0.02  # [s]; time between two polls of the node
_LINE = 1.0  # [s]; time between two lines of text
_CHECK = 2.0  # [s]; time between two checks, which take up to 0.3 s of CPU
_FRAME = 0.25  # [s]; time between two updates of the screen
_LOST = 3.5  # [s]; longest gap between diagnostics, which are sent once a second


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = arguments.new_parser(
        'watch',
        'Show the joints and the state of a running node, and whether its model '
        'agrees with the efforts that the robot measures. The command only subscribes to topics. '
        'On a terminal, the view is updated in place; in a pipe, one line per second is printed.',
        EPILOG,
    )
    arguments.add_node(parser)
    parser.add_argument(
        '--for',
        dest='duration',
        type=arguments.positive,
        metavar='SECONDS',
        help='end after this time, with an exit code that says whether model and robot agree',
    )
    parser.add_argument(
        '--unchecked',
        nargs='+',
        default=[],
        metavar='JOINT',
        help='accept that these joints are not checked',
    )
    parser.add_argument(
        '--json',
        action='store_true',
        help='print one JSON object per second (see doc/watch.md)',
    )
    parser.add_argument(
        '--rate',
        type=arguments.positive,
        metavar='HZ',
        help='expected rate of joint states; below 80 %% of this rate, they are reported as slow '
        '(without --rate: below half of update_rate, or below 80 Hz if the node has no '
        'update_rate)',
    )
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from ..ros.observer import find_nodes, Observer, observing_node  # needs ROS

    try:
        with handled_signals(_stop), observing_node(options.ros_arguments) as node:
            name = choose_node(node, options.node, is_patient=not options.duration)
            watch = _Watch(Observer(node, name), lambda: find_nodes(node), options)
            return watch.run()
    finally:
        gc.freeze()  # because the last garbage collection would take most of a second


class _Watch:
    """Observes one node, and shows its state."""

    def __init__(
        self, observer: Observer, find: Callable[[], list[str]], options: argparse.Namespace
    ) -> None:
        self.observer, self.find, self.options = observer, find, options
        self.agreement = Agreement(Obstacle.TOO_FEW_SAMPLES)
        self._began = time.monotonic()
        self._known_since = math.inf
        self._measured: Any = None  # what the measured efforts contain, and their scale
        self._restart()

    def _restart(self) -> None:
        """Forget all samples and results."""
        robot = self.observer.robot
        self.window = LiveWindow(robot.joint_names) if robot else None
        self.gate = Gate(self.options.unchecked)
        self.sample: Sample | None = None
        self._state_count = 0  # of joint states when the latest sample was added
        self._cut: dict[str, float] = {}  # time at which each joint's effort was last cut

    def run(self) -> int:
        """Show the node until the duration has passed; return the exit code."""
        if self.options.json or not sys.stdout.isatty():
            self._loop(self._print_line, _LINE)
        else:
            with live_view(self._last_words) as show:
                self._loop(lambda: show(self.observer, self.sample, self.agreement), _FRAME)
        return CODES[self.agreement.outcome]

    def _loop(self, show: Any, period: float) -> None:
        """Poll, check and show the node until the duration ends."""
        next_check = next_show = time.monotonic() + period
        is_over, is_new = False, True
        while not is_over:
            now = time.monotonic()
            self._poll()
            is_over = now >= self._end(now)
            if now >= next_check or (is_over and now > next_check - 0.75 * _CHECK):
                self.agreement = self.gate.add(self._check(now))
                next_check = next_time(next_check, _CHECK, now)
                self._check_choice(now)
                is_new = True
            if now >= next_show or (is_over and is_new):
                show()
                next_show = next_time(next_show, period, now)
                is_new = False
            if not is_over:
                time.sleep(_POLL)

    def _check_choice(self, now: float) -> None:
        """Raise ConfigurationError if a second node is found and the user gave no name."""
        if self.options.node is None and now < self._began + MOST_DISCOVERY:
            only_one(self.find())

    def _end(self, now: float) -> float:
        """Return the end time; the duration begins when the state of the node is known."""
        if not self.options.duration:
            return math.inf
        status, robot = self.observer.status, self.observer.robot
        if math.isinf(self._known_since) and status and (robot or not status.is_computing):
            self._known_since = now
        if math.isinf(self._known_since):
            return self._began + MOST_DISCOVERY
        return float(self._known_since + self.options.duration)

    def _poll(self) -> None:
        observer = self.observer
        if observer.poll():
            self._restart()
        status = observer.status
        if status is not None:
            measured = reported_convention(status), status.measured_scale()
            if measured != self._measured:
                self._measured = measured
                self._restart()
            cut = status.names('efforts', 'cut to limit since the last report')
            self._cut |= dict.fromkeys(cut, observer.status_time)
        if self.window is not None:
            sample = self.sample = observer.sample()
            if observer.state_count > self._state_count:
                self._state_count = observer.state_count
                self.window.add(*sample[:5])

    def _check(self, now: float) -> Agreement:
        observer, status = self.observer, self.observer.status
        silence = now - max(observer.status_time, self._began)
        if status is None or silence > _LOST:
            state = 'is starting' if status is None else 'has ended'
            reason = (
                f'no diagnostics from {observer.name} for {silence:.0f} s: the node {state}, or '
                'cannot be reached'
            )
            cause = Obstacle.NO_DIAGNOSTICS if silence > _LOST else Obstacle.TOO_FEW_SAMPLES
            return Agreement(cause, reason=reason)
        if reason := self._reason():
            return Agreement(Obstacle.NODE_STATE, reason=reason)
        if self.window is None or observer.robot is None:
            return Agreement(Obstacle.TOO_FEW_SAMPLES)
        requested = status.number('loop', 'requested rate [Hz]')
        return check_agreement(
            self.window.samples(),
            observer.robot,
            np.array(status.gravity() or np.zeros(3)),
            self._limits(),
            reported_convention(status),
            status.payloads(),
            status.names('model', 'joints'),
            [joint for joint, then in self._cut.items() if now < then + DURATION],
            StateRate(observer.state_rate, self.options.rate, requested, 'clock' in status),
        )

    def _reason(self) -> str:
        """Return why efforts cannot be compared; return '' if they can."""
        observer, status = self.observer, self.observer.status
        assert status is not None
        if status.is_computing:
            return observer.robot_problem
        state, reasons = status.text('loop', 'state'), [status['loop'].message]
        if state != 'active':
            return f'the node is {state}'
        if 'joint states' in status.problems():
            reasons.append(status['joint states'].message)
        return '; '.join(reasons)

    def _limits(self) -> Any:
        robot, status = self.observer.robot, self.observer.status
        if robot is None or status is None:
            return None
        limits, scale = robot.effort_limits.copy(), status.by_joint('scale')
        for joint, limit in status.by_joint('limits [N m, N]').items():
            if joint in robot.joint_names and scale.get(joint):
                limits[robot.joint_names.index(joint)] = limit / abs(scale[joint])
        return limits

    def _last_words(self) -> str:
        return f'{self.observer.name}: {agreement_sentence(self.agreement)}'

    def _print_line(self) -> None:
        if self.options.json:
            print(json.dumps(as_json(self.observer, self.sample, self.agreement)), flush=True)
        else:
            print(as_line(self.observer, self.agreement), flush=True)


def next_time(due: float, period: float, now: float) -> float:
    """Return the next time to act, and skip times that have already passed."""
    return due + period if due + period > now else now + period


def _stop(number: int, _: object) -> None:
    """Raise SystemExit for a signal, so that the terminal is restored."""
    raise SystemExit(128 + number)
