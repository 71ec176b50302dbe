"""
Regressor columns, and least-squares fits.

A column contains the efforts for one unit of an unknown. The efforts are linear in all unknowns,
which are inertial parameters and gravity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.model import Booleans, Floats, Integers, RobotModel
from ..robot.rigid_body import PARAMETERS, parameters_of_pseudo_inertias

NAMES = ('m', 'mx', 'my', 'mz', 'Ixx', 'Ixy', 'Iyy', 'Ixz', 'Iyz', 'Izz')
"""Symbols of mass, first moments, and inertia about the origin of the body frame."""
STATES_AT_ONCE = 2000  # limits the memory for regressors


def gravity_columns(robot: RobotModel, q: Floats) -> Floats:
    """
    Return the efforts for a gravity of 1 m/s^2 along each axis of the base link.

    The result has the shape (samples, joints, 3).

    """
    return np.stack([InverseDynamics(robot, axis).gravity_efforts(q) for axis in np.eye(3)], -1)


def body_columns(
    dynamics: InverseDynamics, states: tuple[Floats, Floats, Floats], bodies: Sequence[int]
) -> Floats:
    """
    Return the regressor columns of the given bodies.

    `states` contains positions, velocities and accelerations, each of shape (samples, joints).
    `bodies` contains indices of bodies other than the base. The result has the shape (samples,
    joints, 10 per body). `InverseDynamics.regressor` defines the order of the ten columns.

    """
    first: Integers = PARAMETERS * (np.array(bodies) - 1)
    index = (first[:, None] + np.arange(PARAMETERS)).ravel()
    parts = []
    for k in range(0, len(states[0]), STATES_AT_ONCE):
        some = [np.ascontiguousarray(signal[k : k + STATES_AT_ONCE]) for signal in states]
        parts.append(dynamics.regressor(*some)[:, :, index])
    return np.concatenate(parts)


def usual_errors(robot: RobotModel, relative: float) -> Floats:
    """
    Return the error of each inertial parameter of links that are wrong by a relative error.

    The result has the shape (bodies except the base, 10).

    """
    mass = np.maximum(robot.mass[1:], 1e-9)
    gyration = np.trace(robot.inertia[1:], axis1=1, axis2=2) / mass
    size = np.sqrt(np.sum(robot.com[1:] ** 2, axis=1) + 0.5 * gyration)
    powers = size[:, None] ** np.repeat([0, 1, 2], [1, 3, 6])
    return np.asarray(relative * mass[:, None] * powers)


def payload_columns(
    robot: RobotModel, gravity: Floats, link: str, states: tuple[Floats, Floats, Floats]
) -> Floats:
    """
    Return the columns of a payload on a link, shape (samples, joints, 10).

    The columns belong to the mass [kg], the first moments x, y and z [kg m], and the second
    moments xx, yy, zz, xy, xz and yz [kg m^2]. All moments are in the link frame. `gravity` is the
    free-fall acceleration in the base frame [m/s^2].

    """
    k = robot.link_index(link)
    body = int(robot.link_body[k])
    if body == 0:  # the base does not move
        return np.zeros((*states[0].shape, PARAMETERS))
    of_link = moment_matrices(np.eye(PARAMETERS))
    to_body = np.eye(4)
    to_body[:3, :3], to_body[:3, 3] = robot.link_rotation[k], robot.link_position[k]
    parameters = parameters_of_pseudo_inertias(to_body @ of_link @ to_body.T)
    columns = body_columns(InverseDynamics(robot, gravity), states, [body])
    return np.asarray(columns @ parameters.T)


def moment_matrices(parameters: Floats) -> Floats:
    """Convert payload parameters, shape (..., 10), to pseudo-inertias, shape (..., 4, 4)."""
    matrices = np.zeros((*parameters.shape[:-1], 4, 4))
    for k, (i, j) in enumerate(_MOMENTS):
        matrices[..., i, j] = matrices[..., j, i] = parameters[..., k]
    return matrices


SECOND_MOMENTS = (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)
"""Axes of the second moments xx, yy, zz, xy, xz and yz."""
_MOMENTS = (3, 3), (0, 3), (1, 3), (2, 3), *SECOND_MOMENTS
"""Row and column of each payload parameter in the pseudo-inertia."""


# ---- Least squares -------------------------------------------------------------------------


def fit_nonnegative(
    features: Floats, target: Floats, signed: Sequence[int] | Booleans = ()
) -> tuple[Floats, float]:
    """
    Solve ``features @ factors = target`` by least squares for nonnegative factors.

    `features` has the shape (rows, columns), and `target` has the shape (rows,). The factors of
    `signed` columns may also be negative. Returns the factors and the sum of squared residuals.

    """
    if not features.shape[1]:
        return np.zeros(0), float(target @ target)
    lengths = np.linalg.norm(features, axis=0)
    lengths[lengths == 0.0] = 1.0
    triangle = np.asarray(np.linalg.qr(np.column_stack([features / lengths, target]), mode='r'))
    factors, squares = solve_nonnegative(triangle[:, :-1], triangle[:, -1], signed)
    return factors / lengths, squares


def solve_nonnegative(
    features: Floats, target: Floats, signed: Sequence[int] | Booleans
) -> tuple[Floats, float]:
    """
    Do the same as `fit_nonnegative`, but do not reduce the rows or scale the columns first.

    The features should have few rows, and columns of similar length.

    """
    from scipy.optimize import nnls

    chosen = list(signed) if not isinstance(signed, np.ndarray) else signed
    solution, norm = nnls(np.column_stack([features, -features[:, chosen]]), target)
    factors: Floats = solution[: features.shape[1]].copy()
    factors[chosen] -= solution[features.shape[1] :]
    return factors, float(norm) ** 2
