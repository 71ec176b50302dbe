"""A robot and everything that acts on it, as the table that the passes read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ConfigurationError
from ..robot.model import Floats, RobotModel
from ..robot.rigid_body import combine, RigidBody
from . import robot_table
from .arguments import read_inertial, read_joints, read_vector

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
"""Free-fall acceleration in a base frame whose z points up [m/s^2]; ISO 80000-3."""

FRICTION_WIDTH = 0.01
"""Speed at which smoothed Coulomb friction has 76 % of its value [rad/s or m/s]."""


class LoadedRobot:
    """
    A robot and everything that acts on it: gravity, base motion, payloads, wrenches and friction.

    Parameters
    ----------
    robot : RobotModel
        Tree of n joints and b bodies.
    gravity : array_like, shape (3,)
        Free-fall acceleration in the base frame [m/s^2].

    Raises
    ------
    ConfigurationError
        If gravity is not three finite numbers.

    Attributes
    ----------
    robot : RobotModel
        The robot without loads.
    revision : int
        Changes with every change of the loads.

    """

    def __init__(self, robot: RobotModel, gravity: ArrayLike = STANDARD_GRAVITY) -> None:
        self.robot = robot
        self.revision = 0
        self._table = robot_table.table_of(robot)
        self._R_ZL = robot_table.rotations_to_z(robot)
        self._R_LZ = np.ascontiguousarray(self._R_ZL.transpose(0, 2, 1)).reshape(-1, 9)
        self._base_motion: Floats = np.zeros((3, 3))  # angular velocity; both accelerations
        self._is_rotating = False  # whether the base has an angular velocity or acceleration
        self._payloads: dict[str, RigidBody] = {}
        self._wrenches: dict[str, tuple[Floats, Floats]] = {}
        self.set_gravity(gravity)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the robot and its loads; compiled functions would be most of the bytes."""
        loads = (self._table, self._base_motion, self._payloads, self._wrenches)
        return type(self), (self.robot, self._gravity), loads

    def __setstate__(self, loads: tuple[Any, ...]) -> None:
        self._table[...], self._base_motion, payloads, wrenches = loads
        self._is_rotating = bool(self._base_motion[:2].any())
        self._payloads, self._wrenches = payloads.copy(), wrenches.copy()
        self.revision += 1

    @property
    def gravity(self) -> Floats:
        """Free-fall acceleration in the base frame, shape (3,) [m/s^2]; read-only."""
        return self._gravity

    @property
    def table(self) -> Floats:
        """The table of `robot_table` with the robot and its loads; not to be modified."""
        return self._table

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
        k = self.robot.link_index(link)
        payload = RigidBody(*read_inertial(mass, com, inertia))
        self._payloads.pop(link, None)
        if payload.mass > 0.0:
            payload = payload.rotate(self.robot.link_rotation[k])
            self._payloads[link] = payload.shift(self.robot.link_position[k])
        self._write_inertial(int(self.robot.link_body[k]))

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
        k = self.robot.link_index(link)
        R = self.robot.link_rotation[k]
        f, n = R @ read_vector('force', force, 'N'), R @ read_vector('moment', moment, 'N m')
        self._wrenches[link] = f, n + np.cross(self.robot.link_position[k], f)
        self._write_external(int(self.robot.link_body[k]))

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
        n = len(self.robot.joint_names)
        damping = self.robot.damping if damping is None else damping
        coulomb = self.robot.friction if coulomb is None else coulomb
        damping = read_joints('damping', damping, n)
        coulomb = read_joints('coulomb', coulomb, n)
        speeds = read_joints('width', width, n)
        if not (speeds >= np.finfo(float).tiny).all():  # the inverse of less may be infinite
            raise ConfigurationError(f'width is {width!r}, expected speeds above 0')
        load_friction = read_joints('load_friction', load_friction, n)
        # All arguments have been checked: a call that fails changes nothing.
        self._write_joints(robot_table.DAMPING, damping)
        self._write_joints(robot_table.COULOMB, coulomb)
        # Zero where it has no effect, so that it does not look like a load to generated code.
        inverse = np.where((coulomb > 0.0) | (load_friction > 0.0), 1.0 / speeds, 0.0)
        self._write_joints(robot_table.INVERSE_WIDTH, inverse)
        self._write_joints(robot_table.LOAD_FRICTION, load_friction)

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
        self._write_joints(robot_table.ARMATURE, values)

    def _rigid_body(self, body: int) -> RigidBody:
        """Combine a body of the robot with the payloads on it."""
        robot = self.robot
        own = RigidBody(robot.mass[body], robot.com[body], robot.inertia[body])
        return combine([own, *self._on_body(self._payloads, body)])

    def _write_joints(self, column: int, values: Floats) -> None:
        """Set a column of all joints."""
        rows = self._table[1 : 1 + len(values)]
        rows[:, column] = values
        terms = [
            robot_table.ARMATURE,
            robot_table.DAMPING,
            robot_table.COULOMB,
            robot_table.LOAD_FRICTION,
        ]
        self._table[0, robot_table.HAS_DRIVE_TERMS] = float(rows[:, terms].any())
        self.revision += 1

    def _write_base(self) -> None:
        self._table[0, robot_table.BASE_MOTION_COLUMNS] = self._base_motion.ravel()
        self._table[0, robot_table.ACCEL : robot_table.ACCEL + 3] -= self._gravity  # LWP (31)
        self.revision += 1

    def _write_inertial(self, body: int) -> None:
        robot_table.write_inertial(self._table[body], self._R_ZL[body], *self._rigid_body(body))
        self.revision += 1

    def _write_external(self, body: int) -> None:
        wrenches = self._on_body(self._wrenches, body)
        row, R_ZL = self._table[body], self._R_ZL[body]
        force = sum((f for f, _ in wrenches), np.zeros(3))
        moment = sum((n for _, n in wrenches), np.zeros(3))
        robot_table.store(row, robot_table.EXTERNAL_FORCE, R_ZL @ force)
        robot_table.store(row, robot_table.EXTERNAL_MOMENT, R_ZL @ moment)
        self.revision += 1

    def _on_body(self, loads: dict[str, Any], body: int) -> Sequence[Any]:
        robot = self.robot
        return [
            load
            for link, load in loads.items()
            if robot.link_body[robot.link_names.index(link)] == body
        ]
