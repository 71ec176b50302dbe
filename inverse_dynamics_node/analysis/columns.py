"""
Columns of regressions: efforts of one unit of an unknown that concerns the whole robot.

Efforts are linear in gravity, and in the inertial parameters of bodies and payloads.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.model import Floats, Integers, RobotModel
from ..robot.rigid_body import PARAMETERS, parameters_of_pseudo_inertias

STATES_AT_ONCE = 2000  # to limit the memory


def gravity_columns(robot: RobotModel, q: Floats) -> Floats:
    """
    Compute the efforts of 1 m/s^2 of gravity along each axis of the base link.

    Parameters
    ----------
    robot : RobotModel
        Robot with n joints.
    q : ndarray, shape (K, n)
        Joint positions [rad or m].

    Returns
    -------
    columns : ndarray, shape (K, n, 3)
        For gravity along x, y and z.

    """
    return np.stack([InverseDynamics(robot, axis).gravity_efforts(q) for axis in np.eye(3)], -1)


def body_columns(
    dynamics: InverseDynamics, states: tuple[Floats, Floats, Floats], bodies: Sequence[int]
) -> Floats:
    """
    Compute the columns of the regressor that belong to some bodies.

    Parameters
    ----------
    dynamics : InverseDynamics
        Robot with n joints.
    states : tuple of q, qd, qdd
        Each of shape (K, n).
    bodies : sequence of int
        Indices of b bodies in the robot, without the base.

    Returns
    -------
    columns : ndarray, shape (K, n, 10 b)
        In the order of `InverseDynamics.regressor`.

    """
    first: Integers = PARAMETERS * (np.array(bodies) - 1)
    index = (first[:, None] + np.arange(PARAMETERS)).ravel()
    parts = []
    for k in range(0, len(states[0]), STATES_AT_ONCE):
        some = [np.ascontiguousarray(signal[k : k + STATES_AT_ONCE]) for signal in states]
        parts.append(dynamics.regressor(*some)[:, :, index])
    return np.concatenate(parts)


def payload_columns(
    robot: RobotModel, gravity: Floats, link: str, states: tuple[Floats, Floats, Floats]
) -> Floats:
    """
    Compute the efforts of a load, separately for each of its parameters.

    A load is a second moment of mass in the homogeneous coordinates of its link. Those of its body
    are linear in them, and efforts are linear in the parameters of the body.

    Parameters
    ----------
    robot : RobotModel
        Robot with n joints.
    gravity : ndarray, shape (3,)
        Free-fall acceleration in the frame of the base link [m/s^2].
    link : str
        Link that carries the load.
    states : tuple of q, qd, qdd
        Each of shape (K, n).

    Returns
    -------
    columns : ndarray, shape (K, n, 10)
        Efforts for m = 1 kg; m c_x, m c_y, m c_z = 1 kg m; and m c c^T = 1 kg m^2, its xx, yy,
        zz, xy, xz, yz.

    """
    k = robot.link_index(link)
    body = int(robot.link_body[k])
    if body == 0:  # the base does not move
        return np.zeros((*states[0].shape, PARAMETERS))
    of_link = np.zeros((PARAMETERS, 4, 4))
    for moment, (i, j) in zip(of_link, _MOMENTS, strict=True):
        moment[i, j] = moment[j, i] = 1.0
    to_body = np.eye(4)
    to_body[:3, :3], to_body[:3, 3] = robot.link_rotation[k], robot.link_position[k]
    parameters = parameters_of_pseudo_inertias(to_body @ of_link @ to_body.T)
    columns = body_columns(InverseDynamics(robot, gravity), states, [body])
    return np.asarray(columns @ parameters.T)


_MOMENTS = (3, 3), (0, 3), (1, 3), (2, 3), (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)
"""Element of the second moment of mass that belongs to each parameter of a load."""
