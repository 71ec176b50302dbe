"""One robot, ready to compute."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import newton_euler
from .compilation import compile_for, IS_COMPILED
from .errors import ConfigurationError, JointStateError
from .model import Floats, RobotModel
from .newton_euler import OK

_V, _M = 'f8[::1]', 'f8[:,::1]'  # a vector and a table of float64, to numba

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
"""Free-fall acceleration in a base frame whose z points up [m/s^2]; ISO 80000-3."""


class InverseDynamics:
    r"""
    Inverse dynamics of one robot: accelerations in, joint efforts out.

    Evaluates :math:`\tau = M(q)\,\ddot q + C(q, \dot q)\,\dot q + g(q)` in one pass out along the
    tree and one pass back, without forming M, C or g. Friction is left out.

    Parameters
    ----------
    robot : RobotModel
        Tree of n joints, from `load_urdf`.
    gravity : array_like, shape (3,)
        Free-fall acceleration in the base frame [m/s^2].

    Raises
    ------
    ConfigurationError
        If gravity is not three finite numbers.

    Notes
    -----
    The first object compiles for about a second; the machine code is kept on disk. An object
    holds its own scratch space: threads need one each.

    References
    ----------
    .. [LWP] J. Y. S. Luh, M. W. Walker, R. P. C. Paul, "Newton-Euler formulation of manipulator
       dynamics for computer control", IFAC, 1979, 165-172: equations (36)-(47).

    """

    def __init__(self, robot: RobotModel, gravity: ArrayLike = STANDARD_GRAVITY) -> None:
        self.robot = robot
        self.gravity = _checked_gravity(gravity)
        self._zeros = np.zeros(len(robot.joint_names))
        table = newton_euler.robot_table(robot, self.gravity)
        self._table: Any = table if IS_COMPILED else table.tolist()
        self._inverse_dynamics = _ready(newton_euler.inverse_dynamics, _V, _V, _V, _V, _M)
        self._batch = _ready(newton_euler.inverse_dynamics_batch, _M, _M, _M, _M, _M)
        self._mass_matrix = _ready(newton_euler.mass_matrix, _V, _V, _V, _M, _M)

    def efforts(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None = None
    ) -> Floats:
        """
        Compute the joint efforts that produce the joint accelerations.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            Joint positions [rad or m], velocities [rad/s or m/s] and accelerations [rad/s^2 or
            m/s^2], in the order of ``robot.joint_names``. Leading dimensions are a batch; they
            broadcast against each other.
        out : ndarray, optional
            Receives the result: C-contiguous float64 of its shape.

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N], positive along the joint axis; ``out`` where it was given.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        Notes
        -----
        Outward pass: LWP (36)-(44); inward pass: LWP (45)-(47).

        """
        try:
            tau = np.empty_like(self._zeros) if out is None else out
            status = self._inverse_dynamics(q, qd, qdd, tau, self._table)
        except (TypeError, ValueError):  # lists, integers, batches, views with strides
            return self._efforts_of_any(q, qd, qdd, out)
        if status != OK:
            raise self._error(out, q=q, qd=qd, qdd=qdd)
        return tau

    def gravity_efforts(self, q: ArrayLike) -> Floats:
        """
        Compute the joint efforts that hold the robot still.

        Parameters
        ----------
        q : array_like, shape (..., n)
            Joint positions [rad or m].

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N].

        Raises
        ------
        JointStateError
            If the shape does not fit the robot, or a value is not finite.

        """
        return self.efforts(q, self._zeros, self._zeros)

    def mass_matrix(self, q: ArrayLike) -> Floats:
        """
        Compute the mass matrix M(q): efforts for unit accelerations, without gravity, at rest.

        Parameters
        ----------
        q : array_like, shape (..., n)
            Joint positions [rad or m].

        Returns
        -------
        mass_matrix : ndarray, shape (..., n, n)
            Symmetric to the last bit [kg m^2, kg m or kg, by kind of joint].

        Raises
        ------
        JointStateError
            If the shape does not fit the robot, or a value is not finite.

        """
        positions = self._vectors('q', q)
        n = len(self._zeros)
        matrices = np.empty((*positions.shape, n))
        unit = np.zeros(n)
        for index in np.ndindex(positions.shape[:-1]):
            arguments = (positions[index], self._zeros, unit, matrices[index])
            if self._mass_matrix(*arguments, self._table) != OK:
                raise self._error(q=q)
        return matrices

    def _efforts_of_any(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None
    ) -> Floats:
        """Compute efforts of whatever numpy can read as rows of n numbers."""
        vectors = [self._vectors(*pair) for pair in (('q', q), ('qd', qd), ('qdd', qdd))]
        try:
            shape = np.broadcast_shapes(*(vector.shape for vector in vectors))
        except ValueError:
            shapes = ', '.join(str(vector.shape) for vector in vectors)
            raise JointStateError(f'q, qd, qdd of shapes {shapes} do not fit together') from None
        rows = [_rows(vector, shape) for vector in vectors]
        tau = np.empty_like(rows[0])
        if self._batch(*rows, tau, self._table) != OK:
            raise self._error(q=q, qd=qd, qdd=qdd)
        if out is None:
            return tau.reshape(shape)
        if out.shape != shape:
            raise _wrong_out(out, shape)
        out[...] = tau.reshape(shape)
        return out

    def _vectors(self, name: str, values: ArrayLike) -> Floats:
        """Read an argument as float64, its last dimension one number a joint."""
        try:
            # Writable, by a copy where need be: the compiled functions take no other.
            vectors = np.require(values, np.float64, ['C', 'W'])
        except (TypeError, ValueError) as error:
            raise JointStateError(f'{name} is no array of numbers: {error}') from None
        n = len(self._zeros)
        if vectors.shape[-1:] != (n,):
            raise JointStateError(f'{name} has shape {vectors.shape}, the robot has {n} joints')
        return vectors

    def _error(self, out: Floats | None = None, **arguments: ArrayLike) -> JointStateError:
        """Say which argument is at fault: its shape, else its first value that is not finite."""
        for name, values in arguments.items():
            vectors = self._vectors(name, values)
            bad = np.argwhere(~np.isfinite(vectors))
            if len(bad):
                where = tuple(int(index) for index in bad[0])
                joint = self.robot.joint_names[where[-1]]
                sample = f' (sample {where[:-1]})' if where[:-1] else ''
                return JointStateError(f"{name} of joint '{joint}' is {vectors[where]}{sample}")
        if out is not None and out.shape != self._zeros.shape:
            return _wrong_out(out, self._zeros.shape)
        return JointStateError(
            'the efforts overflow: a position, velocity or acceleration is '
            'finite, but beyond all reason'
        )


def _rows(vectors: Floats, shape: tuple[int, ...]) -> Floats:
    """Broadcast to a shape, then make of it a list of vectors."""
    if vectors.shape != shape:
        vectors = np.array(np.broadcast_to(vectors, shape), order='C')
    return vectors.reshape(math.prod(shape[:-1]), shape[-1])


def _wrong_out(out: Floats, shape: tuple[int, ...]) -> JointStateError:
    return JointStateError(f'out has shape {out.shape}, the result has {shape}')


def _checked_gravity(gravity: ArrayLike) -> Floats:
    try:
        vector = np.array(gravity, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ConfigurationError(f'gravity is {gravity!r}, expected three finite numbers [m/s^2]')
    vector.setflags(write=False)
    return vector


def _ready(function: Callable[..., int], *kinds: str) -> Callable[..., int]:
    """
    Make a function of `newton_euler` ready for arrays: compiled, or run on lists of floats.

    Either way it raises a TypeError for arguments of other kinds.

    """
    if IS_COMPILED:
        compile_for(function, f'({", ".join(kinds)})')
        return function
    dimensions = [kind.count(',') + 1 for kind in kinds[:-1]]

    def on_lists(*arguments: Any) -> int:
        # Python reads a list several times faster than an array.
        *arrays, robot = arguments
        for values, dimension in zip(arrays, dimensions, strict=True):
            if not isinstance(values, np.ndarray) or values.ndim != dimension:
                raise TypeError
        lists = [values.tolist() for values in arrays]
        try:
            status = function(*lists, robot)
        except ValueError:  # Python's sine of infinity
            return newton_euler.NOT_FINITE
        if arrays[-1].size:
            arrays[-1][...] = lists[-1]
        return status

    return on_lists
