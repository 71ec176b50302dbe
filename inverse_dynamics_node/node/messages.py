"""From messages to arrays and back, every number checked on its way in."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from ..controller import Reference
from ..errors import JointStateError
from ..model import Floats


def reference_from_accelerations(
    message: Float64MultiArray, joints: Sequence[str], now: float
) -> Reference:
    """
    Read accelerations in the order of the commanded joints.

    Raises
    ------
    JointStateError
        If their number is wrong, or one is not finite.

    """
    accelerations = _finite('acceleration', message.data, joints)
    return Reference(accelerations, np.zeros(len(joints)), now)


def reference_from_trajectory(
    message: JointTrajectory, joints: Sequence[str], now: float
) -> Reference:
    """
    Read what the first point has, by name; what it leaves out is zero, or nothing for a loop.

    Raises
    ------
    JointStateError
        If there is no point, or nothing in it, a joint is missing or not commanded, or a value is
        not finite.

    """
    if not message.points:
        raise JointStateError('no points, expected one')
    names = list(message.joint_names)
    if sorted(names) != sorted(joints):
        raise JointStateError(
            f'joint_names are {_listed(names) or "empty"}, expected {_listed(joints)}'
        )
    order = [names.index(joint) for joint in joints]
    point = message.points[0]

    def read(what: str, values: Sequence[float]) -> Floats | None:
        return _finite(what, values, names)[order] if len(values) else None

    accelerations = read('acceleration', point.accelerations)
    efforts = read('effort', point.effort)
    positions = read('position', point.positions)
    velocities = read('velocity', point.velocities)
    if accelerations is None and positions is None and velocities is None and efforts is None:
        raise JointStateError('points[0] has no accelerations, nor anything else')
    zeros = np.zeros(len(joints))
    return Reference(
        zeros if accelerations is None else accelerations,
        zeros if efforts is None else efforts,
        now,
        positions,
        velocities,
    )


def write_commands(message: Float64MultiArray, efforts: Floats) -> None:
    """Put efforts into a message that is used again and again."""
    message.data = array('d', efforts.tobytes())


def write_joint_efforts(message: JointState, efforts: Floats) -> None:
    """Put efforts into a message that has its names already."""
    message.effort = array('d', efforts.tobytes())


def _finite(what: str, values: Sequence[float], names: Sequence[str]) -> Floats:
    numbers = np.array(values, dtype=np.float64)
    if len(numbers) != len(names):
        raise JointStateError(f'{len(numbers)} {what}s, expected {len(names)}: {_listed(names)}')
    is_finite = np.isfinite(numbers)
    if not is_finite.all():
        k = int(np.argmin(is_finite))
        raise JointStateError(f"{what} of joint '{names[k]}' is {numbers[k]}")
    return numbers


def _listed(names: Sequence[str]) -> str:
    """List names, but not a hundred thousand."""
    more = f', and {len(names) - 12} more' if len(names) > 12 else ''
    return ', '.join(name[:80] for name in names[:12]) + more
