"""
Describes the activity and the problems of the node.

A function named ``judge_...`` returns the level and the message of one part of `NodeStatus`.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

from ..robot.limit_checks import implausible_positions
from ..robot.model import Floats
from .external_loads import IMU_TIMEOUT
from .loop import ControlLoop
from .settings import Mode, StalePolicy
from .status import GraphInfo, Level
from .supervision import COMPUTING_PHASES, Phase, recovery_time, TOO_FAR_PHASES

_LONG_SILENCE = 5.0  # [s]; a connected publisher that is silent for longer is suspicious
_MISALIGNED = 5.0  # [degrees]; larger than any mounting error
_SLOW = 0.95  # the loop is too slow below this fraction of the requested rate
_DISCOVERY = 1.0  # [s]; the discovery of a publisher may take this long
_DELAY = 0.005  # [s]; typical delay from measurement to effort at 200 joint states per second
_RECENT = 10.0  # [s]; a problem of the motion in a dry run is reported for this long
_TURN_ERROR = 0.05  # [turns]; of a position that is whole turns away from its reference
_PAUSE = 5.0  # [s]; a longer standstill of simulated time is reported

Judgement = tuple[Level, str]


def activity(now: float, loop: ControlLoop) -> str:
    """Describe what the active control loop does and why; ``now`` is in [s]."""
    doing = _computing(loop)
    if loop.controller.phase is Phase.LIMIT_STOP:
        doing = f'stopped: {loop.controller.supervisor.limit_stop}'
    if not doing:
        doing = f'{_consequence(loop)}: {_reason_to_stop(now, loop)}'
    return f'dry run: {doing}' if loop.dry_run.is_active else doing


def _computing(loop: ControlLoop) -> str:
    """Describe a phase that computes efforts or waits for joint states; otherwise return ''."""
    phase, settings = loop.controller.phase, loop.controller.settings
    doing = str(phase.value).partition(':')[0]
    if phase in (Phase.FLOATING, Phase.HOLDING):
        return f'{doing}: {_reason_for_no_reference(loop)}'
    if phase in TOO_FAR_PHASES:
        return (
            f'{doing}: the reference starts too far away or jumps too far '
            f'(max_tracking_error: {settings.max_tracking_error:g} rad or m)'
            f'{_full_turns(loop)}'
        )
    return str(phase.value) if phase in COMPUTING_PHASES or phase is Phase.WAITING else ''


def _full_turns(loop: ControlLoop) -> str:
    """Name the joints that are whole turns away from the reference."""
    reference, robot = loop.reference, loop.robot
    if reference is None or reference.positions is None:
        return ''
    turns = (reference.positions - loop.collector.q[loop.index]) / (2.0 * math.pi)
    is_whole = (np.abs(turns - np.round(turns)) < _TURN_ERROR) & (np.abs(turns) > 0.5)
    is_whole &= ~(robot.is_prismatic_joint | robot.is_continuous)[loop.index]
    names = [
        joint for joint, is_turn in zip(loop.controller.joints, is_whole, strict=True) if is_turn
    ]
    return f'; whole turns away: {", ".join(names)}' if names else ''


def _consequence(loop: ControlLoop) -> str:
    controller = loop.controller
    if not controller.has_effort:
        return 'stopped' if loop.dry_run.is_active else 'stopped, zeros sent'
    is_stopped = controller.phase is Phase.STOPPED
    if is_stopped or controller.settings.on_stale_state is StalePolicy.ZERO:
        return 'ramping efforts down'
    return 'keeping the last efforts'


def _reason_for_no_reference(loop: ControlLoop) -> str:
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
        return f'{loop.controller.phase.value}: {loop.controller.law.cause_of_failure()}'
    timeout = loop.controller.settings.state_timeout
    joints = ', '.join(loop.collector.stale(now, timeout))
    if joints:
        return f'no joint state of {joints} for more than {timeout:g} s'
    return describe_recovery(loop)


def describe_lost_imu(now: float, loop: ControlLoop) -> str:
    """Report that IMU messages no longer arrive; return '' if they do or if none ever arrived."""
    loads = loop.loads
    if not loop.has_imu or loop.lacks_imu or loads.is_base_known(now):
        return ''
    return f'the motion of the base is unknown: no message on imu for more than {IMU_TIMEOUT:g} s'


def describe_recovery(loop: ControlLoop) -> str:
    """Describe when efforts rise again after a loss of joint states."""
    timeout = loop.controller.settings.state_timeout
    return (
        'joint states were lost or contradictory; efforts rise again after joint states have '
        f'arrived for {recovery_time(timeout):g} s without a gap longer than state_timeout '
        f'({timeout:g} s)'
    )


def describe_silence(around: GraphInfo) -> str:
    """Describe connected publishers that send no joint states; return '' if there are none."""
    if not around.publishers or around.silence < _LONG_SILENCE:
        return ''
    publishers = 'publisher is' if around.publishers == 1 else 'publishers are'
    return (
        f'no message on joint_states for {around.silence:.0f} s, although '
        f'{around.publishers} {publishers} connected (a killed publisher stays connected for up '
        'to 20 s); if ros2 topic hz shows messages, restart this node'
    )


def describe_imu_frame(loop: ControlLoop, frame: str, R_BS: Floats) -> str:
    """
    Describe a contradiction between the IMU frame and the robot description, or return ''.

    ``frame`` is the ``frame_id`` of the IMU messages. The frame need not be that of a link.
    ``R_BS`` is the configured rotation from this frame to the base frame, shape (3, 3).

    """
    robot = loop.robot
    if frame not in robot.link_names:
        return ''
    link = robot.link_index(frame)
    if robot.link_body[link]:
        return f"frame_id is '{frame}', a link moved by joints; expected a link fixed to the base"
    base = robot.link_index(loop.base_link)
    turned = robot.link_rotation[base].T @ robot.link_rotation[link] @ R_BS.T
    angle = math.degrees(math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(turned)) - 1.0)))))
    if angle < _MISALIGNED:
        return ''
    return (
        f"frame_id is '{frame}', but its orientation in the robot description differs from "
        f'imu_orientation by {angle:.0f} degrees'
    )


def describe_late(loop: ControlLoop, now: float) -> list[str]:
    """Describe uncommanded joints whose states are too old, and suggest remedies."""
    return [
        f"joint '{name}' (not commanded) was last reported {age:.1f} s ago and is assumed to be "
        f'at rest at its last position; if this is normal, set locked_positions.{name}'
        for name, age in loop.collector.late(now).items()
    ]


def describe_motion(now: float, loop: ControlLoop) -> str:
    """Describe what would have stopped the arm if the commands had been sent, or return ''."""
    text, time = loop.controller.motion_problem
    if not loop.dry_run.is_active or not 0.0 <= now - time <= _RECENT:
        return ''
    return f'the motion limits would stop the arm: {text}'


def describe_unstable_gains(loop: ControlLoop) -> str:
    """
    Describe gains with which joints may oscillate, if there are any.

    A delay T of the velocities makes damping unstable if it exceeds about I / T, and stiffness if
    it exceeds about I / T^2. I is the inertia of the joint; for `computed_torque`, it is 1.

    """
    names = {
        Mode.COMPUTED_TORQUE: ('kd', 'kp'),
        Mode.JOINT_IMPEDANCE: ('impedance_damping', 'stiffness'),
    }.get(loop.controller.settings.mode)
    if names is None:
        return ''
    gains, inertia = loop.controller.of_joint, np.ones(len(loop.index))
    with_inertia, advice = '', ['lower these gains']
    if names[0] == 'impedance_damping':
        inertia = loop.dynamics.mass_matrix(loop.collector.q).diagonal()[loop.index]
        with_inertia = 'its inertia ({:.2g}) and '
        advice = ['lower these gains, or set armature to the reflected inertia of the rotor']
    damping, stiffness = inertia / _DELAY, inertia / _DELAY**2
    is_unstable = (gains[names[0]] > damping) | (gains[names[1]] > stiffness)
    texts = [
        f'{joint} may oscillate: with {with_inertia.format(inertia[k])}a delay of '
        f'{1e3 * _DELAY:g} ms, {names[0]} should be at most {damping[k]:.2g} and {names[1]} '
        f'at most {stiffness[k]:.2g}'
        for k, joint in enumerate(loop.controller.joints)
        if is_unstable[k]
    ]
    return '; '.join(texts + advice * bool(texts))


def describe_implausible(loop: ControlLoop) -> dict[str, str]:
    """Describe, by joint name, positions that are far outside the position limits."""
    collector = loop.collector
    known = np.where(collector.times > -math.inf, collector.q, math.nan)
    return {found.joint: str(found) for found in implausible_positions(loop.robot, known)}


def judge_loop(
    now: float, loop: ControlLoop | None, around: GraphInfo, rate: float, requested: float | None
) -> Judgement:
    """Describe the loop, or warn that its rate is lower than requested; rates are in [Hz]."""
    if not around.is_active or loop is None:
        return Level.OK, around.state
    if loop.controller.phase is Phase.LIMIT_STOP:
        return Level.ERROR, activity(now, loop)
    if requested and 0.0 < rate < _SLOW * requested:
        return Level.WARN, f'only {rate:.1f} commands/s'
    return Level.OK, activity(now, loop)


def judge_messages(recently: int, total: int) -> Judgement:
    """Report the number of rejected messages."""
    if recently:
        return Level.WARN, f'messages rejected since the last report: {recently}'
    return Level.OK, f'messages rejected in total: {total}'


def judge_joint_states(now: float, loop: ControlLoop, around: GraphInfo) -> Judgement:
    """Report missing, stale, contradictory and implausible joint states."""
    collector, settings = loop.collector, loop.controller.settings
    if_lost = Level.ERROR if around.is_active else Level.WARN
    silence = describe_silence(around)
    if collector.missing():
        return if_lost, '; '.join(filter(None, (f'waiting for {loop.missing()[0]}', silence)))
    stale = collector.stale(now, settings.state_timeout)
    if stale:
        return if_lost, '; '.join(
            filter(None, (f'joint states are lost: {", ".join(stale)}', silence))
        )
    if loop.controller.phase is Phase.STATE_LOST:
        return if_lost, describe_recovery(loop)
    problem = describe_motion(now, loop)
    if problem:
        return Level.ERROR, problem
    warnings = [*describe_late(loop, now), *describe_implausible(loop).values()]
    if warnings:
        return Level.WARN, '; '.join(warnings)
    if collector.unseen():
        joints = ', '.join(collector.unseen())
        return Level.WARN, f'never reported: {joints}; their locked positions are used'
    is_closed = settings.mode in (Mode.COMPUTED_TORQUE, Mode.JOINT_IMPEDANCE)
    if is_closed and collector.without_velocity():
        return Level.WARN, (
            f'joints reported without velocity have no damping in {settings.mode.value}'
        )
    return Level.OK, 'fresh'


def judge_reference(loop: ControlLoop, around: GraphInfo) -> Judgement:
    """Report whether the reference is followed."""
    controller = loop.controller
    if around.is_active and controller.phase in TOO_FAR_PHASES:
        return Level.WARN, controller.phase.value
    if controller.is_stopping:
        return Level.OK, 'disabled'
    return Level.OK, 'followed' if controller.phase is Phase.RUNNING else 'no reference is used'


def judge_efforts(
    now: float, loop: ControlLoop, around: GraphInfo, clamped: Sequence[str]
) -> Judgement:
    """Report that the commands have no subscribers, or which efforts were cut to their limits."""
    if around.is_active and not around.receivers and not loop.dry_run.is_active:
        message = 'the commands have no subscribers'
        if around.others.subscribers.first:
            names = around.others.subscribers
            message += f' that match; another type or quality of service is used by {names}'
        return Level.WARN, message
    if clamped:
        return Level.WARN, f'effort cut to its limit: {", ".join(clamped)}'
    return Level.OK, activity(now, loop)


OUTDATED = (
    'another robot description has arrived; to use it, deactivate, clean up and configure the node'
)


def judge_model(now: float, loop: ControlLoop) -> Judgement:
    """Report an unknown motion of the base, and problems of the robot description."""
    unknown = describe_lost_imu(now, loop)
    if loop.lacks_imu:
        unknown = 'the motion of the base is unknown: no message on imu yet'
    if unknown:
        return Level.ERROR, unknown
    if loop.is_outdated:
        return Level.WARN, OUTDATED
    warnings = loop.robot.warnings
    if warnings:
        number = '1 warning' if len(warnings) == 1 else f'{len(warnings)} warnings'
        return Level.WARN, f'{number} about the robot description'
    return Level.OK, f"robot '{loop.robot.name}'"


def judge_other_nodes(loop: ControlLoop | None, around: GraphInfo) -> Judgement:
    """Report nodes that publish the same commands or have the same name."""
    others = around.others
    problems = []
    if others.rivals.first:
        problems.append(f'{others.commands} is also published by {others.rivals}')
    if others.namesakes:
        is_one = others.namesakes == 1
        nodes = 'another node has' if is_one else f'{others.namesakes} other nodes have'
        problems.append(f'{nodes} the name {around.name}')
    if not problems:
        return Level.OK, 'no other node publishes the commands or has this name'
    # Nodes may take turns at publishing on a topic, but must never have the same name.
    is_sending = around.is_active and not (loop and loop.dry_run.is_active)
    message = (
        f'{"; ".join(problems)} (stop the other node; a killed node stays listed for up to 20 s)'
    )
    return Level.ERROR if is_sending or others.namesakes else Level.WARN, message


def judge_clock(time: float, unchanged_for: float, publishers: int) -> Judgement:
    """Report simulated time that does not advance; see `ClockStatus` for the arguments."""
    is_late = unchanged_for >= _PAUSE
    if not time and not publishers:
        if unchanged_for < _DISCOVERY:
            return Level.OK, 'no message on /clock yet'
        message = 'use_sim_time is set, but nothing publishes /clock'
        return Level.ERROR if is_late else Level.WARN, message
    if not is_late:
        return Level.OK, 'simulated time advances'
    message = f'simulated time has not advanced for more than {_PAUSE:g} s'
    if not publishers:
        message += ': nothing publishes /clock any more'
        return Level.ERROR, message
    message += f' (publishers of /clock: {publishers}); is the simulation paused?'
    return Level.WARN, message
