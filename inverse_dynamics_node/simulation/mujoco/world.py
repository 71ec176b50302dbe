"""
External influences on a simulated robot: payloads, pushes and a base that tilts.

MuJoCo's world frame is the frame of the robot's base. To simulate a moving base, this module
rotates gravity and adds the inertial forces of the rotating frame.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ...dynamics.arguments import read_inertial, read_vector
from ...dynamics.inverse_dynamics import STANDARD_GRAVITY
from ...errors import unknown_name
from ...robot.kinematics import rotation_about
from ...robot.model import Floats
from ...robot.rigid_body import combine, RigidBody
from ..trajectory import ease
from .model import principal_axes, SimulationError

POINT = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))  # inertia of a point mass
TILT_DURATION = 3.0  # [s]: duration of a change of attitude


class World:
    """
    Payloads, pushes and base motion of a simulated robot.

    Inertias and gravity of ``model`` are modified, and ``xfrc_applied`` of ``data`` is
    overwritten. The root link ``root`` is fixed in MuJoCo's world frame. Loads and pushes on this
    link therefore have no effect.
    """

    def __init__(self, model: Any, data: Any, root: str) -> None:
        self._model, self._data, self._root = model, data, root
        self._alone = {
            body: RigidBody(
                float(model.body_mass[body]),
                model.body_ipos[body].copy(),
                _inertia(model, body),
            )
            for body in range(1, model.nbody)
        }
        self._wrenches: dict[int, tuple[Floats, Floats]] = {}
        self._angular_velocity: Floats = np.zeros(3)
        self._angular_acceleration: Floats = np.zeros(3)

    def set_payload(
        self, link: str, mass: float, com: ArrayLike = (0.0, 0.0, 0.0), inertia: ArrayLike = POINT
    ) -> None:
        """
        Attach a rigid load to a link, and remove the link's previous load.

        A mass [kg] of 0 removes the load. The centre of mass, shape (3,), is in the link frame
        [m]. The inertia, shape (3, 3), is about the centre of mass, in link axes [kg m^2]. Raise a
        `SimulationError` if the link does not exist, and a `ConfigurationError` if the mass or the
        inertia is impossible.
        """
        body = self._body(link)
        payload = RigidBody(*read_inertial(mass, com, inertia))
        if not body:
            return
        whole = self._alone[body]
        if mass:
            whole = combine([whole, payload])
        _write_inertial(self._model, body, *whole)

    def set_external_wrench(
        self, link: str, force: ArrayLike = (0.0, 0.0, 0.0), moment: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        """
        Apply a force [N] and a moment [N m] to a link until the next call for this link.

        The vectors, shape (3,), are in the link frame. The force acts at the origin of the frame.
        Raise a `SimulationError` if the link does not exist, and a `ConfigurationError` if a
        vector does not consist of three finite numbers.
        """
        body = self._body(link)
        wrench = read_vector('force', force, 'N'), read_vector('moment', moment, 'N m')
        if body:
            self._wrenches[body] = wrench

    def set_base_motion(
        self, gravity: ArrayLike, angular_velocity: ArrayLike, angular_acceleration: ArrayLike
    ) -> None:
        """
        Set gravity, angular velocity and angular acceleration of the base, whose origin is fixed.

        All vectors have shape (3,) and are in the base frame. ``gravity`` is the free-fall
        acceleration [m/s^2]. Angular velocity and acceleration are in rad/s and rad/s^2.
        """
        self._model.opt.gravity[:] = gravity
        self._angular_velocity = np.asarray(angular_velocity, float)
        self._angular_acceleration = np.asarray(angular_acceleration, float)

    def act(self) -> None:
        """Apply the inertial forces and the external wrenches for the current state."""
        data = self._data
        data.xfrc_applied[:] = 0.0
        if self._angular_velocity.any() or self._angular_acceleration.any():
            data.xfrc_applied[:] = self._inertial_wrenches()
        for body, (force, moment) in self._wrenches.items():
            R = data.xmat[body].reshape(3, 3)  # from the link frame to the world frame
            arm = data.xpos[body] - data.xipos[body]  # moments are about the centre of mass
            data.xfrc_applied[body, :3] += R @ force
            data.xfrc_applied[body, 3:] += R @ moment + np.cross(arm, R @ force)

    def _inertial_wrenches(self) -> Floats:
        """Return inertial forces on bodies, and inertial moments about their centres of mass."""
        model, data = self._model, self._data
        base, base_dot = self._angular_velocity, self._angular_acceleration
        r, omega = data.xipos, data.cvel[:, :3]
        v = data.cvel[:, 3:] + np.cross(omega, r - data.subtree_com[model.body_rootid])
        accel = np.cross(base_dot, r) + np.cross(base, 2.0 * v + np.cross(base, r))
        force = -model.body_mass[:, np.newaxis] * accel
        R = data.ximat.reshape(-1, 3, 3)
        tensor = np.einsum('bij,bj,bkj->bik', R, model.body_inertia, R)

        def spin(vectors: Floats) -> Floats:
            return np.asarray(np.einsum('bij,bj->bi', tensor, vectors))

        total = base + omega
        moment = spin(base_dot + np.cross(base, omega))
        moment += np.cross(total, spin(total)) - np.cross(omega, spin(omega))
        return np.hstack([force, -moment])

    def _body(self, link: str) -> int:
        """Return the index of the body of a link; the fixed root link has index 0."""
        if link == self._root:
            return 0
        body: int = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_BODY, link)
        if body <= 0:
            links = [self._root, *(self._model.body(i).name for i in range(1, self._model.nbody))]
            raise SimulationError(unknown_name('link', link, links))
        return body


def _inertia(model: Any, body: int) -> Floats:
    """Return the inertia of a body about its centre of mass, in the axes of the link frame."""
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, model.body_iquat[body])
    R_LC = R.reshape(3, 3)
    return np.asarray(R_LC @ np.diag(model.body_inertia[body]) @ R_LC.T)


def _write_inertial(model: Any, body: int, mass: float, com: Floats, inertia: Floats) -> None:
    model.body_mass[body] = mass
    model.body_ipos[body] = com
    model.body_inertia[body], model.body_iquat[body] = principal_axes(inertia)
    # MuJoCo's compiler has set this optimization flag for the link without a load.
    model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    mujoco.mj_setConst(model, mujoco.MjData(model))


def rotation(vector: ArrayLike) -> Floats:
    """Return the rotation matrix, shape (3, 3), of a rotation vector [rad]."""
    vector = np.asarray(vector, float)
    angle = float(np.linalg.norm(vector))
    return rotation_about(vector / angle, angle) if angle else np.eye(3)


class Tilt:
    """The attitude of a base over time; the base is level at first."""

    def __init__(self) -> None:
        self._began = -np.inf  # start time of the latest turn [s]
        self._level = np.eye(3)  # rotation from the base frame at that time to the level frame
        self._turn = np.zeros(3)  # rotation vector of the complete turn, in the base frame [rad]

    def turn_to(self, attitude: ArrayLike, time: float) -> None:
        """
        Start to turn the base to ``attitude`` at the time ``time`` [s].

        The attitude is a rotation vector relative to the level base, shape (3,) [rad].
        """
        self._level = self.attitude(time)
        self._began = time
        quaternion, self._turn = np.zeros(4), np.zeros(3)
        mujoco.mju_mat2Quat(quaternion, (self._level.T @ rotation(attitude)).ravel())
        mujoco.mju_quat2Vel(self._turn, quaternion, 1.0)

    def attitude(self, time: float) -> Floats:
        """Return the rotation matrix from the base frame to the level frame at a time [s]."""
        progress = ease(np.array((time - self._began) / TILT_DURATION))[0]
        return np.asarray(self._level @ rotation(progress * self._turn))

    def motion(self, time: float) -> tuple[Floats, Floats, Floats]:
        """
        Return gravity, angular velocity and angular acceleration of the base at a time [s].

        All vectors have shape (3,) and are in the base frame, in m/s^2, rad/s and rad/s^2.
        """
        gravity = self.attitude(time).T @ STANDARD_GRAVITY
        _, speed, acceleration = ease(np.array((time - self._began) / TILT_DURATION))
        speed, acceleration = speed / TILT_DURATION, acceleration / TILT_DURATION**2
        return gravity, speed * self._turn, acceleration * self._turn
