"""Connects a probe of the commands to a running node."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
import time
from typing import Any, NamedTuple

import numpy as np
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..errors import ConfigurationError, JointStateError
from ..robot.model import Floats, RobotModel
from .cdr import JointStateReader
from .middleware import RELIABLE
from .observer import Observer
from .private import waiting_messages

_PATIENCE = 10.0  # [s]; longest wait for an answer, and for joint states
_REPETITION = 2.0  # [s]; a request or its answer may be lost
_RENEWAL = 0.02  # [s]; longest time between references
_POLL = 0.001  # [s]


class Measurement(NamedTuple):
    """A joint state, and the efforts that were commanded last."""

    time: float
    """Time of arrival [s]."""
    q: Floats
    """Positions of all n joints; 0 for a joint that was never reported [rad or m]."""
    commands: Floats
    """Efforts of the m commanded joints, in the units of the commands."""


class Prober:
    """
    Reads the joint states and commands of an observed node, and sends references to it.

    `observer` belongs to `node`, which no executor spins. The services have a node of their own.
    """

    def __init__(self, node: Node, observer: Observer, joints: Sequence[str]) -> None:
        assert observer.robot is not None
        self._node, self._observer, self._joints = node, observer, list(joints)
        self._robot: RobotModel = observer.robot
        self._index = {name: i for i, name in enumerate(self._robot.joint_names)}
        self._q = np.full(len(self._index), np.nan)
        self._commanded = self._robot.joint_indices(self._joints)
        self._reader = JointStateReader()
        self._states: deque[tuple[float, Floats]] = deque()
        self._commands = np.zeros(len(self._joints))
        self._has_commands = False
        efforts = self._observer.status.text('efforts', 'topic with names')  # type: ignore[union-attr]
        self._efforts = node.create_subscription(JointState, efforts, print, 100)
        self._references = node.create_publisher(
            JointTrajectory, f'{observer.name}/reference', RELIABLE
        )
        self._sent, self._next_reference = b'', 0.0
        self._helper = rclpy.create_node(
            f'{node.get_name()}_services',
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter('start_type_description_service', value=False)],
        )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._helper)
        create = self._helper.create_client
        self._getter = create(GetParameters, f'{observer.name}/get_parameters')
        self._setter = create(
            SetParametersAtomically, f'{observer.name}/set_parameters_atomically'
        )
        self._enabler = create(SetBool, f'{observer.name}/enable')
        observer.on_joint_state = self._on_joint_state

    def close(self) -> None:
        """Stop to listen."""
        self._observer.on_joint_state = None
        self._executor.shutdown()
        self._helper.destroy_node()

    def measurements(self) -> list[Measurement]:
        """Return the joint states that have arrived since the last call."""
        self._observer.poll()
        efforts = []
        for message, received in waiting_messages(self._efforts, JointState):
            values = dict(zip(message.name, message.effort, strict=False))
            if all(joint in values for joint in self._joints):
                row = np.array([values[joint] for joint in self._joints])
                efforts.append((received, row))
        found = []
        while self._states:
            now, q = self._states.popleft()
            while efforts and efforts[0][0] <= now:
                self._commands, self._has_commands = efforts.pop(0)[1], True
            if self._has_commands:
                found.append(Measurement(now, q, self._commands))
        if efforts:
            self._commands, self._has_commands = efforts[-1][1], True
        return found

    def _on_joint_state(self, data: bytes, received: float) -> None:
        try:
            names, positions, _, _ = self._reader.read(data)
        except JointStateError:
            return
        is_ours = False
        for name, position in zip(names, positions, strict=False):
            i = self._index.get(name)
            if i is not None and np.isfinite(position):
                self._q[i] = position
                is_ours |= i == self._commanded[-1]
        if is_ours and np.isfinite(self._q[self._commanded]).all():
            self._states.append((received, np.nan_to_num(self._q)))

    def wait_for_measurements(self, count: int) -> list[Measurement]:
        """Wait for joint states; raise a ConfigurationError if they do not arrive."""
        found: list[Measurement] = []
        end = time.monotonic() + _PATIENCE
        while len(found) < count:
            found += self.measurements()
            if time.monotonic() > end:
                raise ConfigurationError(
                    f'{self._observer.name}: only {len(found)} joint states with commands arrived '
                    f'within {_PATIENCE:g} s'
                )
            time.sleep(_POLL)
        return found

    def refer(self, positions: Floats, efforts: Floats) -> None:
        """Send a reference that keeps the joints in their positions, and adds efforts."""
        now, content = time.monotonic(), positions.tobytes() + efforts.tobytes()
        if content == self._sent and now < self._next_reference:
            return
        self._sent, self._next_reference = content, now + _RENEWAL
        rest = [0.0] * len(self._joints)
        point = JointTrajectoryPoint(
            positions=positions.tolist(),
            velocities=rest,
            accelerations=rest,
            effort=efforts.tolist(),
        )
        self._references.publish(JointTrajectory(joint_names=self._joints, points=[point]))

    # Services

    def parameters(self, names: Sequence[str]) -> dict[str, Any]:
        """Return the values of parameters, as messages."""
        answer = self._call(self._getter, GetParameters.Request(names=list(names)))
        return dict(zip(names, answer.values, strict=True))

    def request(self, values: Mapping[str, Any]) -> Callable[[], bool]:
        """
        Ask the node to set parameters; return a function that says whether it has.

        The function raises a ConfigurationError if the node refuses. The values are numbers,
        texts, lists, or messages that `parameters` has returned.
        """
        messages = []
        for name, value in values.items():
            if hasattr(value, 'double_array_value'):
                message = Parameter(name, value=0.0).to_parameter_msg()
                message.value = value
            else:
                message = Parameter(name, value=value).to_parameter_msg()
            messages.append(message)
        request = SetParametersAtomically.Request(parameters=messages)
        future = self._setter.call_async(request)

        def is_done() -> bool:
            self._executor.spin_once(timeout_sec=0.0)
            if not future.done():
                return False
            result = future.result().result
            if not result.successful:
                raise ConfigurationError(f'{self._observer.name}: {result.reason}')
            return True

        return is_done

    def set(self, values: Mapping[str, Any]) -> None:
        """Set parameters, and wait until the node has them."""
        self._wait_for(self._setter)
        self._until(self.request(values), 'set_parameters_atomically')

    def disable(self) -> None:
        """Let the efforts fall to zero."""
        self._call(self._enabler, SetBool.Request(data=False))

    def _call(self, client: Any, request: Any) -> Any:
        self._wait_for(client)
        futures: list[Any] = []
        due = 0.0

        def is_done() -> bool:
            nonlocal due
            if time.monotonic() > due:
                futures.append(client.call_async(request))
                due = time.monotonic() + _REPETITION
            self._executor.spin_once(timeout_sec=0.01)
            return any(future.done() for future in futures)

        self._until(is_done, client.srv_name)
        return next(future for future in futures if future.done()).result()

    def _wait_for(self, client: Any) -> None:
        self._until(client.service_is_ready, client.srv_name)

    def _until(self, is_done: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + _PATIENCE
        while not is_done():
            if time.monotonic() > end:
                raise ConfigurationError(
                    f'{self._observer.name} does not answer on {what} within {_PATIENCE:g} s'
                )
            time.sleep(_POLL)
