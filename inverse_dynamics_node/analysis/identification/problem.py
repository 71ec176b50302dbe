"""What is identified: bodies and joints of a robot, and their efforts."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...dynamics.robot_table import joints_before
from ...errors import ConfigurationError
from ...robot.model import Floats, Integers, RobotModel
from ...robot.rigid_body import (
    moved_inside,
    parameters_of_pseudo_inertias,
    pseudo_inertias,
    rigid_body,
    RigidBody,
    transport,
)
from ..columns import body_columns
from ..recordings.signals import Motion

RANDOM_STATES = 60


@dataclass(frozen=True, eq=False)
class IdentifiedBodies:
    """
    The bodies to identify: moving bodies with mass, without fixed links.

    Links that fixed joints hold together are one body. Its links that are not fixed are identified
    as one, because they cannot be distinguished.

    """

    robot: RobotModel
    bodies: tuple[int, ...]
    """Indices of the identified bodies in the robot, b of them."""
    links: tuple[tuple[int, ...], ...]
    """Links with mass of each identified body that may change."""
    names: tuple[str, ...]
    """Name of the first of these links: the one nearest to the joint."""
    before: Floats
    """Parameters of the robot description about the frames of the bodies, shape (b, 10)."""
    reference: Floats
    """The same, but inside physics: every body has an extent in all directions."""

    def fixed_robot(self) -> RobotModel:
        """Return the robot with the fixed bodies only; the others are massless."""
        return self.robot_with(np.zeros_like(self.before))

    def robot_with(self, parameters: Floats) -> RobotModel:
        """Return the robot with other parameters of the identified bodies, shape (b, 10)."""
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
        Distribute physical parameters of the identified bodies, shape (b, 10), to their links.

        Returns the inertial of each link in its own frame. All links of a body change by the same
        linear map of space and density, so that each of them remains physical.

        """
        inertials = {}
        for k, links in enumerate(self.links):
            after = pseudo_inertias(parameters[k])
            parts = [pseudo_inertias(_link_parameters(self.robot, link)) for link in links]
            if len(parts) == 1:
                changed = [after]
            else:
                # What moved the body inside physics is added to its first link.
                parts[0] = parts[0] + pseudo_inertias(self.reference[k] - self.before[k])
                change = transport(pseudo_inertias(self.reference[k]), after)
                changed = [change @ part @ change.T for part in parts]
            for link, matrix in zip(links, changed, strict=True):
                body = rigid_body(parameters_of_pseudo_inertias(matrix))
                R, p = self.robot.link_rotation[link], self.robot.link_position[link]
                in_link = RigidBody(body.mass, R.T @ (body.com - p), R.T @ body.inertia @ R)
                inertials[self.robot.link_names[link]] = in_link
        return inertials


def identified_bodies(robot: RobotModel, fixed: Collection[str] = ()) -> IdentifiedBodies:
    """
    Select the bodies to identify; those of fixed links do not change.

    Raises
    ------
    ConfigurationError
        If a link does not exist, or nothing is left to identify.

    """
    unchanged = {robot.link_index(name) for name in fixed}
    bodies, links = [], []
    for body in range(1, len(robot.parent)):
        on_body = np.flatnonzero((robot.link_body == body) & (robot.link_mass > 0.0))
        identified = tuple(int(link) for link in on_body if int(link) not in unchanged)
        if identified:
            bodies.append(body)
            links.append(identified)
    if not bodies:
        raise ConfigurationError(
            f"robot '{robot.name}' has no moving link with a mass that may change"
        )
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
    """Return the parameters of one link about the frame of its body, shape (10,)."""
    own = RigidBody(robot.link_mass[link], robot.link_com[link], robot.link_inertia[link])
    placed = own.rotate(robot.link_rotation[link]).shift(robot.link_position[link])
    assert placed.mass > 0.0
    return placed.parameters()


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
        self.before = _joints_before(identified.robot, self.joints)

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


def _joints_before(robot: RobotModel, joints: Sequence[int]) -> Integers:
    """Return the position in the list of the joint before each of m joints; -1 for none."""
    before = joints_before(robot)[list(joints)]
    return np.array([list(joints).index(k) if k in joints else -1 for k in before.tolist()])


def moved_by(robot: RobotModel, joint: int, bodies: Sequence[int]) -> list[int]:
    """Return which of the bodies a joint moves."""
    moved = np.zeros(len(robot.parent), dtype=bool)
    for body in range(1, len(moved)):
        moved[body] = moved[robot.parent[body]] or robot.joint_index[body] == joint
    return [k for k, body in enumerate(bodies) if moved[body]]
