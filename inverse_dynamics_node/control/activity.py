"""Describes what the control loop is doing, and why."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

from ..robot.model import Floats
from .control_loop import ControlLoop
from .graph_info import GraphInfo
from .phase import COMPUTING_PHASES, Phase
from .settings import Mode, StalePolicy

_LONG_SILENCE = 5.0  # [s]; after which connected publishers are suspicious
_MISALIGNED = 5.0  # [degrees]; more than an error of mounting
_MOST_NAMES = 5  # of nodes, in one message


def activity(now: float, loop: ControlLoop, *, is_dry_run: bool = False) -> str:
    """
    Describe what the controller is doing, and why.

    Parameters
    ----------
    now : float
        The time [s].
    loop : ControlLoop
        The active control loop.
    is_dry_run : bool
        Whether its commands are not sent.

    """
    doing = _computing(loop)
    if not doing:
        doing = f'{_consequence(loop, is_dry_run)}: {_reason_to_stop(now, loop)}'
    return f'dry run: {doing}' if is_dry_run else doing


def _computing(loop: ControlLoop) -> str:
    """Describe how efforts are computed; empty in the phases in which they are not."""
    phase, settings = loop.controller.phase, loop.controller.settings
    if phase is Phase.HOLDING:
        return f'{phase.value}: {_reason_to_hold(loop)}'
    if phase is Phase.TOO_FAR:
        return (
            'holding position: the reference starts or jumps more than max_position_jump '
            f'({settings.max_position_jump:g} rad or m) away'
        )
    return str(phase.value) if phase in COMPUTING_PHASES or phase is Phase.WAITING else ''


def _consequence(loop: ControlLoop, is_dry_run: bool) -> str:
    controller = loop.controller
    if not controller.has_effort:
        return 'stopped' if is_dry_run else 'stopped, zeros sent'
    is_stopped = controller.phase is Phase.STOPPED
    if is_stopped or controller.settings.on_stale_state is StalePolicy.ZERO:
        return 'ramping efforts down'
    return 'keeping the last efforts'


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
        return f'{loop.controller.phase.value}: {loop.controller.cause_of_failure()}'
    if loop.lacks_imu:
        return 'no message on imu yet'
    if not loop.collector.is_consistent:
        return '; '.join(describe_alternating(loop).values())
    if loop.collector.missing():
        return f'no joint state of {", ".join(loop.collector.missing())} yet'
    timeout = loop.controller.settings.state_timeout
    joints = ', '.join(loop.collector.stale(now, timeout))
    if joints:
        return f'no joint state of {joints} for more than {timeout:g} s'
    return describe_recovery(loop)


def describe_lost_imu(now: float, loop: ControlLoop) -> str:
    """Describe that the motion of the base was measured, but no longer is; empty if it is."""
    loads = loop.loads
    if not loop.has_imu or loop.lacks_imu or loads.is_base_known(now):
        return ''
    return (
        'the motion of the base is unknown: no message on imu for more than '
        f'{loads.settings.imu_timeout:g} s'
    )


def describe_recovery(loop: ControlLoop) -> str:
    """Describe when efforts will rise again after joint states were lost."""
    controller = loop.controller
    return (
        'joint states were lost or contradictory; efforts rise after '
        f'{controller.recovery_time:g} s without a gap longer than state_timeout '
        f'({controller.settings.state_timeout:g} s)'
    )


def describe_alternating(loop: ControlLoop, publishers: Sequence[str] = ()) -> dict[str, str]:
    """
    Describe the joints whose positions alternate faster than they can move.

    Parameters
    ----------
    loop : ControlLoop
        The control loop.
    publishers : sequence of str
        Nodes that publish joint states, if known.

    Returns
    -------
    descriptions : dict of str to str
        By name of the joint.

    """
    question = 'does more than one node publish it?'
    if publishers:
        question = f'published by {join_names(publishers)}'
    return {
        joint: f'positions of {joint} alternate between {min(pair):.4g} and {max(pair):.4g} '
        f'faster than it can move ({question})'
        for joint, pair in loop.collector.alternating().items()
    }


def describe_silence(around: GraphInfo) -> str:
    """Describe publishers that are connected but send nothing; empty if there are none."""
    if not around.publishers or around.silence < _LONG_SILENCE:
        return ''
    publishers = 'publisher is' if around.publishers == 1 else 'publishers are'
    return (
        f'no message on joint_states for {around.silence:.0f} s, although '
        f'{around.publishers} {publishers} connected (one that was killed stays connected for up '
        'to 20 s): if ros2 topic hz shows messages, restart this node'
    )


def describe_imu_frame(loop: ControlLoop, frame: str, R_BS: Floats) -> str:
    """
    Describe a frame of an IMU that contradicts the robot description.

    Parameters
    ----------
    loop : ControlLoop
        The control loop.
    frame : str
        The frame of its messages, which need not be a link.
    R_BS : ndarray, shape (3, 3)
        The rotation from the frame to that of the base link, as set.

    Returns
    -------
    text : str
        Empty if there is no contradiction.

    """
    robot = loop.robot
    if frame not in robot.link_names:
        return ''
    link = robot.link_index(frame)
    if robot.link_body[link]:
        return f"frame_id is '{frame}', a link that joints move, expected a link of the base"
    base = robot.link_index(loop.base_link)
    turned = robot.link_rotation[base].T @ robot.link_rotation[link] @ R_BS.T
    angle = math.degrees(math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(turned)) - 1.0)))))
    if angle < _MISALIGNED:
        return ''
    return (
        f"frame_id is '{frame}', which the robot description turns by {angle:.0f} degrees "
        'against imu_orientation'
    )


def describe_late(loop: ControlLoop, now: float) -> list[str]:
    """Describe the late joints that are not commanded, with their ages and the remedies."""
    timeout = loop.controller.settings.uncommanded_state_timeout
    return [
        f"joint '{name}' (not commanded) was last reported {age:.1f} s ago and is assumed to be "
        f'at rest at its last position; raise uncommanded_state_timeout ({timeout:g} s) or set '
        f'locked_positions.{name}'
        for name, age in loop.collector.late(now, timeout).items()
    ]


def describe_implausible(loop: ControlLoop) -> dict[str, str]:
    """Describe the joints far outside their position limits, by name."""
    return {found.joint: str(found) for found in loop.implausible_positions()}


def join_names(names: Sequence[str]) -> str:
    """Join the first few names, and say how many more there are."""
    more = len(names) - _MOST_NAMES
    return ', '.join(names[:_MOST_NAMES]) + (f' and {more} more' if more > 0 else '')
