"""
The set-up of a scenario: a robot in its start pose, and the loads and pushes it can withstand.

Loads and pushes are sized by the robot: large enough to deflect some joint visibly with the gains
of the node, small enough to leave every drive a reserve.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.end_effector import last_link
from ...robot.model import Floats, RobotModel
from ..mujoco.hardware import require_inertia
from ..trajectory import EFFORT_USED, effort_used

# Gains [1/s^2], [1/s] of the loop, which the commander or the node closes. Critically damped at
# 20 rad/s: stiff enough that two samples of latency cost less than a millirad, soft enough that
# holding one command for 20 ms does no harm.
KP, KD = 400.0, 40.0
DEFLECTION = 0.2  # [rad or m]: largest deflection of a joint by a load or a push
HEAVIEST = 5.0  # [kg]
LEAST_LOAD = 0.01  # fraction of the robot's mass
HARDEST, FIRM = 20.0, 5.0  # [N]
LEAST_INERTIA = 0.1  # [kg m^2 per N m, kg per N] of dry friction, as of motors with gears
LEAST_DECAY = 0.02  # [s]: viscous friction must not stop a joint faster than the loop reacts
BOX = 0.1  # [m], side of a cubic load
GRIP = (0.0, 0.0, 0.05)  # [m], centre of the load in the frame of the link

Put = Callable[[InverseDynamics, str, float], None]
"""Puts a load or a push of some size on a link."""


@dataclass(frozen=True, eq=False)
class DemoSetup:
    """
    A robot of n joints, at rest.

    Attributes
    ----------
    urdf : str
        Path of the robot description.
    robot : RobotModel
        The robot loaded from it.
    start : ndarray, shape (n,)
        Start pose [rad or m].
    duration : float
        Duration of the run [s].
    link : str
        Link to load and to push; empty to choose the hand, or a link near it.
    friction : bool
        Whether the joints have the friction of the URDF and the node compensates it.
    rate : float
        Rate of the joint states, and of the commands [Hz].

    """

    urdf: str
    robot: RobotModel
    start: Floats
    duration: float
    link: str = ''
    friction: bool = False
    rate: float = 500.0

    @cached_property
    def armature(self) -> Floats:
        """
        Rotor inertia that the URDF leaves out, shape (n,) [kg m^2 or kg].

        Zero without friction. A joint with friction has a motor and gears. If it has hardly any
        inertia, the smallest delay in compensating the friction would make it oscillate.

        """
        robot = self.robot
        if not self.friction:
            return np.zeros(len(self.start))
        least = np.maximum(LEAST_INERTIA * robot.friction, LEAST_DECAY * robot.damping)
        return np.maximum(0.0, least - self.inertia)

    @cached_property
    def inertia(self) -> Floats:
        """Inertia of each joint at the start while the others are free, shape (n,)."""
        mass_matrix = self._mass_matrix(InverseDynamics(self.robot))
        effective: Floats = 1.0 / np.diagonal(np.linalg.inv(mass_matrix))
        return effective

    @cached_property
    def slack(self) -> Floats:
        """Largest position error that dry friction can sustain, shape (n,) [rad or m]."""
        if not self.friction:
            return np.zeros(len(self.start))
        compliance = np.abs(np.linalg.inv(self._mass_matrix(self.dynamics()))) / KP
        error: Floats = compliance @ self.robot.friction
        return error

    def dynamics(self) -> InverseDynamics:
        """Return a new model, equal to that of the node."""
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
        Choose a load: its link, mass [kg], and inertia about its centre of mass, shape (3, 3).

        A last joint without rotor inertia deflects under a few grams. The load therefore hangs on
        the link closest to the hand that withstands 1 % of the robot's mass.

        """
        unit = np.eye(3) * BOX**2 / 6.0

        def put(dynamics: InverseDynamics, link: str, mass: float) -> None:
            dynamics.set_payload(link, mass, GRIP, mass * unit)

        enough = LEAST_LOAD * float(self.robot.mass.sum())
        link, mass = self._place(put, HEAVIEST, enough)
        return link, mass, mass * unit

    def capacity(self, link: str) -> float:
        """Return the mass on a link that takes a drive to its limit in the start pose [kg]."""
        alone, change = self._effect(lambda dynamics: dynamics.set_payload(link, 1.0, GRIP))
        lifting = np.abs(change) > 1e-9
        spare = self.robot.effort_limits - alone * np.sign(change)
        return float(np.min(spare[lifting] / np.abs(change[lifting]), initial=np.inf))

    def push(self) -> tuple[str, Floats]:
        """
        Choose a push: its link, and the force in the frame of the link [N], shape (3,).

        A wrist may deflect under hardly any force. The push therefore acts on the link closest to
        the hand that withstands a firm one.

        """
        direction = np.ones(3) / np.sqrt(3.0)

        def put(dynamics: InverseDynamics, link: str, force: float) -> None:
            dynamics.set_external_wrench(link, force * direction)

        link, force = self._place(put, HARDEST, FIRM)
        return link, force * direction

    def external_efforts(self, link: str, force: Floats, q: Floats) -> Floats:
        """Compute the joint efforts that balance a push on a link: -J^T F."""
        pushed, alone = InverseDynamics(self.robot), InverseDynamics(self.robot)
        pushed.set_external_wrench(link, force)
        difference: Floats = pushed.gravity_efforts(q) - alone.gravity_efforts(q)
        return difference

    def _place(self, put: Put, limit: float, enough: float) -> tuple[str, float]:
        """Return the link closest to the hand that withstands enough, else the most, and that."""
        links = [self.link] if self.link else links_towards_base(self.robot)
        chosen, most = links[0], 0.0
        for link in links:
            size = self._most(put, link, limit)
            if size > most:
                chosen, most = link, size
            if most >= enough:
                break
        return chosen, most

    def _effect(self, put: Callable[[InverseDynamics], None]) -> tuple[Floats, Floats]:
        """Return the efforts of gravity at the start, and how a load or a push changes them."""
        dynamics = InverseDynamics(self.robot)
        alone = dynamics.gravity_efforts(self.start)
        put(dynamics)
        return alone, dynamics.gravity_efforts(self.start) - alone

    def _most(self, put: Put, link: str, limit: float) -> float:
        """Find the largest load or push, up to a limit, that joints and drives withstand."""
        robot = self.robot
        alone, change = self._effect(lambda dynamics: put(dynamics, link, 1.0))
        deflection = np.linalg.solve(self._mass_matrix(self.dynamics()), change) / KP
        most = min(limit, DEFLECTION / max(float(np.max(np.abs(deflection))), 1e-9))
        alone = np.where(np.abs(change) > 1e-9, alone, 0.0)  # ignore joints without a change
        spare = max(0.8 * EFFORT_USED, 0.5 * (EFFORT_USED + effort_used(robot, alone)))
        while effort_used(robot, alone + most * change) > spare and most > 1e-3:
            most *= 0.8
        return float(f'{most:.2g}')  # a round number


def links_towards_base(robot: RobotModel) -> list[str]:
    """Return the links from the hand towards the base, one per joint on the way."""
    link = last_link(robot)
    body = int(robot.link_body[robot.link_index(link)])
    links = [link]
    while (body := int(robot.parent[body])) > 0:
        links.append(robot.link_names[int(np.flatnonzero(robot.link_body == body)[-1])])
    return links
