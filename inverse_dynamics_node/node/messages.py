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
    Read accelerations, and efforts if there are any, by name, from the first point.

    Raises
    ------
    JointStateError
        If there is no point, a joint is missing or not commanded, or a value is not finite.

    """
    if not message.points:
        raise JointStateError('no points, expected one')
    names = list(message.joint_names)
    if sorted(names) != sorted(joints):
        raise JointStateError(
            f'joint_names are {", ".join(names) or "empty"}, expected {", ".join(joints)}'
        )
    order = [names.index(joint) for joint in joints]
    point = message.points[0]
    accelerations = _finite('acceleration', point.accelerations, names)[order]
    efforts = np.zeros(len(joints))
    if len(point.effort):
        efforts = _finite('effort', point.effort, names)[order]
    return Reference(accelerations, efforts, now)


def write_commands(message: Float64MultiArray, efforts: Floats) -> None:
    """Put efforts into a message that is used again and again."""
    message.data = array('d', efforts.tobytes())


def write_joint_efforts(message: JointState, efforts: Floats) -> None:
    """Put efforts into a message that has its names already."""
    message.effort = array('d', efforts.tobytes())


def _finite(what: str, values: Sequence[float], names: Sequence[str]) -> Floats:
    numbers = np.array(values, dtype=np.float64)
    if len(numbers) != len(names):
        raise JointStateError(f'{len(numbers)} {what}s, expected {len(names)}: {", ".join(names)}')
    is_finite = np.isfinite(numbers)
    if not is_finite.all():
        k = int(np.argmin(is_finite))
        raise JointStateError(f"{what} of joint '{names[k]}' is {numbers[k]}")
    return numbers
