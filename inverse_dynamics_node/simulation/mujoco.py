"""MuJoCo as the robot hardware: it takes joint efforts and returns positions and velocities."""

from __future__ import annotations

from collections.abc import Sequence
import logging
import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.arguments import read_inertial, read_vector
from ..dynamics.inverse_dynamics import STANDARD_GRAVITY
from ..errors import InverseDynamicsError
from ..robot.model import Floats, RobotModel
from ..robot.rigid_body import combine, RigidBody

LARGEST_STEP = 0.00025  # [s]: integration errors are far below the effect of one late sample
STIFFEST = 0.9999  # MuJoCo's upper bound on the stiffness of a constraint
LEAST_INDEPENDENCE = 1e-9  # least eigenvalue; rounding leaves 1e-16 if two joints move as one
LEAST_INERTIA = 1e-9  # [kg m^2 or kg]: the smallest finger joints have 1000 times as much
DRIVE_GAINS = 900.0, 60.0  # [1/s^2], [1/s] of the position controller: critically damped, 5 Hz
HELD_STIFFNESS = (2.0 * math.pi * 10.0) ** 2  # [1/s^2]: held joints have springs of 10 Hz
POINT = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))  # inertia of a point mass

logger = logging.getLogger(__name__)


class SimulationError(InverseDynamicsError):
    """A robot cannot be simulated, or a simulation failed."""


