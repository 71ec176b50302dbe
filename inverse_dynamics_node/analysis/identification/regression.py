"""Columns of the regression for several recordings of a robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Floats, Integers, RobotModel
from ..columns import body_columns
from ..recordings.resampling import resampler
from ..recordings.signals import Motion
from .identified_bodies import IdentifiedBodies

ARMATURE, DAMPING, COULOMB, LOAD, OFFSET = range(5)
EXPORTED = 5
"""Number of terms of a joint that a URDF and the node know."""
COUPLINGS = (slice(5, 8), slice(8, 11))
"""Acceleration, velocity and direction of the neighbours nearer to the base and to the tip."""
WIDTH = 11
"""Effect of a small change of the width of Coulomb friction."""
GAIN = 12
"""Effect of a small change of the gain of currents."""
RANDOM_STATES = 60
TERMS = 13
"""Columns of each joint besides those of the bodies."""


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
        """Return the model with all efforts multiplied by a factor."""
        joints = factor * self.joints
        joints[:, LOAD] /= factor
        return Model(factor * self.bodies, joints, self.widths)

    def exported(self) -> Model:
        """Return the model without what neither a URDF nor the node can express."""
        joints = self.joints.copy()
        joints[:, EXPORTED:] = 0.0
        return Model(self.bodies, joints, self.widths)


class IdentificationProblem:
    """
    A robot in its surroundings, and the choice of what is identified.

    Parameters
    ----------
    identified : IdentifiedBodies
        Bodies to identify.
    joints : sequence of int
        Joints with measured efforts, m of them.
    gravity : ndarray, shape (3,)
        Free-fall acceleration in the base frame [m/s^2].
    payload : tuple of link, mass and centre of mass, optional
        Known payload.
    currents : bool
        Whether efforts were recorded as currents.

    """

    def __init__(
        self,
        identified: IdentifiedBodies,
        joints: Sequence[int],
        gravity: Floats,
        payload: tuple[str, float, Sequence[float]] | None = None,
        currents: bool = False,
    ) -> None:
        self.identified, self.joints = identified, list(joints)
        self.gravity, self.payload, self.currents = gravity, payload, currents
        self.neighbours = neighbours(identified.robot, self.joints)

    def dynamics(self, robot: RobotModel) -> InverseDynamics:
        """Return the dynamics of a robot with the payload, without friction."""
        dynamics = InverseDynamics(robot, self.gravity)
        if self.payload is not None:
            dynamics.set_payload(*self.payload)
        dynamics.set_friction(0.0, 0.0)
        return dynamics

    def efforts(self, robot: RobotModel, motion: Motion) -> Floats:
        """Return efforts without friction and armature, shape (K, m)."""
        efforts = self.dynamics(robot).efforts(motion.q, motion.qd, motion.qdd)
        return efforts[:, self.joints]

    def columns(self, motion: Motion) -> Floats:
        """Return the columns of the identified bodies, shape (K, m, 10 b)."""
        states = motion.q, motion.qd, motion.qdd
        dynamics = self.dynamics(self.identified.robot)
        return body_columns(dynamics, states, self.identified.bodies)[:, self.joints]

    def at_random_states(self) -> Floats:
        """Return the columns of the identified bodies at random states, shape (K m, 10 b)."""
        robot = self.identified.robot
        rng, n = np.random.default_rng(0), len(robot.joint_names)
        states = rng.uniform(-1.0, 1.0, (3, RANDOM_STATES, n))
        states *= np.array([np.pi, 3.0, 10.0])[:, None, None]
        states[0][:, robot.is_prismatic_joint] *= 0.2
        q, qd, qdd = states
        columns = body_columns(self.dynamics(robot), (q, qd, qdd), self.identified.bodies)
        table = columns[:, self.joints].reshape(-1, columns.shape[2])
        return np.asarray(table / np.sqrt(np.mean(table**2)))


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
        self.set_efforts([motion.efforts for motion in motions])
        self.block = self._blocks(block_count)

    def set_efforts(self, efforts: Sequence[Floats]) -> None:
        """Set the measured efforts of every motion, each of shape (K, m)."""
        self.efforts = self._smooth(efforts)

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
            [np.tanh(m.qd[:, joints] / widths) for m in self.motions]
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


def neighbours(robot: RobotModel, joints: Sequence[int]) -> Integers:
    """
    Return the joints next to each joint in a chain.

    Returns
    -------
    neighbours : ndarray, shape (2, m)
        Positions in the list of the joint nearer to the base and of the one nearer to the tip;
        -1 if there is none, or more than one.

    """
    body_of = {int(robot.joint_index[b]): b for b in range(len(robot.parent) - 1, 0, -1)}
    found = np.full((2, len(joints)), -1)
    children = np.zeros(len(joints), dtype=int)
    for k, joint in enumerate(joints):
        parent = int(robot.joint_index[robot.parent[body_of[joint]]])
        if parent in joints:
            before = list(joints).index(parent)
            found[0, k], found[1, before] = before, k
            children[before] += 1
    found[1, children != 1] = -1
    return found


def moved_by(robot: RobotModel, joint: int, bodies: Sequence[int]) -> list[int]:
    """Return which of the bodies a joint moves."""
    moved = np.zeros(len(robot.parent), dtype=bool)
    for body in range(1, len(moved)):
        moved[body] = moved[robot.parent[body]] or robot.joint_index[body] == joint
    return [k for k, body in enumerate(bodies) if moved[body]]
