"""The subscriptions of the node: joint states, references, loads and the motion of the base."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
import time
from typing import Any

from geometry_msgs.msg import InertiaStamped, Vector3Stamped, WrenchStamped
import numpy as np
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from ..control.control_loop import ControlLoop
from ..control.reference import Reference
from ..errors import ConfigurationError, InverseDynamicsError, JointStateError, shortened
from ..robot.kinematics import rotation_of_rpy
from ..robot.model import Floats
from . import messages, qos
from .cdr import JointStateReader
from .first_point import read_first_point
from .outputs import Outputs
from .parameters import BaseMotion, Configuration
from .runner import LoopRunner
from .trajectory_filler import TrajectoryFiller


class Inputs:
    """
    Stores received messages in the control loop, and steps it for joint states.

    Parameters
    ----------
    node : LifecycleNode
        The node that subscribes.
    runner : LoopRunner
        Runs the loop that the messages are for.
    outputs : Outputs
        Shows whether measured efforts are needed.
    filler : TrajectoryFiller
        Handles trajectories.
    configuration : Configuration
        The parameters.

    """

    def __init__(
        self,
        node: LifecycleNode,
        runner: LoopRunner,
        outputs: Outputs,
        filler: TrajectoryFiller,
        configuration: Configuration,
    ) -> None:
        self._runner, self._outputs, self._filler = runner, outputs, filler
        self._logger = node.get_logger()
        self._reader = JointStateReader()
        self.last_joint_state = time.monotonic()
        """Steady time of the last message on joint_states [s]; at first, of the start."""
        self._R_BS: Floats = np.eye(3)
        self.state_count = 0
        """Updates of all commanded joints since the start, by one message or several."""
        self._last_state = -math.inf
        self.apply(configuration)
        for kind, topic, callback, profile in (
            (Float64MultiArray, '~/desired_accelerations', self._on_accelerations, qos.RELIABLE),
            # Messages for several links may arrive at once.
            (InertiaStamped, '~/payload', self._on_payload, qos.QUEUED),
            (WrenchStamped, '~/external_wrench', self._on_external_wrench, qos.QUEUED),
            (Vector3Stamped, '~/gravity', self._on_gravity, qos.RELIABLE),
            (Imu, 'imu', self._on_imu, qos.BEST_EFFORT),
        ):
            node.create_subscription(kind, topic, callback, profile, **qos.overridable())
        self._states = node.create_subscription(
            JointState,
            'joint_states',
            self._on_joint_state,
            qos.BEST_EFFORT,
            raw=True,
            **qos.overridable(),
        )

        # Raw, because reading a long one takes seconds.
        for topic, receive in (
            ('~/reference', self._on_reference),
            ('~/joint_trajectory_in', self._on_trajectory),
        ):
            node.create_subscription(
                JointTrajectory, topic, receive, qos.RELIABLE, raw=True, **qos.overridable()
            )

    def apply(self, configuration: Configuration) -> None:
        """Use changed parameters."""
        self._configuration = configuration
        R_BS = rotation_of_rpy(*configuration.imu_orientation)
        if self._runner.loop is not None and (R_BS != self._R_BS).any():
            self._runner.loop.loads.expect_other_axes()
        self._R_BS = R_BS

    def read_latest_joint_state(self) -> None:
        """Handle the latest joint state before the executor does."""
        with self._states.handle:
            message = self._states.handle.take_message(JointState, True)
        if message is not None:
            self._on_joint_state(message[0])

    def _on_joint_state(self, data: bytes) -> None:
        self.last_joint_state = time.monotonic()
        loop = self._runner.loop
        if loop is None:
            return
        now = self._runner.now()
        try:
            names, positions, velocities, measured = self._reader.read(data)
            efforts = self._measured_efforts(len(names), measured)
            is_ours = loop.collector.update(now, names, positions, velocities, efforts)
        except JointStateError as error:
            self._runner.reject('joint_states', error)
            return
        if loop.collector.time != self._last_state:
            self._last_state = loop.collector.time
            self.state_count += 1
        if is_ours and self._runner.is_active and self._configuration.update_rate == 0.0:
            self._runner.step(now)

    def _measured_efforts(self, count: int, measured: Floats) -> Floats | tuple[()]:
        """Return measured efforts if they are used, and NaN for missing ones."""
        if not self._outputs.uses_measured_efforts:
            return ()
        if len(measured) == count:
            return measured
        if len(measured):  # the positions are used anyway
            self._runner.reject('joint_states', f'{count} names, but {len(measured)} efforts')
        return np.full(count, math.nan)

    def _on_accelerations(self, message: Float64MultiArray) -> None:
        self._store_reference('~/desired_accelerations', messages.read_accelerations, message)

    def _on_reference(self, data: bytes) -> None:
        self._store_reference('~/reference', _read_reference, data)

    def _store_reference(self, topic: str, read: Callable[..., Reference], message: Any) -> None:
        loop = self._runner.loop
        if loop is None or not self._runner.is_active:
            return
        now = self._runner.now()
        try:
            loop.reference = read(message, loop.controller.joints, now)
        except JointStateError as error:
            self._runner.reject(topic, error)

    def _on_payload(self, message: InertiaStamped) -> None:
        def store(loop: ControlLoop, now: float) -> None:
            payload = messages.read_payload(message)
            if loop.loads.set_payload(now, *payload):
                self._logger.info(f"payload on link '{payload.link}': {payload.mass:g} kg")

        self._handle('~/payload', store)

    def _on_external_wrench(self, message: WrenchStamped) -> None:
        self._handle(
            '~/external_wrench',
            lambda loop, now: loop.loads.set_external_wrench(now, *messages.read_wrench(message)),
        )

    def _on_gravity(self, message: Vector3Stamped) -> None:
        def store(loop: ControlLoop, now: float) -> None:
            frame = message.header.frame_id
            if frame not in ('', loop.base_link):
                raise ConfigurationError(
                    f"frame_id is '{shortened(frame)}', expected the base link '{loop.base_link}'"
                )
            if loop.has_imu:
                raise ConfigurationError("gravity is measured: parameter 'base_motion' is imu")
            loop.loads.set_gravity(messages.read_vector(message.vector))

        self._handle('~/gravity', store)

    def _on_imu(self, message: Imu) -> None:
        if self._configuration.base_motion is not BaseMotion.IMU:
            return
        self._handle(
            'imu',
            lambda loop, now: loop.set_base_motion(now, *messages.read_imu(message, self._R_BS)),
        )

    def _on_trajectory(self, data: bytes) -> None:
        self._handle(
            '~/joint_trajectory_in',
            lambda loop, now: self._filler.submit(
                loop,
                data,
                self._runner.is_active,
                lambda error: self._runner.reject('~/joint_trajectory_in', error),
            ),
        )

    def _handle(self, topic: str, store: Callable[[ControlLoop, float], None]) -> None:
        """Store a message in the loop, or log why it is dropped."""
        now = self._runner.now()
        if self._runner.loop is None:
            self._runner.reject(topic, 'there is no robot yet')
            return
        try:
            store(self._runner.loop, now)
        except InverseDynamicsError as error:
            self._runner.reject(topic, error)


def _read_reference(data: bytes, joints: Sequence[str], now: float) -> Reference:
    return messages.read_reference(read_first_point(data), joints, now)
