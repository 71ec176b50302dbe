"""Offers the services of the node, and handles errors in the services of rclpy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from ..control.loop import ControlLoop
from ..errors import shortened
from ..report.robot_tables import model_report
from ..robot.model import Floats
from ..ros.private import answer_request
from .ros_parameters import unknown_parameters
from .runner import LoopRunner
from .status_text import missing_inputs

_TYPES = {kind.value for kind in Parameter.Type}


class Services:
    """Offers the services ``~/enable`` and ``~/check_model``."""

    def __init__(self, node: LifecycleNode, runner: LoopRunner) -> None:
        self._runner = runner
        self._logger = node.get_logger()
        node.create_service(SetBool, '~/enable', self._on_enable)
        node.create_service(Trigger, '~/check_model', self._on_check_model)

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        loop = self._runner.loop
        if loop is None or not self._runner.is_active:
            response.message = 'the node is not active'
            return response
        if request.data and self._runner.objection and not loop.dry_run.is_active:
            response.message = self._runner.objection
            return response
        self._runner.enable(is_enabled=request.data)
        response.success = True
        response.message = f'efforts ramp {"up" if request.data else "down to zero"}'
        if loop.dry_run.is_active:
            response.message += ' (dry run: nothing is sent)'
        self._logger.info(response.message)
        return response

    def _on_check_model(self, request: Trigger.Request, response: Trigger.Response) -> Any:
        loop = self._runner.loop
        response.success = loop is not None
        response.message = describe_robot(loop) if loop else 'the node is not configured'
        self._logger.info(response.message)  # ros2 service call prints the report on one long line
        return response


def describe_robot(loop: ControlLoop) -> str:
    """Describe the robot and, if its pose is known, the efforts that hold the pose."""
    missing = missing_inputs(loop)
    if missing:
        waiting = f'waiting for {", ".join(missing)}'
        return f'{_report(loop, None)}\n\nThe holding efforts are not known yet: {waiting}.'
    return _report(loop, loop.collector.q)


def _report(loop: ControlLoop, q: Floats | None) -> str:
    return model_report(loop.dynamics, loop.joints, q, loop.limits)


def answer_requests(node: LifecycleNode) -> None:
    """
    Answer waiting requests during a long callback, except for lifecycle transitions.

    The executor finds the requests gone, and goes on.
    """
    for service in node.services:
        if service.srv_type is not ChangeState:
            answer_request(service)


def contain_errors(node: LifecycleNode, catch_up: Callable[[], None]) -> None:
    """
    Catch errors in the services and subscriptions that rclpy has created.

    In rclpy 7.1, a parameter of an unknown type, a negative time on /clock or an impossible
    lifecycle transition raises an error in the executor. The client of a service would wait
    forever for an answer.

    Call this function before the node creates its own services and subscriptions, because their
    errors must not be hidden. `catch_up` is called after every request, because a request takes as
    long as several steps of the loop.
    """
    setters = {
        SetParameters: lambda request, _: SetParameters.Response(
            results=[_set(node, [parameter]) for parameter in request.parameters]
        ),
        SetParametersAtomically: lambda request, _: SetParametersAtomically.Response(
            result=_set(node, request.parameters)
        ),
    }
    for service in node.services:
        callback = setters.get(service.srv_type, service.callback)
        service.callback = _contained(node, service.srv_name, callback, catch_up)
    for subscription in node.subscriptions:
        name = subscription.topic_name
        subscription.callback = _contained(node, name, subscription.callback, lambda: None)


def _contained(
    node: LifecycleNode, name: str, callback: Callable[..., Any], catch_up: Callable[[], None]
) -> Callable[..., Any]:
    reported: set[str] = set()  # /clock may have a thousand messages per second

    def contained(message: Any, *response: Any) -> Any:
        try:
            return callback(message, *response)
        except Exception as error:
            text = shortened(str(error).partition('\n')[0] or repr(error), 200)
            if text not in reported and len(reported) < 10:
                reported.add(text)
                node.get_logger().error(f'{name}: message dropped: {text}')
            return type(response[0])() if response else None
        finally:
            catch_up()

    return contained


def _set(node: LifecycleNode, parameters: Sequence[Any]) -> SetParametersResult:
    """Set all parameters or none, and return the result."""
    reason = _problem(node, parameters)
    if reason:
        return SetParametersResult(reason=reason)
    return node.set_parameters_atomically(list(map(Parameter.from_parameter_msg, parameters)))


def _problem(node: LifecycleNode, parameters: Sequence[Any]) -> str:
    """
    Return why parameters cannot be set, or '' if no problem is found.

    The error of rclpy 7.1 would not contain the name of an unknown parameter.
    """
    for parameter in parameters:
        if parameter.value.type not in _TYPES:
            return (
                f"parameter '{shortened(parameter.name)}' has type {parameter.value.type}, "
                f'expected {min(_TYPES)} to {max(_TYPES)}'
            )
        for problem in unknown_parameters(node, [parameter.name]):
            return problem
    return ''
