"""
A payload that the model does not know, as efforts that are linear in its inertial parameters.

A point mass m at c adds ``m Y_m + m c . Y_c + m (c c^T) : Y_cc`` to the efforts, where the Y are
efforts themselves: those of loads of which all but one of the parameters are zero.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...dynamics.inverse_dynamics import InverseDynamics
from ...robot.model import Floats, RobotModel

PARAMETERS = 10  # m; m c, three; m c c^T, six
MOST_LINKS = 6  # links to try where nobody says which one carries the load
UNSURE = 0.05  # [m]: a coordinate with a larger standard error is not told


class Payload(NamedTuple):
    """A point mass that would explain efforts."""

    link: str
    mass: float
    """[kg]; below zero where the model carries too much."""
    com: tuple[float, float, float]
    """In the link's frame [m]; NaN where it cannot be told."""
    mass_error: float
    """Standard error [kg]."""


def tip_links(robot: RobotModel) -> tuple[str, ...]:
    """Name one link of every body that loads are fastened to: of palms, then of what ends."""
    carried = np.bincount(robot.parent[1:], minlength=len(robot.parent))
    # Fingers part at a palm: what is fastened there moves no finger.
    bodies = [body for body in range(1, len(carried)) if carried[body] != 1]
    bodies.sort(key=lambda body: (carried[body] == 0, -_depth(robot, body)))
    links = []
    for body in bodies[:MOST_LINKS]:
        on_body = np.flatnonzero(robot.link_body == body)
        reach = np.linalg.norm(robot.link_position[on_body], axis=1)
        # The last of those furthest out: flanges and tool frames come after what they sit on.
        furthest = on_body[reach >= np.max(reach) - 1e-9][-1]
        links.append(robot.link_names[int(furthest)])
    return tuple(links)


def _depth(robot: RobotModel, body: int) -> int:
    depth = 0
    while body > 0:
        body, depth = int(robot.parent[body]), depth + 1
    return depth


def payload_regressors(
    robot: RobotModel, gravity: Floats, link: str, states: tuple[Floats, Floats, Floats]
) -> Floats:
    """
    Compute the efforts for every parameter of a load, one at a time.

    Parameters
    ----------
    robot : RobotModel
        With n joints.
    gravity : ndarray, shape (3,)
        Free-fall acceleration in the base frame [m/s^2].
    link : str
        What carries the load.
    states : tuple of q, qd, qdd
        Each of shape (K, n).

    Returns
    -------
    regressors : ndarray, shape (K, n, 10)
        Efforts for m = 1 kg; m c_x, m c_y, m c_z = 1 kg m; and m c c^T = 1 kg m^2, its xx, yy,
        zz, xy, xz, yz.

    """
    dynamics = InverseDynamics(robot, gravity)
    bare = dynamics.efforts(*states)

    def point(com: Floats) -> Floats:
        dynamics.set_payload(link, 1.0, com)
        return dynamics.efforts(*states) - bare

    at_origin = point(np.zeros(3))
    forth = [point(axis) for axis in np.eye(3)]
    back = [point(-axis) for axis in np.eye(3)]
    # What is odd in the position of a unit mass is m c, what is even is m c c^T.
    first = [0.5 * (f - b) for f, b in zip(forth, back, strict=True)]
    second = [0.5 * (f + b) - at_origin for f, b in zip(forth, back, strict=True)]
    mixed = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        com = np.zeros(3)
        com[[i, j]] = 1.0
        mixed.append(point(com) - at_origin - first[i] - first[j] - second[i] - second[j])
    return np.stack([at_origin, *first, *second, *mixed], axis=-1)


def parameters_of(mass: float, com: Floats) -> Floats:
    """Return what the regressors are multiplied by for a point mass, shape (10,)."""
    x, y, z = com
    return mass * np.array([1.0, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])


def fit_payload(regressors: Floats, residual: Floats, samples: float) -> tuple[Floats, Floats]:
    """
    Fit a point mass to efforts.

    Parameters
    ----------
    regressors : ndarray, shape (r, 10)
        Weighted, so that every row counts the same.
    residual : ndarray, shape (r,)
        What they have to explain, weighted alike.
    samples : float
        How many independent samples the rows stand for.

    Returns
    -------
    solution, errors : ndarray, shape (4,)
        Mass [kg], centre of mass [m]; their standard errors.

    """
    from scipy.optimize import least_squares

    linear = np.linalg.lstsq(regressors[:, :4], residual, rcond=1e-9)[0]
    mass = linear[0] if abs(linear[0]) > 1e-6 else 1e-6
    start = np.array([mass, *np.clip(linear[1:] / mass, -0.5, 0.5)])

    def left(solution: Floats) -> Floats:
        return regressors @ parameters_of(float(solution[0]), solution[1:]) - residual

    found = least_squares(left, start, x_scale=[max(abs(mass), 0.1), 0.1, 0.1, 0.1])
    variance = 2.0 * found.cost / max(samples - 4.0, 1.0)
    covariance = np.linalg.pinv(found.jac.T @ found.jac, rcond=1e-12) * variance
    # A direction that no row feels has no error by that formula: it is not known at all.
    felt = np.linalg.norm(found.jac, axis=0)
    errors = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    errors[felt <= 1e-9 * np.max(felt)] = np.inf
    return found.x, errors
