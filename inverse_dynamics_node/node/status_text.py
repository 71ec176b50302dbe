"""Puts into words what the control loop does, and what is wrong with its inputs."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
import math
from typing import TYPE_CHECKING

import numpy as np

from ..control.joint_states import JointStateCollector
from ..control.loop import ControlLoop
from ..control.settings import StalePolicy
from ..control.supervisor import Phase, recovery_time, TOO_FAR_PHASES
from ..errors import listed
from ..robot.limit_checks import implausible_positions
from ..robot.model import Floats

if TYPE_CHECKING:
    from ..ros.controllers import Controller

_MISALIGNED = 5.0  # [degrees]; larger than any mounting error
_DELAY = 0.005  # [s]; typical delay from measurement to effort at 200 joint states per second
# Controllers that only drivers with gravity compensation have, and the parameter files for them.
_COMPENSATING = {
    'franka_robot_state_broadcaster': 'franka_ros2',
    'io_and_status_controller': 'ur',
    'lbr_state_broadcaster': 'lbr_fri',
}
_NO_EFFORTS = 'position', 'velocity', 'acceleration'  # command interfaces of ros2_control
_TURN_ERROR = 0.05  # [turns]; of a position that is whole turns away from its reference


def activity(now: float, loop: ControlLoop) -> str:
    """Describe what the active control loop does and why; ``now`` is in [s]."""
    phase, settings = loop.phase, loop.settings
    doing = phase.value.partition(':')[0]
    if phase in (Phase.FLOATING, Phase.HOLDING):
        reason = 'no reference'
        if not loop.law.uses_reference:
            reason = 'the reference is not used in mode gravity_compensation'
        elif loop.reference is not None:
            reason += f' for more than {settings.reference_timeout:g} s'
        doing += f': {reason}'
    elif phase in TOO_FAR_PHASES:
        doing += (
            ': the reference starts too far away or jumps too far '
            f'(max_tracking_error: {settings.max_tracking_error:g} rad or m)'
            f'{_full_turns(loop)}'
        )
    elif phase is Phase.CONTACT:
        doing += f' {loop.supervisor.contact}'
    elif phase is Phase.LIMIT_STOP:
        doing = f'stopped: {loop.supervisor.limit_stop}'
    elif phase not in (Phase.RUNNING, Phase.WAITING):
        doing = f'{_consequence(loop)}: {_reason_to_stop(now, loop)}'
    return f'dry run: {doing}' if loop.dry_run.is_active else doing


def similar_names(collector: JointStateCollector) -> list[str]:
    """Return reported names that resemble the names of missing joints, but are none."""
    names = collector.foreign_names
    close = [name for joint in collector.missing() for name in get_close_matches(joint, names, 1)]
    return list(dict.fromkeys(close))


def _explain_names(collector: JointStateCollector) -> str:
    """Say which names arrived in place of those of the missing joints, or return ''."""
    missing, names = collector.missing(), [name for name in collector.foreign_names if name]
    received, first = f' (received {listed(names, 4)}: ', missing[0]
    for name in names:
        before, found, after = first.partition(name)
        if found and {before + each + after for each in names} >= set(missing):
            return f'{received}without the {_affix(before, after)} of the URDF)'
        before, found, after = name.partition(first)
        if found and {before + joint + after for joint in missing} <= set(names):
            return f'{received}with the {_affix(before, after)}, unlike the URDF)'
    similar = similar_names(collector)
    if similar:
        return f' (received similar names: {", ".join(map(repr, similar))})'
    return f' (received other names: {listed(names, 4)})' if names else ''


def _affix(before: str, after: str) -> str:
    return f"prefix '{before}'" if before else f"suffix '{after}'"


def missing_inputs(
    loop: ControlLoop, states: str = 'joint_states', imu: str = 'imu', now: float | None = None
) -> list[str]:
    """
    Describe the necessary inputs that have not arrived yet.

    `states` and `imu` are the topic names to use in the text. If the time `now` [s] is given, the
    text also names joints with old positions.
    """
    joints = loop.collector.missing()
    word = 'position' if len(joints) == 1 else 'positions'
    missing = []
    if joints:
        missing.append(
            f'the {word} of {", ".join(joints)} on {states}{_explain_names(loop.collector)}'
        )
    if now is not None and not missing:
        joints = loop.collector.stale(now, loop.settings.state_timeout)
        if joints:
            missing = [f'new joint states of {", ".join(joints)} on {states}']
    return [*missing, f'the motion of the base on {imu}'] if loop.lacks_imu else missing


def _full_turns(loop: ControlLoop) -> str:
    """Name the joints that are whole turns away from the reference."""
    reference, robot = loop.reference, loop.robot
    if reference is None or reference.positions is None:
        return ''
    turns = (reference.positions - loop.collector.q[loop.index]) / (2.0 * math.pi)
    is_whole = (np.abs(turns - np.round(turns)) < _TURN_ERROR) & (np.abs(turns) > 0.5)
    is_whole &= ~(robot.is_prismatic_joint | robot.is_continuous)[loop.index]
    names = [joint for joint, is_turn in zip(loop.joints, is_whole, strict=True) if is_turn]
    return f'; whole turns away: {", ".join(names)}' if names else ''


def _consequence(loop: ControlLoop) -> str:
    if not loop.has_effort:
        return 'stopped' if loop.dry_run.is_active else 'stopped, zeros sent'
    is_stopped = loop.phase is Phase.STOPPED
    if is_stopped or loop.settings.on_stale_state is StalePolicy.ZERO:
        return 'ramping efforts down'
    return 'keeping the last efforts'


def _reason_to_stop(now: float, loop: ControlLoop) -> str:
    if loop.phase is Phase.STOPPED:
        contact = loop.supervisor.contact
        return f'a contact {contact}' if contact else 'disabled by ~/enable'
    if loop.phase is Phase.NO_SOLUTION:
        return str(loop.phase.value)
    timeout = loop.settings.state_timeout
    joints = ', '.join(loop.collector.stale(now, timeout))
    if joints:
        return f'no joint state of {joints} for more than {timeout:g} s'
    return recovery(timeout)


def recovery(timeout: float) -> str:
    """Describe when efforts rise again after a loss of joint states; `timeout` is in [s]."""
    return (
        'joint states were lost or contradictory; efforts rise again after joint states have '
        f'arrived for {recovery_time(timeout):g} s without a gap longer than state_timeout '
        f'({timeout:g} s)'
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


def describe_unstable_gains(loop: ControlLoop) -> str:
    """Describe gains with which joints may oscillate, if there are any."""
    names = loop.law.gains
    if names is None:
        return ''
    delay = max(_DELAY, loop.collector.delay)
    is_unstable, inertia = loop.law.unstable_gains(loop.collector.q, delay)
    with_inertia, advice = '', ['lower these gains']
    if loop.law.holds:
        with_inertia = 'its inertia ({:.2g}) and '
        advice = ['lower these gains, or set armature to the reflected inertia of the rotor']
    texts = [
        f'{loop.joints[k]} may oscillate: with {with_inertia.format(inertia[k])}a delay of '
        f'{1e3 * delay:.0f} ms, {names[0]} should be at most {inertia[k] / delay:.2g} and '
        f'{names[1]} at most {inertia[k] / delay**2:.2g}'
        for k in np.flatnonzero(is_unstable)
    ]
    return '; '.join(texts + advice * bool(texts))


def describe_implausible(loop: ControlLoop) -> dict[str, str]:
    """Describe, by joint name, positions that are far outside the position limits."""
    collector = loop.collector
    known = np.where(collector.times > -math.inf, collector.q, math.nan)
    return {found.joint: str(found) for found in implausible_positions(loop.robot, known)}


def describe_controllers(loop: ControlLoop, controllers: Sequence[Controller]) -> str:
    """Describe the controllers that expect other commands than the loop computes, or return ''."""
    texts = (_describe_controller(loop, each) for each in controllers)
    return '; '.join(text for text in texts if text)


def describe_compensation(loop: ControlLoop, nodes: Sequence[str]) -> str:
    """Name a node whose driver compensates gravity itself, although the commands contain it."""
    if not loop.loads.include_gravity:
        return ''
    for name in nodes:
        preset = _COMPENSATING.get(name.rpartition('/')[2])
        if preset:
            return (
                f'{name} belongs to a driver that compensates gravity itself, but include_gravity '
                'is true, so the arm would get gravity twice: use the settings in '
                f'config/robots/{preset}.yaml'
            )
    return ''


def _describe_controller(loop: ControlLoop, controller: Controller) -> str:
    name, joints, interface = controller.name, controller.joints, controller.interface
    if interface in _NO_EFFORTS:
        return (
            f"{name} takes the commands as '{interface}' of the joints, expected effort: set its "
            'parameter interface_name to effort'
        )
    if joints == loop.joints:
        return ''
    if len(joints) != len(loop.joints):
        text = f'{name} expects {len(joints)} efforts, but the node commands {len(loop.joints)}'
    elif set(joints) == set(loop.joints):
        text = f'{name} expects the efforts in another order than that of the node'
    else:
        text = f'{name} expects efforts for other joints than the node commands'
    unknown = [joint for joint in joints if joint not in loop.robot.joint_names]
    if unknown:
        robot = f"robot '{loop.robot.name}'"
        return f'{text}; {listed(unknown)}: no joint of {robot} that the node can command'
    return f'{text}; set the parameter joints to [{", ".join(joints)}]'
