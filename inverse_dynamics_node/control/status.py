"""Diagnostics of the parts of the node that need no history."""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

import numpy as np

from ..robot.model import Floats
from .activity import (
    describe_alternating,
    describe_implausible,
    describe_late,
    describe_lost_imu,
    describe_recovery,
    describe_silence,
    join_names,
)
from .control_loop import ControlLoop
from .graph_info import GraphInfo, SimulatedTime
from .phase import Phase
from .settings import Mode

_DISCOVERY = 1.0  # [s]; how long a publisher may exist before it is discovered
_PAUSE = 5.0  # [s]; simulated time that stands still for longer is reported


class Level(enum.IntEnum):
    """Severity; the numbers are those of diagnostic_msgs."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Status(NamedTuple):
    """Diagnostics of one part of the node."""

    part: str
    level: Level
    message: str
    values: dict[str, str]


def joint_states_status(now: float, loop: ControlLoop, around: GraphInfo) -> Status:
    """Report missing, stale, contradictory and implausible joint states."""
    collector = loop.collector
    settings = loop.controller.settings
    values = {
        'topic': around.topics.joint_states,
        'rate [Hz]': f'{around.state_rate:.1f}',
        'age [s]': f'{now - collector.time:.3f}' if math.isfinite(collector.time) else 'never',
        'timeout [s]': f'{settings.state_timeout:g}',
        'publishers': str(around.publishers),
        'late, not commanded': ', '.join(collector.late(now, settings.uncommanded_state_timeout))
        or 'none',
        'locked, never reported': ', '.join(collector.unseen()) or 'none',
        'without velocity': ', '.join(collector.without_velocity()) or 'none',
    }
    level, message = _judge_joint_states(now, loop, around)
    return Status('joint states', level, message, values)


def _judge_joint_states(now: float, loop: ControlLoop, around: GraphInfo) -> tuple[Level, str]:
    collector, settings = loop.collector, loop.controller.settings
    if_lost = Level.ERROR if around.is_active else Level.WARN
    silence = describe_silence(around)
    if collector.missing():
        return if_lost, '; '.join(filter(None, (f'waiting for {loop.missing()[0]}', silence)))
    stale = collector.stale(now, settings.state_timeout)
    if stale:
        return if_lost, '; '.join(filter(None, (f'lost: {", ".join(stale)}', silence)))
    conflicts = describe_alternating(loop, around.state_publishers)
    if conflicts:
        return Level.ERROR, '; '.join(conflicts.values())
    if loop.controller.phase is Phase.STATE_LOST:
        return if_lost, describe_recovery(loop)
    warnings = [*describe_late(loop, now), *describe_implausible(loop).values()]
    if warnings:
        return Level.WARN, '; '.join(warnings)
    if collector.unseen():
        return Level.WARN, f'using the locked positions of {", ".join(collector.unseen())}'
    if settings.mode is Mode.COMPUTED_TORQUE and collector.without_velocity():
        return Level.WARN, 'no velocities: computed_torque has no damping'
    return Level.OK, 'fresh'


def reference_status(now: float, loop: ControlLoop, around: GraphInfo) -> Status:
    """Report the age of the reference, and whether it is followed."""
    controller = loop.controller
    age = 'never' if loop.reference is None else f'{now - loop.reference.time:.3f}'
    values = {
        'age [s]': age,
        'timeout [s]': f'{controller.settings.reference_timeout:g}',
        'mode': controller.settings.mode.value,
    }
    if around.is_active and controller.phase is Phase.TOO_FAR:
        return Status('reference', Level.WARN, controller.phase.value, values)
    if controller.is_stopping:
        return Status('reference', Level.OK, 'disabled', values)
    message = 'followed' if controller.phase is Phase.RUNNING else 'none, or not used'
    return Status('reference', Level.OK, message, values)


def model_status(now: float, loop: ControlLoop) -> Status:
    """Report the robot, its loads, and warnings about its description."""
    robot, loads = loop.robot, loop.loads
    payloads = [f'{load.mass:g} kg on {link}' for link, load in loads.payloads.items()]
    values = {
        'robot': robot.name,
        'mass [kg]': f'{np.sum(robot.mass):.4g}',
        'joints': ', '.join(loop.controller.joints),
        'payload': ', '.join(payloads) or 'none',
        'gravity [m/s^2]': _listed(loads.gravity) if loads.include_gravity else 'not included',
    }
    values |= {f'warning {k}': str(warning) for k, warning in enumerate(robot.warnings, start=1)}
    unknown = describe_lost_imu(now, loop)
    if loop.lacks_imu:
        unknown = 'the motion of the base is unknown: no message on imu yet'
    if unknown:
        return Status('model', Level.ERROR, unknown, values)
    if robot.warnings:
        message = f'{len(robot.warnings)} warnings about the robot description'
        return Status('model', Level.WARN, message, values)
    return Status('model', Level.OK, f"robot '{robot.name}'", values)


def other_nodes_status(around: GraphInfo) -> Status:
    """Report nodes that publish the same commands or have the same name."""
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
    # Nodes may take turns at publishing on a topic, but must never have the same name.
    is_error = (around.is_active and not around.is_dry_run) or others.namesakes
    message = f'{"; ".join(problems)} (stop it; a killed node stays listed for up to 20 s)'
    return Status('other nodes', Level.ERROR if is_error else Level.WARN, message, values)


def clock_status(clock: SimulatedTime) -> Status:
    """Report simulated time that does not advance."""
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


def _listed(vector: Floats) -> str:
    return ', '.join(f'{x:.3f}' for x in vector)
