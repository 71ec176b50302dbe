"""Keeps requests and messages that rclpy cannot handle from ending the process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter

from ..errors import shortened
from .ros_parameters import unknown_parameters

_TYPES = {kind.value for kind in Parameter.Type}


def contain_errors(node: LifecycleNode, keep_up: Callable[[], None]) -> None:
    """
    Catch the errors of the services and subscriptions that rclpy has created.

    rclpy 7.1 raises out of the executor on a parameter whose type does not exist, a clock before
    zero, or a lifecycle transition that is not possible now. The executor would survive that, but
    a client would wait for its answer forever.

    Parameters
    ----------
    node : LifecycleNode
        A node without entities of its own yet: their errors must not be hidden.
    keep_up : callable
        Called after every request. Requests may fill the queue of the executor, and each takes as
        long as several commands.

    """
    for service in node.services:
        callback = service.callback
        if service.srv_type is SetParameters:
            callback = _set_each(node, callback)
        elif service.srv_type is SetParametersAtomically:
            callback = _set_all(node, callback)
        service.callback = _contained(node, service.srv_name, callback, keep_up)
    for subscription in node.subscriptions:
        subscription.callback = _contained_subscription(
            node, subscription.topic_name, subscription.callback
        )


def _contained(
    node: LifecycleNode,
    name: str,
    callback: Callable[[Any, Any], Any],
    keep_up: Callable[[], None],
) -> Callable[[Any, Any], Any]:
    def contained(request: Any, response: Any) -> Any:
        try:
            response = callback(request, response)
        except Exception as error:
            node.get_logger().error(f'{name}: request rejected: {_line(error)}')
            response = type(response)()
        keep_up()
        return response

    return contained


def _set_each(
    node: LifecycleNode, callback: Callable[[Any, Any], Any]
) -> Callable[[Any, Any], Any]:
    def checked(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            reason = _problem(node, [parameter])
            if reason:
                response.results.append(SetParametersResult(reason=reason))
            else:
                callback(SetParameters.Request(parameters=[parameter]), response)
        return response

    return checked


def _set_all(
    node: LifecycleNode, callback: Callable[[Any, Any], Any]
) -> Callable[[Any, Any], Any]:
    def checked(request: Any, response: Any) -> Any:
        reason = _problem(node, request.parameters)
        if reason:
            response.result = SetParametersResult(reason=reason)
            return response
        return callback(request, response)

    return checked


def _problem(node: LifecycleNode, parameters: Sequence[Any]) -> str:
    """Return why parameters cannot be set; rclpy 7.1 does not name those that are unknown."""
    for parameter in parameters:
        if parameter.value.type not in _TYPES:
            return (
                f"parameter '{shortened(parameter.name)}' has type {parameter.value.type}, "
                f'expected {min(_TYPES)} to {max(_TYPES)}'
            )
        for problem in unknown_parameters(node, [parameter.name]):
            return problem
    return ''


def _contained_subscription(
    node: LifecycleNode, topic: str, callback: Callable[[Any], None]
) -> Callable[[Any], None]:
    reported: set[str] = set()  # /clock may have a thousand messages per second

    def contained(message: Any) -> None:
        try:
            callback(message)
        except Exception as error:
            text = _line(error)
            if text not in reported and len(reported) < 10:
                reported.add(text)
                node.get_logger().error(f'{topic}: message dropped: {text}')

    return contained


def _line(error: Exception) -> str:
    return shortened(str(error).partition('\n')[0] or repr(error), 200)
