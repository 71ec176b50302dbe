"""
Splits an explanation of measured efforts into faults.

An *explanation* is a `RobotFit`. A reversed axis negates position, velocity and effort of a joint.
The effort of this joint looks right, but the efforts of neighbouring joints look wrong. Therefore
the search for an explanation is repeated with reversed axes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np

from ...robot.limit_checks import implausible_positions
from ...robot.model import Floats, RobotModel
from .fault import Change, Fault, FaultKind
from .intervals import FaultInterval
from .joint_samples import CREDIBLE, JointFit, NO_FAULT, PARAMETER_COST
from .loads import MAX_COM_ERROR
from .regression_data import angle_between, RegressionData, RobotFit

CHANGED = 0.9  # a fault affects a joint if the correction leaves a smaller fraction of the RMS
MOST_UNEXPLAINED = 0.5  # unexplained fraction above which joints at rest are reported
FAR = 2.0 * np.pi  # [rad]; positions farther outside the limits have a wrong unit
NOT_EXPLAINED = 9.0  # reversed axes are tried if more than this multiple of the floor remains
LARGE = 0.05  # reversed axes are also tried if more than this fraction of the squares remains
AXIS_PARAMETERS = 2  # reversed axes are rare, and cost as much as two parameters


# ---- Directions of axes --------------------------------------------------------------------


class Axes(NamedTuple):
    """Signs of the axes, and the explanation of the efforts with these signs."""

    signs: Floats
    """Signs of the axes, shape (n,): -1 for reversed axes, and 1 for other axes."""
    data: RegressionData
    robot_fit: RobotFit


def search_axes(
    data: RegressionData, with_signs: Callable[[Floats], RegressionData | None]
) -> Axes:
    """
    Find the axes whose reversal improves the explanation of the efforts.

    `with_signs` returns the data for given signs, shape (n,), or None to reject the signs.
    """
    best = Axes(np.ones(len(data.joints)), data, data.explain())
    while not data.is_too_short and best.data.is_open(best.robot_fit, NOT_EXPLAINED, LARGE):
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


# ---- Faults --------------------------------------------------------------------------------


def diagnose(data: RegressionData, robot_fit: RobotFit, names: Sequence[str]) -> list[Fault]:
    """Return the faults that an explanation contains, most important first."""
    found = _Faults(data, robot_fit, names)
    faults = (
        found.order(),
        found.other_gravity(),
        found.mounting(),
        found.unit(),
        found.sensor_fault(FaultKind.SIGN, 'is_swapped', lambda fit: -1.0),
        found.sensor_fault(FaultKind.SCALE, 'is_scaled', lambda fit: fit.scale),
        found.payload(),
        found.sensor_fault(FaultKind.ROTOR_INERTIA, 'has_rotor', lambda fit: fit.rotor),
        found.sensor_fault(FaultKind.OFFSET, 'has_offset', lambda fit: fit.offset),
        found.unexplained(),
    )
    return [fault for fault in faults if fault is not None]


def diagnose_interval(fault: FaultInterval, names: Sequence[str]) -> Fault:
    """Return the fault that acts during an interval."""
    if fault.kind is FaultKind.MOUNTING:
        angles = angle_between(fault.gravity, fault.data.gravity)
        values = tuple(fault.gravity[np.argmax(angles)].tolist())
        angle = float(angles.max())
        found: Fault | None = Fault(FaultKind.MOUNTING, values=values, angle=angle)
    elif fault.kind is FaultKind.PAYLOAD:
        found = _Faults(fault.data, fault.outside, names).payload()
    else:
        found = Fault(FaultKind.EXTERNAL_FORCE, tuple(names[j] for j in fault.joints))
    assert found is not None
    return found._replace(interval=fault.interval)


def diagnose_axes(data: RegressionData, axes: Axes, names: Sequence[str]) -> list[Fault]:
    """Return a fault if axes are reversed. `data` contains the samples as recorded."""
    joints = tuple(name for name, sign in zip(names, axes.signs, strict=True) if sign < 0.0)
    if not joints:
        return []
    before = [fit.rms for fit in data.friction_only().fits]
    after = [fit.rms for fit in axes.data.friction_only().fits]
    changes = decreases(data, names, before, after)
    return [Fault(FaultKind.REVERSED_AXIS, joints, changes=changes)]


def decreases(
    data: RegressionData,
    names: Sequence[str],
    before: Sequence[float],
    after: Sequence[float],
    source: Sequence[int] | None = None,
) -> tuple[Change, ...]:
    """Return the joints whose RMS residual clearly decreases, largest reduction first."""
    found = []
    for j, samples in enumerate(data.joints):
        if after[j] < CHANGED * before[j]:
            measured = data.first_measured + (j if source is None else source[j])
            size = math.sqrt(samples.squares[measured])
            found.append(Change(names[j], samples.is_prismatic, before[j], after[j], size))
    return tuple(sorted(found, key=lambda each: each.after - each.before))


def diagnose_positions(robot: RobotModel, q: Floats, names: tuple[str, ...]) -> list[Fault]:
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


def diagnose_constant(values: Mapping[str, float]) -> list[Fault]:
    """Return one fault that lists all joints with constant efforts, if there are any."""
    if not values:
        return []
    return [Fault(FaultKind.NOT_MEASURED, tuple(values), tuple(values.values()))]


class _Faults:
    """Derives the faults from one explanation."""

    def __init__(self, data: RegressionData, robot_fit: RobotFit, names: Sequence[str]) -> None:
        self.data, self.robot_fit, self.names = data, robot_fit, names
        self.fits = robot_fit.fits
        moving = [fit for fit in self.fits if fit.moves]
        self.is_motor_side = 2 * sum(fit.has_friction for fit in moving) > len(moving)

    def changes(self, without: RobotFit) -> tuple[Change, ...]:
        """Return the effects of correcting one fault, given the fit without the correction."""
        before, after = ([fit.rms for fit in fits] for fits in (without.fits, self.fits))
        return decreases(self.data, self.names, before, after, self.robot_fit.source)

    def order(self) -> Fault | None:
        source = self.robot_fit.source
        moved = [j for j, i in enumerate(source) if i != j]
        if not moved:
            return None
        samples, first = self.data.joints, self.data.first_measured
        weights = self.robot_fit.candidate.weights
        fits = list(self.fits)
        for j in moved:
            fits[j] = samples[j].fit(weights, first + j, NO_FAULT)
        without = self.robot_fit._replace(fits=tuple(fits))
        return Fault(
            FaultKind.ORDER,
            tuple(self.names[j] for j in moved),
            changes=self.changes(without),
            sources=tuple(self.names[source[j]] for j in moved),
        )

    def _without_candidate(self) -> RobotFit:
        candidate = self.robot_fit.candidate
        base = self.data.nominal
        if candidate.kind is FaultKind.PAYLOAD and self.data.contradicts(candidate):
            base = self.data.other_gravity()
        return self.data.refit(self.robot_fit, candidate=base)

    def other_gravity(self) -> Fault | None:
        """Return a fault if the measured efforts unexpectedly lack or contain gravity."""
        candidate, other = self.robot_fit.candidate, self.data.other_gravity()
        if other.kind is None or not self.data.contradicts(candidate):
            return None
        weights = candidate.weights - other.weights + self.data.nominal.weights
        without = self.data.refit(self.robot_fit, candidate=candidate._replace(weights=weights))
        is_commanded = self.data.convention.in_commands
        return Fault(other.kind, changes=self.changes(without), is_commanded=is_commanded)

    def mounting(self) -> Fault | None:
        candidate = self.robot_fit.candidate
        if candidate.kind is not FaultKind.MOUNTING:
            return None
        return Fault(
            FaultKind.MOUNTING,
            values=candidate.solution,
            changes=self.changes(self._without_candidate()),
            angle=float(angle_between(np.array(candidate.solution), self.data.gravity)),
        )

    def payload(self) -> Fault | None:
        candidate = self.robot_fit.candidate
        if candidate.kind is not FaultKind.PAYLOAD:
            return None
        mass, *com = candidate.solution
        known = [
            x if error < MAX_COM_ERROR else math.nan
            for x, error in zip(com, candidate.errors[1:], strict=True)
        ]
        return Fault(
            FaultKind.PAYLOAD,
            values=(mass, *known),
            changes=self.changes(self._without_candidate()),
            error=candidate.errors[0],
            link=candidate.link,
        )

    def unit(self) -> Fault | None:
        factor = self.robot_fit.unit
        if factor == 1.0:
            return None
        without = self.data.refit(self.robot_fit._replace(unit=1.0))
        return Fault(
            FaultKind.UNIT,
            tuple(self.names),
            (factor,),
            self.changes(without),
            is_every_joint=True,
        )

    def sensor_fault(
        self, kind: FaultKind, flag: str, value: Callable[[JointFit], float]
    ) -> Fault | None:
        """Return one fault, with a value for each joint that has this kind of sensor fault."""
        found = [j for j, fit in enumerate(self.fits) if getattr(fit.sensor_fault, flag)]
        if not found:
            return None
        joints = tuple(self.names[j] for j in found)
        friction_only = [
            name for fit, name in zip(self.fits, self.names, strict=True) if fit.is_friction_only
        ]
        return Fault(
            kind,
            joints,
            tuple(value(self.fits[j]) for j in found),
            self.changes(self.data.refit(self.robot_fit, without=flag)),
            unknown=tuple(friction_only) if kind is FaultKind.SCALE else (),
            is_every_joint=len(joints) > 1 and set(self.names) <= {*joints, *friction_only},
            is_motor_side=self.is_motor_side,
        )

    def unexplained(self) -> Fault | None:
        """Return a fault for the joints with unexplained efforts."""
        if self.data.is_too_short:
            return None
        left = [
            (j, fit)
            for j, fit in enumerate(self.fits)
            if fit.remaining > max(CREDIBLE, self.data.floor(self.robot_fit, j))
        ]
        # The effort of a joint at rest also contains unknown dry friction.
        found = [(j, fit) for j, fit in left if fit.moves]
        if not found and self.data.unexplained(self.robot_fit) > MOST_UNEXPLAINED:
            found = left
        if not found:
            return None
        changes = []
        for j, fit in found:
            samples = self.data.joints[j]
            source = self.data.first_measured + self.robot_fit.source[j]
            measured = math.sqrt(samples.squares[source])
            changes.append(Change(self.names[j], samples.is_prismatic, fit.rms, fit.rms, measured))
        return Fault(
            FaultKind.UNEXPLAINED, tuple(each.joint for each in changes), (), tuple(changes)
        )
