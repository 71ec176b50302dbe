"""
Where a scenario takes place: a robot in its start pose, and how much it can take there.

Loads and pushes are sized by the robot: each brings some joint off its place by what can be seen,
with the gains that the node has, and leaves every drive something to give.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.hand import last_link
from ...robot.model import Floats, RobotModel
from ..mujoco.hardware import require_inertia
from ..trajectory import EFFORT_USED, effort_used

KP, KD = 400.0, 40.0  # of the node's own loop; see the commander's [1/s^2], [1/s]
DEFLECTION = 0.2  # [rad or m]: what a load or a push may do to a joint
HEAVIEST = 5.0  # [kg]
LEAST_LOAD = 0.01  # of the robot's mass
HARDEST, FIRM = 20.0, 5.0  # [N]
LEAST_INERTIA = 0.1  # [kg m^2 per N m, kg per N] of dry friction: motors with gears have as much
LEAST_DECAY = 0.02  # [s]: viscous friction may not stop a joint sooner than the loop can tell
BOX = 0.1  # [m], the side of a load
GRIP = (0.0, 0.0, 0.05)  # [m], its centre in the frame of the link


@dataclass(frozen=True, eq=False)
class Stage:
    """
    A robot of n joints, at rest.

    Attributes
    ----------
    urdf : str
        Path of its description.
    robot : RobotModel
        The same, loaded.
    start : ndarray, shape (n,)
        Where it is [rad or m].
    duration : float
        How long it will take [s].
    link : str
        What is loaded and pushed; empty: the hand, as far as can be told.
    friction : bool
        Whether the joints have the friction of the URDF, and the node overcomes it.

    """

    urdf: str
    robot: RobotModel
    start: Floats
    duration: float
    link: str = ''
    friction: bool = False

    @cached_property
    def armature(self) -> Floats:
        """
        Inertia of rotors that the URDF leaves out, shape (n,) [kg m^2 or kg].

        None without friction. With it, a joint that rubs has a motor and gears: where next to
        no inertia is left once friction is overcome, the least delay would throw the joint about.

        """
        robot = self.robot
        if not self.friction:
            return np.zeros(len(self.start))
        least = np.maximum(LEAST_INERTIA * robot.friction, LEAST_DECAY * robot.damping)
        return np.maximum(0.0, least - self.inertia)

    @cached_property
    def inertia(self) -> Floats:
        """What each joint moves at the start while the others are free, shape (n,)."""
        mass_matrix = self._mass_matrix(InverseDynamics(self.robot))
        felt: Floats = 1.0 / np.diagonal(np.linalg.inv(mass_matrix))
        return felt

    @cached_property
    def slack(self) -> Floats:
        """How far dry friction may hold joints off their places, shape (n,) [rad or m]."""
        if not self.friction:
            return np.zeros(len(self.start))
        compliance = np.abs(np.linalg.inv(self._mass_matrix(self.dynamics()))) / KP
        held: Floats = compliance @ self.robot.friction
        return held

    def dynamics(self) -> InverseDynamics:
        """Make what the node has for a model."""
        dynamics = InverseDynamics(self.robot)
        if self.friction:
            dynamics.set_friction()
            dynamics.set_armature(self.armature)
        return dynamics

    def _mass_matrix(self, dynamics: InverseDynamics) -> Floats:
        """Return the mass matrix at the start, which must be invertible, shape (n, n)."""
        mass_matrix = dynamics.mass_matrix(self.start)
        require_inertia(self.robot, mass_matrix)
        return mass_matrix

    def load(self) -> tuple[str, float, Floats]:
        """
        Choose a load: the link, the mass [kg], the inertia about its centre, shape (3, 3).

        A last joint without the inertia of a rotor gives way to a few grams: the nearest link to
        the hand is loaded that takes a load worth mentioning.

        """
        links = [self.link] if self.link else up_from(self.robot, last_link(self.robot))
        unit = np.eye(3) * BOX**2 / 6.0
        chosen, heaviest = links[0], 0.0
        for link in links:

            def put(dynamics: InverseDynamics, mass: float, link: str = link) -> None:
                dynamics.set_payload(link, mass, GRIP, mass * unit)

            mass = self._most(put, HEAVIEST)
            if mass > heaviest:
                chosen, heaviest = link, mass
            if heaviest >= LEAST_LOAD * float(self.robot.mass.sum()):
                break
        return chosen, heaviest, heaviest * unit

    def capacity(self, link: str) -> float:
        """Return the mass at a link that brings a drive to its limit at the start [kg]."""
        dynamics = InverseDynamics(self.robot)
        alone = dynamics.gravity_efforts(self.start)
        dynamics.set_payload(link, 1.0, GRIP)
        change = dynamics.gravity_efforts(self.start) - alone
        lifting = np.abs(change) > 1e-9
        spare = self.robot.effort_limits - alone * np.sign(change)
        return float(np.min(spare[lifting] / np.abs(change[lifting]), initial=np.inf))

    def push(self) -> tuple[str, Floats]:
        """
        Choose a push: the link, and the force in its frame [N], shape (3,).

        Wrists may give way to almost nothing: the nearest link to the hand that stands a firm
        push is pushed.

        """
        links = [self.link] if self.link else up_from(self.robot, last_link(self.robot))
        direction = np.ones(3) / np.sqrt(3.0)
        chosen, hardest = links[0], 0.0
        for link in links:

            def put(dynamics: InverseDynamics, force: float, link: str = link) -> None:
                dynamics.set_external_wrench(link, force * direction)

            force = self._most(put, HARDEST)
            if force > hardest:
                chosen, hardest = link, force
            if hardest >= FIRM:
                break
        return chosen, hardest * direction

    def external_efforts(self, link: str, force: Floats, q: Floats) -> Floats:
        """Compute what joint efforts must make up for while a link is pushed: -J^T F."""
        pushed, alone = InverseDynamics(self.robot), InverseDynamics(self.robot)
        pushed.set_external_wrench(link, force)
        difference: Floats = pushed.gravity_efforts(q) - alone.gravity_efforts(q)
        return difference

    def _most(self, put: Callable[[InverseDynamics, float], None], limit: float) -> float:
        """Find the most of something, up to a limit, that the joints and drives stand."""
        robot, start = self.robot, self.start
        dynamics = InverseDynamics(robot)
        alone = dynamics.gravity_efforts(start)
        put(dynamics, 1.0)
        change = dynamics.gravity_efforts(start) - alone
        deflection = np.linalg.solve(self._mass_matrix(self.dynamics()), change) / KP
        most = min(limit, DEFLECTION / max(float(np.max(np.abs(deflection))), 1e-9))
        alone = np.where(np.abs(change) > 1e-9, alone, 0.0)  # other joints do not matter
        spare = max(0.8 * EFFORT_USED, 0.5 * (EFFORT_USED + effort_used(robot, alone)))
        while effort_used(robot, alone + most * change) > spare and most > 1e-3:
            most *= 0.8
        return float(f'{most:.2g}')  # a load as people would tell it


def up_from(robot: RobotModel, link: str) -> list[str]:
    """List links from one towards the base, one for every joint on the way."""
    body = int(robot.link_body[robot.link_names.index(link)])
    links = [link]
    while (body := int(robot.parent[body])) > 0:
        links.append(robot.link_names[int(np.flatnonzero(robot.link_body == body)[-1])])
    return links
