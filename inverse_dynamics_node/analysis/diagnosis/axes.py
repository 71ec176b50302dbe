"""
Finds positions that are in another unit, and joints whose axis points the other way.

A reversed axis changes position, velocity and effort of its joint alike. The joint looks right by
itself, but every joint that moves it or is moved by it has another effort.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...robot.limit_checks import implausible_positions
from ...robot.model import Floats, RobotModel
from .fault import Fault, FaultKind
from .joint_samples import PARAMETER_COST
from .regression_data import RegressionData, RobotFit

FAR = 2.0 * np.pi  # [rad] outside the limits; a joint that turned once more is not as far
NOT_EXPLAINED = 9.0  # times the floor; if all joints have less, no axis is reversed
LARGE = 0.05  # fraction of the squares that is not explained, whatever the floor
AXIS_PARAMETERS = 2  # an axis has the weight of two parameters, because it is rarely wrong


class Axes(NamedTuple):
    """The directions of the axes, and the explanation of the efforts with these."""

    signs: Floats
    """-1 for each of n joints whose axis is reversed, otherwise 1."""
    data: RegressionData
    robot_fit: RobotFit


def search_axes(
    data: RegressionData, with_signs: Callable[[Floats], RegressionData | None]
) -> Axes:
    """
    Explain efforts, with other directions of axes if these explain more.

    The function returns the samples for given signs of the n axes.

    """
    best = Axes(np.ones(len(data.joints)), data, data.explain())
    while not data.is_too_short and _is_open(best):
        trials = []
        for j, samples in enumerate(data.joints):
            signs = best.signs.copy()
            signs[j] = -1.0
            other = with_signs(signs) if samples.moves and best.signs[j] > 0.0 else None
            if other is not None:
                trials.append((other.friction_only().cost, j, signs, other))
        if not trials:
            break
        _, _, signs, other = min(trials)
        found = Axes(signs, other, other.explain())
        if found.robot_fit.cost + AXIS_PARAMETERS * PARAMETER_COST > best.robot_fit.cost:
            break
        best = found
    return best


def _is_open(axes: Axes) -> bool:
    """Return whether a joint that moves is not explained."""
    data, fit = axes.data, axes.robot_fit
    for samples, each, source in zip(data.joints, fit.fits, fit.source, strict=True):
        floor = samples.floor(data.first_measured + source)
        if samples.moves and each.remaining > max(floor, min(NOT_EXPLAINED * floor, LARGE)):
            return True
    return False


def diagnose_positions(robot: RobotModel, q: Floats, names: tuple[str, ...]) -> list[Fault]:
    """Return the fault of positions so far outside their limits that they have another unit."""
    far = [
        each
        for each in implausible_positions(robot, q, names)
        if not each.is_prismatic
        and max(each.lower - each.position, each.position - each.upper) > FAR
    ]
    if not far:
        return []
    values = (float(np.degrees(1.0)),) if all(each.looks_like_degrees for each in far) else ()
    return [Fault(FaultKind.POSITIONS, tuple(each.joint for each in far), values)]
