"""
Base parameters: the combinations of inertial parameters that efforts depend on.

A QR decomposition with pivoting of the regressor at random states selects as many of its columns
as are independent [1]_; the other columns are combinations of these.

References
----------
.. [1] M. Gautier, "Numerical calculation of the base inertial parameters of robots", Journal of
   Robotic Systems 8(4), 1991.

"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..robot.model import Floats, Integers
from ..robot.rigid_body import PARAMETERS

NAMES = ('m', 'mx', 'my', 'mz', 'Ixx', 'Ixy', 'Iyy', 'Ixz', 'Iyz', 'Izz')
"""Parameters of a body: mass, first moments and inertia about the origin of its frame."""
INDEPENDENT = 1e-8
"""Smallest independent part of a column, relative to the largest one."""


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
