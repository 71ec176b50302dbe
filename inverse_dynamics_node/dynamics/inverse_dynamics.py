"""Inverse dynamics of one robot, including loads, friction and external wrenches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ConfigurationError
from ..robot.model import Floats, RobotModel
from ..robot.rigid_body import combine, RigidBody
from . import (
    batch,
    effort_terms,
    link_kinematics,
    mass_matrix,
    newton_euler,
    regressor,
    robot_table,
)
from .arguments import check_out, over_states, read_inertial, read_joints, read_vector
from .effort_terms import EffortTerms, JointWrenches
from .jit import arrays, compile_for

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
"""Standard gravity of ISO 80000-3, in a base frame with z upwards [m/s^2]."""

FRICTION_WIDTH = 0.01
"""Speed at which smoothed Coulomb friction reaches 76 % of the full value [rad/s or m/s]."""


class InverseDynamics:
    r"""
    Inverse dynamics of one robot.

    `efforts` evaluates :math:`\tau = M(q)\,\ddot q + C(q, \dot q)\,\dot q + g(q)` by the recursive
    Newton-Euler algorithm, without computing M, C or g. Armature, friction, payloads, external
    wrenches and base motion are set once, and apply to all later calls.

    Parameters
    ----------
    robot : RobotModel
        Robot with n joints and b bodies, from `load_urdf`.
    gravity : array_like, shape (3,)
        Free-fall acceleration in the base frame [m/s^2].

    Raises
    ------
    ConfigurationError
        If gravity is not a vector of three finite numbers.

    Attributes
    ----------
    robot : RobotModel
        The robot without loads.

    Notes
    -----
    Creating the first object on a machine takes a few seconds, because code is compiled and cached
    on disk. Each thread needs its own object, because every object contains scratch memory.

    References
    ----------
    .. [LWP] J. Y. S. Luh, M. W. Walker, R. P. C. Paul, "Newton-Euler formulation of manipulator
       dynamics for computer control", IFAC, 1979, 165-172: equations (36)-(47).

    """

    def __init__(self, robot: RobotModel, gravity: ArrayLike = STANDARD_GRAVITY) -> None:
        self.robot = robot
        self._table = robot_table.table_of(robot)
        self._R_ZL = robot_table.rotations_to_z(robot)
        self._R_LZ = np.ascontiguousarray(self._R_ZL.transpose(0, 2, 1)).reshape(-1, 9)
        self._base_motion: Floats = np.zeros((3, 3))  # as in `set_base_motion`
        self._is_rotating = False  # whether the base has an angular velocity or acceleration
        self._payloads: dict[str, RigidBody] = {}
        self._wrenches: dict[str, tuple[Floats, Floats]] = {}
        self.set_gravity(gravity)
        self._inverse_dynamics = compile_for(newton_euler.inverse_dynamics, arrays(1, 1, 1, 1, 2))
        self._gravity_efforts = compile_for(newton_euler.gravity_efforts, arrays(1, 1, 2))
        self._mass_matrix = compile_for(mass_matrix.mass_matrix, arrays(1, 2, 2))
        n = len(robot.joint_names)
        self._zeros, self._tau = np.zeros(n), np.empty(n)
        self._links: dict[str, Floats] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle only the robot and its loads, because compiled functions are much larger."""
        loads = (self._table, self._base_motion, self._payloads, self._wrenches)
        return type(self), (self.robot, self._gravity), loads

    def __setstate__(self, loads: tuple[Any, ...]) -> None:
        self._table[...], self._base_motion, payloads, wrenches = loads
        self._is_rotating = bool(self._base_motion[:2].any())
        self._payloads, self._wrenches = payloads.copy(), wrenches.copy()

    @property
    def gravity(self) -> Floats:
        """Free-fall acceleration in the base frame, shape (3,) [m/s^2], read-only."""
        return self._gravity

    @property
    def table(self) -> Floats:
        """Internal table of the robot and its loads; do not modify the table."""
        return self._table

    @property
    def has_drive_terms(self) -> bool:
        """Whether any joint has friction or armature."""
        return bool(self._table[0, robot_table.HAS_DRIVE_TERMS])

    def efforts(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None = None
    ) -> Floats:
        """
        Compute the joint efforts that produce given joint accelerations.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            Positions [rad or m], velocities [rad/s or m/s] and accelerations [rad/s^2 or m/s^2]
            of the n joints, in the order of ``robot.joint_names``. Leading dimensions form a
            batch, and are broadcast against each other.
        out : ndarray, shape (..., n), optional
            Array for the result, C-contiguous float64.

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N], positive along the joint axis; ``out`` itself if given.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        Notes
        -----
        The outward pass is LWP (36)-(44), and the inward pass is LWP (45)-(47). No memory is
        allocated for a single state if the arguments and ``out`` are contiguous float64 arrays.

        Batches of at least 64 states are computed in blocks. The results may differ from those of
        single states by rounding errors of less than 1e-12 of the largest effort. The first large
        batch on a machine takes seconds, because code is compiled and cached on disk.

        """
        try:
            # Checked first, because numba needs the time of 100 states to reject a batch.
            if q.ndim == 1:  # type: ignore[union-attr]
                tau = np.empty_like(self._zeros) if out is None else out
                # After a failure, the slower code below finds the cause.
                if not self._inverse_dynamics(q, qd, qdd, tau, self._table):
                    return tau
        except (AttributeError, TypeError, ValueError):  # lists, integers, views with strides
            pass
        return self._efforts_in(self._table, q, qd, qdd, out)

    def gravity_efforts(self, q: ArrayLike, out: Floats | None = None) -> Floats:
        """
        Compute the joint efforts that hold the robot still.

        Parameters
        ----------
        q : array_like, shape (..., n)
            Positions of the n joints [rad or m].
        out : ndarray, optional
            Array for the result, as for `efforts`.

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N], equal to `efforts` at zero velocities and accelerations.

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
        return self._efforts_in(self._table, q, self._zeros, self._zeros, out)

    def coriolis_efforts(self, q: ArrayLike, qd: ArrayLike, out: Floats | None = None) -> Floats:
        """
        Compute the Coriolis and centrifugal efforts C(q, qd) qd.

        Parameters
        ----------
        q, qd : array_like, shape (..., n)
            Positions [rad or m] and velocities [rad/s or m/s] of the n joints.
        out : ndarray, optional
            Array for the result, as for `efforts`.

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N], zero at zero velocities. The rotation of the base contributes
            Coriolis efforts.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        """
        table = self._table.copy()
        table[:, robot_table.LOAD_COLUMNS] = 0.0
        table[0, robot_table.BASE_ACCELERATION_COLUMNS] = 0.0
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
            Positions of the n joints [rad or m].
        out : ndarray, shape (..., n, n), optional
            Array for the result, C-contiguous float64.

        Returns
        -------
        mass_matrix : ndarray, shape (..., n, n)
            Mass matrix [kg m^2, kg m or kg], including payloads and armature. The matrix is
            exactly symmetric.

        Raises
        ------
        JointStateError
            If the shape does not fit the robot, or a value is not finite.

        Notes
        -----
        The method is the composite-rigid-body algorithm of Walker and Orin (1982).

        """
        try:
            if q.ndim == 1:  # type: ignore[union-attr]
                matrix = np.empty(2 * self._zeros.shape) if out is None else out
                if not self._mass_matrix(q, matrix, self._table):
                    return matrix
        except (AttributeError, TypeError, ValueError):
            pass

        def one(q: Floats, matrix: Floats) -> int:
            return self._mass_matrix(q, matrix, self._table)

        return over_states(self.robot, 2 * self._zeros.shape, one, out, q=q)

    def effort_terms(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None = None
    ) -> EffortTerms:
        """
        Compute the joint efforts term by term.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            Positions, velocities and accelerations of the n joints, as for `efforts`.
        out : ndarray, shape (5, ..., n), optional
            Array for the five terms, float64.

        Returns
        -------
        terms : EffortTerms
            Named tuple of five arrays of shape (..., n) [N m or N]. The sum of the five arrays
            equals `efforts`.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        """
        total, rest = self.efforts(q, qd, qdd), self._zeros
        table = self._table.copy()
        table[:, robot_table.FRICTION_COLUMNS] = 0.0
        driven = self._efforts_in(table, q, qd, qdd)
        coasting = self._efforts_in(table, q, qd, rest)
        resting = self._efforts_in(table, q, rest, rest)
        table[:, robot_table.EXTERNAL_COLUMNS] = 0.0
        gravity = self._efforts_in(table, q, rest, rest)
        terms = EffortTerms(
            driven - coasting, coasting - resting, gravity, total - driven, resting - gravity
        )
        if out is None:
            out = np.empty((5, *total.shape))
        check_out(out, (5, *total.shape))
        for target, term in zip(out, terms, strict=True):
            target[...] = term
        return EffortTerms(*out)

    def joint_wrenches(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None = None
    ) -> JointWrenches:
        """
        Compute the force and moment at the mount of the base and at every joint.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            Positions, velocities and accelerations of the n joints, as for `efforts`.
        out : ndarray, shape (..., b, 6), optional
            Array for the forces and moments on b bodies, C-contiguous float64.

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
        The equations are LWP (45) and (46). The wrenches exclude armature, friction and springs,
        which act inside the joint. For a robot without armature, friction, springs and mimic
        joints, the moment about the axis of a revolute joint equals the joint effort. For a
        prismatic joint, the force along the axis equals the joint effort.

        """

        def one(q: Floats, qd: Floats, qdd: Floats, wrenches: Floats) -> int:
            return self._joint_wrenches(q, qd, qdd, self._tau, self._R_LZ, wrenches, self._table)

        shape = (len(self._R_LZ), 6)
        wrenches = over_states(self.robot, shape, one, out, q=q, qd=qd, qdd=qdd)
        return JointWrenches(wrenches[..., :3], wrenches[..., 3:])

    def pose(self, q: ArrayLike, link: str, out: Floats | None = None) -> Floats:
        """
        Compute the pose of a link in the base frame.

        Parameters
        ----------
        q : array_like, shape (..., n)
            Positions of the n joints [rad or m].
        link : str
            Any link of the robot description.
        out : ndarray, shape (..., 4, 4), optional
            Array for the result, C-contiguous float64.

        Returns
        -------
        pose : ndarray, shape (..., 4, 4)
            Homogeneous matrix from the link's frame to the base frame, which is the frame of the
            root link. The rotation is ``pose[..., :3, :3]``. The position of the link's origin is
            ``pose[..., :3, 3]`` [m].

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
        Compute the geometric Jacobian J of a link.

        Parameters
        ----------
        q : array_like, shape (..., n)
            Positions of the n joints [rad or m].
        link : str
            Any link of the robot description.
        out : ndarray, shape (..., 6, n), optional
            Array for the result, C-contiguous float64.

        Returns
        -------
        jacobian : ndarray, shape (..., 6, n)
            Rows 0 to 2 of :math:`J\,\dot q` are the velocity of the link's origin [m/s]. Rows 3 to
            5 are the angular velocity of the link [rad/s]. Velocities are relative to the base,
            in base coordinates. The columns are in the order of ``robot.joint_names``. A joint
            that does not move the link has a column of zeros.

        Raises
        ------
        ConfigurationError
            If the link does not exist.
        JointStateError
            If the shape does not fit the robot, or a value is not finite.

        See Also
        --------
        pose : ``R = pose(q, link)[:3, :3]`` rotates vectors from link to base coordinates.

        Notes
        -----
        The transpose of J maps a wrench that the link exerts on the world to the joint efforts
        that the robot needs in addition to `efforts`. The wrench consists of a force, and a moment
        about the link's origin, in base coordinates. `set_external_wrench` expects the opposite
        wrench, which the world exerts on the link, in link coordinates.

        J does not include the motion of the base. A mimic joint contributes to the column of its
        master joint.

        """
        return self._of_link(self._jacobian, (6, len(self._zeros)), q, link, out)

    def regressor(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, out: Floats | None = None
    ) -> Floats:
        r"""
        Compute the regressor Y of the inertial parameters: :math:`\tau = Y(q, qd, qdd)\,\pi`.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            Positions, velocities and accelerations of the n joints, as for `efforts`.
        out : ndarray, shape (..., n, 10 (b - 1)), optional
            Array for the result, C-contiguous float64.

        Returns
        -------
        regressor : ndarray, shape (..., n, 10 (b - 1))
            Ten columns for each of the b - 1 moving bodies, in the order of
            ``robot.body_names[1:]``. The order of the ten columns is that of Pinocchio: mass [kg],
            mass times centre of mass (x, y, z) [kg m], and inertia about the origin of the body's
            frame (xx, xy, yy, xz, yz, zz) [kg m^2]. The frame of a body is the URDF frame of the
            joint that moves the body.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        See Also
        --------
        inertial_parameters : The inertial parameters pi of this robot.

        Notes
        -----
        Links connected by fixed joints are one body. A body on a mimic joint has its own columns,
        and contributes to the row of the master joint. Y includes gravity and the motion of the
        base. Y excludes armature, friction, springs and external wrenches, because their efforts
        are not proportional to pi. Payloads change pi, but not Y.

        The first call on a machine takes longer, because code is compiled and cached on disk.

        """

        def one(q: Floats, qd: Floats, qdd: Floats, matrix: Floats) -> int:
            return self._regressor(q, qd, qdd, self._R_LZ, matrix, self._table)

        def many(states: Sequence[Floats], matrices: Floats) -> int:
            return batch.regressor_many(states, matrices, self._R_LZ, self._table)

        shape = len(self._zeros), 10 * (len(self.robot.parent) - 1)
        return over_states(self.robot, shape, one, out, many, q=q, qd=qd, qdd=qdd)

    def inertial_parameters(self) -> Floats:
        """
        Return the inertial parameters pi of the moving bodies, including payloads.

        Returns
        -------
        parameters : ndarray, shape (10 (b - 1),)
            Parameters in the order of the columns of `regressor`, for b - 1 moving bodies. The
            product ``regressor(q, qd, qdd) @ parameters`` equals the efforts of a robot without
            armature, friction, springs or external wrenches.

        """
        bodies = range(1, len(self.robot.parent))
        parameters = [self._rigid_body(body).parameters() for body in bodies]
        return np.array(parameters).reshape(-1)

    def set_gravity(self, gravity: ArrayLike) -> None:
        """
        Set the free-fall acceleration due to gravity.

        Parameters
        ----------
        gravity : array_like, shape (3,)
            Free-fall acceleration in the base frame [m/s^2].

        Raises
        ------
        ConfigurationError
            If gravity is not a vector of three finite numbers.

        """
        self._gravity = read_vector('gravity', gravity, 'm/s^2')
        self._gravity.setflags(write=False)
        self._write_base()

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
            Motion of the base frame, in base coordinates [rad/s, rad/s^2, m/s^2]. The linear
            acceleration refers to the frame's origin and excludes gravity. An accelerometer on
            the base measures the linear acceleration minus gravity.

        Raises
        ------
        ConfigurationError
            If an argument is not a vector of three finite numbers.

        """
        motion = [
            read_vector('angular_velocity', angular_velocity, 'rad/s'),
            read_vector('angular_acceleration', angular_acceleration, 'rad/s^2'),
            read_vector('linear_acceleration', linear_acceleration, 'm/s^2'),
        ]
        self._base_motion = np.array(motion)
        self._is_rotating = bool(self._base_motion[:2].any())
        self._write_base()

    def set_payload(
        self,
        link: str,
        mass: float,
        com: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ) -> None:
        """
        Attach a rigid body to a link, replacing the previous payload of the link.

        Parameters
        ----------
        link : str
            Any link of the robot description.
        mass : float
            Mass of the payload [kg]; 0 removes the payload.
        com : array_like, shape (3,)
            Centre of mass in the link's frame [m].
        inertia : array_like, shape (3, 3)
            Inertia about the centre of mass, along the axes of the link's frame [kg m^2].

        Raises
        ------
        ConfigurationError
            If the link does not exist, or the mass, centre of mass or inertia is invalid.

        """
        k = self.robot.link_index(link)
        payload = RigidBody(*read_inertial(mass, com, inertia))
        self._payloads.pop(link, None)
        if payload.mass > 0.0:
            payload = payload.rotate(self.robot.link_rotation[k])
            self._payloads[link] = payload.shift(self.robot.link_position[k])
        body = int(self.robot.link_body[k])
        robot_table.write_inertial(self._table[body], self._R_ZL[body], *self._rigid_body(body))

    def set_external_wrench(
        self,
        link: str,
        force: ArrayLike = (0.0, 0.0, 0.0),
        moment: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        """
        Set the wrench that the world exerts on a link, replacing the link's previous wrench.

        Parameters
        ----------
        link : str
            Any link of the robot description.
        force, moment : array_like, shape (3,)
            Force [N], and moment about the link's origin [N m], both in the link's frame.

        Raises
        ------
        ConfigurationError
            If the link does not exist, or an argument is not a vector of three finite numbers.

        """
        k = self.robot.link_index(link)
        R = self.robot.link_rotation[k]
        f, n = R @ read_vector('force', force, 'N'), R @ read_vector('moment', moment, 'N m')
        self._wrenches[link] = f, n + np.cross(self.robot.link_position[k], f)
        body = int(self.robot.link_body[k])
        wrenches = self._on_body(self._wrenches, body)
        robot_table.write_external(self._table[body], self._R_ZL[body], wrenches)

    def set_friction(
        self,
        damping: ArrayLike | None = None,
        coulomb: ArrayLike | None = None,
        width: ArrayLike = FRICTION_WIDTH,
        load_friction: ArrayLike = 0.0,
    ) -> None:
        r"""
        Set friction: :math:`d\,v + (c + \eta\,|\tau_{load}|) \tanh(v / w)`.

        Here v is the velocity of the drive. Without `set_drive_coupling`, v is the velocity of the
        joint.

        Parameters
        ----------
        damping : array_like, shape (n,) or ()
            Viscous friction d [N m s/rad or N s/m]; by default from the robot description.
        coulomb : array_like, shape (n,) or ()
            Coulomb friction c [N m or N]; by default from the robot description.
        width : array_like, shape (n,) or ()
            Speed w at which Coulomb friction reaches 76 % of the full value [rad/s or m/s].
        load_friction : array_like, shape (n,) or ()
            Coulomb friction eta per unit of load on the gear [-].

        Raises
        ------
        ConfigurationError
            If a value is negative or not finite, or a width is zero.

        Notes
        -----
        The load on the gear is the effort that moves and holds the links. The load includes
        payloads, springs, base motion and external wrenches, but not armature and friction.
        Friction proportional to the load is the usual model of losses in gears [1]_.

        References
        ----------
        .. [1] P. Hamon, M. Gautier, P. Garrec, "Dynamic identification of robots with a dry
           friction model depending on load and velocity", IROS, 2010.

        """
        n = len(self.robot.joint_names)
        damping = self.robot.damping if damping is None else damping
        coulomb = self.robot.friction if coulomb is None else coulomb
        damping = read_joints('damping', damping, n)
        coulomb = read_joints('coulomb', coulomb, n)
        speeds = read_joints('width', width, n)
        if not (speeds >= np.finfo(float).tiny).all():  # the inverse must not overflow
            raise ConfigurationError(f'width is {width!r}, expected values above 0 [rad/s or m/s]')
        per_load = read_joints('load_friction', load_friction, n)
        # A failing call changes nothing, because all arguments have been checked before.
        robot_table.write_friction(self._table, damping, coulomb, speeds, per_load)

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
        values = read_joints('armature', armature, len(self.robot.joint_names))
        robot_table.write_joints(self._table, robot_table.ARMATURE, values)

    def set_drive_coupling(self, coupling: ArrayLike) -> None:
        r"""
        Set the coupling of each drive to the previous joint.

        Gear trains that pass through a wrist joint cause such a coupling. The velocity of the
        drive of joint k is :math:`v_k = \dot q_k + g_k\,\dot q_{k-1}`. Here k - 1 is the
        previous joint, which moves the parent of the body on joint k. The effort due to friction
        and armature of the drive acts on joint k. The previous joint receives :math:`g_k` times
        the same effort.

        Parameters
        ----------
        coupling : array_like, shape (n,) or ()
            Turns g of each drive per turn of the previous joint [-]; 0 means no coupling.

        Raises
        ------
        ConfigurationError
            If a value is not finite, or a joint without a previous joint has a nonzero coupling.

        """
        values = self.checked_coupling(coupling)
        robot_table.write_joints(self._table, robot_table.COUPLING, values)

    def checked_coupling(self, coupling: ArrayLike) -> Floats:
        """Check couplings as in `set_drive_coupling`; return an array of shape (n,)."""
        values = read_joints('coupling', coupling, len(self.robot.joint_names), is_signed=True)
        for k in np.flatnonzero(values):
            if self._table[k + 1, robot_table.JOINT_BEFORE] < 0.0:
                raise ConfigurationError(
                    f"coupling of joint '{self.robot.joint_names[k]}' is {values[k]}, expected 0 "
                    'because no joint precedes this joint'
                )
        return values

    def set_springs(self, stiffness: ArrayLike, rest: ArrayLike = 0.0) -> None:
        r"""
        Set springs or counterweights that add :math:`k\,(q - q_0)` to the joint efforts.

        Spring efforts are part of `gravity_efforts`, of the term ``gravity`` of `effort_terms`,
        and of the load on the gear.

        Parameters
        ----------
        stiffness : array_like, shape (n,) or ()
            Stiffness k [N m/rad or N/m]. A negative stiffness pushes the joint away from q_0.
        rest : array_like, shape (n,) or ()
            Joint position q_0 at which the spring exerts no effort [rad or m].

        Raises
        ------
        ConfigurationError
            If a value is not finite.

        """
        n = len(self.robot.joint_names)
        values = read_joints('stiffness', stiffness, n, is_signed=True)
        preload = -values * read_joints('rest', rest, n, is_signed=True)
        robot_table.write_joints(self._table, robot_table.STIFFNESS, values)
        robot_table.write_joints(self._table, robot_table.PRELOAD, preload)

    def _efforts_in(
        self,
        table: Any,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        out: Floats | None = None,
    ) -> Floats:
        """Compute the efforts from a given table."""

        def one(q: Floats, qd: Floats, qdd: Floats, tau: Floats) -> int:
            return self._inverse_dynamics(q, qd, qdd, tau, table)

        def many(states: Sequence[Floats], tau: Floats) -> int:
            return batch.inverse_dynamics_many(states, tau, table)

        return over_states(self.robot, self._zeros.shape, one, out, many, q=q, qd=qd, qdd=qdd)

    def _of_link(
        self,
        compute: Callable[..., int],
        shape: tuple[int, ...],
        q: ArrayLike,
        link: str,
        out: Floats | None,
    ) -> Floats:
        """Compute the pose or Jacobian of a link."""
        if link not in self._links:
            self._links[link] = link_kinematics.row_of_link(self.robot, self._R_ZL, link)
        row = self._links[link]

        def one(q: Floats, matrix: Floats) -> int:
            return compute(q, row, matrix, self._table)

        return over_states(self.robot, shape, one, out, q=q)

    def _rigid_body(self, body: int) -> RigidBody:
        """Combine a body with its payloads."""
        robot = self.robot
        own = RigidBody(robot.mass[body], robot.com[body], robot.inertia[body])
        return combine([own, *self._on_body(self._payloads, body)])

    def _write_base(self) -> None:
        robot_table.write_base(self._table[0], self._base_motion, self._gravity)

    def _on_body(self, loads: dict[str, Any], body: int) -> Sequence[Any]:
        robot = self.robot
        return [
            load
            for link, load in loads.items()
            if robot.link_body[robot.link_names.index(link)] == body
        ]

    @cached_property
    def _regressor(self) -> Callable[..., int]:
        """The regressor function, compiled at first use because few programs need a regressor."""
        return compile_for(regressor.regressor, arrays(1, 1, 1, 2, 2, 2))

    @cached_property
    def _joint_wrenches(self) -> Callable[..., int]:
        return compile_for(effort_terms.joint_wrenches, arrays(1, 1, 1, 1, 2, 2, 2))

    @cached_property
    def _pose(self) -> Callable[..., int]:
        return compile_for(link_kinematics.pose, arrays(1, 1, 2, 2))

    @cached_property
    def _jacobian(self) -> Callable[..., int]:
        return compile_for(link_kinematics.jacobian, arrays(1, 1, 2, 2))
