"""
Defines the bodies and joints to identify, and their regression.

Joint terms are the effects of a drive, such as friction and armature. The friction width is the
speed over which Coulomb friction is smoothed. The coupling of a drive is the rotation of the drive
per rotation of the preceding joint.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...dynamics.robot_table import joints_before
from ...errors import ConfigurationError
from ...robot.kinematics import path_to
from ...robot.model import Floats, Integers, RobotModel
from ...robot.rigid_body import (
    moved_inside,
    PARAMETERS,
    parameters_of_pseudo_inertias,
    pseudo_inertias,
    rigid_body,
    RigidBody,
    transport,
)
from ..columns import body_columns
from ..recordings.resampling import Resampler, resampler
from ..recordings.signals import Motion

ARMATURE, DAMPING, COULOMB, LOAD, SPRING, OFFSET = range(6)
NAMES = 'armature', 'damping', 'coulomb', 'load_friction', 'stiffness', 'offset'
TERMS = len(NAMES)
"""Number of terms of each joint."""
OF_DRIVE = [ARMATURE, DAMPING, COULOMB, LOAD]
"""Terms of a coupled drive that also act on the preceding joint."""
SIGNED = np.array([False, False, False, False, True, True])
"""Whether each term may have a negative factor."""
ROWS_AT_ONCE = 500
"""Number of rows for which regressors are computed at once; this limits the memory."""


class IdentifiedBodies:
    """
    The bodies to identify, which are all bodies with mass.

    Links that are connected by fixed joints form one body. Recordings cannot distinguish these
    links, so the links of a body are identified together. `bodies` contains indices in the robot
    model, and `links` the links with mass of each body. `before` contains the parameters in the
    robot description, relative to the body frames, shape (bodies, 10). In `reference`, flat and
    impossible links are enlarged.

    Raises ConfigurationError if no moving link has mass.

    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        on_body = [
            np.flatnonzero((robot.link_body == body) & (robot.link_mass > 0.0)).tolist()
            for body in range(len(robot.parent))
        ]
        self.bodies = [body for body in range(1, len(robot.parent)) if on_body[body]]
        if not self.bodies:
            raise ConfigurationError(
                f"robot '{robot.name}' has no moving link with mass to identify"
            )
        self.links: list[list[int]] = [on_body[body] for body in self.bodies]
        bodies = zip(robot.mass, robot.com, robot.inertia, strict=True)
        parameters = np.array([RigidBody(*body).parameters() for body in bodies])
        self.before: Floats = parameters[self.bodies]
        self.reference: Floats = np.array([sum(map(self._link, each)) for each in self.links])

    def _link(self, link: int) -> Floats:
        """Return the parameters of a link, enlarged if flat, in the frame of its body."""
        robot = self.robot
        own = RigidBody(robot.link_mass[link], robot.link_com[link], robot.link_inertia[link])
        placed = own.rotate(robot.link_rotation[link]).shift(robot.link_position[link])
        return moved_inside(placed.parameters())

    def robot_with(self, parameters: Floats) -> RobotModel:
        """Return the robot with new parameters of the bodies, shape (bodies, 10)."""
        robot = self.robot
        mass, com, inertia = robot.mass.copy(), robot.com.copy(), robot.inertia.copy()
        for b, own in zip(self.bodies, parameters, strict=True):
            mass[b], com[b], inertia[b] = rigid_body(own)
        return replace(robot, mass=mass, com=com, inertia=inertia)

    def link_inertials(self, parameters: Floats) -> dict[str, RigidBody]:
        """
        Return the inertial of each identified link in the link frame.

        `parameters` describes physically possible bodies, shape (bodies, 10). The pseudo-inertia P
        of each link becomes ``T P T^T``, with the same matrix T for all links of a body.
        Therefore, each link stays physically possible.

        """
        inertials = {}
        for links, *body in zip(self.links, self.reference, parameters, strict=True):
            change = transport(*map(pseudo_inertias, body))
            for link in links:
                matrix = change @ pseudo_inertias(self._link(link)) @ change.T
                mass, com, inertia = rigid_body(parameters_of_pseudo_inertias(matrix))
                R, p = self.robot.link_rotation[link], self.robot.link_position[link]
                in_link = RigidBody(mass, R.T @ (com - p), R.T @ inertia @ R)
                inertials[self.robot.link_names[link]] = in_link
        return inertials


