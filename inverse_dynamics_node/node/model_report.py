"""The answer of the service ~/check_model."""

from __future__ import annotations

from ..control.control_loop import Rig
from ..errors import JointStateError
from ..report.report import model_report
from ..robot.model import Floats


def describe_robot(rig: Rig) -> str:
    """Describe the robot, and the efforts that hold it in its present pose, if that is known."""
    missing = rig.missing()
    if missing:
        return f'{_report(rig, None)}\n\nNot known yet: {", ".join(missing)}.'
    try:
        return _report(rig, rig.collector.q)
    except JointStateError as error:
        return f'{_report(rig, None)}\n\nNot known: {error}.'


def _report(rig: Rig, q: Floats | None) -> str:
    return model_report(rig.dynamics, rig.controller.joints, q, rig.controller.limits)
