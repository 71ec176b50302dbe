"""Faults that need no regression: positions far outside their limits, and constant efforts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...robot.limit_checks import implausible_positions
from ...robot.model import Booleans, Floats, RobotModel
from .fault import Fault, FaultKind

FAR = 2.0 * np.pi  # [rad]; positions farther outside the limits have a wrong unit
CONSTANT = 1e-9  # variations below this fraction of the largest effort are rounding errors


def positions_fault(robot: RobotModel, q: Floats, names: tuple[str, ...]) -> list[Fault]:
    """Return a fault if positions are far outside the position limits."""
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


def constant_fault(values: Mapping[str, float]) -> list[Fault]:
    """Return one fault that lists all joints with constant efforts, if there are any."""
    if not values:
        return []
    return [Fault(FaultKind.NOT_MEASURED, tuple(values), tuple(values.values()))]


def not_measured(measured: Floats, modelled: Floats, least: Floats | float) -> Booleans:
    """
    Return a mask of joints with a constant measured effort that contradicts the model.

    Efforts have the shape (K, c). A constant measured effort contradicts a modelled effort that
    varies by more than `least` [N m or N]. A measured effort of zero contradicts a modelled effort
    above `least`.
    """
    largest = np.max(np.abs([measured, modelled]))
    is_constant = np.ptp(measured, axis=0) <= CONSTANT * largest
    is_zero = np.max(np.abs(measured), axis=0) <= CONSTANT * largest
    expected = np.where(is_zero, np.max(np.abs(modelled), axis=0), np.ptp(modelled, axis=0))
    return np.asarray(is_constant & (expected > least))