@dataclass(frozen=True, eq=False)
class IdentificationProblem:
    """A robot with gravity and payload, and the bodies and joints to identify."""

    identified: IdentifiedBodies
    joints: list[int]
    """Joints with measured efforts."""
    gravity: Floats
    """Free-fall acceleration in the base frame [m/s^2]."""
    payload: tuple[str, float, Sequence[float]] | None = None
    """Link, mass [kg] and centre of mass [m] of a known payload."""
    currents: bool = False
    """Whether motor currents were recorded instead of efforts."""

    @cached_property
    def before(self) -> Integers:
        """For each joint, the index of the preceding joint in `joints`, or -1 if not there."""
        before = joints_before(self.identified.robot)[self.joints].tolist()
        return np.array([self.joints.index(k) if k in self.joints else -1 for k in before])

    def dynamics(self, robot: RobotModel) -> InverseDynamics:
        """Return the dynamics of a robot with the payload and without friction."""
        dynamics = InverseDynamics(robot, self.gravity)
        if self.payload is not None:
            dynamics.set_payload(*self.payload)
        dynamics.set_friction(0.0, 0.0)
        return dynamics

    def efforts(self, robot: RobotModel, motion: Motion) -> Floats:
        """Return efforts without friction and armature, shape (samples, joints)."""
        efforts = self.dynamics(robot).efforts(motion.q, motion.qd, motion.qdd)
        return efforts[:, self.joints]

    def columns(self, motion: Motion) -> Floats:
        """Return regressor columns of identified bodies, shape (samples, joints, 10 per body)."""
        states = motion.q, motion.qd, motion.qdd
        dynamics = self.dynamics(self.identified.robot)
        return body_columns(dynamics, states, self.identified.bodies)[:, self.joints]


def moved_by(robot: RobotModel, joint: int, bodies: Sequence[int]) -> list[int]:
    """Return indices into `bodies`, for the bodies that a joint moves."""
    joints = [robot.joint_index[path_to(robot, body)] for body in bodies]
    return [k for k, on_path in enumerate(joints) if joint in on_path]


# ---- The regression ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Model:
    """Identified parameters of bodies and joints."""

    bodies: Floats
    """Inertial parameters of the identified bodies, shape (bodies, 10)."""
    joints: Floats
    """Factors of the columns of `Regression.terms`, shape (joints, 6)."""
    widths: Floats
    """Friction widths, shape (joints,) [rad/s or m/s]."""
    couplings: Floats
    """Couplings of the drives, shape (joints,)."""

    def exported(self, least_widths: Floats) -> Model:
        """Return the model with the friction widths that are written."""
        return replace(self, widths=np.maximum(self.widths, least_widths))

    def with_coupling(self, j: int, ratio: float) -> Model:
        """Return the model with another coupling of joint j."""
        couplings = self.couplings.copy()
        couplings[j] = ratio
        return replace(self, couplings=couplings)

    def springs(self, q: Floats) -> Floats:
        """Return the efforts of springs, including their offsets, shape (samples, joints)."""
        stiffness, offset = self.joints[:, SPRING], self.joints[:, OFFSET]
        return np.asarray(stiffness * q + np.where(stiffness != 0.0, offset, 0.0))


