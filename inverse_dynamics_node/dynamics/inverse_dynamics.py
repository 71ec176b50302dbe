"""Inverse dynamics of one robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..robot.model import Floats, RobotModel
from . import batch, effort_terms, link_kinematics, mass_matrix, newton_euler, regressor
from .arguments import broadcast, check_out, explain, is_free
from .dispatch import one_by_one, over_states
from .effort_terms import EffortTerms, JointWrenches, TermTables
from .kernels import MATRICES as _MS
from .kernels import MATRIX as _M
from .kernels import prepared
from .kernels import VECTOR as _V
from .loaded_robot import LoadedRobot, STANDARD_GRAVITY


class InverseDynamics(LoadedRobot):
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
        super().__init__(robot, gravity)
        self._inverse_dynamics = prepared(newton_euler.inverse_dynamics, _V, _V, _V, _V, _M)
        self._batch = prepared(newton_euler.inverse_dynamics_batch, _M, _M, _M, _M, _M)
        self._gravity_efforts = prepared(newton_euler.gravity_efforts, _V, _V, _M)
        self._mass_matrix = prepared(mass_matrix.mass_matrix, _V, _M, _M)
        self._effort_terms = prepared(effort_terms.effort_terms, *(3 * (_V,)), *(7 * (_M,)))
        self._joint_wrenches = prepared(effort_terms.joint_wrenches, *(4 * (_V,)), _M, _M, _M)
        n = len(robot.joint_names)
        self._zeros, self._tau, self._state = np.zeros(n), np.empty(n), np.zeros((4, n))
        self._terms = TermTables(self.table)
        self._regressor_shape = n, 10 * (len(robot.parent) - 1)
        self._links: dict[str, Floats] = {}

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
            Receives the result: C-contiguous float64 of the shape of the result.

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N], positive along the joint axis; ``out`` if it was given.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

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
                # After a failure, the slower way below finds its cause.
                if not self._inverse_dynamics(q, qd, qdd, tau, self._table):
                    return tau
        except (AttributeError, TypeError, ValueError):  # lists, integers, views with strides
            pass
        return self._efforts_of_any(self._table, q, qd, qdd, out)

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
        if not self._is_rotating:
            try:
                if q.ndim == 1:  # type: ignore[union-attr]
                    tau = np.empty_like(self._zeros) if out is None else out
                    if not self._gravity_efforts(q, tau, self._table):
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
        table = self._terms.only('coriolis', self.revision)
        if not self._is_rotating:
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
                if not self._mass_matrix(q, matrix, self._table):
                    return matrix
        except (AttributeError, TypeError, ValueError):
            pass
        return over_states(
            self.robot,
            2 * self._zeros.shape,
            one_by_one(lambda state, out: self._mass_matrix(*state, out, self._table)),
            lambda states, out: self._mass_matrices(*states, out, self._table),
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
            if q.ndim == 1:  # type: ignore[union-attr]
                found = np.empty((5, len(self._zeros))) if out is None else out
                return self._terms_of_state(q, qd, qdd, found)
        except (AttributeError, TypeError, ValueError):
            pass
        rows, shape = broadcast(len(self._zeros), q=q, qd=qd, qdd=qdd)
        if out is not None:
            check_out(out, (5, *shape))
        found = np.empty((5, *shape)) if out is None or not is_free(out, rows) else out
        if len(shape) == 1:
            self._terms_of_state(rows[0][0], rows[1][0], rows[2][0], found)
        else:
            self._terms_of_many(rows[0], rows[1], rows[2], found.reshape(5, *rows[0].shape))
        if out is None or found is out:
            return EffortTerms(*found)
        out[...] = found
        return EffortTerms(*out)

    def _terms_of_state(self, q: Any, qd: Any, qdd: Any, out: Floats) -> EffortTerms:
        """Compute all terms in one compiled call."""
        tables = self._terms.of_kernel(self.revision)
        if self._effort_terms(q, qd, qdd, self._state, *tables, out, self._table):
            shape = (5, len(self._zeros))
            raise explain(self.robot.joint_names, out, shape, q=q, qd=qd, qdd=qdd)
        return EffortTerms(*out)

    def _terms_of_many(self, q: Floats, qd: Floats, qdd: Floats, out: Floats) -> None:
        """Compute the terms of many states by one pass over all of them for each term."""
        zeros, only, revision = np.zeros(q.shape), self._terms.only, self.revision
        terms = EffortTerms(*out)
        self._efforts_in(only('inertial', revision), q, zeros, qdd, terms.inertial)
        self.coriolis_efforts(q, qd, terms.coriolis)
        self._efforts_in(only('gravity', revision), q, zeros, zeros, terms.gravity)
        self._efforts_in(only('external', revision), q, zeros, zeros, terms.external)
        if self._friction_terms(qd, qdd, out, self._table):
            raise explain(self.robot.joint_names, q=q, qd=qd, qdd=qdd)

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
                if not self._joint_wrenches(*arguments):
                    return JointWrenches(wrenches[:, :3], wrenches[:, 3:])
        except (AttributeError, TypeError, ValueError):
            pass

        def one(state: Sequence[Floats], out: Floats) -> int:
            return self._joint_wrenches(*state, self._tau, self._R_LZ, out, self._table)

        def many(states: Sequence[Floats], out: Floats) -> int:
            return self._all_wrenches(*states, self._tau, self._R_LZ, out, self._table)

        wrenches = over_states(self.robot, shape, one_by_one(one), many, out, q=q, qd=qd, qdd=qdd)
        return JointWrenches(wrenches[..., :3], wrenches[..., 3:])

    def pose(self, q: ArrayLike, link: str, out: Floats | None = None) -> Floats:
        """
        Compute the pose of a link in the base frame.

        Parameters
        ----------
        q : array_like, shape (..., n)
            Joint positions [rad or m].
        link : str
            Any link of the robot description.
        out : ndarray, shape (..., 4, 4), optional
            Receives the result: C-contiguous float64.

        Returns
        -------
        pose : ndarray, shape (..., 4, 4)
            Homogeneous matrix from the link's frame to the base frame, which is that of the root
            link: ``pose[..., :3, :3]`` is the rotation, ``pose[..., :3, 3]`` the position of the
            link's origin [m].

        Raises
        ------
        ConfigurationError
            If the link does not exist.
        JointStateError
            If the shape does not fit the robot, or a value is not finite.

        """
        return self._of_link(self._pose, (4, 4), q, link, out)

    def jacobian(self, q: ArrayLike, link: str, out: Floats | None = None) -> Floats:
        r"""
        Compute the geometric Jacobian J of a link: :math:`J\,\dot q` is its velocity.

        Parameters
        ----------
        q : array_like, shape (..., n)
            Joint positions [rad or m].
        link : str
            Any link of the robot description.
        out : ndarray, shape (..., 6, n), optional
            Receives the result: C-contiguous float64.

        Returns
        -------
        jacobian : ndarray, shape (..., 6, n)
            Rows 0 to 2 are linear: the velocity of the origin of the link's frame [m/s]. Rows 3 to
            5 are angular: the angular velocity of the link [rad/s]. Both are relative to the base
            and in coordinates of the base frame. Columns are per unit of joint velocity [rad/s or
            m/s], in the order of ``robot.joint_names``; those of joints that do not move the link
            are zero.

        Raises
        ------
        ConfigurationError
            If the link does not exist.
        JointStateError
            If the shape does not fit the robot, or a value is not finite.

        See Also
        --------
        pose : ``R = pose(q, link)[:3, :3]`` rotates vectors from the link's frame to the base's.

        Notes
        -----
        The transpose maps a force and a moment about the link's origin, in coordinates of the
        base, to the joint efforts that do the same work. To exert them on the world, a robot
        needs these efforts in addition; `set_external_wrench`, which is about what the world
        exerts and in the link's frame, subtracts them. The motion of the base is not included.
        A mimic joint adds to the column of the joint that it mimics.

        """
        return self._of_link(self._jacobian, (6, len(self._zeros)), q, link, out)

    def _of_link(
        self,
        compute: Callable[..., int],
        shape: tuple[int, ...],
        q: ArrayLike,
        link: str,
        out: Floats | None,
    ) -> Floats:
        """Compute a matrix of a link with a function of `link_kinematics`."""
        if link not in self._links:
            self._links[link] = self._row_of_link(link)
        row = self._links[link]
        try:
            if q.ndim == 1:  # type: ignore[union-attr]
                matrix = np.empty(shape) if out is None else out
                if not compute(q, row, matrix, self._table):
                    return matrix
        except (AttributeError, TypeError, ValueError):
            pass
        each = one_by_one(lambda state, out: compute(*state, row, out, self._table))
        return over_states(self.robot, shape, each, each, out, q=q)

    def _row_of_link(self, link: str) -> Floats:
        """Return the body of a link and its place in it, for `link_kinematics`."""
        k = self.robot.link_index(link)
        body = self.robot.link_body[k]
        origin = self._R_ZL[body] @ self.robot.link_position[k]
        axes = self._R_ZL[body] @ self.robot.link_rotation[k]
        return np.array([body, *origin, *axes.T.ravel()])

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
        shape = self._regressor_shape
        try:
            if q.ndim == 1:  # type: ignore[union-attr]
                matrix = np.empty(shape) if out is None else out
                if not self._regressor(q, qd, qdd, self._R_LZ, matrix, self._table):
                    return matrix
        except (AttributeError, TypeError, ValueError):
            pass

        def one(state: Sequence[Floats], out: Floats) -> int:
            return self._regressor(*state, self._R_LZ, out, self._table)

        def many(states: Sequence[Floats], out: Floats) -> int:
            return batch.regressor_many(states, out, self._R_LZ, self._table)

        return over_states(self.robot, shape, one_by_one(one), many, out, q=q, qd=qd, qdd=qdd)

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
        parameters = [self._rigid_body(body).parameters() for body in bodies]
        return np.array(parameters).reshape(-1)

    def _efforts_in(
        self,
        table: Any,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        out: Floats | None = None,
    ) -> Floats:
        """Compute efforts with a table of `TermTables`, quickly if the arguments are arrays."""
        try:
            if q.ndim == 1:  # type: ignore[union-attr]
                tau = np.empty_like(self._zeros) if out is None else out
                if not self._inverse_dynamics(q, qd, qdd, tau, table):
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
    ) -> Floats:
        """Compute efforts of anything that numpy can read as rows of n numbers."""

        def few(states: Sequence[Floats], out: Floats) -> int:
            return self._batch(*states, out, table)

        def many(states: Sequence[Floats], out: Floats) -> int:
            return batch.inverse_dynamics_many(states, out, table)

        return over_states(self.robot, self._zeros.shape, few, many, out, q=q, qd=qd, qdd=qdd)

    @cached_property
    def _regressor(self) -> Callable[..., int]:
        """Prepared at the first use, like the next ones, because most programs do not need it."""
        return prepared(regressor.regressor, _V, _V, _V, _M, _M, _M)

    @cached_property
    def _pose(self) -> Callable[..., int]:
        return prepared(link_kinematics.pose, _V, _V, _M, _M)

    @cached_property
    def _jacobian(self) -> Callable[..., int]:
        return prepared(link_kinematics.jacobian, _V, _V, _M, _M)

    @cached_property
    def _mass_matrices(self) -> Callable[..., int]:
        return prepared(mass_matrix.mass_matrix_batch, _M, _MS, _M)

    @cached_property
    def _friction_terms(self) -> Callable[..., int]:
        return prepared(effort_terms.friction_batch, _M, _M, _MS, _M)

    @cached_property
    def _all_wrenches(self) -> Callable[..., int]:
        return prepared(effort_terms.joint_wrenches_batch, _M, _M, _M, _V, _M, _MS, _M)
