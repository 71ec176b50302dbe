"""
Rigid bodies, given by mass, centre of mass and inertia, or by ten inertial parameters.

The ten parameters of a body are m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz, in the order of
`InverseDynamics.regressor`. Here m is the mass, and h is the mass times the centre of mass. I is
the inertia about the origin of the frame. The pseudo-inertia [1]_ is the matrix
[[S, h], [h^T, m]], where S = E tr(I) / 2 - I, and E is the identity. A body with these parameters
can exist if and only if the pseudo-inertia is positive semidefinite.

References
----------
.. [1] P. M. Wensing, S. Kim, J.-J. E. Slotine, "Linear matrix inequalities for physically
   consistent inertial parameter identification: a statistical perspective on the mass
   distribution", IEEE Robotics and Automation Letters 3(1), 2018.

"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from .model import Floats

PARAMETERS = 10
_ROWS = np.array([0, 0, 1, 0, 1, 2])  # of Ixx, Ixy, Iyy, Ixz, Iyz, Izz
_COLUMNS = np.array([0, 1, 1, 2, 2, 2])

SMALLEST_RADIUS = 0.01
"""Least RMS extent [m], in each direction, of a body that `moved_inside` has enlarged."""


class RigidBody(NamedTuple):
    """Mass, centre of mass and inertia of a rigid body, in some frame."""

    mass: float
    """Mass [kg]."""
    com: Floats
    """Centre of mass, shape (3,) [m]."""
    inertia: Floats
    """Inertia about the centre of mass, along the axes of the frame, shape (3, 3) [kg m^2]."""

    def rotate(self, rotation: Floats) -> RigidBody:
        """Express the body in new axes; ``rotation`` converts old to new coordinates."""
        return RigidBody(self.mass, rotation @ self.com, rotation @ self.inertia @ rotation.T)

    def shift(self, position: Floats) -> RigidBody:
        """Express the body in a new frame; ``position`` [m] is the old origin in the new frame."""
        return RigidBody(self.mass, position + self.com, self.inertia)

    def parameters(self) -> Floats:
        """
        Return the ten inertial parameters, shape (10,).

        The parameters are the mass [kg], the mass times the centre of mass (x, y, z) [kg m], and
        the inertia (xx, xy, yy, xz, yz, zz) [kg m^2]. The inertia is about the origin of the
        frame, not about the centre of mass.

        """
        com = self.com
        about_origin = self.inertia + self.mass * (com @ com * np.eye(3) - np.outer(com, com))
        # The lower triangle, row by row.
        return np.array([self.mass, *(self.mass * com), *about_origin[np.tril_indices(3)]])


def combine(bodies: Iterable[RigidBody]) -> RigidBody:
    """
    Combine bodies, given in the same frame, into one rigid body.

    A massless body, such as the rotor of a motor, may have inertia. If all bodies are massless,
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


def _basis() -> Floats:
    basis = np.zeros((PARAMETERS, 4, 4))
    basis[0, 3, 3] = 1.0
    for axis in range(3):
        basis[1 + axis, axis, 3] = basis[1 + axis, 3, axis] = 1.0
    for k, (i, j) in enumerate(zip(_ROWS, _COLUMNS, strict=True)):
        element = basis[4 + k]
        if i == j:
            element[[0, 1, 2], [0, 1, 2]] = 0.5
            element[i, i] = -0.5
        else:
            element[i, j] = element[j, i] = -1.0
    return basis


BASIS = _basis()
"""Derivatives of the pseudo-inertia with respect to the ten parameters, shape (10, 4, 4)."""


def pseudo_inertias(parameters: Floats) -> Floats:
    """Convert parameters, shape (..., 10), to pseudo-inertias, shape (..., 4, 4)."""
    return np.asarray(np.tensordot(parameters, BASIS, 1))


def parameters_of_pseudo_inertias(matrices: Floats) -> Floats:
    """Convert pseudo-inertias, shape (..., 4, 4), to parameters, shape (..., 10)."""
    second = matrices[..., :3, :3]
    trace = np.trace(second, axis1=-2, axis2=-1)[..., None, None]
    inertia = trace * np.eye(3) - second
    parts = [matrices[..., 3, 3:], matrices[..., 3, :3], inertia[..., _ROWS, _COLUMNS]]
    return np.concatenate(parts, axis=-1)


def rigid_body(parameters: Floats) -> RigidBody:
    """Convert ten parameters to a rigid body; the mass must be positive."""
    mass = float(parameters[0])
    c = parameters[1:4] / mass
    inertia = np.zeros((3, 3))
    inertia[_ROWS, _COLUMNS] = inertia[_COLUMNS, _ROWS] = parameters[4:]
    return RigidBody(mass, c, inertia - mass * (c @ c * np.eye(3) - np.outer(c, c)))


def moved_inside(parameters: Floats) -> Floats:
    """
    Enlarge a body that has an impossible inertia or almost no extent in some direction.

    In every direction, the root mean square distance of the mass from the centre of mass becomes
    at least `SMALLEST_RADIUS`. Other bodies do not change. Argument and result are parameters,
    shape (10,). The mass must be positive.

    """
    matrix = pseudo_inertias(parameters)
    mass, c = matrix[3, 3], matrix[:3, 3] / matrix[3, 3]
    spread = matrix[:3, :3] - mass * np.outer(c, c)
    moments, axes = np.linalg.eigh(spread)
    least = mass * SMALLEST_RADIUS**2
    if moments[0] >= 0.01 * least:
        return parameters
    spread = (axes * np.maximum(moments, least)) @ axes.T
    matrix[:3, :3] = spread + mass * np.outer(c, c)
    return parameters_of_pseudo_inertias(matrix)


def transport(before: Floats, after: Floats) -> Floats:
    """
    Return the symmetric positive definite matrix T with ``T before T^T = after``.

    The arguments are positive definite pseudo-inertias of a body, shape (4, 4). If the
    pseudo-inertia P of every part of the body is replaced by ``T P T^T``, the parts remain
    physically possible, and their sum is ``after``.

    """
    root = _power(before, 0.5)
    inverse = _power(before, -0.5)
    return np.asarray(inverse @ _power(root @ after @ root, 0.5) @ inverse)


def _power(matrix: Floats, exponent: float) -> Floats:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0) ** exponent) @ vectors.T)
