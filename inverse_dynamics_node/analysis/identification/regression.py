"""Columns of the regression for several recordings of a robot."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...robot.model import Floats, Integers
from ..columns import direction_of
from ..recordings.resampling import resampler
from ..recordings.signals import Motion
from .problem import IdentificationProblem

ARMATURE, DAMPING, COULOMB, LOAD, OFFSET = range(5)
EXPORTED = 5
"""Number of terms of a joint that a URDF and the node know."""
COUPLINGS = (slice(5, 8), slice(8, 11))
"""Acceleration, velocity and direction of the neighbours nearer to the base and to the tip."""
WIDTH = 11
"""Effect of a small change of the width of Coulomb friction."""
GAIN = 12
"""Effect of a small change of the gain of currents."""
TERMS = 13
"""Columns of each joint besides those of the bodies."""
SIGNED = ~np.isin(np.arange(TERMS), [ARMATURE, DAMPING, COULOMB, LOAD])
"""Which of them may have negative factors."""


@dataclass(frozen=True, eq=False)
class Model:
    """Identified parameters of a robot with b identified bodies and m joints with efforts."""

    bodies: Floats
    """Shape (b, 10)."""
    joints: Floats
    """Shape (m, 13): the columns of `Regression.terms`, from armature to gain."""
    widths: Floats
    """Speeds over which Coulomb friction is smoothed, shape (m,) [rad/s or m/s]."""

    def with_fitted_widths(self) -> Model:
        """Return the model with the change of the widths applied to them, within reason."""
        joints = self.joints.copy()
        change = np.clip(joints[:, WIDTH], -0.3 * self.widths, 0.4 * self.widths)
        joints[:, WIDTH] = 0.0
        return Model(self.bodies, joints, self.widths + change)

    def scaled(self, factor: float) -> Model:
        """Return the model with all efforts multiplied by a factor, and gains that fit."""
        joints = factor * self.joints
        joints[:, LOAD] /= factor
        joints[:, GAIN] = 0.0
        return Model(factor * self.bodies, joints, self.widths)

    def exported(self) -> Model:
        """Return the model without what neither a URDF nor the node can express."""
        joints = self.joints.copy()
        joints[:, EXPORTED:] = 0.0
        return Model(self.bodies, joints, self.widths)


class Regression:
    """
    Smoothed rows of several motions.

    Parameters
    ----------
    problem : IdentificationProblem
        The robot, with m joints that have efforts.
    motions : sequence of Motion
        The recordings.
    seconds : float
        Length of the smoothing window [s].
    block_count : int
        Approximate number of contiguous blocks.

    Attributes
    ----------
    efforts : ndarray, shape (R, m)
        Measured efforts.
    qdd, qd : ndarray, shape (R, m)
        Columns of armature and damping.
    block : ndarray, shape (R,)
        Number of the contiguous block that a row belongs to; -1 for rows at their borders.

    """

    def __init__(
        self,
        problem: IdentificationProblem,
        motions: Sequence[Motion],
        seconds: float,
        block_count: int,
    ) -> None:
        self.problem, self.motions, self.seconds = problem, list(motions), seconds
        self.resamplers = [resampler(motion, seconds) for motion in motions]
        joints = problem.joints
        self.qdd = self._smooth([motion.qdd[:, joints] for motion in motions])
        self.qd = self._smooth([motion.qd[:, joints] for motion in motions])
        self.efforts = self._smooth([motion.efforts for motion in motions])
        self.block = self._blocks(block_count)

    def with_efforts(self, efforts: Sequence[Floats]) -> Regression:
        """Return the regression with other measured efforts of every motion, (K, m) each."""
        other = copy(self)
        other.efforts = self._smooth(efforts)
        return other

    @cached_property
    def bodies(self) -> Floats:
        """Columns of the identified bodies, shape (R, m, 10 b)."""
        return self._smooth([self.problem.columns(motion) for motion in self.motions])

    @cached_property
    def known(self) -> Floats:
        """Efforts of what is not identified, shape (R, m)."""
        fixed = self.problem.identified.fixed_robot()
        return self._smooth([self.problem.efforts(fixed, motion) for motion in self.motions])

    def rigid(self, bodies: Floats) -> Floats:
        """Return the efforts of a robot with these bodies, shape (R, m)."""
        if 'bodies' in self.__dict__:
            return np.asarray(self.known + self.bodies @ bodies.ravel())
        robot = self.problem.identified.robot_with(bodies)
        return self._smooth([self.problem.efforts(robot, motion) for motion in self.motions])

    def direction(self, widths: Floats) -> Floats:
        """Return the directions of Coulomb friction, shape (R, m)."""
        joints = self.problem.joints
        return self._smooth_discontinuous(
            [direction_of(m.qd[:, joints], widths) for m in self.motions]
        )

    def terms(self, model: Model) -> Floats:
        """
        Return the columns of the joints themselves, shape (R, m, 13).

        They depend on the model by the widths of Coulomb friction, by the efforts that load the
        gears, and by the friction that changes with the width.

        """
        robot = self.problem.identified.robot_with(model.bodies)
        speeds = [motion.qd[:, self.problem.joints] / model.widths for motion in self.motions]
        loads = [np.abs(self.problem.efforts(robot, motion)) for motion in self.motions]
        steps = [np.tanh(speed) for speed in speeds]
        direction = self._smooth_discontinuous(steps)
        loaded = self._smooth_discontinuous([a * b for a, b in zip(steps, loads, strict=True)])
        coulomb, per_load = model.joints[:, COULOMB], model.joints[:, LOAD]
        widening = self._smooth_discontinuous(
            [
                (coulomb + per_load * load) * speed * (step**2 - 1.0) / model.widths
                for load, speed, step in zip(loads, speeds, steps, strict=True)
            ]
        )
        own = [self.qdd, self.qd, direction, loaded, np.ones_like(self.qd)]
        coupled = [
            np.where(others >= 0, signal[:, others], 0.0)
            for others in self.problem.neighbours
            for signal in (self.qdd, self.qd, direction)
        ]
        gain = -self.rigid(model.bodies) if self.problem.currents else np.zeros_like(self.qd)
        return np.stack([*own, *coupled, widening, gain], axis=-1)

    def predict(self, model: Model) -> Floats:
        """Return modelled efforts, shape (R, m)."""
        terms = self.terms(model)
        return np.asarray(self.rigid(model.bodies) + (terms * model.joints).sum(axis=-1))

    def residual(self, model: Model) -> Floats:
        """Return measured minus modelled efforts, shape (R, m)."""
        return self.efforts - self.predict(model)

    def _smooth(self, signals: Sequence[Floats]) -> Floats:
        return np.concatenate(
            [smooth(values) for smooth, values in zip(self.resamplers, signals, strict=True)]
        )

    def _smooth_discontinuous(self, signals: Sequence[Floats]) -> Floats:
        return np.concatenate(
            [
                smooth.discontinuous(values)
                for smooth, values in zip(self.resamplers, signals, strict=True)
            ]
        )

    def _blocks(self, count: int) -> Integers:
        """Return the block of every row; blocks have equal durations and share no rows."""
        durations = [max(float(np.ptp(motion.times)), 1e-9) for motion in self.motions]
        numbers: list[Integers] = []
        first = 0
        for motion, smooth, duration in zip(self.motions, self.resamplers, durations, strict=True):
            own = max(1, round(count * duration / sum(durations)))
            position = (smooth.times - motion.times[0]) / duration * own
            nearest = np.round(position)
            is_near = np.abs(position - nearest) * duration / own < 0.5 * smooth.seconds
            is_border = is_near & (nearest > 0) & (nearest < own)
            block = np.minimum(position.astype(int), own - 1)
            numbers.append(np.where(is_border, -1, first + block))
            first += own
        return np.concatenate(numbers)
