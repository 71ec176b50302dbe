"""The command `probe`: pushes the joints of a live arm, and checks how they move."""

from __future__ import annotations

import argparse
import json
import time
from typing import Any, TYPE_CHECKING

import numpy as np

from ..analysis.probe import (
    FAULTS,
    largest_pushes,
    node_parameters,
    Probe,
    PROBE_TIMEOUT,
    Verdict,
)
from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import ConfigurationError
from ..report.probe_report import as_json, probe_table, probe_verdict
from ..robot.model import RobotModel
from . import arguments
from .arguments import choose_node
from .console import collected_signals, say

if TYPE_CHECKING:
    from ..ros.diagnostics import NodeStatus
    from ..ros.observer import Observer
    from ..ros.prober import Prober

EPILOG = """\
The arm must float: the node sends commands, nothing else holds the arm, and no reference is sent.
One joint after another is pushed, first in the positive and then in the negative direction, with
an effort that rises slowly until the joint has moved by 2 mrad (2 mm). Keep the emergency stop in
your hand. During the probe, the node uses its strictest motion limits: an arm that moves by more
than 30 mrad (30 mm), or faster than 1 rad/s (1 m/s), is stopped. At the first fault, the efforts
fall to zero at once; an arm without brakes drops. At the end, the parameters of the node are those
of before. After Ctrl-C, the arm floats on.

examples:
  inverse_dynamics probe
  inverse_dynamics probe /left/inverse_dynamics --share 0.1
  inverse_dynamics probe --json

exit code:
    0  every joint moves as commanded
    3  a joint moves otherwise, and the efforts are zero
    4  not all joints could be probed, but no fault was found
    1  the node was not found, or its state does not permit a probe
    2  invalid arguments
  130  ended by Ctrl-C"""

_FAULT, _UNDECIDED = 3, 4
_SILENCE = 0.5  # [s]; after this time without joint states, the probe ends
_REPETITION = 2.0  # [s]; a request that is not answered is sent again
_POLL = 0.001  # [s]
_FLOATING = 'floating: no reference', 'holding position: no reference'
_STATES = 50  # joint states whose times show the period


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = arguments.new_parser(
        'probe',
        'Push the joints of an arm that floats, one after another, and check sign, order and '
        'scale of the commands. This moves the arm a little.',
        EPILOG,
    )
    arguments.add_node(parser)
    parser.add_argument(
        '--share',
        type=arguments.number('a number from 0 to 1', lambda value: 0.0 < value <= 1.0),
        default=0.25,
        metavar='SHARE',
        help='largest push, as a share of the effort limit of the joint (default: 0.25)',
    )
    parser.add_argument('--json', action='store_true', help='print the result as JSON')
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    from ..ros.observer import Observer, observing_node  # needs ROS
    from ..ros.prober import Prober

    with collected_signals() as signals, observing_node(options.ros_arguments) as node:
        observer = Observer(node, choose_node(node, options.node, is_patient=False))
        status, robot = _wait_for_status(observer)
        joints = status.names('model', 'joints')
        prober = Prober(node, observer, joints)
        try:
            probe = _run(prober, observer, status, robot, joints, options.share, signals)
        finally:
            prober.close()
    if signals:
        raise SystemExit(128 + signals[0])
    if options.json:
        print(json.dumps(as_json(probe.results.values(), probe.reason)))
    else:
        results = list(probe.results.values())
        say(probe_verdict(results, joints, probe.reason))
        print(f'\n{probe_table(results, robot)}')
    return _code(probe, joints)


def _code(probe: Probe, joints: list[str]) -> int:
    verdicts = [result.verdict for result in probe.results.values()]
    if probe.reason or any(verdict in FAULTS for verdict in verdicts):
        return _FAULT
    is_complete = len(verdicts) == len(joints)
    return 0 if is_complete and set(verdicts) == {Verdict.RIGHT} else _UNDECIDED


def _wait_for_status(observer: Observer) -> tuple[NodeStatus, RobotModel]:
    """Wait until the node floats; raise a ConfigurationError if it does not."""
    end = time.monotonic() + arguments.MOST_DISCOVERY
    while observer.status is None or (observer.robot is None and not observer.robot_problem):
        observer.poll()
        if time.monotonic() > end:
            raise ConfigurationError(
                f'no diagnostics or no robot description from {observer.name} for '
                f'{arguments.MOST_DISCOVERY:g} s'
            )
        time.sleep(0.02)
    status, robot = observer.status, observer.robot
    if robot is None:
        raise ConfigurationError(observer.robot_problem)
    problem = _obstacle(status)
    if problem:
        raise ConfigurationError(f'{observer.name}: {problem}')
    return status, robot


