"""What the node has been doing, and whether someone has to look after it, as values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import enum
import math
from typing import NamedTuple

import numpy as np

from ..robot.model import Booleans, Floats
from ..robot.plausibility import describe_implausible_position
from .control_loop import ControlLoop
from .controller import Command, COMPUTING_PHASES, Phase
from .settings import Mode, StalePolicy

_LONG_SILENCE = 5.0  # [s]; after which connected publishers are suspicious
_MOST_REASONS = 20  # distinct ones to tell apart
_MOST_NAMES = 5  # of nodes, in one message
_DISCOVERY = 1.0  # [s]; how long a publisher may be there without being known
_PAUSE = 5.0  # [s]; simulated time that stands still for longer is worth a message
_SLOW = 0.95  # share of the rate asked for below which it is worth a warning


class Level(enum.IntEnum):
    """How bad it is; the numbers are those of diagnostic_msgs."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Status(NamedTuple):
    """How one part of the node is."""

    part: str
    level: Level
    message: str
    values: dict[str, str]


class Others(NamedTuple):
    """Nodes that have to do with this one."""

    name: str = ''
    """Fully qualified name of this node."""
    commands: str = ''
    """Topic of the commands."""
    subscribers: tuple[str, ...] = ()
    """Nodes that subscribe to the commands."""
    rivals: tuple[str, ...] = ()
    """Other nodes that publish on the topic of the commands."""
    namesakes: int = 0
    """Number of other nodes with the name of this one."""


class SimulatedTime(NamedTuple):
    """The clock of a simulation."""

    time: float
    """[s]; 0 if there has been none yet."""
    unchanged_for: float
    """Steady time since it changed [s]."""
    publishers: int
    """Of /clock."""


class GraphInfo(NamedTuple):
    """What the node sees of others."""

    receivers: int
    """Subscriptions to the commands."""
    publishers: int
    """Publishers of joint states."""
    is_active: bool
    state: str
    """Of the life cycle."""
    others: Others = Others()
    state_publishers: tuple[str, ...] = ()
    """Nodes that publish joint states; only asked for while their positions contradict."""
    simulated: SimulatedTime | None = None
    """None unless the node runs on simulated time."""
    silence: float = 0.0
    """Time since the last message on joint_states, of whichever joints [s]."""


