"""The subscriptions of the node: joint states, references, loads and the motion of the base."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
import math
import time
from typing import Any

from geometry_msgs.msg import InertiaStamped, Vector3Stamped, WrenchStamped
import numpy as np
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from ..control.joint_states import JointStateCollector, LARGEST, Layout
from ..control.laws import Reference
from ..control.loop import ControlLoop
from ..errors import ConfigurationError, InverseDynamicsError, JointStateError, listed, shortened
from ..robot.kinematics import rotation_of_rpy
from ..robot.model import Floats
from ..ros.cdr import JointStateReader, stamp_of
from ..ros.middleware import BEST_EFFORT, overridable, QUEUED, RELIABLE
from ..ros.private import waiting_messages
from .parameters import BaseMotion, Configuration
from .runner import LoopRunner
from .status_text import describe_imu_frame
from .trajectory_filler import deserialize_trajectory, TrajectoryFiller

_OLDEST = 0.1  # [s]; a state that seems older was stamped by another clock
_RISE_OF_DELAY, _LONGEST_RISE = 0.2, 0.1  # [s/s], [s]
_SMALL_CHANGE = 0.05  # smaller relative changes of gravity are not logged
_MAX_REFERENCE = 1 << 16  # [bytes]; reading so many bytes delays commands by 2 ms


class Inputs:
    """Passes messages to the control loop; if update_rate is 0, each joint state starts a step."""

    def __init__(self, node: LifecycleNode, runner: LoopRunner, filler: TrajectoryFiller) -> None:
        self._runner, self._filler, self._log = runner, filler, runner.log
        self._uses_sim_time = node.get_parameter('use_sim_time').value
        self._reported_gravity: tuple[ControlLoop, Configuration, Floats] | None = None
        self._imu: tuple[ControlLoop, str] | None = None  # loop and frame of the last message
        self._collector: JointStateCollector | None = None  # of `self._reader`
        self.last_joint_state = time.monotonic()
        """Monotonic time of the last joint state [s]; initially the start time."""
        self._R_BS: Floats = np.eye(3)
        self.state_count = 0
        """Number of times that all commanded joints have been updated."""
        self._last_state = -math.inf

        def subscribe(
            kind: Any, topic: str, callback: Any, profile: QoSProfile, raw: bool = False
        ) -> Any:
            return node.create_subscription(
                kind, topic, callback, profile, raw=raw, **overridable()
            )

        topic = '~/desired_accelerations'
        on_accelerations = partial(self._on_reference, topic, _read_accelerations)
        subscribe(Float64MultiArray, topic, on_accelerations, RELIABLE)
        # Messages for several links may arrive at once.
        subscribe(InertiaStamped, '~/payload', self._on_payload, QUEUED)
        subscribe(WrenchStamped, '~/external_wrench', self._on_external_wrench, QUEUED)
        subscribe(Vector3Stamped, '~/gravity', self._on_gravity, RELIABLE)
        subscribe(Imu, 'imu', self._on_imu, BEST_EFFORT)
        self._states = subscribe(
            JointState, 'joint_states', self._on_joint_state, BEST_EFFORT, raw=True
        )
        # Raw, because deserializing a long trajectory takes seconds.
        topic = '~/reference'
        on_reference = partial(self._on_reference, topic, _read_reference)
        subscribe(JointTrajectory, topic, on_reference, RELIABLE, raw=True)
        subscribe(
            JointTrajectory, '~/joint_trajectory_in', self._on_trajectory, RELIABLE, raw=True
        )

    def read_latest_joint_state(self) -> None:
        """Handle the latest joint state before the executor does."""
        taken = next(waiting_messages(self._states, JointState, raw=True), None)
        if taken is not None:
            self._on_joint_state(taken[0])

    def _on_joint_state(self, data: bytes) -> None:
        self.last_joint_state = time.monotonic()
        loop = self._runner.loop
        if loop is None:
            return
        if self._collector is not loop.collector:
            self._collector = loop.collector
            self._reader = JointStateReader(loop.collector.layout)
        now = self._runner.now()
        try:
            layout, positions, velocities, measured = self._reader.read(data)
            efforts = self._measured_efforts(loop, layout, measured)
            is_ours = loop.collector.store(now, layout, positions, velocities, efforts)
        except JointStateError as error:
            self._runner.reject('joint_states', error)
            return
        if loop.collector.time != self._last_state:
            self._measure_delay(now, data, loop.collector)
            self._last_state = loop.collector.time
            self.state_count += 1
        if is_ours and self._runner.is_active and self._runner.configuration.update_rate == 0.0:
            self._runner.step(now)

    def _measure_delay(self, now: float, data: bytes, collector: JointStateCollector) -> None:
        """
        Measure the delay of the joint states by their stamps.

        The delay rises slowly, because states that have waited during a pause arrive together.

        """
        age = (now if self._uses_sim_time else time.time()) - 1e-9 * stamp_of(data)
        longest = collector.delay + _RISE_OF_DELAY * min(now - self._last_state, _LONGEST_RISE)
        collector.delay = min(age, longest) if 0.0 <= age <= _OLDEST else 0.0

    def _measured_efforts(
        self, loop: ControlLoop, layout: Layout, measured: Floats
    ) -> Floats | tuple[()]:
        """Return the measured efforts, which may be NaN, or () if nothing needs efforts."""
        are_used = self._runner.outputs.uses_measured_efforts or loop.has_contact_limits
        if not (are_used and layout.places.size):
            return ()
        count = len(layout.names)
        if len(measured) == count:
            return measured
        if len(measured):  # the positions are still used
            reason = f'received {count} names, but {len(measured)} efforts'
            self._runner.reject('joint_states', reason, 'efforts')
        return np.full(count, math.nan)

    def _on_reference(self, topic: str, read: Callable[..., Reference], message: Any) -> None:
        loop = self._runner.loop
        if loop is None or not self._runner.is_active:
            return
        now = self._runner.now()
        try:
            loop.follow(read(message, loop.joints, now))
        except InverseDynamicsError as error:
            self._runner.reject(topic, error)

    def _on_payload(self, message: InertiaStamped) -> None:
        def store(loop: ControlLoop, now: float) -> None:
            link, mass, com, inertia = _read_payload(message)
            if loop.loads.set_payload(link, mass, com, inertia):
                place = f'on link {link!r}'
                text = f'payload of {mass:g} kg {place}' if mass else f'payload {place} removed'
                self._log.report_message('~/payload', text, is_problem=False)

        self._handle('~/payload', store)

    def _on_external_wrench(self, message: WrenchStamped) -> None:
        def store(loop: ControlLoop, now: float) -> None:
            link, wrench = message.header.frame_id, message.wrench
            force, moment = _read_vector(wrench.force), _read_vector(wrench.torque)
            if loop.loads.set_external_wrench(now, link, force, moment):
                text = (
                    f'force {_listed(force)} N and moment {_listed(moment)} N m act on link '
                    f"'{link}' until {self._runner.configuration.wrench_timeout:g} s after the "
                    'last message'
                )
                self._log.report_message('~/external_wrench', text, is_problem=False)

        self._handle('~/external_wrench', store)

    def _on_gravity(self, message: Vector3Stamped) -> None:
        def store(loop: ControlLoop, now: float) -> None:
            frame = message.header.frame_id
            if frame not in ('', loop.base_link):
                raise ConfigurationError(
                    f"frame_id is '{shortened(frame)}', expected the base link '{loop.base_link}'"
                )
            if loop.has_imu:
                raise ConfigurationError('the IMU measures gravity (base_motion: imu)')
            gravity = _read_vector(message.vector)
            loop.loads.set_gravity(gravity, now)
            self._report_gravity(loop, gravity)

        self._handle('~/gravity', store)

    def _report_gravity(self, loop: ControlLoop, gravity: Floats) -> None:
        """Log a change of gravity; warn if it is over 90 degrees off the parameter `gravity`."""
        configuration, last = self._runner.configuration, self._reported_gravity
        known = last[2] if last and last[:2] == (loop, configuration) else np.inf
        if np.linalg.norm(gravity - known) <= _SMALL_CHANGE * np.linalg.norm(gravity):
            return
        self._reported_gravity = loop, configuration, gravity
        text = f"{_listed(gravity)} m/s^2 in the frame of '{loop.base_link}'"
        expected = np.array(configuration.gravity)
        is_problem = bool(gravity @ expected < 0.0)
        if is_problem:
            text += (
                f' points against the parameter gravity ({_listed(expected)}); expected the '
                'free-fall acceleration, which points to the ground (an IMU at rest measures the '
                'opposite)'
            )
        self._log.report_message('~/gravity', text, is_problem=is_problem)

    def _on_imu(self, message: Imu) -> None:
        configuration, frame = self._runner.configuration, message.header.frame_id
        if configuration.base_motion is not BaseMotion.IMU:
            return

        def store(loop: ControlLoop, now: float) -> None:
            if self._imu != (loop, frame):
                self._imu = loop, frame
                self._R_BS = rotation_of_rpy(*configuration.imu_orientation)
                text = describe_imu_frame(loop, frame, self._R_BS)
                if text:
                    self._log.report_message('imu', text)
            loop.loads.set_base_motion(now, *_read_imu(message, self._R_BS))

        self._handle('imu', store)

    def _on_trajectory(self, data: bytes) -> None:
        self._handle('~/joint_trajectory_in', lambda loop, now: self._filler.submit(loop, data))

    def _handle(self, topic: str, store: Callable[[ControlLoop, float], None]) -> None:
        """Call `store` with the loop, or log why the message is dropped."""
        now = self._runner.now()
        if self._runner.loop is None:
            self._runner.reject(topic, 'the node is not configured')
            return
        try:
            store(self._runner.loop, now)
        except InverseDynamicsError as error:
            self._runner.reject(topic, error)


def _listed(vector: Floats) -> str:
    return ', '.join(f'{x:.3g}' for x in vector)


def _read_accelerations(
    message: Float64MultiArray, joints: Sequence[str], now: float
) -> Reference:
    """Read the accelerations of the commanded joints."""
    accelerations = _plausible('acceleration', message.data, joints)
    return Reference(accelerations, np.zeros(len(joints)), now)


def _read_reference(data: bytes, joints: Sequence[str], now: float) -> Reference:
    """Read the first point of a trajectory; missing accelerations and efforts become zero."""
    if len(data) > _MAX_REFERENCE:
        raise JointStateError(
            f'the message has {len(data)} bytes, expected at most {_MAX_REFERENCE}; only the '
            'first point is used, so send one point at a time'
        )
    message = deserialize_trajectory(data)
    if not message.points:
        raise JointStateError('there are no points, expected one')
    names = list(message.joint_names)
    if sorted(names) != sorted(joints):
        raise JointStateError(
            f'joint_names are {listed(names) or "empty"}; expected {listed(joints)}'
        )
    order = [names.index(joint) for joint in joints]
    point = message.points[0]

    def read(what: str, values: Sequence[float]) -> Floats | None:
        return _plausible(what, values, names)[order] if len(values) else None

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


def _read_payload(message: InertiaStamped) -> tuple[str, float, Floats, Floats]:
    """Return link, mass, centre of mass, and inertia about the centre of mass."""
    body = message.inertia
    inertia = [
        [body.ixx, body.ixy, body.ixz],
        [body.ixy, body.iyy, body.iyz],
        [body.ixz, body.iyz, body.izz],
    ]
    return message.header.frame_id, body.m, _read_vector(body.com), np.array(inertia)


def _read_imu(message: Imu, R_BS: Floats) -> tuple[Floats, Floats]:
    """Return the specific force and the angular velocity in the base frame."""
    for what, covariance in (
        ('linear acceleration', message.linear_acceleration_covariance),
        ('angular velocity', message.angular_velocity_covariance),
    ):
        if covariance[0] == -1.0:
            raise ConfigurationError(f'the covariance says that {what} is not measured')
    force = _read_vector(message.linear_acceleration)
    return R_BS @ force, R_BS @ _read_vector(message.angular_velocity)


def _read_vector(message: Any) -> Floats:
    """Read a message with x, y and z, such as Vector3 or Point."""
    return np.array([message.x, message.y, message.z])


def _plausible(what: str, values: Sequence[float], names: Sequence[str]) -> Floats:
    numbers = np.array(values, dtype=np.float64)
    if len(numbers) != len(names):
        raise JointStateError(
            f'{len(numbers)} {what} values, expected {len(names)} ({listed(names)})'
        )
    is_plausible = np.abs(numbers) <= LARGEST  # false for NaN
    if not is_plausible.all():
        k = int(np.argmin(is_plausible))
        raise JointStateError(
            f"{what} of joint '{names[k]}' is {numbers[k]}, expected a number of at most "
            f'{LARGEST:g}'
        )
    return numbers
