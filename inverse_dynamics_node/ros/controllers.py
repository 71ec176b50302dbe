"""Asks the controllers that receive the commands for the joints that they command."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import time
from typing import Any, NamedTuple

from rcl_interfaces.srv import GetParameters
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import parameter_value_to_python

from .graph import subscribers_by_endpoint
from .middleware import LATCHED

try:
    from controller_manager_msgs.msg import ControllerManagerActivity
except ImportError:  # without ros2_control, there is nobody to ask
    ControllerManagerActivity = None

_PERIOD = 1.0  # [s]; between searches for subscribers, unless their number changes
_REPETITION = 2.0  # [s]; a request or its answer may be lost
_MOST_REQUESTS = 5  # to a subscriber that does not answer
_ACTIVITY = 'controller_manager_msgs/msg/ControllerManagerActivity'
_JOINTS, _INTERFACE = 'joints', 'interface_name'  # parameters of controllers of ros2_control


class Controller(NamedTuple):
    """What a controller says about the commands that it takes."""

    name: str
    """Fully qualified name of its node."""
    joints: tuple[str, ...]
    """The joints that it commands, in the order of the commands."""
    interface: str
    """The command interface that it writes; '' if unknown."""
    is_late: bool
    """Whether it has answered only after the request was sent again."""
    state: str = ''
    """Its lifecycle state, such as inactive; '' if no controller manager says it."""


class Controllers:
    """
    Finds the controllers of ros2_control among the subscribers of the commands.

    A controller is a node with the parameter ``joints``, a list of names. Its answer arrives while
    the executor spins: no call waits for it. A subscriber that does not answer is asked a few
    times. A node that subscribes again is asked again. A controller manager that publishes its
    activity says which controllers are inactive.

    `commands` is the publisher of the commands.
    """

    def __init__(self, node: LifecycleNode, commands: Any) -> None:
        self._node, self._commands = node, commands
        self._interviews: dict[bytes, _Interview] = {}  # by the identifier of the subscription
        self._count, self._next_search = 0, 0.0
        self._managers: set[str] = set()  # topics with the activity of controller managers
        self._states: dict[str, str] = {}  # of controllers, by name

    def poll(self) -> list[Controller]:
        """Look for new subscribers, and return the controllers that have answered since."""
        now, count = time.monotonic(), self._commands.get_subscription_count()
        if count != self._count or now >= self._next_search:
            self._count, self._next_search = count, now + _PERIOD
            self._search()
        found = (interview.proceed(now) for interview in self._interviews.values())
        return [controller for controller in found if controller is not None]

    @property
    def known(self) -> list[Controller]:
        """The controllers that have answered, and still subscribe to the commands."""
        found = (interview.controller for interview in self._interviews.values())
        return [
            each._replace(state=self._states.get(each.name.rpartition('/')[2], ''))
            for each in found
            if each is not None
        ]

    def _search(self) -> None:
        names = subscribers_by_endpoint(self._node, self._commands)
        for endpoint in self._interviews.keys() - names.keys():
            self._interviews.pop(endpoint).end()
        for endpoint, name in names.items():
            if endpoint not in self._interviews:
                self._interviews[endpoint] = _Interview(self._node, name)
        if ControllerManagerActivity is not None and names:
            self._find_managers()

    def _find_managers(self) -> None:
        for topic, types in self._node.get_topic_names_and_types():
            if _ACTIVITY in types and topic not in self._managers:
                self._managers.add(topic)
                with suppress(RuntimeError):  # the security policy may forbid it
                    self._node.create_subscription(
                        ControllerManagerActivity, topic, self._on_activity, LATCHED
                    )

    def _on_activity(self, message: Any) -> None:
        self._states.update({each.name: each.state.label for each in message.controllers})


class _Interview:
    """Asks one subscriber for its parameters."""

    def __init__(self, node: LifecycleNode, name: str) -> None:
        self._node, self._name = node, name
        self._client: Any = None
        self._answers: list[tuple[Any, Any]] = []  # to each pair of requests
        self._next_request = 0.0
        self.controller: Controller | None = None
        """The answer; None until it arrives, and if the subscriber is not a controller."""

    def proceed(self, now: float) -> Controller | None:
        """Send a request if one is due; return the answer once. `now` is the steady time [s]."""
        answer = next((pair for pair in self._answers if all(each.done() for each in pair)), None)
        if answer is not None:
            joints, interface = (_value(future) for future in answer)
            if _is_list_of_names(joints):
                text = interface if isinstance(interface, str) else ''
                is_late = answer is not self._answers[0] or len(self._answers) > 1
                self.controller = Controller(self._name, tuple(joints), text, is_late)
            self.end()
            return self.controller
        if now >= self._next_request and self._may_ask():
            self._next_request = now + _REPETITION
            requests = (GetParameters.Request(names=[name]) for name in (_JOINTS, _INTERFACE))
            joints, interface = map(self._client.call_async, requests)
            self._answers.append((joints, interface))
        return None

    def _may_ask(self) -> bool:
        service = f'{self._name}/get_parameters'
        if len(self._answers) == _MOST_REQUESTS or self._next_request < 0.0:
            return False
        if self._client is None and self._node.count_services(service):
            try:
                self._client = self._node.create_client(GetParameters, service)
            except RuntimeError:  # the security policy may forbid it
                self.end()
        return self._client is not None and self._client.service_is_ready()

    def end(self) -> None:
        """Stop asking."""
        self._next_request, self._answers = -1.0, []
        if self._client is not None:
            self._node.destroy_client(self._client)
            self._client = None


def _value(future: Any) -> Any:
    """Return the value of a parameter, or None if the subscriber does not have it."""
    values = future.result().values if future.exception() is None else []
    return parameter_value_to_python(values[0]) if values else None


def _is_list_of_names(value: Any) -> bool:
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    return is_list and bool(value) and all(isinstance(each, str) and each for each in value)