class Monitor:
    """
    Counts what happens, and judges it once in a while.

    Parameters
    ----------
    period : float
        Time between commands that was asked for [s]; 0 for one for every joint state.

    """

    def __init__(self, period: float = 0.0) -> None:
        self.rejected: Counter[str] = Counter()
        """Messages that could not be used, by topic and reason, since the start."""
        self.clamped: Counter[str] = Counter()
        """Commands in which a joint's effort was cut to its limit, since the start."""
        self.slowed: Counter[str] = Counter()
        """Commands in which a joint's effort was kept from changing faster, since the start."""
        self.overruns = 0
        """Commands that came more than half a period late, since the start."""
        self.period = period
        self._last = math.nan
        self._periods: list[float] = []
        self._times: list[float] = []
        self._news: Counter[str] = Counter()

    def step(self, now: float, took: float, command: Command, joints: Sequence[str]) -> None:
        """
        Count one command.

        Parameters
        ----------
        now : float
            When its computation began [s].
        took : float
            How long that and sending it took [s].
        command : Command
            As sent.
        joints : sequence of str
            The commanded joints.

        """
        elapsed = now - self._last
        self._last = now
        if elapsed >= 0.0:  # there was one before, and the clock has not been put back
            self._periods.append(elapsed)
            self.overruns += 0.0 < 1.5 * self.period < elapsed
        self._times.append(took)
        if np.count_nonzero(command.is_saturated):
            self._count('cut', self.clamped, joints, command.is_saturated)
        if np.count_nonzero(command.is_slowed):
            self._count('slowed', self.slowed, joints, command.is_slowed)

    def _count(
        self, what: str, counter: Counter[str], joints: Sequence[str], flags: Booleans
    ) -> None:
        names = [name for name, flag in zip(joints, flags, strict=True) if flag]
        counter.update(names)
        self._news.update(f'{what} {name}' for name in names)

    def pause(self) -> None:
        """Count no time until the next command."""
        self._last = math.nan

    def reject(self, topic: str, reason: str) -> None:
        """Count one message that could not be used."""
        text = f'{topic}: {reason}'
        if text not in self.rejected and len(self.rejected) >= _MOST_REASONS:
            text = 'others'
        self.rejected[text] += 1
        self._news['rejected'] += 1

    def report(self, now: float, loop: ControlLoop | None, around: GraphInfo) -> list[Status]:
        """
        Judge all parts of the node by what happened since the last report.

        Parameters
        ----------
        now : float
            The time [s].
        loop : ControlLoop or None
            None as long as the node is not configured.
        around : GraphInfo
            See there.

        Returns
        -------
        statuses : list of Status
            One for each part.

        """
        statuses = [self._of_loop(now, loop, around), self._of_messages(), _of_others(around)]
        if around.simulated is not None:
            statuses.append(_of_clock(around.simulated))
        if loop is not None:
            statuses += [
                _of_states(now, loop, around),
                _of_reference(now, loop, around),
                self._of_efforts(now, loop, around),
                _of_model(now, loop),
            ]
        self._periods, self._times = [], []
        self._news.clear()
        return statuses

    def _of_loop(self, now: float, loop: ControlLoop | None, around: GraphInfo) -> Status:
        total = sum(self._periods)
        rate = len(self._periods) / total if total > 0.0 else 0.0
        values = {
            'state': around.state,
            'rate [Hz]': f'{rate:.1f}',
            'rate asked for [Hz]': f'{1.0 / self.period:g}' if self.period else 'of joint states',
            'period p99 [ms]': _in_ms(self._periods, 99.0),
            'period worst [ms]': _in_ms(self._periods, 100.0),
            'compute time p99 [ms]': _in_ms(self._times, 99.0),
            'overruns': str(self.overruns),
        }
        if not around.is_active or loop is None:
            return Status('loop', Level.OK, around.state, values)
        values['mode'] = loop.controller.settings.mode.value
        values['phase'] = loop.controller.phase.value
        values['gain'] = f'{loop.controller.gain:.3f}'
        if self.period and total > 0.0 and rate * self.period < _SLOW:
            return Status('loop', Level.WARN, f'only {rate:.1f} commands/s', values)
        return Status('loop', Level.OK, activity(now, loop), values)

    def _of_messages(self) -> Status:
        values = {text: str(count) for text, count in self.rejected.items()}
        new = self._news['rejected']
        if new:
            return Status('messages', Level.WARN, f'{new} rejected lately', values)
        total = sum(self.rejected.values())
        return Status('messages', Level.OK, f'{total} rejected in all', values)

    def _of_efforts(self, now: float, loop: ControlLoop, around: GraphInfo) -> Status:
        values = {'receivers': str(around.receivers)}
        for what, counter in (('cut to limit', self.clamped), ('slowed', self.slowed)):
            values |= {f'{name} {what}': str(count) for name, count in counter.items()}
        cut = [text.removeprefix('cut ') for text in self._news if text.startswith('cut ')]
        if around.is_active and not around.receivers:
            message = 'nobody receives the commands'
            if around.others.subscribers:
                names = join_names(around.others.subscribers)
                message += f': {names} subscribes with another type or quality of service'
            return Status('efforts', Level.WARN, message, values)
        if cut:
            return Status('efforts', Level.WARN, f'cut to its limit: {", ".join(cut)}', values)
        return Status('efforts', Level.OK, activity(now, loop), values)


def _of_others(around: GraphInfo) -> Status:
    others = around.others
    values = {
        'commands': others.commands,
        'subscribers of the commands': join_names(others.subscribers) or 'none',
        'other publishers of the commands': join_names(others.rivals) or 'none',
        'other nodes with this name': str(others.namesakes),
    }
    problems = []
    if others.rivals:
        problems.append(f'{others.commands} is also published by {join_names(others.rivals)}')
    if others.namesakes:
        nodes = 'another node' if others.namesakes == 1 else f'{others.namesakes} other nodes'
        problems.append(f'{nodes} with the name {others.name}')
    if not problems:
        message = 'no other node publishes the commands or has this name'
        return Status('other nodes', Level.OK, message, values)
    # Nodes that share a topic may be meant to take turns, nodes that share a name never are.
    is_error = around.is_active or others.namesakes
    message = f'{"; ".join(problems)} (stop it; a killed one is listed for up to 20 s more)'
    return Status('other nodes', Level.ERROR if is_error else Level.WARN, message, values)


