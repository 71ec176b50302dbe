"""Mass, centre of mass and inertia of a rigid body."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from .model import Floats


class RigidBody(NamedTuple):
    """The inertial parameters of a rigid body, in some frame."""

    mass: float
    """[kg]."""
    com: Floats
    """Centre of mass, shape (3,) [m]."""
    inertia: Floats
    """Inertia about the centre of mass, along the axes of the frame, shape (3, 3) [kg m^2]."""

    def rotate(self, rotation: Floats) -> RigidBody:
        """
        Express the body in a frame with the same origin and other axes.

        Parameters
        ----------
        rotation : ndarray, shape (3, 3)
            Rotation from the present frame to the new one.

        """
        return RigidBody(self.mass, rotation @ self.com, rotation @ self.inertia @ rotation.T)

    def shift(self, position: Floats) -> RigidBody:
        """
        Express the body in a frame with the same axes and another origin.

        Parameters
        ----------
        position : ndarray, shape (3,)
            Origin of the present frame in the new one [m].

        """
        return RigidBody(self.mass, position + self.com, self.inertia)

    def scale(self, factor: float) -> RigidBody:
        """Return a body of the same shape with a multiple of the density."""
        return RigidBody(factor * self.mass, self.com, factor * self.inertia)

    def parameters(self) -> Floats:
        """
        Return the ten inertial parameters, in which efforts are linear, shape (10,).

        Mass [kg], mass times centre of mass (x, y, z) [kg m], and inertia about the origin of the
        frame instead of the centre of mass (xx, xy, yy, xz, yz, zz) [kg m^2].

        """
        com = self.com
        about_origin = self.inertia + self.mass * (com @ com * np.eye(3) - np.outer(com, com))
        # The lower triangle, row by row.
        return np.array([self.mass, *(self.mass * com), *about_origin[np.tril_indices(3)]])


def combine(bodies: Iterable[RigidBody]) -> RigidBody:
    """
    Combine bodies, all in the same frame, into one rigid body.

    Massless bodies may have inertia, such as the rotor of a motor. If all bodies are massless,
    the centre of mass is the origin.

    """
    parts = list(bodies)
    mass = sum((part.mass for part in parts), 0.0)
    com = sum((part.mass * part.com for part in parts), np.zeros(3)) / (mass or 1.0)
    inertia = np.zeros((3, 3))
    for part in parts:  # parallel axis theorem
        arm = part.com - com
        inertia += part.inertia
        inertia += part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return RigidBody(mass, com, inertia)
