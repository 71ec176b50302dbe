"""Effort limits that are missing, or that look like placeholders."""

from __future__ import annotations

from collections import Counter
import math

import numpy as np

from .model import RobotModel
from .model_warning import ModelWarning

_FAR_BEYOND = 50.0
"""An effort limit of this many times the moment of the robot's weight is a placeholder."""
_FEWEST_EQUAL, _FRACTION_EQUAL = 3, 0.8
_ROUND_LIMITS = (100.0, 1000.0, 10000.0, 100000.0)
"""Effort limits [N m] that exporters write; equal for shoulder and wrist, they are not real."""


def limit_subject(joint: str, quantity: str) -> str:
    """Return the subject of warnings about the limit of a joint's 'effort' or 'velocity'."""
    return f"joint '{joint}' {quantity} limit"


def effort_limit_warnings(robot: RobotModel) -> tuple[ModelWarning, ...]:
    """Return warnings about missing and unlikely effort limits, except those of the loader."""
    hint = 'write <limit effort="..."/>, or set the parameter effort_limits of the node'
    missing = (
        ModelWarning('missing', hint, limit_subject(name, 'effort'))
        for name, limit in zip(robot.joint_names, robot.effort_limits, strict=True)
        if math.isinf(limit)
    )
    reported = {warning.subject for warning in robot.warnings}
    return (
        *(warning for warning in missing if warning.subject not in reported),
        *_placeholders(robot),
    )


def _placeholders(robot: RobotModel) -> tuple[ModelWarning, ...]:
    """
    Return warnings about effort limits that look like placeholders.

    They are compared with the moment of the weight of all moving parts at the farthest reach of
    the robot. The wrist needs much less, but motors are not oversized by orders of magnitude.
    Prismatic joints are not compared: a gripper presses with many times the weight of its fingers.

    """
    hint = 'write the largest effort of the joint, from the data sheet of its drive'
    is_revolute = ~robot.is_prismatic_joint
    limits = robot.effort_limits
    rated = limits[is_revolute & np.isfinite(limits)]
    if not rated.size:
        return ()
    most = _moment_of_weight(robot)
    common, count = Counter(rated.tolist()).most_common(1)[0]
    if common in _ROUND_LIMITS and count >= max(_FEWEST_EQUAL, _FRACTION_EQUAL * rated.size):
        text = f'{count} of {rated.size} effort limits of revolute joints are {common:g} N m'
        return (ModelWarning(f'{text}: looks like a placeholder', hint),)
    return tuple(
        ModelWarning(
            f'{limit:.7g} N m, but holding the whole robot stretched out takes at most '
            f'{most:.3g} N m: looks like a placeholder',
            hint,
            limit_subject(name, 'effort'),
        )
        for name, limit, revolute in zip(robot.joint_names, limits, is_revolute, strict=True)
        if revolute and most > 0.0 and _FAR_BEYOND * most < limit < math.inf
    )


def _moment_of_weight(robot: RobotModel) -> float:
    """Return an upper bound of the gravity efforts, on Earth [N m]."""
    reach = np.zeros(len(robot.parent))
    for body in range(1, len(robot.parent)):
        joint = int(robot.joint_index[body])
        ends = np.abs([robot.lower[joint], robot.upper[joint]])
        travel = np.max(ends[np.isfinite(ends)], initial=0.0) if robot.is_prismatic[body] else 0.0
        reach[body] = reach[robot.parent[body]] + np.linalg.norm(robot.p_PL[body]) + travel
    arms = reach + np.linalg.norm(robot.com, axis=1)
    return float(9.81 * np.sum((robot.mass * arms)[1:]))
