"""The answer of the service ~/check_model."""

from __future__ import annotations

from ..control.loop import ControlLoop
from ..errors import JointStateError
from ..report.model_report import model_report
from ..robot.model import Floats


def describe_robot(loop: ControlLoop) -> str:
    """Describe the robot, and the efforts that hold it in its present pose if it is known."""
    missing = loop.missing()
    if missing:
        return f'{_report(loop, None)}\n\nNot known yet: {", ".join(missing)}.'
    try:
        return _report(loop, loop.collector.q)
    except JointStateError as error:
        return f'{_report(loop, None)}\n\nNot known: {error}.'


def _report(loop: ControlLoop, q: Floats | None) -> str:
    return model_report(loop.dynamics, loop.controller.joints, q, loop.controller.limits)
