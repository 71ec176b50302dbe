"""Converts messages to arrays and back, and checks the numbers that are received."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple

from geometry_msgs.msg import InertiaStamped, WrenchStamped
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..control.control_law import Reference
from ..dynamics.trajectory import Trajectory
from ..errors import (
    ConfigurationError,
    JointStateError,
    listed,
    TrajectoryError,
)
from ..robot.model import Floats


def read_accelerations(message: Float64MultiArray, joints: Sequence[str], now: float) -> Reference:
    """
    Read accelerations in the order of the commanded joints.

    Raises
    ------
    JointStateError
        If their number is wrong, or one is not finite.

    """
    accelerations = _finite('acceleration', message.data, joints)
    return Reference(accelerations, np.zeros(len(joints)), now)


def read_reference(message: JointTrajectory, joints: Sequence[str], now: float) -> Reference:
    """
    Read the first point of a reference, by joint name.

    Missing accelerations and efforts are zero; missing positions and velocities are None.

    Raises
    ------
    JointStateError
        If there is no point or the first one is empty, a joint is missing or not commanded, or a
        value is not finite.

    """
    if not message.points:
        raise JointStateError('no points, expected one')
    names = list(message.joint_names)
    if sorted(names) != sorted(joints):
        raise JointStateError(
            f'joint_names are {listed(names) or "empty"}, expected {listed(joints)}'
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
        raise JointStateError('points[0] is empty, expected accelerations')
    zeros = np.zeros(len(joints))
    return Reference(
        zeros if accelerations is None else accelerations,
        zeros if efforts is None else efforts,
        now,
        positions,
        velocities,
    )


class PayloadMessage(NamedTuple):
    """A rigid load, as arguments of `ExternalLoads.set_payload`."""

    link: str
    mass: float
    com: Floats
    inertia: Floats


def read_payload(message: InertiaStamped) -> PayloadMessage:
    """Read a rigid load; its inertia is about its centre of mass."""
    body = message.inertia
    inertia = [
        [body.ixx, body.ixy, body.ixz],
        [body.ixy, body.iyy, body.iyz],
        [body.ixz, body.iyz, body.izz],
    ]
    return PayloadMessage(_frame(message), body.m, read_vector(body.com), np.array(inertia))


def read_wrench(message: WrenchStamped) -> tuple[str, Floats, Floats]:
    """Read a link, and the force and moment on it."""
    return _frame(message), read_vector(message.wrench.force), read_vector(message.wrench.torque)


def read_imu(message: Imu, R_BS: Floats) -> tuple[Floats, Floats]:
    """
    Read a specific force and an angular velocity, and rotate them into the frame of the base.

    Raises
    ------
    ConfigurationError
        If the covariance shows that one of them is not measured.

    """
    for what, covariance in (
        ('linear acceleration', message.linear_acceleration_covariance),
        ('angular velocity', message.angular_velocity_covariance),
    ):
        if covariance[0] == -1.0:
            raise ConfigurationError(f'the covariance says that {what} is not measured')
    return R_BS @ read_vector(message.linear_acceleration), R_BS @ read_vector(
        message.angular_velocity
    )


def read_vector(message: Any) -> Floats:
    """Read a message with x, y and z, such as Vector3 or Point."""
    return np.array([message.x, message.y, message.z])


def deserialize_trajectory(data: bytes) -> JointTrajectory:
    """Read a trajectory from a raw subscription, or raise a TrajectoryError."""
    try:
        return deserialize_message(data, JointTrajectory)
    except Exception as error:  # RMWError, which is not public
        raise TrajectoryError(f'{len(data)} bytes that are not a trajectory: {error}') from error


def read_trajectory(message: JointTrajectory) -> Trajectory:
    """
    Read a whole trajectory.

    Raises
    ------
    TrajectoryError
        If the points have different fields, or no positions.

    """
    names, points = tuple(message.joint_names), message.points

    def read(what: str) -> Floats | None:
        rows = [getattr(point, what) for point in points]
        lengths = {len(row) for row in rows}
        if lengths <= {0}:
            return None
        if lengths != {len(names)}:
            raise TrajectoryError(
                f'points have {", ".join(map(str, sorted(lengths)))} {what}, expected '
                f'{len(names)} each, or none'
            )
        return np.array(rows, dtype=np.float64)

    positions = read('positions')
    if positions is None:
        raise TrajectoryError('no positions, expected one for every joint at every point')
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points]
    velocities, accelerations = read('velocities'), read('accelerations')
    return Trajectory(names, np.array(times), positions, velocities, accelerations)


def write_trajectory(
    message: JointTrajectory, trajectory: Trajectory, efforts: Floats
) -> JointTrajectory:
    """Make the message of a trajectory with efforts; header and times are those of `message`."""
    result = JointTrajectory(header=message.header, joint_names=message.joint_names)
    rows = (trajectory.positions, trajectory.velocities, trajectory.accelerations, efforts)
    result.points = [
        JointTrajectoryPoint(
            **{
                name: array('d', row[k].tobytes())
                for name, row in zip(_FIELDS, rows, strict=True)
                if row is not None
            },
            time_from_start=point.time_from_start,
        )
        for k, point in enumerate(message.points)
    ]
    return result


_FIELDS = ('positions', 'velocities', 'accelerations', 'effort')


def write_joint_efforts(message: JointState, joints: Sequence[str], efforts: Floats) -> None:
    """Write efforts into a reused message."""
    message.name = list(joints)
    message.effort = array('d', efforts.tobytes())


def write_wrench(message: WrenchStamped, link: str, force: Floats, moment: Floats) -> None:
    """Write a wrench into a reused message."""
    message.header.frame_id = link
    for part, values in ((message.wrench.force, force), (message.wrench.torque, moment)):
        part.x, part.y, part.z = values.tolist()


def _frame(message: Any) -> str:
    return str(message.header.frame_id)


def _finite(what: str, values: Sequence[float], names: Sequence[str]) -> Floats:
    numbers = np.array(values, dtype=np.float64)
    if len(numbers) != len(names):
        raise JointStateError(f'{len(numbers)} {what}s, expected {len(names)}: {listed(names)}')
    is_finite = np.isfinite(numbers)
    if not is_finite.all():
        k = int(np.argmin(is_finite))
        raise JointStateError(f"{what} of joint '{names[k]}' is {numbers[k]}")
    return numbers
