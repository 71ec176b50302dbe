"""
Rigid bodies by mass, centre of mass and inertia, and by their ten inertial parameters.

The ten parameters of a body are, in the order of `InverseDynamics.regressor`, its mass m, its
first moment h = m c, and its inertia I about the origin of its frame: m, hx, hy, hz, Ixx, Ixy,
Iyy, Ixz, Iyz, Izz. Its pseudo-inertia is the second moment of its mass in homogeneous coordinates,
[[S, h], [h^T, m]] with S = tr(I) / 2 E - I. There is a distribution of mass with these parameters
if and only if the pseudo-inertia is positive semidefinite.

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
_ROWS = np.array([0, 0, 1, 0, 1, 2])  # of the elements Ixx, Ixy, Iyy, Ixz, Iyz, Izz
_COLUMNS = np.array([0, 1, 1, 2, 2, 2])

SMALLEST_RADIUS = 0.01
"""Radius of gyration [m] up to which bodies on the edge of physics are extended."""


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
"""Derivatives of the pseudo-inertia by the parameters, shape (10, 4, 4)."""


def pseudo_inertias(parameters: Floats) -> Floats:
    """Return the pseudo-inertias of parameters of shape (..., 10), shape (..., 4, 4)."""
    return np.asarray(np.tensordot(parameters, BASIS, 1))


def parameters_of_pseudo_inertias(matrices: Floats) -> Floats:
    """Return the parameters of pseudo-inertias of shape (..., 4, 4), shape (..., 10)."""
    second = matrices[..., :3, :3]
    trace = np.trace(second, axis1=-2, axis2=-1)[..., None, None]
    inertia = trace * np.eye(3) - second
    parts = [matrices[..., 3, 3:], matrices[..., 3, :3], inertia[..., _ROWS, _COLUMNS]]
    return np.concatenate(parts, axis=-1)


def rigid_body(parameters: Floats) -> RigidBody:
    """Return the body that has ten parameters, with a mass above zero."""
    mass = float(parameters[0])
    c = parameters[1:4] / mass
    inertia = np.zeros((3, 3))
    inertia[_ROWS, _COLUMNS] = inertia[_COLUMNS, _ROWS] = parameters[4:]
    return RigidBody(mass, c, inertia - mass * (c @ c * np.eye(3) - np.outer(c, c)))


def moved_inside(parameters: Floats) -> Floats:
    """
    Return the nearest parameters that a body with extent in all directions has.

    Point masses, impossible inertias and negative ones are extended until the radius about the
    centre of mass is `SMALLEST_RADIUS` in every direction; other bodies are not changed.

    Parameters
    ----------
    parameters : ndarray, shape (10,)
        With a mass above zero.

    Returns
    -------
    parameters : ndarray, shape (10,)

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
    Return the matrix T nearest to the identity with ``T before T^T = after``.

    Applied to the parts of a body, ``T part T^T``, it distributes a change of the whole: the parts
    remain physical, and add up to the changed body.

    Parameters
    ----------
    before, after : ndarray, shape (4, 4)
        Positive definite pseudo-inertias.

    """
    root = _power(before, 0.5)
    inverse = _power(before, -0.5)
    return np.asarray(inverse @ _power(root @ after @ root, 0.5) @ inverse)


def _power(matrix: Floats, exponent: float) -> Floats:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0) ** exponent) @ vectors.T)