class MujocoRobot:
    """
    One simulated robot.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    start : array_like, shape (n,)
        Start positions [rad or m], in the order of ``robot.joint_names``.
    friction : bool
        Whether to simulate the damping and Coulomb friction that the URDF specifies.
    joints : sequence of str
        Commanded joints, in the order of the commands (default: all). Stiff springs hold the
        others in their start positions.

    Raises
    ------
    SimulationError
        If a joint moves no mass.
    ConfigurationError
        If one of ``joints`` does not exist.

    """

    def __init__(
        self,
        robot: RobotModel,
        start: ArrayLike,
        friction: bool = True,
        joints: Sequence[str] = (),
    ) -> None:
        self.robot = robot
        self.command_names = tuple(joints) or robot.joint_names
        """Commanded joints, in the order of the commands."""
        self.command_index = robot.joint_indices(self.command_names)
        """Index of each commanded joint in ``robot.joint_names``."""
        self.state_names = tuple(sorted(robot.body_names[1:]))
        """All movable joints, including mimic joints, sorted by name."""
        self._model = compile_model(robot, friction)
        self._data = mujoco.MjData(self._model)
        self._at_rest = mujoco.MjData(self._model)
        self._payloads: dict[int, RigidBody] = {}  # by link
        self._wrenches: dict[int, tuple[Floats, Floats]] = {}
        self._state_order, self._order, self._command_order, moving = (
            [int(self._model.joint(name).dofadr[0]) for name in names]
            for names in (
                self.state_names,
                robot.joint_names,
                self.command_names,
                robot.body_names[1:],
            )
        )
        self._command_limits = robot.effort_limits[self.command_index]
        self._coupling = np.zeros((len(moving), len(robot.joint_names)))
        self._coupling[moving, robot.joint_index[1:]] = robot.multiplier[1:]
        self._data.qpos[:] = self._coupling @ np.asarray(start)
        self._data.qpos[moving] += robot.offset[1:]
        mujoco.mj_forward(self._model, self._data)
        require_inertia(robot, self.mass_matrix())
        self._held = sorted(set(range(len(self._order))) - set(self.command_index))
        self._hold_in_place()

    def state(self) -> tuple[Floats, Floats, Floats]:
        """Return positions, velocities and efforts in the order of ``state_names``."""
        order, data = self._state_order, self._data
        efforts = data.qfrc_applied.copy()
        held = [self._order[i] for i in self._held]
        efforts[held] = data.qfrc_passive[held]
        return data.qpos[order], data.qvel[order], efforts[order]

    def positions(self) -> Floats:
        """Return positions [rad or m] in the order of ``robot.joint_names``."""
        return np.asarray(self._data.qpos[self._order])

    def velocities(self) -> Floats:
        """Return velocities [rad/s or m/s] in the order of ``robot.joint_names``."""
        return np.asarray(self._data.qvel[self._order])

    def command(self, efforts: ArrayLike) -> None:
        """Apply efforts [N m or N], in the order of ``command_names``, until the next call."""
        limits = self._command_limits
        self._data.qfrc_applied[self._command_order] = np.clip(efforts, -limits, limits)

    def track(self, q: Floats, qd: Floats, qdd: Floats) -> None:
        """Command efforts to track positions, velocities and accelerations, each of shape (n,)."""
        kp, kd = DRIVE_GAINS
        error, rate = q - self.positions(), qd - self.velocities()
        efforts = self.mass_matrix() @ (qdd + kp * error + kd * rate) + self.bias_efforts()
        self.command(efforts[self.command_index])

    def stop(self) -> None:
        """Stop all joints instantly, as brakes do."""
        self._data.qvel[:] = 0.0
        mujoco.mj_forward(self._model, self._data)

    def advance(self, duration: float) -> None:
        """Advance the simulation by a duration [s]."""
        steps = math.ceil(duration / LARGEST_STEP)
        self._model.opt.timestep = duration / steps
        self._push()
        mujoco.mj_step(self._model, self._data, nstep=steps)
        if not np.isfinite(self._data.qacc).all():
            raise SimulationError('the simulation became unstable: the efforts are too large')

    def mass_matrix(self) -> Floats:
        """Return the current mass matrix, including the effect of mimic joints, shape (n, n)."""
        velocities = self._coupling.T.copy()
        momenta = np.zeros(velocities.shape)
        for row, velocity in zip(momenta, velocities, strict=True):
            mujoco.mj_mulM(self._model, self._data, row, velocity)
        return np.asarray(momenta @ self._coupling)

    def bias_efforts(self) -> Floats:
        """Return efforts due to gravity and velocities, including mimic joints, shape (n,)."""
        return np.asarray(self._coupling.T @ self._data.qfrc_bias)

    def gravity_efforts(self) -> Floats:
        """Return the joint efforts due to gravity on robot and payloads, shape (n,)."""
        self._at_rest.qpos[:] = self._data.qpos
        mujoco.mj_fwdPosition(self._model, self._at_rest)
        mujoco.mj_fwdVelocity(self._model, self._at_rest)
        return np.asarray(self._coupling.T @ self._at_rest.qfrc_bias)

    def set_payload(
        self, link: str, mass: float, com: ArrayLike = (0.0, 0.0, 0.0), inertia: ArrayLike = POINT
    ) -> None:
        """
        Attach a rigid load to a link, and remove the link's previous load.

        A mass [kg] of 0 removes the load. The centre of mass, shape (3,), is in the link frame
        [m]. The inertia, shape (3, 3), is about the centre of mass, in link axes [kg m^2]. Raise a
        `ConfigurationError` if the link does not exist, or if the mass or the inertia is
        impossible.
        """
        robot, k = self.robot, self.robot.link_index(link)
        payload = RigidBody(*read_inertial(mass, com, inertia))
        self._payloads[k] = payload.rotate(robot.link_rotation[k]).shift(robot.link_position[k])
        body = robot.link_body[k]
        loads = [load for i, load in self._payloads.items() if robot.link_body[i] == body]
        _write_inertial(self._model, robot, body, [load for load in loads if load.mass])
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))

    def set_external_wrench(
        self, link: str, force: ArrayLike = (0.0, 0.0, 0.0), moment: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        """
        Apply a force [N] and a moment [N m] to a link until the next call for this link.

        The vectors, shape (3,), are in the link frame. The force acts at the origin of the frame.
        Raise a `ConfigurationError` if the link does not exist, or if a vector does not consist of
        three finite numbers.
        """
        wrench = read_vector('force', force, 'N'), read_vector('moment', moment, 'N m')
        self._wrenches[self.robot.link_index(link)] = wrench

    def _push(self) -> None:
        """Apply the external wrenches in the current pose."""
        robot, data = self.robot, self._data
        data.xfrc_applied[:] = 0.0
        for link, (force, moment) in self._wrenches.items():
            body = int(robot.link_body[link])
            R_WB = data.xmat[body].reshape(3, 3)
            R_WL = R_WB @ robot.link_rotation[link]
            origin = data.xpos[body] + R_WB @ robot.link_position[link]
            arm = origin - data.xipos[body]  # MuJoCo takes moments about the centre of mass
            data.xfrc_applied[body, :3] += R_WL @ force
            data.xfrc_applied[body, 3:] += R_WL @ moment + np.cross(arm, R_WL @ force)

    def _hold_in_place(self) -> None:
        """Hold joints without commands in their positions with critically damped springs."""
        inertia, load = self.mass_matrix().diagonal(), self.bias_efforts()
        for i in self._held:
            dof = self._order[i]
            stiffness = HELD_STIFFNESS * inertia[i]
            self._model.jnt_stiffness[self._model.dof_jntid[dof]] = stiffness
            self._model.dof_damping[dof] = 2.0 * math.sqrt(HELD_STIFFNESS) * inertia[i]
            self._model.qpos_spring[dof] = self._data.qpos[dof] + load[i] / stiffness
        mujoco.mj_forward(self._model, self._data)


def require_inertia(robot: RobotModel, mass_matrix: Floats) -> None:
    """Raise a `SimulationError` if a joint cannot move mass independently of other joints."""
    independence, mixtures = np.linalg.eigh(with_unit_diagonal(mass_matrix))
    singular = mixtures[:, independence < LEAST_INDEPENDENCE]
    idle = np.flatnonzero((abs(singular) > 0.1).any(axis=1))
    if idle.size:
        names = ', '.join(repr(robot.joint_names[i]) for i in idle)
        raise SimulationError(
            f'no mass resists the motion of joint {names}: add an <inertial> with mass and '
            'inertia to a link that the joint moves, or make the joint fixed'
        )


def with_unit_diagonal(inertia: Floats) -> Floats:
    """
    Scale a mass matrix to a unit diagonal; strong coupling then shows as a small eigenvalue.

    So does a joint that moves no mass.
    """
    diagonal = inertia.diagonal()
    scale = np.where(diagonal < LEAST_INERTIA, 0.0, 1.0 / np.sqrt(np.maximum(diagonal, 1e-300)))
    return np.asarray(inertia * np.outer(scale, scale))


def compile_model(robot: RobotModel, friction: bool = True) -> Any:
    """
    Build a MuJoCo model with one body and one joint for each body of a robot except its base.

    Equality constraints couple mimic joints. If ``friction`` is False, the joints have neither the
    damping nor the Coulomb friction that the URDF specifies.
    """
    # By default, MuJoCo would append its warnings to a file in the working directory.
    mujoco.set_mju_user_warning(logger.info)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    bodies = [spec.worldbody]
    for k in range(1, len(robot.body_names)):
        name, i = robot.body_names[k], robot.joint_index[k]
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, robot.R_PL[k].ravel())
        # MuJoCo rejects some inertias of URDFs, so they are written after the compilation. The
        # placeholder is outside the origin, or MuJoCo would simplify the mass matrix for it.
        body = bodies[robot.parent[k]].add_body(pos=robot.p_PL[k], quat=quaternion)
        body.mass, body.inertia, body.ipos, body.explicitinertial = 1.0, [1.0] * 3, [1.0] * 3, True
        bodies.append(body)
        kind = (
            mujoco.mjtJoint.mjJNT_SLIDE if robot.is_prismatic[k] else mujoco.mjtJoint.mjJNT_HINGE
        )
        joint = body.add_joint(name=name, type=kind, axis=robot.axis[k])
        if name != robot.joint_names[i]:
            coupling = spec.add_equality(
                type=mujoco.mjtEq.mjEQ_JOINT, name1=name, name2=robot.joint_names[i]
            )
            coupling.data[:2] = robot.offset[k], robot.multiplier[k]
        elif np.isfinite([robot.lower[i], robot.upper[i]]).all():
            joint.limited, joint.range = True, [robot.lower[i], robot.upper[i]]
    model = spec.compile()
    for k in range(1, len(robot.body_names)):
        _write_inertial(model, robot, k)
    if friction:
        moving = [int(model.joint(name).dofadr[0]) for name in robot.joint_names]
        model.dof_damping[moving], model.dof_frictionloss[moving] = robot.damping, robot.friction
    _set_options(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _write_inertial(
    model: Any, robot: RobotModel, body: int, loads: Sequence[RigidBody] = ()
) -> None:
    """Write mass and inertia of a body with its loads."""
    bare = RigidBody(robot.mass[body], robot.com[body], robot.inertia[body])
    whole = combine([bare, *loads]) if loads else bare
    moments, axes = np.linalg.eigh(whole.inertia)
    axes *= np.linalg.det(axes)  # turns a reflection into a rotation
    model.body_mass[body], model.body_ipos[body] = whole.mass, whole.com
    model.body_inertia[body] = moments
    mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())
    # MuJoCo's compiler has set this optimization flag for other inertias.
    model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE


def _set_options(model: Any) -> None:
    model.opt.gravity[:] = STANDARD_GRAVITY
    # Integrate damping implicitly, because a joint with a small inertia may have large damping.
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # A diverging state must be an error, not a jump back to the start.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    model.eq_solimp[:, :2] = STIFFEST
    model.eq_solref[:, 0] = 2.0 * LARGEST_STEP  # the smallest value that MuJoCo considers stable
    model.dof_solimp[:, :2] = STIFFEST  # otherwise joints creep under Coulomb friction
