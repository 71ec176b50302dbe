"""
The only uses of names that rclpy does not declare as public.

Tried with rclpy 7.1.6 of ROS 2 Jazzy.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node


def overrides_of(node: Node) -> dict[str, Any]:
    """
    Return the values of parameters on the command line and in files by name, even if undeclared.

    The public method, automatically_declare_parameters_from_overrides, would declare every name,
    even a mistyped one.
    """
    return {name: each.value for name, each in node._parameter_overrides.items()}


def lifecycle_state(node: LifecycleNode) -> str:
    """Return the lifecycle state; the only public way is a service."""
    return str(node._state_machine.current_state[1])


def leave_graph(node: LifecycleNode) -> None:
    """
    Let a destroyed node leave the ROS graph at once.

    The state machine would keep the node alive, and in the graph for another 20 s.
    """
    node._state_machine.destroy_when_not_in_use()


def waiting_messages(
    subscription: Any, kind: type, *, raw: bool = False
) -> Iterator[tuple[Any, float]]:
    """Take each message in a queue and its arrival time [s], without an executor."""
    while True:
        with subscription.handle:
            taken = subscription.handle.take_message(kind, raw)
        if taken is None:
            return
        message, info = taken
        yield message, info['received_timestamp'] * 1e-9


def answer_request(service: Any) -> None:
    """Answer the next request of a service, if any, without an executor."""
    with service.handle:
        request, header = service.handle.service_take_request(service.srv_type.Request)
    if request is not None:
        service.send_response(service.callback(request, service.srv_type.Response()), header)


def is_unknown_arguments(error: Exception) -> bool:
    """Return whether `rclpy.init` has raised the error because of unknown ROS arguments."""
    return type(error).__name__ == 'UnknownROSArgsError'
