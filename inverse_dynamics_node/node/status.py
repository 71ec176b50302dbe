"""
Writes the status of the node: the level, the message and the values of each part.

This is the only place where they are chosen. `/diagnostics` publishes them as they are, the log
prints the problems that are new, and `watch` reads some of the values by their keys.
"""

from __future__ import annotations

from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from ..control.loop import COMPUTING_PHASES, ControlLoop, Phase, TOO_FAR_PHASES
from ..ros.controllers import Controller
from ..ros.diagnostics import Level, NodeStatus, NONE, Part
from ..ros.graph import OtherNodes, SimulatedClock
from .monitor import Monitor
from .status_text import (
    activity,
    describe_compensation,
    describe_implausible,
    describe_late,
    describe_lost_imu,
    describe_lost_states,
    describe_motion,
    describe_unstable_gains,
    missing_inputs,
)

_SLOW = 0.95  # the loop is too slow below this fraction of the requested rate
_LONG_SILENCE = 5.0  # [s]; a connected publisher that is silent for longer is suspicious
_DISCOVERY = 1.0  # [s]; the discovery of a publisher may take this long
_PAUSE = 5.0  # [s]; a longer standstill of simulated time is reported

OUTDATED = (
    'another robot description has arrived; to use it, deactivate, clean up and configure the node'
)


class Surroundings(NamedTuple):
    """The lifecycle state and the connections of the node."""

    state: str
    """Lifecycle state."""
    is_active: bool
    name: str
    """Fully qualified name of this node."""
    receivers: int
    """Number of subscriptions to the commands."""
    publishers: int
    """Number of publishers of joint states."""
    silence: float
    """Length of the silence on joint_states [s]; see `lasting_silence`."""
    state_rate: float
    """Rate at which all commanded joints were updated since the last report [Hz]."""
    inputs: tuple[str, str]
    """Topics of the joint states and of the IMU, with their numbers of publishers."""
    topics: tuple[str, str, str]
    """Topics joint_states, ~/joint_efforts and ~/external_efforts."""
    others: OtherNodes
    controllers: list[Controller]
    """The controllers among the receivers of the commands."""
    objection: str
    """Why no commands may begin, or ''."""
    clock: SimulatedClock | None
    """None unless the node uses simulated time."""


def describe_node(
    now: float, loop: ControlLoop | None, around: Surroundings, monitor: Monitor
) -> NodeStatus:
    """
    Return the status since the last report; `now` is in [s].

    `loop` is None until the node is configured. The parts about the robot are then missing.
    """
    status = NodeStatus()
    status['loop'] = _loop(now, loop, around, monitor)
    status['messages'] = _messages(monitor)
    status['other nodes'] = _other_nodes(loop, around)
    if around.clock is not None:
        status['clock'] = _clock(around.clock)
    if loop is not None:
        missing = missing_inputs(
            loop, *around.inputs, now if loop.phase is Phase.WAITING else None
        )
        missing = [f'no command yet: waiting for {each}' for each in missing]
        imu = missing.pop() if loop.lacks_imu else describe_lost_imu(now, loop)
        status['joint states'] = _joint_states(now, loop, around, '; '.join(missing))
        status['reference'] = _reference(now, loop, around)
        status['efforts'] = _efforts(now, loop, around, monitor)
        status['model'] = _model(loop, imu)
    return status


def _part(fine: str, values: dict[str, Any], *problems: tuple[Level, str]) -> Part:
    """Return a part with the texts of its problems; a problem without text does not exist."""
    found = [(level, text) for level, text in problems if text]
    level = max((level for level, _ in found), default=Level.OK)
    message = '; '.join(text for _, text in found) or fine
    return Part(level, message, {key: _text(value) for key, value in values.items()})


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    if isinstance(value, float):
        return f'{value + 0.0:g}'  # the sum has no negative zero
    if isinstance(value, str | int):
        return str(value)
    return ', '.join(map(_text, () if value is None else value)) or NONE


