"""One robot, ready to compute."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from . import columns, lanes, newton_euler
from .arguments import (
    broadcast,
    check_out,
    explain,
    is_free,
    read_inertial,
    read_joints,
    read_threads,
    read_vector,
    read_vectors,
)
from .compilation import compile_for, IS_COMPILED
from .errors import ConfigurationError
from .model import Floats, join_bodies, RobotModel
from .newton_euler import OK

_V, _M = 'f8[::1]', 'f8[:,::1]'  # a vector and a table of float64, to numba

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
"""Free-fall acceleration in a base frame whose z points up [m/s^2]; ISO 80000-3."""

FRICTION_WIDTH = 0.01
"""Speed at which smoothed Coulomb friction has 76 % of its value [rad/s or m/s]."""


class Terms(NamedTuple):
    """What joint efforts are made of, each of shape (..., n) [N m or N]; they add up to them."""

    inertial: Floats
    """M(q) qdd, armature included."""
    velocity: Floats
    """C(q, qd) qd: Coriolis and centrifugal, and what a turning base adds to them."""
    gravity: Floats
    """g(q), and what accelerates or turns the base."""
    friction: Floats
    """Viscous and Coulomb friction."""
    external: Floats
    """Minus what the external wrenches do for the joints."""


class JointWrenches(NamedTuple):
    """
    What holds every body, each of shape (..., b, 3), in the order of ``robot.body_names``.

    A row is what the body's parent exerts on it, in the URDF frame of the joint between them,
    about that frame's origin. The first row is what the mount exerts on the base.

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
    wrenches and motion of the base count from when they are set.

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
    The first object on a machine compiles for some seconds; the machine code is kept on disk. An
    object holds its own scratch space: threads need one each.

    References
    ----------
    .. [LWP] J. Y. S. Luh, M. W. Walker, R. P. C. Paul, "Newton-Euler formulation of manipulator
       dynamics for computer control", IFAC, 1979, 165-172: equations (36)-(47).

    """

    def __init__(self, robot: RobotModel, gravity: ArrayLike = STANDARD_GRAVITY) -> None:
        self.robot = robot
        self._zeros = np.zeros(len(robot.joint_names))
        self._inverse_dynamics = _ready(newton_euler.inverse_dynamics, _V, _V, _V, _V, _M)
        self._batch = _ready(newton_euler.inverse_dynamics_batch, _M, _M, _M, _M, _M)
        self._mass_matrix = _ready(newton_euler.mass_matrix, _V, _V, _V, _M, _M)
        self._joint_wrenches = _ready(newton_euler.joint_wrenches, _V, _V, _V, _V, _M, _M)
        self._numbers = columns.robot_table(robot)
        self._table = _runnable(self._numbers)
        self._R_ZL = columns.rotations_to_z(robot)
        self._payloads: dict[str, tuple[float, Floats, Floats]] = {}
        self._wrenches: dict[str, tuple[Floats, Floats]] = {}
        self._base_motion: Floats = np.zeros((3, 3))
        self.revision = 0
        self.set_gravity(gravity)

    # What acts on the robot

    def set_gravity(self, gravity: ArrayLike) -> None:
        """
        Let things fall another way.

        Parameters
        ----------
        gravity : array_like, shape (3,)
            Free-fall acceleration in the base frame [m/s^2].

        Raises
        ------
        ConfigurationError
            If gravity is not three finite numbers.

        """
        self.gravity = read_vector('gravity', gravity, 'm/s^2')
        self.gravity.setflags(write=False)
        self._write_base()

    def set_base_motion(
        self,
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_acceleration: ArrayLike = (0.0, 0.0, 0.0),
        linear_acceleration: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        """
        Let the base move: omega_0, omega_dot_0 and v_dot_0 of LWP.

        Parameters
        ----------
        angular_velocity, angular_acceleration, linear_acceleration : array_like, shape (3,)
            Of the base frame and its origin, in the base frame [rad/s], [rad/s^2], [m/s^2].
            Gravity is not part of the last; an accelerometer on the base reads the last minus
            gravity.

        Raises
        ------
        ConfigurationError
            If one is not three finite numbers.

        """
        self._base_motion = np.array(
            [
                read_vector('angular_velocity', angular_velocity, 'rad/s'),
                read_vector('angular_acceleration', angular_acceleration, 'rad/s^2'),
                read_vector('linear_acceleration', linear_acceleration, 'm/s^2'),
            ]
        )
        self._write_base()

    def set_payload(
        self,
        link: str,
        mass: float,
        com: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ) -> None:
        """
        Fasten a rigid load to a link, in place of any that it had.

        Parameters
        ----------
        link : str
            Any link of the robot description.
        mass : float
            Mass of the load [kg]; 0 takes it off.
        com : array_like, shape (3,)
            Its centre of mass in the link's frame [m].
        inertia : array_like, shape (3, 3)
            About that, along the link's axes [kg m^2].

        Raises
        ------
        ConfigurationError
            If there is no such link, or no body has such a mass and inertia.

        """
        k = self.link_index(link)
        load = read_inertial(mass, com, inertia)
        self._payloads.pop(link, None)
        if load[0] > 0.0:
            rotation = self.robot.link_rotation[k]
            centre = rotation @ load[1] + self.robot.link_position[k]
            self._payloads[link] = load[0], centre, rotation @ load[2] @ rotation.T
        self._write_inertial(int(self.robot.link_body[k]))

    def set_external_wrench(
        self,
        link: str,
        force: ArrayLike = (0.0, 0.0, 0.0),
        moment: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        """
        Let the world push or pull a link, in place of what it did to this link before.

        Parameters
        ----------
        link : str
            Any link of the robot description.
        force, moment : array_like, shape (3,)
            What the world exerts on the robot, in the link's frame, about its origin [N], [N m].

        Raises
        ------
        ConfigurationError
            If there is no such link, or one is not three finite numbers.

        """
        k = self.link_index(link)
        rotation = self.robot.link_rotation[k]
        F = rotation @ read_vector('force', force, 'N')
        N = rotation @ read_vector('moment', moment, 'N m')
        self._wrenches[link] = F, N + np.cross(self.robot.link_position[k], F)
        self._write_external(int(self.robot.link_body[k]))

    def set_friction(
        self,
        damping: ArrayLike | None = None,
        coulomb: ArrayLike | None = None,
        width: ArrayLike = FRICTION_WIDTH,
    ) -> None:
        r"""
        Overcome friction at the joints: :math:`d\,\dot q + c \tanh(\dot q / w)`.

        Parameters
        ----------
        damping : array_like, shape (n,) or ()
            Viscous friction d [N m s/rad or N s/m]; without it, that of the robot description.
        coulomb : array_like, shape (n,) or ()
            Coulomb friction c [N m or N]; without it, that of the robot description.
        width : array_like, shape (n,) or ()
            Speed w over which Coulomb friction is smoothed [rad/s or m/s].

        Raises
        ------
        ConfigurationError
            If a value is negative or not finite, or the width is zero.

        """
        n = len(self._zeros)
        damping = self.robot.damping if damping is None else damping
        coulomb = self.robot.friction if coulomb is None else coulomb
        damping = read_joints('damping', damping, n)
        coulomb = read_joints('coulomb', coulomb, n)
        speeds = read_joints('width', width, n)
        if not (speeds >= np.finfo(float).tiny).all():  # the inverse of less may be infinite
            raise ConfigurationError(f'width is {width!r}, expected speeds above 0')
        # Nothing is written before all has been read: a call that fails changes nothing.
        self._write_joints(columns.DAMPING, damping)
        self._write_joints(columns.COULOMB, coulomb)
        self._write_joints(columns.INVERSE_WIDTH, 1.0 / speeds)

    def set_armature(self, armature: ArrayLike) -> None:
        """
        Count the inertia of rotors and gears, as it is felt at the joints.

        Parameters
        ----------
        armature : array_like, shape (n,) or ()
            Rotor inertia times the square of the gear ratio [kg m^2 or kg].

        Raises
        ------
        ConfigurationError
            If a value is negative or not finite.

        """
        self._write_joints(columns.ARMATURE, read_joints('armature', armature, len(self._zeros)))

    # What it takes

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
            Receives the result: C-contiguous float64 of its shape.
        threads : int
            How many work on a large batch side by side, at most. The results do not depend on it.

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N], positive along the joint axis; ``out`` where it was given.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.
        ConfigurationError
            If ``threads`` is no whole number above 0.

        Notes
        -----
        Outward pass: LWP (36)-(44); inward pass: LWP (45)-(47). With arrays of float64 as
        arguments and ``out``, nothing is allocated.

        Batches of 64 states and more go through the passes in blocks. That rounds a little
        differently: by less than 1e-12 of the largest effort. The first of them compiles for
        seconds; the machine code is kept on disk.

        """
        try:
            # Asked first: for numba to refuse a batch takes as long as hundreds of its states.
            if q.ndim == 1:  # type: ignore[union-attr]
                tau = np.empty_like(self._zeros) if out is None else out
                if self._inverse_dynamics(q, qd, qdd, tau, self._table):
                    raise explain(self.robot.joint_names, out, q=q, qd=qd, qdd=qdd)
                return tau
        except (AttributeError, TypeError, ValueError):  # lists, integers, views with strides
            pass
        return self._efforts_of_any(self._table, q, qd, qdd, out, read_threads(threads))

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
            Joint efforts [N m or N]: `efforts` for velocities and accelerations of zero.

        Raises
        ------
        JointStateError
            If the shape does not fit the robot, or a value is not finite.

        """
        return self.efforts(q, self._zeros, self._zeros)

    def velocity_efforts(self, q: ArrayLike, qd: ArrayLike) -> Floats:
        """
        Compute C(q, qd) qd: the Coriolis and centrifugal efforts.

        Parameters
        ----------
        q, qd : array_like, shape (..., n)
            Joint positions [rad or m] and velocities [rad/s or m/s].

        Returns
        -------
        tau : ndarray, shape (..., n)
            Joint efforts [N m or N]; with what a turning base adds to them.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        """
        turning = self._without(
            columns.BASE_ACCELERATION_COLUMNS, columns.EXTERNAL_COLUMNS, columns.JOINT_TERM_COLUMNS
        )
        moving = self._efforts_of_any(turning, q, qd, self._zeros)
        if not self._base_motion[0].any():
            return moving
        return moving - self._efforts_of_any(turning, q, self._zeros, self._zeros)

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
        positions = read_vectors('q', q, len(self._zeros))
        n = len(self._zeros)
        matrices = np.empty((*positions.shape, n))
        unit = np.zeros(n)
        table = self._inertia_only()
        for index in np.ndindex(positions.shape[:-1]):
            arguments = (positions[index], self._zeros, unit, matrices[index])
            if self._mass_matrix(*arguments, table) != OK:
                raise explain(self.robot.joint_names, q=q)
        return matrices

    def terms(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Terms:
        """
        Compute what the joint efforts are made of.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            As for `efforts`.

        Returns
        -------
        terms : Terms
            Named tuple of arrays of shape (..., n) [N m or N]; their sum is `efforts`.

        Raises
        ------
        JointStateError
            If a shape does not fit the robot, or a value is not finite.

        """
        _, shape = broadcast(len(self._zeros), q=q, qd=qd, qdd=qdd)
        zeros = np.zeros(shape)
        weight = self._without(columns.EXTERNAL_COLUMNS, columns.JOINT_TERM_COLUMNS)
        bodiless = (columns.MASS, columns.INERTIA_COLUMNS, columns.BASE_MOTION_COLUMNS)
        friction = self._without(*bodiless, columns.EXTERNAL_COLUMNS, columns.ARMATURE)
        external = self._without(*bodiless, columns.JOINT_TERM_COLUMNS)
        return Terms(
            inertial=self._efforts_of_any(self._inertia_only(), q, zeros, qdd),
            velocity=self.velocity_efforts(q, np.broadcast_to(qd, shape)),
            gravity=self._efforts_of_any(weight, q, zeros, zeros),
            friction=self._efforts_of_any(friction, q, qd, zeros),
            external=self._efforts_of_any(external, q, zeros, zeros),
        )

    def joint_wrenches(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> JointWrenches:
        """
        Compute the force and moment at every joint, the reaction of the mount first.

        Parameters
        ----------
        q, qd, qdd : array_like, shape (..., n)
            As for `efforts`.

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
        LWP (45) and (46). A joint's moment (or force, where it slides) along its axis is its
        effort, armature and friction apart: those act inside the joint.

        """
        rows, shape = broadcast(len(self._zeros), q=q, qd=qd, qdd=qdd)
        b = len(self.robot.parent)
        wrenches = np.empty((len(rows[0]), b, 6))
        tau = np.empty_like(self._zeros)
        for *state, wrench in zip(*rows, wrenches, strict=True):
            if self._joint_wrenches(*state, tau, wrench, self._table) != OK:
                raise explain(self.robot.joint_names, q=q, qd=qd, qdd=qdd)
        R_LZ = self._R_ZL.transpose(0, 2, 1)
        turned = np.einsum('bij,kbwj->wkbi', R_LZ, wrenches.reshape(-1, b, 2, 3))
        force, moment = turned.reshape(2, *shape[:-1], b, 3)
        return JointWrenches(force, moment)

    # The table

    @property
    def table(self) -> Floats:
        """The robot and what acts on it, as `robot_table` lays it out; for reading only."""
        return self._numbers

    def _without(self, *parts: int | slice) -> Any:
        """Copy the robot's table, with nothing in some of its columns."""
        numbers = self._numbers.copy()
        for part in parts:
            numbers[:, part] = 0.0
        return _runnable(numbers)

    def _inertia_only(self) -> Any:
        return self._without(
            columns.BASE_MOTION_COLUMNS, columns.EXTERNAL_COLUMNS, columns.DAMPING, columns.COULOMB
        )

    def _write_base(self) -> None:
        self._numbers[0, columns.BASE_MOTION_COLUMNS] = self._base_motion.ravel()
        self._numbers[0, columns.ACCEL : columns.ACCEL + 3] -= self.gravity  # LWP (31)
        self._update(0)

    def _write_inertial(self, body: int) -> None:
        """Make one body of a link and the loads on it."""
        robot = self.robot
        parts = [(robot.mass[body], robot.com[body], robot.inertia[body])]
        for link, load in self._payloads.items():
            if robot.link_body[robot.link_names.index(link)] == body:
                parts.append(load)
        row = self._numbers[body]
        columns.write_inertial(row, self._R_ZL[body], *join_bodies(parts))
        self._update(body)

    def _write_external(self, body: int) -> None:
        robot = self.robot
        on_body = [
            wrench
            for link, wrench in self._wrenches.items()
            if robot.link_body[robot.link_names.index(link)] == body
        ]
        row, R_ZL = self._numbers[body], self._R_ZL[body]
        force = sum((f for f, _ in on_body), np.zeros(3))
        moment = sum((n for _, n in on_body), np.zeros(3))
        columns.store(row, columns.EXTERNAL_FORCE, R_ZL @ force)
        columns.store(row, columns.EXTERNAL_MOMENT, R_ZL @ moment)
        self._update(body)

    def _write_joints(self, column: int, values: Floats) -> None:
        rows = self._numbers[1 : 1 + len(values)]
        rows[:, column] = values
        has_terms = rows[:, [columns.ARMATURE, columns.DAMPING, columns.COULOMB]].any()
        self._numbers[0, columns.HAS_JOINT_TERMS] = float(has_terms)
        for i in range(1 + len(values)):
            self._update(i)

    def _update(self, body: int) -> None:
        self.revision += 1
        if not IS_COMPILED:
            self._table[body] = self._numbers[body].tolist()

    def link_index(self, name: str) -> int:
        """Find a link among ``robot.link_names``, or raise a ConfigurationError."""
        if name not in self.robot.link_names:
            links = ', '.join(self.robot.link_names)
            raise ConfigurationError(f"link '{name}' does not exist; links are {links}")
        return self.robot.link_names.index(name)

    def _efforts_of_any(
        self,
        table: Any,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        out: Floats | None = None,
        threads: int = 1,
    ) -> Floats:
        """Compute efforts of whatever numpy can read as rows of n numbers."""
        rows, shape = broadcast(len(self._zeros), q=q, qd=qd, qdd=qdd)
        if out is not None:
            check_out(out, shape)
        tau = np.empty(shape) if out is None or not is_free(out, rows) else out
        states = (*rows, tau.reshape(rows[0].shape))
        if tau.size and len(rows[0]) >= lanes.FEWEST:
            status = lanes.inverse_dynamics_many(states, np.asarray(table), threads)
        else:
            status = self._batch(*states, table)
        if status != OK:
            raise explain(self.robot.joint_names, q=q, qd=qd, qdd=qdd)
        if out is None or tau is out:
            return tau
        out[...] = tau
        return out


def _runnable(numbers: Floats) -> Any:
    """Return a table as the functions of `newton_euler` want it here."""
    return numbers if IS_COMPILED else numbers.tolist()


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
            if values.dtype != np.float64:
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
