"""Inverse dynamics of one robot."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ConfigurationError
from ..robot.model import Floats, RobotModel
from . import (
    batch,
    batch_mass_matrix,
    batch_regressor,
    columns,
    effort_terms,
    mass_matrix,
    newton_euler,
    regressor,
)
from .arguments import (
    broadcast,
    check_out,
    explain,
    is_free,
    read_inertial,
    read_joints,
    read_threads,
    read_vector,
)
from .jit import IS_COMPILED
from .kernels import prepared
from .lanes import FEWEST
from .loaded_robot import LoadedRobot
from .newton_euler import OK

_V, _M = 'f8[::1]', 'f8[:,::1]'  # a vector and a table of float64, to numba

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
"""Free-fall acceleration in a base frame whose z points up [m/s^2]; ISO 80000-3."""

FRICTION_WIDTH = 0.01
"""Speed at which smoothed Coulomb friction has 76 % of its value [rad/s or m/s]."""


class EffortTerms(NamedTuple):
    """Terms of the joint efforts, each of shape (..., n) [N m or N]; their sum is the effort."""

    inertial: Floats
    """M(q) qdd, including armature."""
    velocity: Floats
    """C(q, qd) qd: Coriolis and centrifugal efforts, including those of a rotating base."""
    gravity: Floats
    """g(q), and the efforts due to the acceleration and rotation of the base."""
    friction: Floats
    """Viscous and Coulomb friction, including the part that grows with the load."""
    external: Floats
    """Minus the efforts that the external wrenches exert."""


class JointWrenches(NamedTuple):
    """
    Force and moment at every joint, of shape (..., b, 3), in the order of ``robot.body_names``.

    A row is the wrench that the parent of the body exerts on it, in the URDF frame of the joint
    between them and about its origin. The first row is the wrench of the mount on the base.

    """

    force: Floats
    """[N]."""
    moment: Floats
    """[N m]."""


class InverseDynamics:
    r"""
    Inverse dynamics of one robot: accelerations in, joint efforts out.

    Evaluates :math:`\tau = M(q)\,\ddot q + C(q, \dot q)\,\dot q + g(q)` in one pass out along the
    tree and one pass back, without forming M, C or g. Armature, friction, payloads, external
    wrenches and base motion are set once and apply to all later calls.

    Parameters
    ----------
    robot : RobotModel
        Tree of n joints and b bodies, from `load_urdf`.
    gravity : array_like, shape (3,)
        Free-fall acceleration in the base frame [m/s^2].

    Raises
    ------
    ConfigurationError
        If gravity is not three finite numbers.

    Notes
    -----
    The first object on a machine compiles for some seconds; the machine code is cached on disk. An
    object contains scratch space: each thread needs its own.

    References
    ----------
    .. [LWP] J. Y. S. Luh, M. W. Walker, R. P. C. Paul, "Newton-Euler formulation of manipulator
       dynamics for computer control", IFAC, 1979, 165-172: equations (36)-(47).

    """

    def __init__(self, robot: RobotModel, gravity: ArrayLike = STANDARD_GRAVITY) -> None:
        self.robot = robot
        self._zeros = np.zeros(len(robot.joint_names))
        self._inverse_dynamics = prepared(newton_euler.inverse_dynamics, _V, _V, _V, _V, _M)
        self._batch = prepared(newton_euler.inverse_dynamics_batch, _M, _M, _M, _M, _M)
        self._gravity_efforts = prepared(newton_euler.gravity_efforts, _V, _V, _M)
        self._mass_matrix = prepared(mass_matrix.mass_matrix, _V, _M, _M)
        self._effort_terms = prepared(effort_terms.effort_terms, *(3 * (_V,)), *(7 * (_M,)))
        self._joint_wrenches = prepared(newton_euler.joint_wrenches, _V, _V, _V, _V, _M, _M, _M)
        self.loaded = LoadedRobot(robot)
        """The robot with its loads, as the passes read it; to be modified by the setters only."""
        self._table = self.loaded.table
        self._tau = np.empty_like(self._zeros)
        self._state = np.zeros((4, len(self._zeros)))
        self._terms_tables: tuple[Any, ...] = ()
        self._terms_revision = -1
        R_LZ = self.loaded.R_ZL.transpose(0, 2, 1)
        self._R_LZ = np.ascontiguousarray(R_LZ).reshape(len(R_LZ), 9)
        self._regressor_shape = (len(self._zeros), 10 * (len(R_LZ) - 1))
        self.set_gravity(gravity)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the robot and its loads; the compiled functions would be most of the bytes."""
        return _with_loads, (type(self), self.loaded)

    @property
    def gravity(self) -> Floats:
        """Free-fall acceleration in the base frame, shape (3,) [m/s^2]; read-only."""
        return self.loaded.gravity

    @property
    def table(self) -> Floats:
        """The table of `columns` with the robot and its loads; not to be modified."""
        return self.loaded.numbers

    # Gravity, loads, friction

    def set_gravity(self, gravity: ArrayLike) -> None:
        """
        Set gravity.

        Parameters
        ----------
        gravity : array_like, shape (3,)
            Free-fall acceleration in the base frame [m/s^2].

        Raises
        ------
        ConfigurationError
            If gravity is not three finite numbers.

        """
        vector = read_vector('gravity', gravity, 'm/s^2')
        vector.setflags(write=False)
        self.loaded.set_gravity(vector)

    def set_base_motion(
        self,
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_acceleration: ArrayLike = (0.0, 0.0, 0.0),
        linear_acceleration: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        """
        Set the motion of the base: omega_0, omega_dot_0 and v_dot_0 of LWP.

        Parameters
        ----------
        angular_velocity, angular_acceleration, linear_acceleration : array_like, shape (3,)
            Motion of the base frame and its origin, in the base frame [rad/s], [rad/s^2],
            [m/s^2]. The linear acceleration does not include gravity; an accelerometer on the
            base measures the linear acceleration minus gravity.

        Raises
        ------
        ConfigurationError
            If one is not three finite numbers.

        """
        motion = [
            read_vector('angular_velocity', angular_velocity, 'rad/s'),
            read_vector('angular_acceleration', angular_acceleration, 'rad/s^2'),
            read_vector('linear_acceleration', linear_acceleration, 'm/s^2'),
        ]
        self.loaded.set_base_motion(np.array(motion))

    def set_payload(
        self,
        link: str,
        mass: float,
        com: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ) -> None:
        """
        Attach a rigid body to a link, replacing the payload that the link had.

        Parameters
        ----------
        link : str
            Any link of the robot description.
        mass : float
            Mass of the payload [kg]; 0 removes it.
        com : array_like, shape (3,)
            Centre of mass in the link's frame [m].
        inertia : array_like, shape (3, 3)
            Inertia about the centre of mass, along the axes of the link's frame [kg m^2].

        Raises
        ------
        ConfigurationError
            If the link does not exist, or no rigid body has such a mass and inertia.

        """
        self.robot.link_index(link)
        self.loaded.set_payload(link, *read_inertial(mass, com, inertia))

    def set_external_wrench(
        self,
        link: str,
        force: ArrayLike = (0.0, 0.0, 0.0),
        moment: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        """
        Set the wrench that the world exerts on a link, replacing the previous one.

        Parameters
        ----------
        link : str
            Any link of the robot description.
        force, moment : array_like, shape (3,)
            In the link's frame, about its origin [N], [N m].

        Raises
        ------
        ConfigurationError
            If the link does not exist, or an argument is not three finite numbers.

        """
        self.robot.link_index(link)
        vectors = read_vector('force', force, 'N'), read_vector('moment', moment, 'N m')
        self.loaded.set_external_wrench(link, *vectors)

    def set_friction(
        self,
        damping: ArrayLike | None = None,
        coulomb: ArrayLike | None = None,
        width: ArrayLike = FRICTION_WIDTH,
        load_friction: ArrayLike = 0.0,
    ) -> None:
        r"""
        Set friction: :math:`d\,\dot q + (c + \eta\,|\tau_{load}|) \tanh(\dot q / w)`.

        Parameters
        ----------
        damping : array_like, shape (n,) or ()
            Viscous friction d [N m s/rad or N s/m]; by default, that of the robot description.
        coulomb : array_like, shape (n,) or ()
            Coulomb friction c [N m or N]; by default, that of the robot description.
        width : array_like, shape (n,) or ()
            Speed w over which Coulomb friction is smoothed [rad/s or m/s].
        load_friction : array_like, shape (n,) or ()
            Increase eta of Coulomb friction per effort that loads the gear [-].

        Raises
        ------
        ConfigurationError
            If a value is negative or not finite, or the width is zero.

        Notes
        -----
        The effort that loads the gear is what moves and holds the links: inertia, Coriolis and
        centrifugal efforts, and gravity, with payloads, base motion and external wrenches. It
        includes neither armature nor friction. Its product with eta is the usual model of gears
        whose losses are proportional to the transmitted effort [1]_.

        References
        ----------
        .. [1] P. Hamon, M. Gautier, P. Garrec, "Dynamic identification of robots with a dry
           friction model depending on load and velocity", IROS, 2010.

        """
        n = len(self._zeros)
        damping = self.robot.damping if damping is None else damping
        coulomb = self.robot.friction if coulomb is None else coulomb
        damping = read_joints('damping', damping, n)
        coulomb = read_joints('coulomb', coulomb, n)
        speeds = read_joints('width', width, n)
        if not (speeds >= np.finfo(float).tiny).all():  # the inverse of less may be infinite
            raise ConfigurationError(f'width is {width!r}, expected speeds above 0')
        load_friction = read_joints('load_friction', load_friction, n)
        # All arguments have been checked: a call that fails changes nothing.
        self.loaded.set_joints(columns.DAMPING, damping)
        self.loaded.set_joints(columns.COULOMB, coulomb)
        # Zero where it has no effect, so that it does not look like a load to generated code.
        inverse = np.where((coulomb > 0.0) | (load_friction > 0.0), 1.0 / speeds, 0.0)
        self.loaded.set_joints(columns.INVERSE_WIDTH, inverse)
        self.loaded.set_joints(columns.LOAD_FRICTION, load_friction)

    def set_armature(self, armature: ArrayLike) -> None:
        """
        Set the reflected inertia of rotors and gears.

        Parameters
        ----------
        armature : array_like, shape (n,) or ()
            Rotor inertia times the square of the gear ratio [kg m^2 or kg].

        Raises
        ------
        ConfigurationError
            If a value is negative or not finite.

        """
        values = read_joints('armature', armature, len(self._zeros))
        self.loaded.set_joints(columns.ARMATURE, values)

    # Quantities

    def efforts(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        out: Floats | None = None,
        threads: int = 1,
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
            Receives the result: C-contiguous float64 of the shape of the result.
        threads : int
            Maximum number of threads for a large batch. The results do not depend on it.

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N], positive along the joint axis; ``out`` if it was given.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.
        ConfigurationError
            If ``threads`` is not a positive integer.

        Notes
        -----
        Outward pass: LWP (36)-(44); inward pass: LWP (45)-(47). With arrays of float64 as
        arguments and ``out``, nothing is allocated.

        Batches of 64 states and more are computed in blocks. The results differ from those of
        single states by rounding, less than 1e-12 of the largest effort. The first such batch
        compiles for seconds; the machine code is cached on disk.

        """
        try:
            # Checked first, because numba takes as long to reject a batch as for 100 states.
            if q.ndim == 1:  # type: ignore[union-attr]
                tau = np.empty_like(self._zeros) if out is None else out
                if self._inverse_dynamics(q, qd, qdd, tau, self._table):
                    raise explain(self.robot.joint_names, out, q=q, qd=qd, qdd=qdd)
                return tau
        except (AttributeError, TypeError, ValueError):  # lists, integers, views with strides
            pass
        return self._efforts_of_any(self._table, q, qd, qdd, out, read_threads(threads))

    def gravity_efforts(self, q: ArrayLike, out: Floats | None = None) -> Floats:
        """
        Compute the joint efforts that hold the robot still.

        Parameters
        ----------
        q : array_like, shape (..., n)
            Joint positions [rad or m].
        out : ndarray, optional
            As for `efforts`.

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N]: `efforts` for velocities and accelerations of zero.

        Raises
        ------
        JointStateError
            If the shape does not fit the robot, or a value is not finite.

        """
        if not self.loaded.is_rotating:
            try:
                if q.ndim == 1:  # type: ignore[union-attr]
                    tau = np.empty_like(self._zeros) if out is None else out
                    if self._gravity_efforts(q, tau, self._table):
                        raise explain(self.robot.joint_names, out, q=q)
                    return tau
            except (AttributeError, TypeError, ValueError):
                pass
        return self._efforts_of_any(self._table, q, self._zeros, self._zeros, out)

    def coriolis_efforts(self, q: ArrayLike, qd: ArrayLike, out: Floats | None = None) -> Floats:
        """
        Compute C(q, qd) qd: the Coriolis and centrifugal efforts.

        Parameters
        ----------
        q, qd : array_like, shape (..., n)
            Joint positions [rad or m] and velocities [rad/s or m/s].
        out : ndarray, optional
            As for `efforts`.

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N], including those due to the rotation of the base.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        """
        table = self.loaded.only('velocity')
        if not self.loaded.is_rotating:
            return self._efforts_in(table, q, qd, self._zeros, out)
        # Computed first, because `out` may be q.
        resting = self._efforts_in(table, q, self._zeros, self._zeros)
        tau = self._efforts_in(table, q, qd, self._zeros, out)
        tau -= resting
        return tau

    def mass_matrix(self, q: ArrayLike, out: Floats | None = None) -> Floats:
        """
        Compute the mass matrix M(q).

        Parameters
        ----------
        q : array_like, shape (..., n)
            Joint positions [rad or m].
        out : ndarray, optional
            Receives the result: C-contiguous float64 of the shape of the result.

        Returns
        -------
        mass_matrix : ndarray, shape (..., n, n)
            Symmetric to the last bit [kg m^2, kg m or kg, depending on the kinds of joints].
            Includes payloads and armature.

        Raises
        ------
        JointStateError
            If the shape does not fit the robot, or a value is not finite.

        Notes
        -----
        The composite-rigid-body algorithm; see `mass_matrix` for its references.

        """
        try:
            if q.ndim == 1:  # type: ignore[union-attr]
                matrix = np.empty(2 * self._zeros.shape) if out is None else out
                if self._mass_matrix(q, matrix, self._table):
                    shape = 2 * self._zeros.shape
                    raise explain(self.robot.joint_names, out, shape, q=q)
                return matrix
        except (AttributeError, TypeError, ValueError):
            pass
        return self._matrices(
            2 * self._zeros.shape,
            lambda states, out: self._mass_matrix(*states, out, self._table),
            lambda states, out: batch_mass_matrix.mass_matrix_many(states[0], out, self.table),
            out,
            q=q,
        )

    def effort_terms(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None = None
    ) -> EffortTerms:
        """
        Compute the joint efforts term by term.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            As for `efforts`.
        out : ndarray, shape (5, ..., n), optional
            Receives the terms.

        Returns
        -------
        terms : EffortTerms
            Named tuple of arrays of shape (..., n) [N m or N]; their sum is `efforts`.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        """
        try:
            if IS_COMPILED and q.ndim == 1:  # type: ignore[union-attr]
                found = np.empty((5, len(self._zeros))) if out is None else out
                return self._terms_of_state(q, qd, qdd, found)
        except (AttributeError, TypeError, ValueError):
            pass
        rows, shape = broadcast(len(self._zeros), q=q, qd=qd, qdd=qdd)
        q, qd, qdd = (row.reshape(shape) for row in rows)
        if out is not None:
            check_out(out, (5, *shape))
            if not is_free(out, rows):
                out[...] = self.effort_terms(q, qd, qdd)
                return EffortTerms(*out)
        found = np.empty((5, *shape)) if out is None else out
        if IS_COMPILED and len(shape) == 1:
            return self._terms_of_state(q, qd, qdd, found)
        terms = EffortTerms(*found)
        zeros = self._zeros if shape == self._zeros.shape else np.zeros(shape)
        only = self.loaded.only
        self._efforts_in(only('inertial'), q, zeros, qdd, terms.inertial)
        self.coriolis_efforts(q, qd, terms.velocity)
        self._efforts_in(only('gravity'), q, zeros, zeros, terms.gravity)
        self._efforts_in(only('constant friction'), q, qd, zeros, terms.friction)
        if self._table[0][columns.HAS_LOAD_FRICTION]:
            load = self._efforts_in(only('load on gears'), q, qd, qdd)
            of_joints: Floats = self.loaded.numbers[1 : 1 + len(self._zeros)]
            step = np.tanh(qd * of_joints[:, columns.INVERSE_WIDTH])
            friction = terms.friction
            friction += of_joints[:, columns.LOAD_FRICTION] * np.abs(load) * step
        self._efforts_in(only('external'), q, zeros, zeros, terms.external)
        return terms

    def _terms_of_state(self, q: Any, qd: Any, qdd: Any, out: Floats) -> EffortTerms:
        if self._effort_terms(q, qd, qdd, self._state, out, *self._tables_of_terms()):
            shape = (5, len(self._zeros))
            raise explain(self.robot.joint_names, out, shape, q=q, qd=qd, qdd=qdd)
        return EffortTerms(*out)

    def _tables_of_terms(self) -> tuple[Any, ...]:
        """Return the tables for `effort_terms`; kept until a load changes."""
        if self._terms_revision != self.loaded.revision:
            terms = ('inertial', 'velocity', 'gravity', 'external')
            self._terms_tables = (*map(self.loaded.only, terms), self._table)
            self._terms_revision = self.loaded.revision
        return self._terms_tables

    def joint_wrenches(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None = None
    ) -> JointWrenches:
        """
        Compute the force and moment at every joint, the reaction of the mount first.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            As for `efforts`.
        out : ndarray, shape (..., b, 6), optional
            Receives force and moment: C-contiguous float64.

        Returns
        -------
        wrenches : JointWrenches
            Named tuple of ``force`` [N] and ``moment`` [N m], each of shape (..., b, 3).

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        Notes
        -----
        LWP (45) and (46). The moment about the axis of a revolute joint, or the force along the
        axis of a prismatic one, is the joint's effort without armature and friction, which act
        inside the joint.

        """
        shape = (len(self._R_LZ), 6)
        try:
            if q.ndim == 1:  # type: ignore[union-attr]
                wrenches = np.empty(shape) if out is None else out
                arguments = (q, qd, qdd, self._tau, self._R_LZ, wrenches, self._table)
                if self._joint_wrenches(*arguments):
                    raise explain(self.robot.joint_names, out, shape, q=q, qd=qd, qdd=qdd)
                return JointWrenches(wrenches[:, :3], wrenches[:, 3:])
        except (AttributeError, TypeError, ValueError):
            pass
        wrenches = self._matrices(
            shape,
            lambda states, out: self._joint_wrenches(
                *states, self._tau, self._R_LZ, out, self._table
            ),
            lambda states, out: batch.joint_wrenches_many(
                (*states, np.empty_like(states[0])), out, self._R_LZ, self.table
            ),
            out,
            q=q,
            qd=qd,
            qdd=qdd,
        )
        return JointWrenches(wrenches[..., :3], wrenches[..., 3:])

    def regressor(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None = None
    ) -> Floats:
        r"""
        Compute the regressor Y of the inertial parameters: :math:`\tau = Y(q, qd, qdd)\,\pi`.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            As for `efforts`.
        out : ndarray, shape (..., n, 10 (b - 1)), optional
            Receives the result: C-contiguous float64.

        Returns
        -------
        regressor : ndarray, shape (..., n, 10 (b - 1))
            Ten columns for each moving body, in the order of ``robot.body_names[1:]``, which are
            the names of the joints that move them: for mass [kg], mass times centre of mass (x,
            y, z) [kg m], and inertia about the origin of the body's frame (xx, xy, yy, xz, yz,
            zz) [kg m^2], as in Pinocchio. The frame is the URDF frame of the joint.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        See Also
        --------
        inertial_parameters : pi of this robot.

        Notes
        -----
        Links that fixed joints hold together are one body. A body that a mimic joint moves has
        columns of its own, and adds to the row of the joint that is mimicked. Gravity and the
        motion of the base are included. Armature, friction and external wrenches are not: the
        efforts due to them do not depend on pi. Payloads are part of pi and do not change Y.

        The first call on a machine compiles; the machine code is cached on disk.

        """
        try:
            if q.ndim == 1:  # type: ignore[union-attr]
                matrix = np.empty(self._regressor_shape) if out is None else out
                if self._regressor(q, qd, qdd, self._R_LZ, matrix, self._table):
                    shape = self._regressor_shape
                    raise explain(self.robot.joint_names, out, shape, q=q, qd=qd, qdd=qdd)
                return matrix
        except (AttributeError, TypeError, ValueError):
            pass
        return self._matrices(
            self._regressor_shape,
            lambda states, out: self._regressor(*states, self._R_LZ, out, self._table),
            lambda states, out: batch_regressor.regressor_many(
                states, out, self._R_LZ, self.table
            ),
            out,
            q=q,
            qd=qd,
            qdd=qdd,
        )

    def inertial_parameters(self) -> Floats:
        """
        Return the inertial parameters pi of the moving bodies, including payloads.

        Returns
        -------
        parameters : ndarray, shape (10 (b - 1),)
            In the order of the columns of `regressor`. ``regressor(q, qd, qdd) @ parameters`` are
            the efforts of a robot without armature, friction and external wrenches.

        """
        bodies = range(1, len(self.robot.parent))
        parameters = [self.loaded.rigid_body(body).parameters() for body in bodies]
        return np.array(parameters).reshape(-1)

    @cached_property
    def _regressor(self) -> Callable[..., int]:
        """Prepared at the first use, because most programs do not need it."""
        return prepared(regressor.regressor, _V, _V, _V, _M, _M, _M)

    def _matrices(
        self,
        kind: tuple[int, ...],
        one: Callable[[list[Floats], Floats], int],
        many: Callable[[list[Floats], Floats], int],
        out: Floats | None,
        **arguments: ArrayLike,
    ) -> Floats:
        """
        Compute a quantity of anything that numpy can read as rows of n numbers.

        Parameters
        ----------
        kind : tuple of int
            Shape of the result for one state.
        one, many : callable
            Compute the quantity for a state, and for at least `lanes.FEWEST` states in blocks;
            return a status.
        out : ndarray, optional
            Receives the result.
        **arguments : array_like
            Joint positions and so on, by name.

        """
        rows, shape = broadcast(len(self._zeros), **arguments)
        shape = (*shape[:-1], *kind)
        if out is not None:
            check_out(out, shape)
        result = np.empty(shape) if out is None or not is_free(out, rows) else out
        flat = result.reshape(len(rows[0]), *kind)
        if self._zeros.size and len(flat) >= FEWEST:
            status = many(rows, flat)
        else:
            states = zip(zip(*rows, strict=True), flat, strict=True)
            status = max((one(list(state), entry) for state, entry in states), default=OK)
        if status != OK:
            raise explain(self.robot.joint_names, None, None, **arguments)
        if out is None or result is out:
            return result
        out[...] = result
        return out

    def _efforts_in(
        self,
        table: Any,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        out: Floats | None = None,
    ) -> Floats:
        """Compute efforts with a table of `LoadedRobot`, quickly if the arguments are arrays."""
        try:
            if q.ndim == 1:  # type: ignore[union-attr]
                tau = np.empty_like(self._zeros) if out is None else out
                if self._inverse_dynamics(q, qd, qdd, tau, table):
                    raise explain(self.robot.joint_names, out, q=q, qd=qd, qdd=qdd)
                return tau
        except (AttributeError, TypeError, ValueError):
            pass
        return self._efforts_of_any(table, q, qd, qdd, out)

    def _efforts_of_any(
        self,
        table: Any,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        out: Floats | None = None,
        threads: int = 1,
    ) -> Floats:
        """Compute efforts of anything that numpy can read as rows of n numbers."""
        rows, shape = broadcast(len(self._zeros), q=q, qd=qd, qdd=qdd)
        if out is not None:
            check_out(out, shape)
        tau = np.empty(shape) if out is None or not is_free(out, rows) else out
        states = (*rows, tau.reshape(rows[0].shape))
        if tau.size and len(rows[0]) >= FEWEST:
            status = batch.inverse_dynamics_many(states, np.asarray(table), threads)
        else:
            status = self._batch(*states, table)
        if status != OK:
            raise explain(self.robot.joint_names, q=q, qd=qd, qdd=qdd)
        if out is None or tau is out:
            return tau
        out[...] = tau
        return out


def _with_loads(kind: type[InverseDynamics], loaded: LoadedRobot) -> InverseDynamics:
    dynamics = kind(loaded.robot)
    dynamics.loaded, dynamics._table = loaded, loaded.table
    return dynamics