class Regression:
    """
    Smoothed regression rows of several motions.

    Each motion has a resampler, which smooths its signals. `block` contains the block index of
    each row, or -1 for rows between blocks. `efforts` contains the measured efforts. `q`, `qd` and
    `qdd` contain the positions, velocities and accelerations. All four have the shape (rows,
    joints).

    """

    def __init__(
        self,
        problem: IdentificationProblem,
        motions: Sequence[Motion],
        resamplers: Sequence[Resampler],
        block: Integers,
    ) -> None:
        self.problem, self.motions, self.resamplers = problem, motions, resamplers
        self.block, self.block_count = block, int(block.max(initial=-1)) + 1
        joints = problem.joints
        self.qdd = self._smooth([motion.qdd[:, joints] for motion in motions])
        self.qd = self._smooth([motion.qd[:, joints] for motion in motions])
        self.q = self._smooth([motion.q[:, joints] for motion in motions])
        self.efforts = self._smooth([motion.efforts for motion in motions])

    def with_efforts(self, efforts: Sequence[Floats]) -> Regression:
        """Return the regression with other measured efforts for each motion."""
        other = copy(self)
        other.efforts = self._smooth(efforts)
        return other

    @property
    def times(self) -> Floats:
        """Times of the rows; the motions are placed one second apart, shape (rows,) [s]."""
        parts, start = [], 0.0
        for smooth in self.resamplers:
            parts.append(smooth.times - smooth.times[0] + start)
            start = float(parts[-1][-1]) + 1.0
        return np.concatenate(parts)

    def only(self, block: int) -> Regression:
        """Return the rows of one block, which is a part of one motion."""
        ends = np.cumsum([len(smooth.times) for smooth in self.resamplers])
        rows = np.split(self.block == block, ends[:-1])
        k = next(k for k, part in enumerate(rows) if part.any())
        resamplers = [self.resamplers[k].where(rows[k])]
        return Regression(
            self.problem, [self.motions[k]], resamplers, np.zeros(rows[k].sum(), dtype=int)
        )

    @cached_property
    def bodies(self) -> Floats:
        """Regressor columns of the identified bodies, shape (rows, joints, 10 per body)."""
        return self._in_parts(self.problem.columns)

    @cached_property
    def known(self) -> Floats:
        """Efforts due to the payload, shape (rows, joints)."""
        if self.problem.payload is None:
            return np.zeros_like(self.q)
        robot = self.problem.identified.robot
        massless = replace(
            robot,
            mass=np.zeros_like(robot.mass),
            com=np.zeros_like(robot.com),
            inertia=np.zeros_like(robot.inertia),
        )
        return self._in_parts(partial(self.problem.efforts, massless))

    def rigid(self, bodies: Floats) -> Floats:
        """Return efforts of a robot with the given bodies, shape (rows, joints)."""
        if 'bodies' in self.__dict__:
            return np.asarray(self.known + self.bodies @ bodies.ravel())
        robot = self.problem.identified.robot_with(bodies)
        return self._in_parts(partial(self.problem.efforts, robot))

    def direction(self, model: Model) -> Floats:
        """Return the smoothed directions of the drives, shape (rows, joints)."""
        joints, before = self.problem.joints, self.problem.before
        signals = []
        for motion in self.motions:
            qd = motion.qd[:, joints]
            if model.couplings.any():
                qd = qd + model.couplings * qd[:, before]
            signals.append(np.tanh(qd / model.widths))
        return self._smooth(signals, Resampler.discontinuous)

    def terms(self, model: Model, rigid: Floats) -> Floats:
        """
        Return the columns of the joint terms, shape (rows, joints, 6).

        The columns depend on the widths, the couplings, and the loads of the gears. `rigid` are
        the efforts of the bodies, shape (rows, joints).

        """
        before = self.problem.before
        load = np.abs(rigid + model.springs(self.q))
        direction = self.direction(model)
        columns = (
            self.qdd + model.couplings * self.qdd[:, before],
            self.qd + model.couplings * self.qd[:, before],
            direction,
            load * direction,
            self.q,
            np.ones_like(self.qd),
        )
        return np.stack(columns, axis=-1)

    def actions(self, model: Model, rigid: Floats) -> list[tuple[int, int, Floats]]:
        """
        Return the columns of the joint terms for each affected joint.

        The terms of a joint affect the joint itself. The terms of a coupled drive also affect the
        preceding joint. Each tuple contains the affected joint, the owner of the terms, and the
        columns, shape (rows, 6).

        """
        terms = self.terms(model, rigid)
        found = [(j, j, terms[:, j]) for j in range(len(model.joints))]
        for j in np.flatnonzero(model.couplings).tolist():
            shared = np.zeros(terms[:, j].shape)
            shared[:, OF_DRIVE] = model.couplings[j] * terms[:, j, OF_DRIVE]
            found.append((int(self.problem.before[j]), j, shared))
        return found

    @cached_property
    def body_grams(self) -> list[Floats]:
        """Products of the body columns of each joint, shape (blocks + 1, columns, columns)."""
        return [
            self.by_block(table, table)
            for table in (self.bodies[:, j][:, self.moved(j)] for j in range(self.q.shape[1]))
        ]

    def moved(self, j: int) -> Integers:
        """Return the indices of the parameters of all bodies that a joint moves."""
        problem = self.problem
        bodies = moved_by(problem.identified.robot, problem.joints[j], problem.identified.bodies)
        index = PARAMETERS * np.array(bodies, dtype=int)[:, None] + np.arange(PARAMETERS)
        return np.asarray(index.ravel())

    def by_block(self, left: Floats, right: Floats) -> Floats:
        """Return ``left.T @ right`` for each block; the last one is for rows between blocks."""
        chosen = [self.block == k for k in (*range(self.block_count), -1)]
        return np.array([left[rows].T @ right[rows] for rows in chosen])

    def predict(self, model: Model) -> Floats:
        """Return modelled efforts, shape (rows, joints)."""
        efforts = self.rigid(model.bodies)
        for joint, owner, columns in self.actions(model, efforts):
            efforts[:, joint] += columns @ model.joints[owner]
        return efforts

    def residual(self, model: Model) -> Floats:
        """Return measured minus modelled efforts, shape (rows, joints)."""
        return self.efforts - self.predict(model)

    def _smooth(
        self,
        signals: Sequence[Floats],
        method: Callable[[Resampler, Floats], Floats] = Resampler.__call__,
    ) -> Floats:
        pairs = zip(self.resamplers, signals, strict=True)
        return np.concatenate([method(smooth, values) for smooth, values in pairs])

    def _in_parts(self, function: Callable[[Motion], Floats]) -> Floats:
        """Smooth a function of the states, such as the regressor, a few rows at a time."""
        found = []
        for motion, smooth in zip(self.motions, self.resamplers, strict=True):

            def part(samples: slice, motion: Motion = motion) -> Floats:
                q, qd, qdd = motion.q[samples], motion.qd[samples], motion.qdd[samples]
                return function(motion._replace(q=q, qd=qd, qdd=qdd))

            found.append(smooth.in_parts(part, ROWS_AT_ONCE))
        return np.concatenate(found)


def regression_of(
    problem: IdentificationProblem, motions: Sequence[Motion], seconds: float, block_count: int
) -> Regression:
    """
    Return the regression of several motions, divided into blocks.

    `seconds` is the length of the smoothing window. The number of blocks, which are contiguous
    parts of the motions, is approximately `block_count`.

    """
    resamplers = [resampler(motion, seconds) for motion in motions]
    durations = [max(float(np.ptp(motion.times)), 1e-9) for motion in motions]
    numbers: list[Integers] = []
    first = 0
    for motion, smooth, duration in zip(motions, resamplers, durations, strict=True):
        own = max(1, round(block_count * duration / sum(durations)))
        position = (smooth.times - motion.times[0]) / duration * own
        nearest = np.round(position)
        reach = 0.5 * smooth.seconds if seconds > 0.0 else 0.0
        is_near = np.abs(position - nearest) * duration / own < reach
        is_border = is_near & (nearest > 0) & (nearest < own)
        block = np.minimum(position.astype(int), own - 1)
        numbers.append(np.where(is_border, -1, first + block))
        first += own
    return Regression(problem, motions, resamplers, np.concatenate(numbers))
