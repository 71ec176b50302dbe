"""
The set-up of a scenario: a robot in its start pose, with a suitable load and push.

Load and push are large enough to deflect a joint visibly. They are also small enough that every
drive keeps some effort in reserve.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.kinematics import last_link, path_to
from ...robot.model import Floats, RobotModel
from ..mujoco.hardware import require_inertia
from ..trajectory import EFFORT_USED, effort_used

# Gains [1/s^2], [1/s] of the control loop, which is critically damped at 20 rad/s. With these
# gains, two samples of latency cause an error of less than a millirad.
KP, KD = 400.0, 40.0
DEFLECTION = 0.2  # [rad or m]: largest deflection of a joint under a load or a push
HEAVIEST = 5.0  # [kg]: heaviest load
LEAST_LOAD = 0.01  # smallest load as a fraction of the robot's mass
HARDEST, FIRM = 20.0, 5.0  # [N]: largest push, and a push that is large enough
LEAST_INERTIA = 0.1  # [kg m^2 per N m, kg per N]: smallest ratio of inertia to Coulomb friction
LEAST_DECAY = 0.02  # [s]: smallest ratio of inertia to viscous friction
BOX = 0.1  # [m]: side of a cubic load
GRIP = (0.0, 0.0, 0.05)  # [m]: centre of the load in the frame of the link

Put = Callable[[InverseDynamics, str, float], None]
"""A function that applies a load [kg] or a push [N] to a link of a model."""


@dataclass(frozen=True, eq=False)
class DemoSetup:
    """A robot of n joints, at rest in its start pose."""

    urdf: str
    """Path of the URDF."""
    robot: RobotModel
    """The robot loaded from the URDF."""
    start: Floats
    """Start pose, shape (n,) [rad or m]."""
    duration: float
    """Duration of the run [s]."""
    link: str = ''
    """Name of the link for load and push; if empty, a link at or near the hand is chosen."""
    friction: bool = False
    """Whether the joints have friction, which the node then compensates."""
    rate: float = 500.0
    """Rate of the joint states and of the commands [Hz]."""

    @cached_property
    def armature(self) -> Floats:
        """
        Rotor inertia that the demo adds to each joint, shape (n,) [kg m^2 or kg].

        Without enough inertia, even a tiny delay in the friction compensation would make a joint
        oscillate. If ``friction`` is False, no inertia is added.
        """
        robot = self.robot
        if not self.friction:
            return np.zeros(len(self.start))
        least = np.maximum(LEAST_INERTIA * robot.friction, LEAST_DECAY * robot.damping)
        return np.maximum(0.0, least - self.inertia)

    @cached_property
    def inertia(self) -> Floats:
        """Inertia of each joint in the start pose if the other joints move freely, shape (n,)."""
        mass_matrix = self._mass_matrix(InverseDynamics(self.robot))
        return np.asarray(1.0 / np.diagonal(np.linalg.inv(mass_matrix)))

    @cached_property
    def slack(self) -> Floats:
        """Largest position error that Coulomb friction can maintain, shape (n,) [rad or m]."""
        if not self.friction:
            return np.zeros(len(self.start))
        compliance = np.abs(np.linalg.inv(self._mass_matrix(self.dynamics()))) / KP
        return np.asarray(compliance @ self.robot.friction)

    def dynamics(self) -> InverseDynamics:
        """Return a new dynamics model with the same parameters as in the node."""
        dynamics = InverseDynamics(self.robot)
        if self.friction:
            dynamics.set_friction()
            dynamics.set_armature(self.armature)
        return dynamics

    def _mass_matrix(self, dynamics: InverseDynamics) -> Floats:
        """Return the mass matrix in the start pose, shape (n, n); raise if it is singular."""
        mass_matrix = dynamics.mass_matrix(self.start)
        require_inertia(self.robot, mass_matrix)
        return mass_matrix

    def load(self) -> tuple[str, float, Floats]:
        """
        Choose a load; return the link, the mass [kg] and the inertia [kg m^2].

        The inertia is about the centre of mass. If ``self.link`` is empty, the load is on the
        outermost link that can carry 1 % of the robot's mass. Even a few grams may be too
        much for a wrist without rotor inertia.
        """
        unit = np.eye(3) * BOX**2 / 6.0

        def put(dynamics: InverseDynamics, link: str, mass: float) -> None:
            dynamics.set_payload(link, mass, GRIP, mass * unit)

        enough = LEAST_LOAD * float(self.robot.mass.sum())
        link, mass = self._place(put, HEAVIEST, enough)
        return link, mass, mass * unit

    def capacity(self, link: str) -> float:
        """Return the largest load [kg] that the drives can hold on a link in the start pose."""
        alone, change = self._effect(
            lambda dynamics: dynamics.set_payload(link, 1.0, GRIP), self.start
        )
        lifting = np.abs(change) > 1e-9
        spare = self.robot.effort_limits - alone * np.sign(change)
        return float(np.min(spare[lifting] / np.abs(change[lifting]), initial=np.inf))

    def push(self) -> tuple[str, Floats]:
        """
        Choose a push; return the link, and the force in the link frame [N], shape (3,).

        If ``self.link`` is empty, the push acts on the outermost link that withstands 5 N. Even a
        tiny force may be too much for a wrist joint.
        """
        direction = np.ones(3) / np.sqrt(3.0)

        def put(dynamics: InverseDynamics, link: str, force: float) -> None:
            dynamics.set_external_wrench(link, force * direction)

        link, force = self._place(put, HARDEST, FIRM)
        return link, force * direction

    def external_efforts(self, link: str, force: Floats, q: Floats) -> Floats:
        """Return the joint efforts -J^T F that balance the force F on a link."""
        return self._effect(lambda dynamics: dynamics.set_external_wrench(link, force), q)[1]

    def _place(self, put: Put, limit: float, enough: float) -> tuple[str, float]:
        """
        Choose a link; return the link, and the largest load or push that the link withstands.

        The load or push does not exceed ``limit``. If ``self.link`` is empty, choose the outermost
        link that withstands at least ``enough``. If no link does, choose the link that withstands
        the most.
        """
        links = [self.link] if self.link else links_towards_base(self.robot)
        chosen, most = links[0], 0.0
        for link in links:
            size = self._most(put, link, limit)
            if size > most:
                chosen, most = link, size
            if most >= enough:
                break
        return chosen, most

    def _effect(self, put: Callable[[InverseDynamics], None], q: Floats) -> tuple[Floats, Floats]:
        """Return the gravity efforts at ``q``, and the added efforts due to a load or push."""
        dynamics = InverseDynamics(self.robot)
        alone = dynamics.gravity_efforts(q)
        put(dynamics)
        return alone, dynamics.gravity_efforts(q) - alone

    def _most(self, put: Put, link: str, limit: float) -> float:
        """Return the largest load or push that joints and drives withstand, at most ``limit``."""
        robot = self.robot
        alone, change = self._effect(lambda dynamics: put(dynamics, link, 1.0), self.start)
        deflection = np.linalg.solve(self._mass_matrix(self.dynamics()), change) / KP
        most = min(limit, DEFLECTION / max(float(np.max(np.abs(deflection))), 1e-9))
        alone = np.where(np.abs(change) > 1e-9, alone, 0.0)  # ignore unaffected joints
        spare = max(0.8 * EFFORT_USED, 0.5 * (EFFORT_USED + effort_used(robot, alone)))
        while effort_used(robot, alone + most * change) > spare and most > 1e-3:
            most *= 0.8
        return float(f'{most:.2g}')  # a round number


def links_towards_base(robot: RobotModel) -> list[str]:
    """Return one link per joint, from the hand towards the base."""
    link = last_link(robot)
    body = int(robot.link_body[robot.link_index(link)])
    inner = reversed(path_to(robot, body)[:-1])
    return [link, *(robot.link_names[np.flatnonzero(robot.link_body == b)[-1]] for b in inner)]
