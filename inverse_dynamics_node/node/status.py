"""
Writes the status of the node: a record of values, and a table of what there is to say about them.

`/diagnostics` publishes both as they are, the log prints the problems that are new, and `watch`
reads some of the values by their keys.
"""

from __future__ import annotations

from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from ..control.external_loads import IMU_TIMEOUT
from ..control.following import Following
from ..control.loop import ControlLoop
from ..control.supervisor import COMPUTING_PHASES, Phase, TOO_FAR_PHASES
from ..ros.controllers import Controller
from ..ros.diagnostics import as_text, Level, NodeStatus, Part
from ..ros.graph import OtherNodes, SimulatedClock
from .monitor import Monitor
from .scheduling import Scheduled
from .status_text import (
    activity,
    describe_compensation,
    describe_implausible,
    describe_unstable_gains,
    missing_inputs,
    recovery,
)

OK, WARN, ERROR = Level.OK, Level.WARN, Level.ERROR

_SLOW = 0.95  # the loop is too slow below this fraction of the requested rate
_LONG_SILENCE = 5.0  # [s]; a connected publisher that is silent for longer is suspicious
_DISCOVERY = 1.0  # [s]; the discovery of a publisher may take this long
_PAUSE = 5.0  # [s]; a longer standstill of simulated time is reported
_RECENT = 10.0  # [s]; a problem of the motion in a dry run is reported for this long

OUTDATED = (
    'another robot description has arrived; to use it, deactivate, clean up and configure the node'
)
_Row = tuple[str, Level, str]  # part, level and sentence; a row without a sentence is left out


class Surroundings(NamedTuple):
    """The lifecycle state, the connections and the scheduling of the node."""

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
    scheduled: Scheduled


def describe_node(
    now: float, loop: ControlLoop | None, around: Surroundings, monitor: Monitor
) -> NodeStatus:
    """
    Return the status since the last report; `now` is in [s].

    The message of a part has the sentences about its problems, or else the sentence about its
    normal condition. `loop` is None until the node is configured. The parts about the robot are
    then missing.
    """
    record, table = _values_of_node(around, monitor), _table_of_node(loop, around, monitor)
    if loop is not None:
        record |= _values_of_robot(now, loop, around, monitor)
        table += _table_of_robot(now, loop, around, monitor)
        if around.is_active:
            record['loop'] |= {
                'mode': loop.settings.mode.value,
                'phase': loop.phase.value,
                'dry run': loop.dry_run.is_active,
                'gain': loop.shaper.gain,
            }
    status = NodeStatus()
    for part, values in record.items():
        rows = [(level, text) for name, level, text in table if name == part and text]
        worst = max(level for level, _ in rows)
        texts = (text for level, text in rows if (level is OK) is (worst is OK))
        values = {key: as_text(value) for key, value in values.items()}
        status[part] = Part(worst, '; '.join(texts), values)
    return status


def _values_of_node(around: Surroundings, monitor: Monitor) -> dict[str, dict[str, Any]]:
    """Return the values of each part about the node and what surrounds it."""
    others, clock = around.others, around.clock
    controllers = [
        f'{each.name}{f" ({each.state})" * bool(each.state)}: {", ".join(each.joints)}'
        for each in around.controllers
    ]
    record: dict[str, dict[str, Any]] = {
        'loop': {
            'state': around.state,
            'rate [Hz]': monitor.rate,
            'requested rate [Hz]': (
                1.0 / monitor.period if monitor.period else 'that of the joint states'
            ),
            'period p99 [ms]': _milliseconds(monitor.periods, 99.0),
            'period worst [ms]': _milliseconds(monitor.periods, 100.0),
            'compute time p99 [ms]': _milliseconds(monitor.durations, 99.0),
            'overruns': monitor.overruns,
        },
        'messages': monitor.rejected,
        'other nodes': {
            'commands': others.commands,
            'subscribers of the commands': others.subscribers or None,
            'joints of the controllers': '; '.join(controllers) or None,
            'other publishers of the commands': others.rivals or None,
            'other nodes with this name': others.namesakes,
        },
        'scheduling': {
            'policy': around.scheduled.policy,
            'priority': around.scheduled.priority,
        },
    }
    if clock is not None:
        record['clock'] = {
            'time [s]': f'{clock.time:.3f}',
            'unchanged for [s]': clock.unchanged_for,
            'publishers': clock.publishers,
        }
    return record


def _milliseconds(times: list[float], percentile: float) -> float | None:
    return float(1e3 * np.percentile(times, percentile)) if times else None