def _of_clock(clock: SimulatedTime) -> Status:
    values = {
        'time [s]': f'{clock.time:.3f}',
        'unchanged for [s]': f'{clock.unchanged_for:.1f}',
        'publishers': str(clock.publishers),
    }
    is_late = clock.unchanged_for >= _PAUSE
    if not clock.time and not clock.publishers:
        if clock.unchanged_for < _DISCOVERY:
            return Status('clock', Level.OK, 'no message on /clock yet', values)
        message = 'use_sim_time is set, but nothing publishes /clock (0 publishers)'
        return Status('clock', Level.ERROR if is_late else Level.WARN, message, values)
    if not is_late:
        return Status('clock', Level.OK, 'simulated time advances', values)
    message = f'simulated time has not advanced for more than {_PAUSE:g} s'
    if not clock.publishers:
        message += ': nothing publishes /clock any more (0 publishers)'
        return Status('clock', Level.ERROR, message, values)
    message += f' (publishers of /clock: {clock.publishers}): is the simulation paused?'
    return Status('clock', Level.WARN, message, values)


def activity(now: float, loop: ControlLoop) -> str:
    """
    Describe what the controller is doing, and why.

    Parameters
    ----------
    now : float
        The time [s].
    loop : ControlLoop
        The active robot.

    """
    controller = loop.controller
    phase, settings = controller.phase, controller.settings
    if phase is Phase.HOLDING:
        return f'{phase.value}: {_reason_to_hold(loop)}'
    if phase is Phase.TOO_FAR:
        return (
            'holding position: the reference starts or jumps more than max_position_jump '
            f'({settings.max_position_jump:g} rad or m) away'
        )
    if phase in COMPUTING_PHASES or phase is Phase.WAITING:
        return str(phase.value)
    if not controller.has_effort:
        consequence = 'stopped, zeros sent'
    elif phase is Phase.STOPPED or settings.on_stale_state is StalePolicy.ZERO:
        consequence = 'ramping efforts down'
    else:
        consequence = 'keeping the last efforts'
    return f'{consequence}: {_reason_to_stop(now, loop)}'


def _reason_to_hold(loop: ControlLoop) -> str:
    settings = loop.controller.settings
    if settings.mode is Mode.GRAVITY_COMPENSATION:
        return 'the reference is not used in mode gravity_compensation'
    if loop.reference is None:
        return 'no reference'
    return f'no reference for more than {settings.reference_timeout:g} s'


def _reason_to_stop(now: float, loop: ControlLoop) -> str:
    if loop.controller.phase is Phase.STOPPED:
        return 'disabled by ~/enable'
    if loop.controller.phase is Phase.NO_SOLUTION:
        return str(loop.controller.phase.value)
    if loop.lacks_imu:
        return 'no message on imu yet'
    if not loop.collector.is_consistent:
        return '; '.join(describe_alternating(loop).values())
    if loop.collector.missing():
        return f'no joint state of {", ".join(loop.collector.missing())} yet'
    timeout = loop.controller.settings.state_timeout
    joints = ', '.join(loop.collector.stale(now, timeout))
    return f'no joint state of {joints} for more than {timeout:g} s' if joints else _recovery(loop)


def _of_states(now: float, loop: ControlLoop, around: GraphInfo) -> Status:
    collector = loop.collector
    timeout = loop.controller.settings.state_timeout
    slow = loop.controller.settings.uncommanded_state_timeout
    values = {
        'age [s]': _age(now, collector.time),
        'publishers': str(around.publishers),
        'late, not commanded': ', '.join(collector.late(now, slow)) or 'none',
        'locked, not seen': ', '.join(collector.unseen()) or 'none',
        'without velocity': ', '.join(collector.without_velocity()) or 'none',
    }
    stale = collector.stale(now, timeout)
    if collector.missing():
        level = Level.ERROR if around.is_active else Level.WARN
        message = f'waiting for {loop.missing()[0]}'
        return Status('joint states', level, message + describe_silence(around), values)
    if stale:
        level = Level.ERROR if around.is_active else Level.WARN
        message = f'lost: {", ".join(stale)}'
        return Status('joint states', level, message + describe_silence(around), values)
    conflicts = describe_alternating(loop, around.state_publishers)
    if conflicts:
        return Status('joint states', Level.ERROR, '; '.join(conflicts.values()), values)
    if loop.controller.phase is Phase.STATE_LOST:
        level = Level.ERROR if around.is_active else Level.WARN
        return Status('joint states', level, _recovery(loop), values)
    warnings = [*describe_late(loop, now), *describe_implausible(loop).values()]
    if warnings:
        return Status('joint states', Level.WARN, '; '.join(warnings), values)
    if collector.unseen():
        return Status('joint states', Level.WARN, 'some joints count as locked', values)
    if loop.controller.settings.mode is Mode.COMPUTED_TORQUE and collector.without_velocity():
        return Status('joint states', Level.WARN, 'no velocity, no damping of the loop', values)
    return Status('joint states', Level.OK, 'fresh', values)


