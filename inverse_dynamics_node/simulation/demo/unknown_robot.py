"""
A robot that differs from its URDF: other masses, and friction and rotors that the URDF leaves out.

Friction and rotors are sized by the inertia of the joints, so that every robot can move with them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robot.model import Floats, RobotModel
from ...robot.rigid_body import RigidBody
from ...robot.urdf.writer import Friction, rewrite
from .demo_setup import DemoSetup

MASS = (0.75, 1.35)
"""Smallest and largest ratio of the masses of links to those in the URDF."""
PLACE = (0.85, 1.15)
"""The same for the coordinates of their centres of mass."""
ROTOR = 0.4
"""Inertia of rotors relative to that of the joint."""
COULOMB = 3.0
"""Acceleration at which the inertia of a joint takes as much effort as its friction [rad/s^2]."""
DAMPING_SPEED = 1.5
"""Speed at which viscous friction is as large as Coulomb friction [rad/s]."""
LARGEST_FRICTION = 0.05
"""Largest Coulomb friction, as a fraction of the effort limit."""
_SEED = 1979


@dataclass(frozen=True, eq=False)
class UnknownRobot:
    """A robot as it is, which its URDF describes wrongly."""

    urdf: bytes
    """The URDF with the right inertials and friction."""
    armature: Floats
    """Inertia of rotors, shape (n,) [kg m^2 or kg]."""
    damping: Floats
    """Viscous friction, shape (n,) [N m s/rad or N s/m]."""
    coulomb: Floats
    """Coulomb friction, shape (n,) [N m or N]."""


def unknown_robot(setup: DemoSetup) -> UnknownRobot:
    """
    Draw a robot that its URDF describes wrongly, always the same for the same URDF.

    Parameters
    ----------
    setup : DemoSetup
        The robot as in its URDF.

    """
    robot, rng = setup.robot, np.random.default_rng(_SEED)
    inertials = {}
    for k, name in enumerate(robot.link_names):
        factor, place = rng.uniform(*MASS), rng.uniform(*PLACE, 3)
        if robot.link_mass[k] > 0.0:
            inertials[name] = RigidBody(
                factor * robot.link_mass[k],
                place * robot.link_com[k],
                factor * robot.link_inertia[k],
            )
    armature = ROTOR * setup.inertia
    coulomb = np.minimum(
        COULOMB * (setup.inertia + armature), LARGEST_FRICTION * robot.effort_limits
    )
    damping = coulomb / DAMPING_SPEED
    return UnknownRobot(
        rewrite(setup.urdf, inertials, _friction(robot, damping, coulomb)),
        armature,
        damping,
        coulomb,
    )


def _friction(robot: RobotModel, damping: Floats, coulomb: Floats) -> dict[str, Friction]:
    """Return the friction of all joints; mimicking joints have none of their own."""
    friction = {name: Friction(0.0, 0.0) for name in robot.body_names[1:]}
    for name, viscous, dry in zip(robot.joint_names, damping, coulomb, strict=True):
        friction[name] = Friction(float(viscous), float(dry))
    return friction