def _obstacle(status: NodeStatus) -> str:
    """Return why the arm cannot be probed; '' if it can."""
    if status.text('loop', 'state') != 'active':
        return f'the node is {status.text("loop", "state")}, expected an active one'
    if status.text('loop', 'dry run') == 'yes':
        return 'the node is in a dry run, expected a live arm that floats: set dry_run to false'
    errors = [part.message for part in status.problems().values() if part.level.name == 'ERROR']
    if errors:
        return '; '.join(errors)
    phase, gain = status.text('loop', 'phase'), status.number('loop', 'gain')
    if phase not in _FLOATING:
        return f"the arm is '{phase}', expected one that floats: end the reference"
    if gain is not None and gain < 1.0:
        return 'the efforts still rise: wait for start_ramp'
    if not status.number('efforts', 'receivers'):
        return 'the commands have no subscriber'
    return ''


def _dynamics(robot: RobotModel, status: NodeStatus) -> InverseDynamics:
    """Return the model that the node uses for its commands."""
    has_gravity = status.text('model', 'gravity [m/s^2]') != 'not included'
    dynamics = InverseDynamics(robot, status.gravity() if has_gravity else np.zeros(3))
    for link, mass, com in status.payloads():
        dynamics.set_payload(link, mass, com)
    return dynamics


def _run(
    prober: Prober,
    observer: Observer,
    status: NodeStatus,
    robot: RobotModel,
    joints: list[str],
    share: float,
    signals: list[int],
) -> Probe:
    """Run the probe, restore the parameters of the node, and return the probe."""
    first = prober.wait_for_measurements(_STATES)
    period = (first[-1].time - first[0].time) / (len(first) - 1)
    scale = np.array([status.by_joint('scale').get(joint) or 1.0 for joint in joints])
    limits = np.array([status.by_joint('limits [N m, N]')[joint] for joint in joints])
    dynamics = _dynamics(robot, status)
    most = largest_pushes(robot, joints, limits / np.abs(scale), dynamics, first[-1].q, share)
    has_gains = status.text('other nodes', 'commands').endswith('joint_commands')
    probe = Probe(dynamics, joints, most, period, judges_scale=not has_gains)
    strict = node_parameters(robot, joints, probe.is_held, period)
    before = prober.parameters(list(strict))
    try:
        prober.set(strict)
        prober.measurements()  # those that are old by now
        _follow(prober, observer, probe, dynamics, joints, scale, period, signals)
    finally:
        if _code(probe, joints) == _FAULT:
            prober.disable()
        prober.set(before)
    return probe


def _follow(
    prober: Prober,
    observer: Observer,
    probe: Probe,
    dynamics: InverseDynamics,
    joints: list[str],
    scale: Any,
    period: float,
    signals: list[int],
) -> None:
    """Do what the probe requests until it is over."""
    is_held, is_set, due = probe.is_held.copy(), None, 0.0
    began = heard = time.monotonic()
    request = None
    while not probe.is_over and not signals:
        now = time.monotonic()
        if is_set is not None and is_set():
            is_set = None
        for time_, q, commands in prober.measurements():
            heard = now
            if is_set is not None:
                continue  # the node does not hold the joints of the last request yet
            is_zero = not commands.any() and bool(dynamics.gravity_efforts(q).any())
            request = probe.step(time_, q, commands / scale, _stopped(observer, is_zero))
        if request is not None:
            prober.refer(request.positions, request.efforts)
            # A request or its answer may be lost.
            is_lost = is_set is not None and now > due
            if is_lost or (request.is_held != is_held).any():
                is_held, due = request.is_held, now + _REPETITION
                gains = node_parameters(dynamics.robot, joints, is_held, period)
                is_set = prober.request({name: gains[name] for name in ('kp', 'kd')})
        if now > heard + _SILENCE:
            raise ConfigurationError(
                f'{observer.name}: no joint state for {_SILENCE:g} s; the probe ends'
            )
        if now > began + PROBE_TIMEOUT * len(joints):
            raise ConfigurationError(
                f'{observer.name}: the probe has not ended within {now - began:.0f} s'
            )
        time.sleep(_POLL)


def _stopped(observer: Observer, is_zero: bool) -> str:
    """Return why the node has stopped the arm, or ''."""
    status = observer.status
    assert status is not None
    phase = status.text('loop', 'phase')
    if phase.startswith('stopped'):
        return status['loop'].message
    # The commands show a stop earlier than the diagnostics.
    return 'the efforts are zero' if is_zero else ''