def _values_of_robot(
    now: float, loop: ControlLoop, around: Surroundings, monitor: Monitor
) -> dict[str, dict[str, Any]]:
    """Return the values of each part about the robot."""
    collector, settings, robot, loads = loop.collector, loop.settings, loop.robot, loop.loads
    state = collector.state()
    springs = () if state is None else compress(loop.joints, loop.motion_limits.springs(state))
    return {
        'joint states': {
            'topic': around.topics[0],
            'rate [Hz]': around.state_rate,
            'age [s]': now - collector.time if np.isfinite(collector.time) else 'never',
            'timeout [s]': settings.state_timeout,
            'publishers': around.publishers,
            'late, not commanded': collector.late(now),
            'locked, never reported': collector.unseen(),
            'locked positions [rad, m]': [
                float(collector.q[collector.joint_names.index(name)])
                for name in collector.unseen()
            ],
            'without velocity': collector.without_velocity(),
        },
        'reference': {
            'age [s]': now - loop.reference.time if loop.reference else 'never',
            'timeout [s]': settings.reference_timeout,
            'mode': settings.mode.value,
            **_values_of_trajectory(loop.following),
        },
        'efforts': {
            'receivers': around.receivers,
            'topic with names': around.topics[1],
            'topic of the external efforts': around.topics[2],
            'measured efforts contain gravity': loop.measures_gravity,
            'not shown by the tool wrench': loop.hidden_components,
            'scale of the measured efforts': loop.external_effort_estimator.scale[loop.index],
            'scale': loop.of_joint['effort_scale'],
            'limits [N m, N]': loop.limits,
            'cut to limit since the last report': monitor.cut,
            'pushed back from position limits': springs,
            **{f'{joint} cut to limit': count for joint, count in monitor.cut_counts.items()},
            **{f'{joint} slowed': count for joint, count in monitor.slowed.items()},
        },
        'model': {
            'robot': robot.name,
            'mass [kg]': float(np.sum(robot.mass)),
            'joints': loop.joints,
            'payload': [f'{load.mass:g} kg on {link}' for link, load in loads.payloads.items()],
            'payload links': list(loads.payloads),
            'payload masses [kg]': [load.mass for load in loads.payloads.values()],
            'payload com [m]': [x for load in loads.payloads.values() for x in load.com],
            'gravity [m/s^2]': loads.gravity if loads.include_gravity else 'not included',
            'gravity in the root link [m/s^2]': loads.gravity_at_root,
            **{f'warning {k}': str(each) for k, each in enumerate(robot.warnings, start=1)},
        },
    }


def _values_of_trajectory(following: Following) -> dict[str, Any]:
    doing = ''
    if following.is_active:
        doing = 'followed' if following.time_left else 'held'
    return {
        'trajectory': ': '.join(filter(None, (doing, following.reason))) or None,
        'trajectory progress [%]': round(100.0 * following.progress, 1),
        'trajectory time left [s]': round(following.time_left, 3),
        'trajectory largest error [rad, m]': float(following.largest_error.max()),
    }


def _table_of_node(loop: ControlLoop | None, around: Surroundings, monitor: Monitor) -> list[_Row]:
    others, scheduled = around.others, around.scheduled
    rivals, namesakes = '', ''
    hint = ' (stop the other node; a killed node stays listed for up to 20 s)'
    if others.namesakes:
        is_one = others.namesakes == 1
        nodes = 'another node has' if is_one else f'{others.namesakes} other nodes have'
        namesakes = f'{nodes} the name {around.name}{hint}'
    if others.rivals:
        rivals = f'{others.commands} is also published by {others.rivals}'
        rivals += hint * (not namesakes)
    # Nodes may take turns at publishing on a topic, but must never have the same name.
    is_sending = around.is_active and not (loop and loop.dry_run.is_active)
    rejections = f'messages rejected since the last report: {monitor.rejections}'
    return [
        ('loop', OK, '' if loop and around.is_active else around.state),
        ('messages', OK, f'messages rejected in total: {sum(monitor.rejected.values())}'),
        ('messages', WARN, rejections if monitor.rejections else ''),
        ('other nodes', OK, 'no other node publishes the commands or has this name'),
        ('other nodes', ERROR, around.objection),
        *(
            (
                'other nodes',
                WARN,
                f'{each.name} is {each.state}: it takes no commands until it is activated',
            )
            for each in around.controllers
            if is_sending and each.state not in ('', 'active')
        ),
        ('other nodes', WARN, describe_compensation(loop, others.names) if loop else ''),
        ('other nodes', ERROR if is_sending or namesakes else WARN, rivals),
        ('other nodes', ERROR, namesakes),
        ('scheduling', OK, scheduled.problem or 'real-time priority'),
        ('scheduling', WARN, scheduled.problem if scheduled.is_requested else ''),
        *(_table_of_clock(around.clock) if around.clock is not None else ()),
    ]