def _of_reference(now: float, loop: ControlLoop, around: GraphInfo) -> Status:
    controller = loop.controller
    time = -math.inf if loop.reference is None else loop.reference.time
    values = {'age [s]': _age(now, time), 'mode': controller.settings.mode.value}
    if around.is_active and controller.phase is Phase.TOO_FAR:
        return Status('reference', Level.WARN, controller.phase.value, values)
    if controller.is_stopping:
        return Status('reference', Level.OK, 'disabled', values)
    message = 'followed' if controller.phase is Phase.RUNNING else 'none, or not wanted'
    return Status('reference', Level.OK, message, values)


def _of_model(now: float, loop: ControlLoop) -> Status:
    robot, loads = loop.robot, loop.loads
    payloads = [f'{load.mass:g} kg on {link}' for link, load in loads.payloads.items()]
    values = {
        'robot': robot.name,
        'mass [kg]': f'{np.sum(robot.mass):.4g}',
        'joints': ', '.join(loop.controller.joints),
        'payload': ', '.join(payloads) or 'none',
        'gravity [m/s^2]': _listed(loads.gravity) if loads.include_gravity else 'not included',
    }
    values |= {f'warning {k}': text for k, text in enumerate(robot.warnings, start=1)}
    if loop.has_imu and not loads.is_base_known(now):
        since = 'yet' if loop.lacks_imu else f'for more than {loads.settings.imu_timeout:g} s'
        message = f'the motion of the base is not known: no message on imu {since}'
        return Status('model', Level.ERROR, message, values)
    if robot.warnings:
        message = f'{len(robot.warnings)} warnings about the robot description'
        return Status('model', Level.WARN, message, values)
    return Status('model', Level.OK, f"robot '{robot.name}'", values)


def describe_alternating(loop: ControlLoop, publishers: Sequence[str] = ()) -> dict[str, str]:
    """
    Describe the joints whose positions alternate faster than they can move, by name.

    Parameters
    ----------
    loop : ControlLoop
        The robot.
    publishers : sequence of str
        Nodes that publish joint states, if known.

    """
    question = 'does more than one node publish it?'
    if publishers:
        question = f'published by {join_names(publishers)}'
    return {
        joint: f'positions of {joint} alternate between {min(pair):.4g} and {max(pair):.4g} '
        f'faster than it can move ({question})'
        for joint, pair in loop.collector.alternating().items()
    }


def _recovery(loop: ControlLoop) -> str:
    """Say when efforts will rise again after joint states were lost."""
    controller = loop.controller
    return (
        'joint states were lost or contradictory; efforts rise after '
        f'{controller.recovery_time:g} s without a gap longer than state_timeout '
        f'({controller.settings.state_timeout:g} s)'
    )


def describe_silence(around: GraphInfo) -> str:
    """Describe connected publishers from which nothing arrives; empty if there are none."""
    if not around.publishers or around.silence < _LONG_SILENCE:
        return ''
    return (
        f'; no message on joint_states for {around.silence:.0f} s, although '
        f'{around.publishers} publishers are connected: if they do publish (ros2 topic hz), '
        'restart this node; if it happens again, set FASTDDS_BUILTIN_TRANSPORTS=UDPv4'
    )


def describe_late(loop: ControlLoop, now: float) -> list[str]:
    """Name the late joints that are not commanded, with their ages and the remedies."""
    timeout = loop.controller.settings.uncommanded_state_timeout
    return [
        f"joint '{name}' (not commanded) was last reported {age:.1f} s ago: taken to be at rest "
        f'where it was; raise uncommanded_state_timeout ({timeout:g} s) or set '
        f'locked_positions.{name}'
        for name, age in loop.collector.late(now, timeout).items()
    ]


def describe_implausible(loop: ControlLoop) -> dict[str, str]:
    """Describe joints far outside their position limits, by name."""
    findings = loop.implausible_positions()
    return {finding.joint: describe_implausible_position(finding) for finding in findings}


def _in_ms(times: list[float], percentile: float) -> str:
    return f'{1e3 * float(np.percentile(times, percentile)):.3f}' if times else 'none'


def _age(now: float, time: float) -> str:
    return f'{now - time:.3f}' if math.isfinite(time) else 'never'


def join_names(names: Sequence[str]) -> str:
    """Join names; of many, only the first few."""
    more = len(names) - _MOST_NAMES
    return ', '.join(names[:_MOST_NAMES]) + (f' and {more} more' if more > 0 else '')


def _listed(vector: Floats) -> str:
    return ', '.join(f'{x:.3f}' for x in vector)
