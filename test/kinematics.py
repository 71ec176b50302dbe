"""
Mechanics of a tree of links without a recursion for forces: Jacobians, energy, momentum.

It starts from the numbers that a `random_trees.Link` writes into its URDF, and shares no code
with the package, neither for reading a URDF nor for merging links. Positions may be complex, so
derivatives are exact to rounding: f(x + ih) has the imaginary part h f'(x), and h may be tiny.
"""

from typing import NamedTuple

import numpy as np

TINY = 1e-30  # the step into the complex plane; nothing is subtracted, so nothing cancels


class Placed(NamedTuple):
    """Pose and Jacobians of a link in the frame of the first link."""

    R: np.ndarray
    p: np.ndarray
    linear: np.ndarray  # (3, n) Jacobian of its origin
    angular: np.ndarray  # (3, n)

    def point(self, x):
        """Return the position and the Jacobian of a point in the link's frame."""
        arm = self.R @ x
        return self.p + arm, self.linear + np.cross(self.angular.T, arm).T


class Tree:
    """
    A tree of links without a robot model.

    Parameters
    ----------
    links : sequence of random_trees.Link
        Link i is moved by joint i.
    joint_names : sequence of str
        The order of joint vectors.

    """

    def __init__(self, links, joint_names):
        self.links = links
        self.n = len(joint_names)
        self.column = [-1] * len(links)
        for i, link in enumerate(links):
            if i and link.kind != 'fixed':
                master = link.mimics if link.mimics >= 0 else i
                self.column[i] = joint_names.index(f'joint{master}')
        self.inertias = [link_inertia(link) for link in links]

    def placed(self, q):
        """Return pose and Jacobians of every link."""
        zeros = np.zeros((3, self.n), dtype=np.result_type(q, float))
        placed = [Placed(np.eye(3), np.zeros(3), zeros, zeros)]
        for link, column in zip(self.links[1:], self.column[1:], strict=True):
            parent = placed[link.parent]
            R = parent.R @ rotation_of_rpy(link.rpy)
            p, linear = parent.point(np.array(link.xyz))
            angular = parent.angular
            if column >= 0:
                multiplier, offset = (
                    (link.multiplier, link.offset) if link.mimics >= 0 else (1.0, 0.0)
                )
                position = multiplier * q[column] + offset
                axis = np.array(link.axis) / np.linalg.norm(link.axis)
                moves = np.outer(R @ axis, multiplier * np.eye(self.n)[column])
                if link.kind == 'prismatic':
                    # The link slides along its parent, and rotates with it.
                    p, linear = parent.point(
                        np.array(link.xyz) + rotation_of_rpy(link.rpy) @ axis * position
                    )
                    linear = linear + moves
                else:
                    R = R @ rotation_about(axis, position)
                    angular = angular + moves
            placed.append(Placed(R, p, linear, angular))
        return placed

    def mass_matrix(self, q):
        """Return M from the kinetic energy 1/2 qd M qd = sum 1/2 (m v v + omega I omega)."""
        matrix = 0.0
        for link, inertia, at in zip(self.links, self.inertias, self.placed(q), strict=True):
            _, linear = at.point(np.array(link.com))
            matrix = matrix + link.mass * linear.T @ linear
            matrix = matrix + at.angular.T @ (at.R @ inertia @ at.R.T) @ at.angular
        return matrix

    def potential_energy(self, q, gravity):
        first_moment = sum(
            link.mass * at.point(np.array(link.com))[0]
            for link, at in zip(self.links, self.placed(q), strict=True)
        )
        return -first_moment @ np.asarray(gravity)

    def efforts(self, q, qd, qdd, gravity):
        """Return the efforts by Lagrange's equations: d/dt (dT/dqd) - dT/dq + dV/dq."""

        def lagrangian(position):
            kinetic = 0.5 * qd @ self.mass_matrix(position) @ qd
            return kinetic - self.potential_energy(position, gravity)

        def momentum(t):
            return self.mass_matrix(q + t * qd) @ (qd + t * qdd)

        return derivative(momentum) - gradient(lagrangian, q)

    def energy_growth(self, q, qd, qdd, gravity):
        """Return d/dt of kinetic and potential energy."""

        def energy(t):
            position, velocity = q + t * qd, qd + t * qdd
            kinetic = 0.5 * velocity @ self.mass_matrix(position) @ velocity
            return kinetic + self.potential_energy(position, gravity)

        return derivative(energy)

    def momentum(self, q, qd, of):
        """Sum the linear momentum of some links, and the angular one about the first's origin."""
        linear, angular = 0.0, 0.0
        placed = self.placed(q)
        for i in of:
            link, at = self.links[i], placed[i]
            centre, jacobian = at.point(np.array(link.com))
            momentum = link.mass * jacobian @ qd
            spin = at.R @ self.inertias[i] @ at.R.T @ at.angular @ qd
            linear = linear + momentum
            angular = angular + np.cross(centre, momentum) + spin
        return np.array([linear, angular])

    def carried_by(self, i):
        """Return a link and all its descendants."""
        carried = {i}
        for k, link in enumerate(self.links):
            if k and link.parent in carried:  # parents stand before their children
                carried.add(k)
        return sorted(carried)


def derivative(f):
    """Differentiate a function of time at 0."""
    return np.imag(f(1j * TINY)) / TINY


def gradient(f, x):
    return np.array([derivative(lambda t, d=d: f(x + t * d)) for d in np.eye(len(x))])


def link_inertia(link):
    """Return the inertia of a link about its centre of mass, along the axes of its frame."""
    a, b, c = np.square(link.box)
    R = rotation_of_rpy(link.com_rpy)
    return link.mass / 12.0 * R @ np.diag([b + c, c + a, a + b]) @ R.T


def rotation_of_rpy(rpy):
    """Return the rotation about fixed x, then y, then z, as in a URDF."""
    x, y, z = (rotation_about(axis, angle) for axis, angle in zip(np.eye(3), rpy, strict=True))
    return z @ y @ x


def rotation_about(axis, angle):
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def assert_close(actual, expected, tolerance=1e-10):
    """Compare relative to the largest expected value, which must not be zero."""
    scale = np.abs(expected).max()
    assert scale > 0.0, 'there is nothing to compare'
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * scale)