def _table_of_clock(clock: SimulatedClock) -> list[_Row]:
    has_publisher, has_stopped = bool(clock.publishers), clock.unchanged_for >= _PAUSE
    level = WARN if has_publisher or not has_stopped else ERROR
    if not clock.time and not has_publisher:
        is_missing = clock.unchanged_for >= _DISCOVERY
        problem = 'use_sim_time is set, but nothing publishes /clock'
        return [
            ('clock', OK, 'no message on /clock yet'),
            ('clock', level, problem if is_missing else ''),
        ]
    reason = ': nothing publishes /clock any more'
    if has_publisher:
        reason = f' (publishers of /clock: {clock.publishers}); is the simulation paused?'
    problem = f'simulated time has not advanced for more than {_PAUSE:g} s{reason}'
    return [
        ('clock', OK, 'simulated time advances'),
        ('clock', level, problem if has_stopped else ''),
    ]


def _table_of_robot(
    now: float, loop: ControlLoop, around: Surroundings, monitor: Monitor
) -> list[_Row]:
    collector, settings, phase = loop.collector, loop.settings, loop.phase
    is_active, is_dry = around.is_active, loop.dry_run.is_active
    doing = activity(now, loop)
    missing = missing_inputs(loop, *around.inputs, now if phase is Phase.WAITING else None)
    missing = [f'no command yet: waiting for {each}' for each in missing]
    imu = missing.pop() if loop.lacks_imu else ''
    if loop.has_imu and not imu and not loop.loads.is_base_known(now):
        imu = f'no message on imu for more than {IMU_TIMEOUT:g} s'
        imu = f'the motion of the base is unknown: {imu}'
    stale = collector.stale(now, settings.state_timeout)
    lost = '; '.join(missing)
    if not lost and stale:
        lost = f'joint states are lost: {", ".join(stale)}'
    elif not lost and phase is Phase.STATE_LOST:
        lost = recovery(settings.state_timeout)
    motion, found_at = loop.motion_problem
    is_moved = is_dry and 0.0 <= now - found_at <= _RECENT
    no_damping = f'joints reported without velocity have no damping in {settings.mode.value}'
    has_no_damping = loop.law.is_closed and collector.without_velocity()
    if_lost = ERROR if is_active else WARN
    unmatched = 'the commands have no subscribers'
    if around.others.subscribers:
        unmatched += (
            ' that match; another type or quality of service is used by '
            f'{around.others.subscribers}'
        )
    is_unmatched = is_active and not is_dry and not around.receivers
    count = len(loop.robot.warnings)
    warnings = f'{count} warning{"s" * (count > 1)} about the robot description'
    fine = 'followed' if phase is Phase.RUNNING else 'no reference is used'
    rate, period = monitor.rate, monitor.period
    is_slow = is_active and 0.0 < rate * period < _SLOW
    has_stopped = is_active and phase in (Phase.LIMIT_STOP, Phase.NO_SOLUTION)
    return [
        ('loop', OK, doing if is_active else ''),
        ('loop', ERROR, doing if has_stopped else ''),
        ('loop', WARN, doing if is_active and loop.supervisor.contact else ''),
        ('loop', WARN, f'only {rate:.1f} commands/s' if is_slow else ''),
        ('joint states', OK, 'fresh'),
        ('joint states', if_lost, lost),
        ('joint states', if_lost, _describe_silence(around)),
        ('joint states', ERROR, f'the motion limits would stop the arm: {motion}' * is_moved),
        *(
            (
                'joint states',
                WARN,
                f"joint '{name}' (not commanded) was last reported {age:.1f} s ago and is assumed "
                'to be at rest at its last position; if this is normal, set '
                f'locked_positions.{name}',
            )
            for name, age in collector.late(now).items()
        ),
        *(('joint states', WARN, text) for text in describe_implausible(loop).values()),
        *(
            ('joint states', WARN, f"'{name}' is not reported; its locked position is used")
            for name in collector.unseen()
        ),
        ('joint states', WARN, no_damping if has_no_damping else ''),
        ('reference', OK, 'disabled' if loop.supervisor.is_stopping else fine),
        ('reference', WARN, phase.value if is_active and phase in TOO_FAR_PHASES else ''),
        ('efforts', OK, doing),
        ('efforts', WARN, unmatched if is_unmatched else ''),
        ('efforts', WARN, f'effort cut to its limit: {as_text(monitor.cut)}' * bool(monitor.cut)),
        (
            'efforts',
            WARN,
            describe_unstable_gains(loop) if is_active and phase in COMPUTING_PHASES else '',
        ),
        ('model', OK, f"robot '{loop.robot.name}'"),
        ('model', ERROR, imu),
        ('model', WARN, OUTDATED if loop.is_outdated else ''),
        ('model', WARN, warnings if count else ''),
    ]


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