def _loop(now: float, loop: ControlLoop | None, around: Surroundings, monitor: Monitor) -> Part:
    rate, period = monitor.rate, monitor.period
    values = {
        'state': around.state,
        'rate [Hz]': rate,
        'requested rate [Hz]': 1.0 / period if period else 'that of the joint states',
        'period p99 [ms]': _milliseconds(monitor.periods, 99.0),
        'period worst [ms]': _milliseconds(monitor.periods, 100.0),
        'compute time p99 [ms]': _milliseconds(monitor.durations, 99.0),
        'overruns': monitor.overruns,
    }
    if loop is None or not around.is_active:
        return _part(around.state, values)
    phase, doing = loop.phase, activity(now, loop)
    values |= {
        'mode': loop.settings.mode.value,
        'phase': phase.value,
        'dry run': loop.dry_run.is_active,
        'gain': loop.shaper.gain,
    }
    is_stopped = phase in (Phase.LIMIT_STOP, Phase.NO_SOLUTION)
    is_slow = 0.0 < rate * period < _SLOW
    return _part(
        doing,
        values,
        (Level.ERROR, doing if is_stopped else ''),
        (Level.WARN, f'only {rate:.1f} commands/s' if is_slow else ''),
    )


def _milliseconds(times: list[float], percentile: float) -> float | None:
    return float(1e3 * np.percentile(times, percentile)) if times else None


def _messages(monitor: Monitor) -> Part:
    recent = f'messages rejected since the last report: {monitor.rejections}'
    return _part(
        f'messages rejected in total: {sum(monitor.rejected.values())}',
        monitor.rejected,
        (Level.WARN, recent if monitor.rejections else ''),
    )


def _other_nodes(loop: ControlLoop | None, around: Surroundings) -> Part:
    others, problems = around.others, []
    if others.rivals:
        problems.append(f'{others.commands} is also published by {others.rivals}')
    if others.namesakes:
        is_one = others.namesakes == 1
        nodes = 'another node has' if is_one else f'{others.namesakes} other nodes have'
        problems.append(f'{nodes} the name {around.name}')
    if problems:
        problems[-1] += ' (stop the other node; a killed node stays listed for up to 20 s)'
    # Nodes may take turns at publishing on a topic, but must never have the same name.
    is_sending = around.is_active and not (loop and loop.dry_run.is_active)
    level = Level.ERROR if is_sending or others.namesakes else Level.WARN
    controllers = [f'{each.name}: {", ".join(each.joints)}' for each in around.controllers]
    return _part(
        'no other node publishes the commands or has this name',
        {
            'commands': others.commands,
            'subscribers of the commands': others.subscribers or None,
            'joints of the controllers': '; '.join(controllers) or NONE,
            'other publishers of the commands': others.rivals or None,
            'other nodes with this name': others.namesakes,
        },
        (Level.ERROR, around.objection),
        (Level.WARN, describe_compensation(loop, others.names) if loop else ''),
        *((level, text) for text in problems),
    )


def _clock(clock: SimulatedClock) -> Part:
    """Report simulated time that does not advance."""
    is_late = clock.unchanged_for >= _PAUSE
    fine, problem = 'simulated time advances', ''
    if not clock.time and not clock.publishers:
        fine = 'no message on /clock yet'
        if clock.unchanged_for >= _DISCOVERY:
            problem = 'use_sim_time is set, but nothing publishes /clock'
    elif is_late:
        problem = f'simulated time has not advanced for more than {_PAUSE:g} s' + (
            f' (publishers of /clock: {clock.publishers}); is the simulation paused?'
            if clock.publishers
            else ': nothing publishes /clock any more'
        )
    values = {
        'time [s]': f'{clock.time:.3f}',
        'unchanged for [s]': clock.unchanged_for,
        'publishers': clock.publishers,
    }
    return _part(
        fine, values, (Level.WARN if clock.publishers or not is_late else Level.ERROR, problem)
    )


def _joint_states(now: float, loop: ControlLoop, around: Surroundings, missing: str) -> Part:
    collector, settings = loop.collector, loop.settings
    if_lost = Level.ERROR if around.is_active else Level.WARN
    unseen, without_velocity = collector.unseen(), collector.without_velocity()
    no_damping = f'joints reported without velocity have no damping in {settings.mode.value}'
    warnings = [
        *describe_late(loop, now),
        *describe_implausible(loop).values(),
        *(f"'{name}' is not reported; its locked position is used" for name in unseen),
        no_damping if loop.law.is_closed and without_velocity else '',
    ]
    return _part(
        'fresh',
        {
            'topic': around.topics[0],
            'rate [Hz]': around.state_rate,
            'age [s]': now - collector.time if np.isfinite(collector.time) else 'never',
            'timeout [s]': settings.state_timeout,
            'publishers': around.publishers,
            'late, not commanded': collector.late(now),
            'locked, never reported': unseen,
            'without velocity': without_velocity,
        },
        (if_lost, missing or describe_lost_states(now, loop)),
        (if_lost, _describe_silence(around)),
        (Level.ERROR, describe_motion(now, loop)),
        *((Level.WARN, text) for text in warnings),
    )


