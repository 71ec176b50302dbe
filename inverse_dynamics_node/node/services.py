"""The services of the node, besides those of every lifecycle node."""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode
from std_srvs.srv import SetBool, Trigger

from .model_report import describe_robot
from .runner import LoopRunner


class Services:
    """
    Answers ``~/enable`` and ``~/check_model``.

    Parameters
    ----------
    node : LifecycleNode
        The node that offers the services.
    runner : LoopRunner
        Runs the loop that they are about.

    """

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
        self._runner.enable(is_enabled=request.data)
        response.success = True
        response.message = f'efforts {"rise" if request.data else "fall to zero"} along the ramp'
        if loop.dry_run.is_active:
            response.message += ' (dry run: nothing is sent)'
        self._logger.info(response.message)
        return response

    def _on_check_model(self, request: Trigger.Request, response: Trigger.Response) -> Any:
        loop = self._runner.loop
        response.success = loop is not None
        response.message = describe_robot(loop) if loop else 'there is no robot yet'
        self._logger.info(response.message)  # ros2 service call prints it on one long line
        return response
