"""Columns of the regression for several recordings of a robot."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...robot.model import Floats, Integers
from ..columns import direction_of
from ..recordings.resampling import resampler
from ..recordings.signals import Motion
from .problem import IdentificationProblem

ARMATURE, DAMPING, COULOMB, LOAD, SQRT, SPRING, OFFSET = range(7)
EXPORTED = 7
"""Number of terms of a joint that the node knows."""
WIDTH = 7
"""Effect of a small change of the width of Coulomb friction."""
RATIO = 8
"""Effect of a small change of the coupling of the drive."""
GAIN = 9
"""Effect of a small change of the gain of currents."""
TERMS = 10
"""Columns of each joint besides those of the bodies."""
OF_DRIVE = [ARMATURE, DAMPING, COULOMB, LOAD, SQRT, WIDTH, RATIO]
"""Those that follow the drive, which may also turn with the joint before."""
SIGNED = ~np.isin(np.arange(TERMS), [ARMATURE, DAMPING, COULOMB, LOAD, SQRT])
"""Which of them may have negative factors."""
FIXED_RATIO = 0.995
"""Two joints moved in a fixed ratio if their velocities have at least this correlation."""


@dataclass(frozen=True, eq=False)
class Model:
    """Identified parameters of a robot with b identified bodies and m joints with efforts."""

    bodies: Floats
    """Shape (b, 10)."""
    joints: Floats
    """Shape (m, 10): the columns of `Regression.terms`, from armature to gain."""
    widths: Floats
    """Speeds over which Coulomb friction is smoothed, shape (m,) [rad/s or m/s]."""
    couplings: Floats
    """Turn of each drive per turn of the joint before, shape (m,)."""

    def with_fitted_shapes(self) -> Model:
        """Return the model with the changes of widths and couplings applied, within reason."""
        joints = self.joints.copy()
        change = np.clip(joints[:, WIDTH], -0.3 * self.widths, 0.4 * self.widths)
        most = 0.5 * np.abs(self.couplings)
        couplings = self.couplings + np.clip(joints[:, RATIO], -most, most)
        joints[:, [WIDTH, RATIO]] = 0.0
        return Model(self.bodies, joints, self.widths + change, couplings)

    def scaled(self, factor: float) -> Model:
        """Return the model with all efforts multiplied by a factor, and gains that fit."""
        joints = factor * self.joints
        joints[:, LOAD] /= factor
        joints[:, GAIN] = 0.0
        return replace(self, bodies=factor * self.bodies, joints=joints)

    def exported(self, least_widths: Floats) -> Model:
        """Return the model as the node applies it: what it cannot express is missing."""
        joints = self.joints.copy()
        joints[:, EXPORTED:] = 0.0
        return replace(self, joints=joints, widths=np.maximum(self.widths, least_widths))

    def springs(self, q: Floats) -> Floats:
        """Return the efforts of the springs at positions of shape (K, m), with their offsets."""
        stiffness, offset = self.joints[:, SPRING], self.joints[:, OFFSET]
        return np.asarray(stiffness * q + np.where(stiffness != 0.0, offset, 0.0))


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
    qdd, qd, q : ndarray, shape (R, m)
        Columns of armature, damping and springs.
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
        self.q = self._smooth([motion.q[:, joints] for motion in motions])
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
        Return the columns of the joints themselves, shape (R, m, 10).

        They depend on the model by the widths of Coulomb friction and the couplings of the drives,
        by the efforts that load the gears, and by the friction that changes with the width.

        """
        robot, joints = self.problem.identified.robot_with(model.bodies), self.problem.joints
        before = self.problem.before
        coulomb, per_load, per_root = (model.joints[:, k] for k in (COULOMB, LOAD, SQRT))
        parts = []
        for motion in self.motions:
            qd = motion.qd[:, joints]
            rate = qd + model.couplings * qd[:, before]
            load = self.problem.efforts(robot, motion) + model.springs(motion.q[:, joints])
            speed, load, root = rate / model.widths, np.abs(load), np.sqrt(np.abs(rate))
            step = np.tanh(speed)
            slope = (coulomb + per_load * load + per_root * root) * (1.0 - step**2) / model.widths
            parts.append((step, load * step, root * step, -slope * speed, slope * qd[:, before]))
        direction, loaded, rooted, widening, coupling = (
            self._smooth_discontinuous(signals) for signals in zip(*parts, strict=True)
        )
        armature, damping = model.joints[:, ARMATURE], model.joints[:, DAMPING]
        coupling += armature * self.qdd[:, before] + damping * self.qd[:, before]
        gain = -self.rigid(model.bodies) if self.problem.currents else np.zeros_like(self.qd)
        columns = (
            self.qdd + model.couplings * self.qdd[:, before],
            self.qd + model.couplings * self.qd[:, before],
            direction,
            loaded,
            rooted,
            self.q,
            np.ones_like(self.qd),
            widening,
            coupling,
            gain,
        )
        return np.stack(columns, axis=-1)

    def actions(self, model: Model) -> list[tuple[int, int, Floats]]:
        """
        Return on which joint the terms of which joint act, and their columns, shape (R, 10).

        The terms of a joint act on itself. Those of a coupled drive act on the joint before, too.

        """
        terms = self.terms(model)
        found = [(j, j, terms[:, j]) for j in range(len(model.joints))]
        for j in np.flatnonzero(model.couplings).tolist():
            shared = np.zeros(terms[:, j].shape)
            shared[:, OF_DRIVE] = model.couplings[j] * terms[:, j, OF_DRIVE]
            shared[:, RATIO] += terms[:, j, OF_DRIVE] @ model.joints[j, OF_DRIVE]
            found.append((int(self.problem.before[j]), j, shared))
        return found

    def shared(self, model: Model) -> Floats:
        """Return the efforts of coupled drives on the joints before them, shape (R, m)."""
        efforts = np.zeros_like(self.qd)
        for joint, owner, columns in self.actions(model):
            if joint != owner:
                efforts[:, joint] += columns @ model.joints[owner]
        return efforts

    @cached_property
    def together(self) -> tuple[tuple[int, ...], ...]:
        """Groups of joints that always moved in a fixed ratio, by their positions in the list."""
        spread = self.qd.std(axis=0)
        moved = np.flatnonzero(spread > 1e-6 * spread.max())
        if len(moved) < 2:
            return ()
        related = np.abs(np.corrcoef(self.qd[:, moved].T)) > FIXED_RATIO
        groups = {tuple(moved[row].tolist()) for row in related if row.sum() > 1}
        return tuple(sorted(groups))

    def predict(self, model: Model) -> Floats:
        """Return modelled efforts, shape (R, m)."""
        efforts = self.rigid(model.bodies)
        for joint, owner, columns in self.actions(model):
            efforts[:, joint] += columns @ model.joints[owner]
        return efforts

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