def _describe_silence(around: Surroundings) -> str:
    """Describe connected publishers that send no joint states; return '' if there are none."""
    if not around.publishers or around.silence < _LONG_SILENCE:
        return ''
    publishers = 'publisher is' if around.publishers == 1 else 'publishers are'
    return (
        f'no message on joint_states for {around.silence:.0f} s, although '
        f'{around.publishers} {publishers} connected (a killed publisher stays connected for up '
        'to 20 s); if ros2 topic hz shows messages, restart this node'
    )


def _reference(now: float, loop: ControlLoop, around: Surroundings) -> Part:
    fine = 'followed' if loop.phase is Phase.RUNNING else 'no reference is used'
    is_too_far = around.is_active and loop.phase in TOO_FAR_PHASES
    return _part(
        'disabled' if loop.supervisor.is_stopping else fine,
        {
            'age [s]': now - loop.reference.time if loop.reference else 'never',
            'timeout [s]': loop.settings.reference_timeout,
            'mode': loop.settings.mode.value,
        },
        (Level.WARN, loop.phase.value if is_too_far else ''),
    )


def _efforts(now: float, loop: ControlLoop, around: Surroundings, monitor: Monitor) -> Part:
    unmatched, gains = '', ''
    if around.is_active and not around.receivers and not loop.dry_run.is_active:
        unmatched, names = 'the commands have no subscribers', around.others.subscribers
        if names:
            unmatched += f' that match; another type or quality of service is used by {names}'
    if around.is_active and loop.phase in COMPUTING_PHASES:
        gains = describe_unstable_gains(loop)
    return _part(
        activity(now, loop),
        {
            'receivers': around.receivers,
            'topic with names': around.topics[1],
            'topic of the external efforts': around.topics[2],
            'measured efforts contain gravity': loop.measures_gravity,
            'scale of the measured efforts': loop.external_effort_estimator.scale[loop.index],
            'scale': loop.of_joint['effort_scale'],
            'limits [N m, N]': loop.limits,
            'cut to limit since the last report': monitor.cut,
            'pushed back from position limits': _pushed_back(loop),
            **{f'{joint} cut to limit': count for joint, count in monitor.cut_counts.items()},
            **{f'{joint} slowed': count for joint, count in monitor.slowed.items()},
        },
        (Level.WARN, unmatched),
        (Level.WARN, f'effort cut to its limit: {_text(monitor.cut)}' if monitor.cut else ''),
        (Level.WARN, gains),
    )


def _pushed_back(loop: ControlLoop) -> list[str]:
    """Return the joints that a spring pushes away from a position limit."""
    state = loop.collector.state()
    if state is None:
        return []
    return list(compress(loop.joints, loop.motion_limits.springs(state)))


def _model(loop: ControlLoop, imu: str) -> Part:
    """Report the robot and its loads; `imu` says why the motion of the base is unknown, if so."""
    robot, loads, count = loop.robot, loop.loads, len(loop.robot.warnings)
    warnings = f'{count} warning{"s" * (count > 1)} about the robot description'
    return _part(
        f"robot '{robot.name}'",
        {
            'robot': robot.name,
            'mass [kg]': float(np.sum(robot.mass)),
            'joints': loop.joints,
            'payload': [f'{load.mass:g} kg on {link}' for link, load in loads.payloads.items()],
            'payload com [m]': [x for load in loads.payloads.values() for x in load.com],
            'gravity [m/s^2]': loads.gravity if loads.include_gravity else 'not included',
            'gravity in the root link [m/s^2]': loads.gravity_at_root,
            **{f'warning {k}': str(each) for k, each in enumerate(robot.warnings, start=1)},
        },
        (Level.ERROR, imu),
        (Level.WARN, OUTDATED if loop.is_outdated else ''),
        (Level.WARN, warnings if count else ''),
    )
