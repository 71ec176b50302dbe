"""
Base parameters: the combinations of inertial parameters that efforts depend on.

References
----------
.. [1] M. Gautier, "Numerical calculation of the base inertial parameters of robots", Journal of
   Robotic Systems 8(4), 1991: by a QR decomposition of the regressor at random states.

"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...robot.model import Floats
from ...robot.pseudo_inertia import PARAMETERS
from ..diagnosis.signals import Motion
from .regression import IdentificationProblem

NAMES = ('m', 'mx', 'my', 'mz', 'Ixx', 'Ixy', 'Iyy', 'Ixz', 'Iyz', 'Izz')
STATES = 60
_TOLERANCE = 1e-8


class BaseParameters(NamedTuple):
    """Combinations of the parameters of b identified bodies that determine their efforts."""

    combinations: Floats
    """Shape (r, 10 b); each contains one parameter with factor 1 that no other contains."""
    leading: tuple[int, ...]
    """Index of that parameter for each combination."""

    def names(self, links: tuple[str, ...]) -> list[str]:
        """Return the names of the leading parameters, such as ``mx of forearm``."""
        return [f'{NAMES[k % PARAMETERS]} of {links[k // PARAMETERS]}' for k in self.leading]


def base_parameters(problem: IdentificationProblem) -> BaseParameters:
    """
    Find the base parameters of the bodies that the joints with efforts move.

    Parameters
    ----------
    problem : IdentificationProblem
        The robot and what is identified.

    """
    from scipy.linalg import qr, solve_triangular

    rng = np.random.default_rng(0)
    robot = problem.identified.robot
    n = len(robot.joint_names)
    states = rng.uniform(-1.0, 1.0, (3, STATES, n)) * np.array([np.pi, 3.0, 10.0])[:, None, None]
    slides = robot.is_prismatic_joint
    states[0][:, slides] *= 0.2
    times = np.arange(STATES, dtype=float)
    q, qd, qdd = states
    motion = Motion(times, q, qd, qdd, np.zeros((STATES, len(problem.joints))), 1, 0)
    table = problem.columns(motion).reshape(-1, PARAMETERS * len(problem.identified.bodies))
    table /= np.sqrt(np.mean(table**2))
    _, triangle, order = qr(table, mode='economic', pivoting=True)
    sizes = np.abs(np.diagonal(triangle))
    rank = int(np.sum(sizes > _TOLERANCE * sizes[0]))
    combinations = np.zeros((rank, table.shape[1]))
    combinations[:, order[:rank]] = np.eye(rank)
    combinations[:, order[rank:]] = solve_triangular(
        triangle[:rank, :rank], triangle[:rank, rank:]
    )
    return BaseParameters(combinations, tuple(int(k) for k in order[:rank]))
