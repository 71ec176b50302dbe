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

RANDOM_STATES = 60
ARMATURE, DAMPING, COULOMB, LOAD, SPRING, OFFSET = range(6)
TERMS = 6
"""Number of terms of each joint."""
OF_DRIVE = [ARMATURE, DAMPING, COULOMB, LOAD]
"""Terms of a coupled drive that also act on the preceding joint."""
SIGNED = np.array([False, False, False, False, True, True])
"""Whether each term may have a negative factor."""
FIXED_RATIO = 0.995
"""Two joints moved in a fixed ratio if their velocities have at least this correlation."""
ROWS_AT_ONCE = 500
"""Number of rows for which regressors are computed at once; this limits the memory."""


@dataclass(frozen=True, eq=False)
class IdentifiedBodies:
    """
    The bodies to identify.

    Links that are connected by fixed joints form one body. Recordings cannot distinguish these
    links, so the links of a body are identified together.

    """

    robot: RobotModel
    bodies: tuple[int, ...]
    """Indices of the identified bodies in the robot model."""
    links: tuple[tuple[int, ...], ...]
    """Links of each body that have mass and may change."""
    names: tuple[str, ...]
    """Names of the bodies, taken from the first link of each body."""
    before: Floats
    """Parameters in the robot description, relative to the body frames, shape (bodies, 10)."""
    reference: Floats
    """The same parameters, but flat or impossible bodies are enlarged."""

    def fixed_robot(self) -> RobotModel:
        """Return the robot without the masses of the identified links."""
        return self.robot_with(np.zeros_like(self.before))

    def robot_with(self, parameters: Floats) -> RobotModel:
        """Return the robot with new parameters of the identified bodies, shape (bodies, 10)."""
        robot = self.robot
        mass, com, inertia = robot.mass.copy(), robot.com.copy(), robot.inertia.copy()
        for k, b in enumerate(self.bodies):
            own = RigidBody(mass[b], com[b], inertia[b]).parameters()
            own = own - self.before[k] + parameters[k]
            if own[0] <= 1e-9 * mass[b]:
                mass[b], com[b], inertia[b] = 0.0, 0.0, 0.0
            else:
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
        for k, links in enumerate(self.links):
            after = pseudo_inertias(parameters[k])
            parts = [pseudo_inertias(_link_parameters(self.robot, link)) for link in links]
            if len(parts) == 1:
                changed = [after]
            else:
                # The first link receives the change from `before` to `reference`.
                parts[0] = parts[0] + pseudo_inertias(self.reference[k] - self.before[k])
                change = transport(pseudo_inertias(self.reference[k]), after)
                changed = [change @ part @ change.T for part in parts]
            for link, matrix in zip(links, changed, strict=True):
                body = rigid_body(parameters_of_pseudo_inertias(matrix))
                R, p = self.robot.link_rotation[link], self.robot.link_position[link]
                in_link = RigidBody(body.mass, R.T @ (body.com - p), R.T @ body.inertia @ R)
                inertials[self.robot.link_names[link]] = in_link
        return inertials


def identified_bodies(robot: RobotModel) -> IdentifiedBodies:
    """
    Select the bodies to identify.

    Raises ConfigurationError if no moving link has mass.

    """
    bodies, links = [], []
    for body in range(1, len(robot.parent)):
        on_body = np.flatnonzero((robot.link_body == body) & (robot.link_mass > 0.0))
        identified = tuple(on_body.tolist())
        if identified:
            bodies.append(body)
            links.append(identified)
    if not bodies:
        raise ConfigurationError(f"robot '{robot.name}' has no moving link with mass to identify")
    before = np.array([sum(_link_parameters(robot, link) for link in each) for each in links])
    return IdentifiedBodies(
        robot=robot,
        bodies=tuple(bodies),
        links=tuple(links),
        names=tuple(robot.link_names[each[0]] for each in links),
        before=before,
        reference=np.array([moved_inside(parameters) for parameters in before]),
    )


