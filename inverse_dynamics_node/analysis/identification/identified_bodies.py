"""The parts of a robot whose inertial parameters are identified, and those that are fixed."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from ...errors import ConfigurationError
from ...robot.model import Floats, RobotModel
from ...robot.rigid_body import (
    moved_inside,
    parameters_of_pseudo_inertias,
    pseudo_inertias,
    rigid_body,
    RigidBody,
    transport,
)


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
        return self._robot(np.zeros_like(self.before))

    def robot_with(self, parameters: Floats) -> RobotModel:
        """Return the robot with other parameters of the identified bodies, shape (b, 10)."""
        return self._robot(parameters)

    def link_inertials(self, parameters: Floats) -> dict[str, RigidBody]:
        """
        Distribute the parameters of the identified bodies to their links.

        Parameters
        ----------
        parameters : ndarray, shape (b, 10)
            Physical parameters of the identified bodies.

        Returns
        -------
        inertials : dict of str to RigidBody
            By name of the link, in the frame of the link. All links of a body change by the same
            linear map of space and density, so that each of them remains physical.

        """
        inertials = {}
        for k, links in enumerate(self.links):
            after = pseudo_inertias(parameters[k])
            parts = [self._link(link) for link in links]
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

    def _link(self, link: int) -> Floats:
        return pseudo_inertias(_link_parameters(self.robot, link))

    def _robot(self, parameters: Floats) -> RobotModel:
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


def identified_bodies(robot: RobotModel, fixed: Collection[str] = ()) -> IdentifiedBodies:
    """
    Select the bodies to identify.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    fixed : collection of str
        Links that do not change.

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
