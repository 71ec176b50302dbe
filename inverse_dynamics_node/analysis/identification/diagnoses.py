"""Explanations of measured efforts as separate diagnoses, each with its own contribution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .bodies import Bodies
from .evidence import Evidence
from .explanation import Explanation
from .joint_samples import CREDIBLE, Fit, UNDISTORTED
from .loads import MAX_COM_ERROR
from .part import Cause, Part

SAME_FACTOR = 1.1  # factors with a smaller ratio are regarded as equal
CHANGED = 0.9  # of the RMS residual; a joint whose residual falls by less is not affected
MOST_UNEXPLAINED = 0.5  # fraction of the squares; if more remains, the model explains nothing


class Change(NamedTuple):
    """RMS residual of one joint, with fitted friction, without and with a diagnosis."""

    joint: str
    is_prismatic: bool
    before: float
    """[N m or N], as recorded."""
    after: float
    """[N m or N], as recorded."""
    measured: float
    """RMS of the measured effort [N m or N], as recorded."""


class Diagnosis(NamedTuple):
    """One explanation of a difference between measured and modelled efforts."""

    kind: str
    """``sign``, ``scale``, ``unit``, ``gravity_compensated``, ``mounting``, ``payload``,
    ``bodies``, ``external_force``, ``order``, ``rotor_inertia``, ``offset``, ``constant`` or
    ``unexplained``."""
    joints: tuple[str, ...] = ()
    """Joints whose efforts it explains; empty if it concerns the whole robot."""
    values: tuple[float, ...] = ()
    """
    Factor, inertia [kg m^2, kg] or offset [N m, N] of each joint; mass [kg] and centre of mass [m]
    of a payload, NaN where unknown; gravity in the frame of the base link [m/s^2] of a mounting.
    """
    changes: tuple[Change, ...] = ()
    """Joints whose residual it reduces, the largest reduction first."""
    error: float = 0.0
    """Standard error of the mass of a payload [kg]."""
    angle: float = 0.0
    """Angle of a mounting to that in the model [rad]."""
    link: str = ''
    """Link that carries the payload."""
    sources: tuple[str, ...] = ()
    """Names under which the efforts of ``joints`` were recorded, if in another order."""
    unknown: tuple[str, ...] = ()
    """Joints whose unit is unknown because friction dominates."""
    is_every_joint: bool = False
    """Whether it applies to all joints that show more than friction."""
    is_motor_side: bool = False
    """Whether the efforts contain the friction of the gears, as those of motor currents do."""
    interval: tuple[float, float] | None = None
    """Begin and end [s] if it applies to a part of the recording."""

    @property
    def is_same_factor(self) -> bool:
        """Whether all factors are equal, as those of a unit are."""
        return max(self.values) < SAME_FACTOR * min(self.values)


def diagnose(
    evidence: Evidence, explanation: Explanation, names: Sequence[str]
) -> list[Diagnosis]:
    """
    Divide an explanation into diagnoses.

    Parameters
    ----------
    evidence : Evidence
        Samples of n joints.
    explanation : Explanation
        Explanation of the efforts of these joints.
    names : sequence of str
        Names of the joints.

    Returns
    -------
    diagnoses : list of Diagnosis
        Most important first; empty if the model explains the efforts without changes.

    """
    found = _Diagnoses(evidence, explanation, names)
    return [
        *found.order(),
        *found.weightless(),
        *found.mounting(),
        *found.unit(),
        *found.distortion('sign', 'is_swapped'),
        *found.distortion('scale', 'is_scaled'),
        *found.payload(),
        *found.distortion('rotor_inertia', 'has_rotor'),
        *found.distortion('offset', 'has_offset'),
        *found.unexplained(),
    ]


def diagnose_part(part: Part, names: Sequence[str]) -> list[Diagnosis]:
    """Return the diagnosis of a cause that acts during a part of the recording."""
    if part.cause is Cause.TILT and part.gravity is not None:
        angles = [angle_between(each, part.evidence.gravity) for each in part.gravity]
        steepest = int(np.argmax(angles))
        values = tuple(part.gravity[steepest].tolist())
        return [
            Diagnosis('mounting', values=values, angle=angles[steepest], interval=part.interval)
        ]
    if part.cause is Cause.LOAD:
        (payload,) = _Diagnoses(part.evidence, part.outside, names).payload()
        return [payload._replace(interval=part.interval)]
    joints = tuple(names[j] for j in part.joints)
    return [Diagnosis('external_force', joints, interval=part.interval)]


def diagnose_bodies(bodies: Bodies, evidence: Evidence, names: Sequence[str]) -> Diagnosis:
    """Return the diagnosis for several wrong links."""
    changes = []
    for j, (before, after) in enumerate(zip(bodies.before, bodies.after, strict=True)):
        if after < CHANGED * before:
            samples = evidence.joints[j]
            measured = math.sqrt(samples.squares[evidence.first_measured + j])
            change = Change(names[j], samples.is_prismatic, float(before), float(after), measured)
            changes.append(change)
    return Diagnosis(
        'bodies', changes=tuple(sorted(changes, key=lambda each: each.after - each.before))
    )


def diagnose_constant(values: Mapping[str, float]) -> list[Diagnosis]:
    """Return the diagnosis for joints whose measured effort is constant, given their efforts."""
    if not values:
        return []
    return [Diagnosis('constant', tuple(values), tuple(values.values()))]


class _Diagnoses:
    """The diagnoses that one explanation consists of."""

    def __init__(self, evidence: Evidence, explanation: Explanation, names: Sequence[str]) -> None:
        self.evidence, self.explanation, self.names = evidence, explanation, names
        self.fits = explanation.fits
        moving = [fit for fit in self.fits if fit.moves]
        self.is_motor_side = 2 * sum(fit.has_friction for fit in moving) > len(moving)
        self.relevant = [
            name for fit, name in zip(self.fits, names, strict=True) if not fit.is_friction_only
        ]

    def changes(self, without: Explanation) -> tuple[Change, ...]:
        """Return the joints that are explained worse without a part of the explanation."""
        found = []
        for j, (before, after) in enumerate(zip(without.fits, self.fits, strict=True)):
            samples = self.evidence.joints[j]
            source = self.explanation.source[j]
            measured = math.sqrt(samples.squares[self.evidence.first_measured + source])
            if after.rms < CHANGED * before.rms:
                change = Change(
                    self.names[j], samples.is_prismatic, before.rms, after.rms, measured
                )
                found.append(change)
        return tuple(sorted(found, key=lambda each: each.after - each.before))

    def order(self) -> list[Diagnosis]:
        source = self.explanation.source
        moved = [j for j, i in enumerate(source) if i != j]
        if not moved:
            return []
        samples, first = self.evidence.joints, self.evidence.first_measured
        weights = self.explanation.hypothesis.weights
        fits = list(self.fits)
        for j in moved:
            fits[j] = samples[j].fit(weights, first + j, UNDISTORTED)
        without = self.explanation._replace(fits=tuple(fits))
        return [
            Diagnosis(
                'order',
                tuple(self.names[j] for j in moved),
                changes=self.changes(without),
                sources=tuple(self.names[source[j]] for j in moved),
            )
        ]

    def _without_hypothesis(self) -> Explanation:
        hypothesis = self.explanation.hypothesis
        base = self.evidence.as_is
        if hypothesis.kind == 'payload' and hypothesis.is_weightless:
            base = self.evidence.weightless()
        return self.evidence.refit(self.explanation, hypothesis=base)

    def weightless(self) -> list[Diagnosis]:
        if not self.explanation.hypothesis.is_weightless:
            return []
        with_gravity = self.explanation.hypothesis
        weights = with_gravity.weights - self.evidence.weightless().weights
        base = with_gravity._replace(weights=weights + self.evidence.as_is.weights)
        without = self.evidence.refit(self.explanation, hypothesis=base)
        return [Diagnosis('gravity_compensated', changes=self.changes(without))]

    def mounting(self) -> list[Diagnosis]:
        hypothesis = self.explanation.hypothesis
        if hypothesis.kind != 'mounting':
            return []
        return [
            Diagnosis(
                'mounting',
                values=hypothesis.solution,
                changes=self.changes(self._without_hypothesis()),
                angle=angle_between(hypothesis.solution, self.evidence.gravity),
            )
        ]

    def payload(self) -> list[Diagnosis]:
        hypothesis = self.explanation.hypothesis
        if hypothesis.kind != 'payload':
            return []
        mass, *com = hypothesis.solution
        known = [
            x if error < MAX_COM_ERROR else math.nan
            for x, error in zip(com, hypothesis.errors[1:], strict=True)
        ]
        return [
            Diagnosis(
                'payload',
                values=(mass, *known),
                changes=self.changes(self._without_hypothesis()),
                error=hypothesis.errors[0],
                link=hypothesis.link,
            )
        ]

    def unit(self) -> list[Diagnosis]:
        factor = self.explanation.unit
        if factor == 1.0:
            return []
        without = self.evidence.refit(self.explanation._replace(unit=1.0))
        return [
            Diagnosis(
                'unit',
                tuple(self.names),
                (factor,),
                self.changes(without),
                is_every_joint=True,
            )
        ]

    def distortion(self, kind: str, flag: str) -> list[Diagnosis]:
        """Return the diagnosis for the joints with one kind of distortion."""
        found = [j for j, fit in enumerate(self.fits) if getattr(fit.distortion, flag)]
        if not found:
            return []
        joints = tuple(self.names[j] for j in found)
        friction_only = [
            name for fit, name in zip(self.fits, self.names, strict=True) if fit.is_friction_only
        ]
        return [
            Diagnosis(
                kind,
                joints,
                tuple(_value(self.fits[j], kind) for j in found),
                self.changes(self.evidence.refit(self.explanation, without=flag)),
                unknown=tuple(friction_only) if kind == 'scale' else (),
                is_every_joint=len(joints) > 1 and set(self.relevant) <= set(joints),
                is_motor_side=self.is_motor_side,
            )
        ]

    def unexplained(self) -> list[Diagnosis]:
        """Return the joints that nothing explains; the worst ones if the sum is not explained."""
        if self.evidence.is_too_short:
            return []
        left = [
            (j, fit)
            for j, fit in enumerate(self.fits)
            if fit.remaining > max(CREDIBLE, self.evidence.joints[j].floor(self._measured(j)))
        ]
        # The effort of a joint at rest also contains an unknown dry friction.
        found = [(j, fit) for j, fit in left if fit.moves]
        if not found and self.evidence.unexplained(self.explanation) > MOST_UNEXPLAINED:
            found = left
        if not found:
            return []
        changes = []
        for j, fit in found:
            samples = self.evidence.joints[j]
            measured = math.sqrt(samples.squares[self._measured(j)])
            changes.append(Change(self.names[j], samples.is_prismatic, fit.rms, fit.rms, measured))
        return [
            Diagnosis('unexplained', tuple(each.joint for each in changes), (), tuple(changes))
        ]

    def _measured(self, j: int) -> int:
        return self.evidence.first_measured + self.explanation.source[j]


def _value(fit: Fit, kind: str) -> float:
    """Return the number that describes a kind of distortion."""
    if kind == 'sign':
        return -1.0
    return {'scale': fit.scale, 'rotor_inertia': fit.rotor, 'offset': fit.offset}[kind]


def angle_between(a: ArrayLike, b: ArrayLike) -> float:
    """Return the angle between two vectors [rad]."""
    cosine = float(np.dot(a, b)) / float(np.linalg.norm(a) * np.linalg.norm(b))
    return math.acos(min(1.0, max(-1.0, cosine)))