def _link_parameters(robot: RobotModel, link: int) -> Floats:
    """Return the parameters of one link relative to the frame of its body, shape (10,)."""
    own = RigidBody(robot.link_mass[link], robot.link_com[link], robot.link_inertia[link])
    placed = own.rotate(robot.link_rotation[link]).shift(robot.link_position[link])
    assert placed.mass > 0.0
    return placed.parameters()


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

    @property
    def has_known_mass(self) -> bool:
        """Whether a payload or a link that is not identified has a known mass."""
        return self.payload is not None or bool(self.identified.fixed_robot().mass[1:].any())

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

    def at_random_states(self) -> Floats:
        """Return scaled regressor columns at random states, shape (rows, 10 per body)."""
        robot = self.identified.robot
        rng, n = np.random.default_rng(0), len(robot.joint_names)
        states = rng.uniform(-1.0, 1.0, (3, RANDOM_STATES, n))
        states *= np.array([np.pi, 3.0, 10.0])[:, None, None]
        states[0][:, robot.is_prismatic_joint] *= 0.2
        q, qd, qdd = states
        columns = body_columns(self.dynamics(robot), (q, qd, qdd), self.identified.bodies)
        table = columns[:, self.joints].reshape(-1, columns.shape[2])
        return np.asarray(table / np.sqrt(np.mean(table**2)))


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

    `seconds` is the length of the smoothing window. `block_count` is the approximate number of
    blocks, which are contiguous parts of the motions. `efforts` contains the measured efforts.
    `q`, `qd` and `qdd` contain the positions, velocities and accelerations. All four have the
    shape (rows, joints). `block` contains the block index of each row, or -1 for rows between
    blocks.

    """

    def __init__(
        self,
        problem: IdentificationProblem,
        motions: Sequence[Motion],
        seconds: float,
        block_count: int,
    ) -> None:
        self.problem, self.motions = problem, list(motions)
        self.resamplers = [resampler(motion, seconds) for motion in motions]
        joints = problem.joints
        self.qdd = self._smooth([motion.qdd[:, joints] for motion in motions])
        self.qd = self._smooth([motion.qd[:, joints] for motion in motions])
        self.q = self._smooth([motion.q[:, joints] for motion in motions])
        self.efforts = self._smooth([motion.efforts for motion in motions])
        self.block = self._blocks(block_count)
        self.block_count = int(self.block.max(initial=-1)) + 1

    def with_efforts(self, efforts: Sequence[Floats]) -> Regression:
        """Return the regression with other measured efforts for each motion."""
        other = copy(self)
        other.efforts = self._smooth(efforts)
        return other

    @cached_property
    def bodies(self) -> Floats:
        """Regressor columns of the identified bodies, shape (rows, joints, 10 per body)."""
        return self._in_parts(self.problem.columns)

    @cached_property
    def known(self) -> Floats:
        """Efforts due to the payload and to unidentified links, shape (rows, joints)."""
        fixed = self.problem.identified.fixed_robot()
        return self._in_parts(partial(self.problem.efforts, fixed))

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

    def terms(self, model: Model) -> Floats:
        """
        Return the columns of the joint terms, shape (rows, joints, 6).

        The columns depend on the widths, the couplings, and the loads of the gears.

        """
        before = self.problem.before
        load = np.abs(self.rigid(model.bodies) + model.springs(self.q))
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

    def actions(self, model: Model) -> list[tuple[int, int, Floats]]:
        """
        Return the columns of the joint terms for each affected joint.

        The terms of a joint affect the joint itself. The terms of a coupled drive also affect the
        preceding joint. Each tuple contains the affected joint, the owner of the terms, and the
        columns, shape (rows, 6).

        """
        terms = self.terms(model)
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

    @cached_property
    def together(self) -> tuple[tuple[int, ...], ...]:
        """Groups of joints that moved in a fixed ratio, as indices into `problem.joints`."""
        spread = self.qd.std(axis=0)
        moved = np.flatnonzero(spread > 1e-6 * spread.max())
        if len(moved) < 2:
            return ()
        related = np.abs(np.corrcoef(self.qd[:, moved].T)) > FIXED_RATIO
        groups = {tuple(moved[row].tolist()) for row in related if row.sum() > 1}
        return tuple(sorted(groups))

    def predict(self, model: Model) -> Floats:
        """Return modelled efforts, shape (rows, joints)."""
        efforts = self.rigid(model.bodies)
        for joint, owner, columns in self.actions(model):
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

    def _blocks(self, count: int) -> Integers:
        """Return the block index of each row, or -1 near the border between two blocks."""
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
