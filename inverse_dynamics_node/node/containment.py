"""Keeps requests and messages that rclpy cannot handle from ending the process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter

from ..errors import ConfigurationError, shortened
from .ros_parameters import describe_unknown

_TYPES = {kind.value for kind in Parameter.Type}


def contain_errors(node: LifecycleNode, keep_up: Callable[[], None] = lambda: None) -> None:
    """
    Catch the errors of the services and subscriptions that rclpy has created.

    rclpy 7.1 raises out of the executor on a parameter whose type does not exist, a clock before
    zero, or a lifecycle transition that is not possible now.

    Parameters
    ----------
    node : LifecycleNode
        A node without entities of its own yet: their errors must not be hidden.
    keep_up : callable, optional
        Called after every request. Requests may fill the queue of the executor, and each takes as
        long as several commands.

    """
    for service in node.services:
        if service.srv_type is SetParameters:
            callback = _set_each(node, service.callback)
        elif service.srv_type is SetParametersAtomically:
            callback = _set_all(node, service.callback)
        else:
            callback = _contained(node, service.srv_name, service.callback)
        service.callback = _followed_by(keep_up, callback)
    for subscription in node.subscriptions:
        subscription.callback = _contained_subscription(
            node, subscription.topic_name, subscription.callback
        )


def _followed_by(
    keep_up: Callable[[], None], callback: Callable[[Any, Any], Any]
) -> Callable[[Any, Any], Any]:
    def followed(request: Any, response: Any) -> Any:
        response = callback(request, response)
        keep_up()
        return response

    return followed


def _contained(
    node: LifecycleNode, name: str, callback: Callable[[Any, Any], Any]
) -> Callable[[Any, Any], Any]:
    def contained(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:
            node.get_logger().error(f'{name}: request rejected: {_line(error)}')
            return type(response)()

    return contained


def _set_each(
    node: LifecycleNode, callback: Callable[[Any, Any], Any]
) -> Callable[[Any, Any], Any]:
    def contained(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            one = SetParameters.Response()
            try:
                _check_names(node, [parameter])
                callback(SetParameters.Request(parameters=[parameter]), one)
                response.results.append(one.results[0])
            except Exception as error:
                response.results.append(_rejection([parameter], error))
        return response

    return contained


def _set_all(
    node: LifecycleNode, callback: Callable[[Any, Any], Any]
) -> Callable[[Any, Any], Any]:
    def contained(request: Any, response: Any) -> Any:
        try:
            _check_names(node, request.parameters)
            return callback(request, response)
        except Exception as error:
            response.result = _rejection(request.parameters, error)
            return response

    return contained


def _check_names(node: LifecycleNode, parameters: Sequence[Any]) -> None:
    """Reject unknown names: rclpy 7.1 does not show them, and accepts an empty one."""
    for parameter in parameters:
        if parameter.name not in node._parameters:
            raise ConfigurationError(describe_unknown(parameter.name, node._parameters))


def _rejection(parameters: Sequence[Any], error: Exception) -> SetParametersResult:
    for parameter in parameters:
        if parameter.value.type not in _TYPES:
            reason = (
                f"parameter '{shortened(parameter.name)}' has type {parameter.value.type}, "
                f'expected {min(_TYPES)} to {max(_TYPES)}'
            )
            return SetParametersResult(successful=False, reason=reason)
    return SetParametersResult(successful=False, reason=_line(error))


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
