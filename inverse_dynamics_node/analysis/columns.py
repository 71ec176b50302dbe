"""
Columns of regressions, efforts of one unit of an unknown, and least squares with them.

Efforts are linear in gravity, in the inertial parameters of bodies and payloads, and in friction.
They depend on combinations of the inertial parameters, the base parameters. A QR decomposition
with pivoting of the regressor at random states selects as many of its columns as are independent
[1]_; the other columns are combinations of these.

References
----------
.. [1] M. Gautier, "Numerical calculation of the base inertial parameters of robots", Journal of
   Robotic Systems 8(4), 1991.

"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..dynamics.inverse_dynamics import InverseDynamics
from ..robot.model import Booleans, Floats, Integers, RobotModel
from ..robot.rigid_body import PARAMETERS, parameters_of_pseudo_inertias

NAMES = ('m', 'mx', 'my', 'mz', 'Ixx', 'Ixy', 'Iyy', 'Ixz', 'Iyz', 'Izz')
"""Parameters of a body: mass, first moments and inertia about the origin of its frame."""
INDEPENDENT = 1e-8
"""Smallest independent part of a column, relative to the largest one."""
STATES_AT_ONCE = 2000  # to limit the memory


def direction_of(qd: Floats, width: Floats | float) -> Floats:
    """Return the directions of Coulomb friction, smoothed over a speed [rad/s or m/s]."""
    return np.asarray(np.tanh(qd / width))


def friction_columns(
    qd: Floats, width: float, load: Floats, smooth: Callable[[Floats], Floats]
) -> Floats:
    """
    Compute the efforts of damping, Coulomb friction, friction per load, and an offset.

    Parameters
    ----------
    qd : ndarray, shape (K,)
        Velocities of a joint [rad/s or m/s].
    width : float
        Speed over which Coulomb friction is smoothed [rad/s or m/s].
    load : ndarray, shape (K,)
        Magnitude of the effort that moves the links [N m or N].
    smooth : callable
        Smooths columns of shape (K, c) in the same way as the measured efforts.

    Returns
    -------
    columns : ndarray, shape (K, 4)

    """
    direction = direction_of(qd, width)
    steps = smooth(np.column_stack([direction, load * direction]))
    return np.column_stack([qd, steps, np.ones_like(qd)])


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

    A load is a second moment of mass in the homogeneous coordinates of its link. The parameters of
    its body are linear in this moment, and efforts are linear in the parameters of the body.

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


SECOND_MOMENTS = (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)
"""Axes of the last six parameters of a load."""
_MOMENTS = (3, 3), (0, 3), (1, 3), (2, 3), *SECOND_MOMENTS
"""Element of the second moment of mass that belongs to each parameter of a load."""


# ---- Base parameters -----------------------------------------------------------------------


class BaseParameters(NamedTuple):
    """Combinations of p parameters that determine the efforts."""

    combinations: Floats
    """Shape (r, p); each contains one parameter with factor 1 that no other contains."""
    leading: Integers
    """Index of that parameter for each combination."""

    def names(self, links: tuple[str, ...]) -> list[str]:
        """Return the names of the leading parameters, such as ``mx of forearm``."""
        return [
            f'{NAMES[k % PARAMETERS]} of {links[k // PARAMETERS]}' for k in self.leading.tolist()
        ]


def base_parameters(matrix: Floats) -> BaseParameters:
    """
    Find the combinations of columns that are independent.

    Parameters
    ----------
    matrix : ndarray, shape (k, p)
        Rows of a regressor at random states. Of columns that depend on each other, the larger ones
        are selected.

    """
    from scipy.linalg import qr, solve_triangular

    triangle, order = qr(matrix, mode='r', pivoting=True)
    sizes = np.abs(np.diagonal(triangle))
    rank = int(np.count_nonzero(sizes > INDEPENDENT * sizes[0]))
    combinations = np.zeros((rank, matrix.shape[1]))
    combinations[:, order[:rank]] = np.eye(rank)
    combinations[:, order[rank:]] = solve_triangular(
        triangle[:rank, :rank], triangle[:rank, rank:]
    )
    return BaseParameters(combinations, order[:rank])


# ---- Least squares -------------------------------------------------------------------------


def fit_nonnegative(
    features: Floats, target: Floats, signed: Sequence[int] | Booleans = ()
) -> tuple[Floats, float]:
    """
    Fit factors of columns that are not negative, such as those of friction.

    Parameters
    ----------
    features : ndarray, shape (K, p)
        Columns.
    target : ndarray, shape (K,)
        What their sum explains.
    signed : sequence of int, or ndarray of bool
        The columns whose factors may be negative, such as that of an offset.

    Returns
    -------
    factors : ndarray, shape (p,)
    left : float
        Sum of squares that is not explained.

    """
    from scipy.optimize import nnls

    if not features.shape[1]:
        return np.zeros(0), float(target @ target)
    chosen = list(signed) if not isinstance(signed, np.ndarray) else signed
    both = np.column_stack([features, -features[:, chosen]])
    lengths = np.linalg.norm(both, axis=0)
    lengths[lengths == 0.0] = 1.0
    triangle = np.asarray(np.linalg.qr(np.column_stack([both / lengths, target]), mode='r'))
    solution, norm = nnls(triangle[:, :-1], triangle[:, -1])
    solution /= lengths
    factors: Floats = solution[: features.shape[1]].copy()
    factors[chosen] -= solution[features.shape[1] :]
    return factors, float(norm) ** 2
