"""Rigid loads on links."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.arguments import read_inertial
from ..errors import ConfigurationError
from ..robot.rigid_body import combine, RigidBody

_LARGEST = 1e9  # [kg], [m], [kg m^2]; sums and products of smaller numbers are finite
_ROUNDING = 1e-3  # of the moments of a flat body, as in a robot description


NO_PAYLOAD = RigidBody(0.0, np.zeros(3), np.zeros((3, 3)))


def read_payload(mass: float, com: ArrayLike, inertia: ArrayLike) -> RigidBody:
    """
    Validate a payload.

    Parameters
    ----------
    mass, com, inertia
        As for `InverseDynamics.set_payload`.

    Returns
    -------
    payload : RigidBody
        `NO_PAYLOAD` if the mass is zero.

    Raises
    ------
    ConfigurationError
        If no rigid body has this mass and inertia, or a number is beyond 1e9.

    """
    payload = RigidBody(*read_inertial(mass, com, inertia))
    largest = max(
        payload.mass, float(np.abs(payload.com).max()), float(np.abs(payload.inertia).max())
    )
    if largest > _LARGEST:
        raise ConfigurationError(
            f'payload has {largest:g} for its mass, centre of mass or inertia, expected at most '
            f'{_LARGEST:g} kg, m, kg m^2'
        )
    if not payload.mass:
        return NO_PAYLOAD
    principal = np.linalg.eigvalsh(payload.inertia)
    if principal[0] + principal[1] < principal[2] - _ROUNDING * np.sum(principal):
        moments = ', '.join(f'{moment:.3g}' for moment in principal)
        raise ConfigurationError(
            f'payload has an inertia that is physically impossible: one of its principal moments '
            f'{moments} kg m^2 exceeds the sum of the others'
        )
    # Remove a moment that rounding left below zero: blends of two such inertias would be rejected.
    shift = max(0.0, -float(principal[0]))
    return payload._replace(inertia=payload.inertia + shift * np.eye(3))


def is_same(one: RigidBody, other: RigidBody) -> bool:
    """Return whether two payloads are exactly equal."""
    return (
        one.mass == other.mass
        and np.array_equal(one.com, other.com)
        and np.array_equal(one.inertia, other.inertia)
    )


def blend_payloads(old: RigidBody, new: RigidBody, fraction: float) -> RigidBody:
    """Return the body that consists of a fraction of the new payload and the rest of the old."""
    return combine([old.scale(1.0 - fraction), new.scale(fraction)])
