"""MuJoCo as the robot hardware: it takes joint efforts and returns positions and velocities."""

from __future__ import annotations

from collections.abc import Collection
import math
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ...errors import unknown_name
from ...robot.model import Booleans, Floats, RobotModel
from ..trajectory import with_unit_diagonal
from .model import compile_model, LARGEST_STEP, SimulationError
from .world import World

LEAST_INERTIA = 1e-9  # [kg m^2 or kg]: the smallest finger joints have 1000 times as much
LEAST_INDEPENDENCE = 1e-9  # least eigenvalue; rounding leaves 1e-16 if two joints move as one
DRIVE_GAINS = 900.0, 60.0  # [1/s^2], [1/s] of the position controller: critically damped, 5 Hz
HELD_STIFFNESS = (2.0 * math.pi * 10.0) ** 2  # [1/s^2]: held joints have springs of 10 Hz


class MujocoRobot:
    """
    One simulated robot, held by brakes until they are released.

    Parameters
    ----------
    urdf : str or pathlib.Path
        Path of a URDF, or the URDF as text.
    robot : RobotModel
        The robot that `load_urdf` reads from the URDF.
    start : array_like, shape (n,)
        Start positions [rad or m], in the order of ``robot.joint_names``.
    friction : bool
        Whether to simulate the damping and Coulomb friction that the URDF specifies.
    held : collection of str
        Joints that take no commands; stiff springs hold them in their start positions.
    armature : array_like, shape (n,) or ()
        Inertia of rotors and gears at the joints [kg m^2 or kg].

    Raises
    ------
    SimulationError
        If MuJoCo cannot simulate the robot.

    """

    def __init__(
        self,
        urdf: str | Path,
        robot: RobotModel,
        start: ArrayLike,
        friction: bool = True,
        held: Collection[str] = (),
        armature: ArrayLike = 0.0,
    ) -> None:
        self.robot = robot
        self.brakes_on = True
        """Whether brakes hold every joint in place, regardless of the efforts."""
        self._model = compile_model(urdf, friction)
        self._data = mujoco.MjData(self._model)
        self._at_rest = mujoco.MjData(self._model)
        self.world = World(self._model, self._data, robot.body_names[0])
        """Payloads, pushes, and the motion of the base."""
        address = {
            self._model.joint(i).name: int(self._model.jnt_dofadr[i])
            for i in range(self._model.njnt)
        }
        self.state_names = tuple(sorted(address))
        """All movable joints, including mimic joints, sorted by name."""
        self._state_order = [address[name] for name in self.state_names]
        self._order = [address[name] for name in robot.joint_names]
        self._model.dof_armature[self._order] = armature
        unknown = sorted(set(held) - set(robot.joint_names))
        if unknown:
            raise SimulationError(unknown_name('joint', unknown[0], robot.joint_names))
        self._free = [i for i, name in enumerate(robot.joint_names) if name not in held]
        self.command_names = tuple(robot.joint_names[i] for i in self._free)
        """Commanded joints, in the order of the commands."""
        self._command_order = [self._order[i] for i in self._free]
        self._held_order = [address[name] for name in held]
        self._command_limits = robot.effort_limits[self._free]
        moving = [address[name] for name in robot.body_names[1:]]
        self._coupling = np.zeros((len(moving), len(robot.joint_names)))
        self._coupling[moving, robot.joint_index[1:]] = robot.multiplier[1:]
        self._data.qpos[:] = self._coupling @ np.asarray(start)
        self._data.qpos[moving] += robot.offset[1:]
        mujoco.mj_forward(self._model, self._data)
        require_inertia(robot, self.mass_matrix())
        self._hold(held)

    def state(self) -> tuple[Floats, Floats, Floats]:
        """Return positions, velocities and efforts in the order of ``state_names``."""
        order, data = self._state_order, self._data
        efforts = data.qfrc_applied.copy()
        efforts[self._held_order] = data.qfrc_passive[self._held_order]
        return data.qpos[order], data.qvel[order], efforts[order]

    def command(self, efforts: ArrayLike) -> None:
        """Apply efforts [N m or N], in the order of ``command_names``, until the next call."""
        limits = self._command_limits
        self._data.qfrc_applied[self._command_order] = np.clip(efforts, -limits, limits)

    def positions(self) -> Floats:
        """Return positions [rad or m] in the order of ``robot.joint_names``."""
        return np.asarray(self._data.qpos[self._order])

    def velocities(self) -> Floats:
        """Return velocities [rad/s or m/s] in the order of ``robot.joint_names``."""
        return np.asarray(self._data.qvel[self._order])

    def hold(self, q: Floats, qd: Floats, qdd: Floats) -> None:
        """Command efforts to track positions, velocities and accelerations, each of shape (n,)."""
        kp, kd = DRIVE_GAINS
        error, rate = q - self.positions(), qd - self.velocities()
        efforts = self.mass_matrix() @ (qdd + kp * error + kd * rate) + self.bias_efforts()
        self.command(efforts[self._free])

    def advance(self, duration: float) -> None:
        """Advance the simulation by a duration [s]."""
        if self.brakes_on:
            self._data.qvel[:] = 0.0
            return
        steps = math.ceil(duration / LARGEST_STEP)
        self._model.opt.timestep = duration / steps
        self.world.act()
        mujoco.mj_step(self._model, self._data, nstep=steps)
        if not np.isfinite(self._data.qacc).all():
            raise SimulationError('the simulation became unstable: the efforts are too large')

    def advance_within(self, duration: float, bounds: Floats) -> Floats | None:
        """
        Advance the simulation by a short duration [s], unless a joint would become too fast.

        Return None if the simulation has advanced. If a joint would exceed its speed bound,
        restore the previous state, and return the speeds that the joints would have reached.
        Speeds and bounds have shape (n,) [rad/s or m/s].
        """
        data = self._data
        before = data.qpos.copy(), data.qvel.copy(), data.qacc_warmstart.copy()
        try:
            self.advance(duration)
            speeds = np.abs(self.velocities())
        except SimulationError:
            speeds = np.full(len(bounds), np.inf)
        if (speeds <= bounds).all():
            return None
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = before
        mujoco.mj_forward(self._model, data)
        return speeds

    def stop(self) -> None:
        """Stop all joints instantly, as brakes do."""
        self._data.qvel[:] = 0.0
        mujoco.mj_forward(self._model, self._data)

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

    def _hold(self, joints: Collection[str]) -> None:
        """Hold joints in their current positions with critically damped springs."""
        inertia, load = self.mass_matrix().diagonal(), self.bias_efforts()
        for name in joints:
            i = self.robot.joint_names.index(name)
            dof = self._order[i]
            joint = self._model.dof_jntid[dof]
            stiffness = HELD_STIFFNESS * inertia[i]
            self._model.jnt_stiffness[joint] = stiffness
            self._model.dof_damping[dof] = 2.0 * math.sqrt(HELD_STIFFNESS) * inertia[i]
            self._model.qpos_spring[dof] = self._data.qpos[dof] + load[i] / stiffness
        mujoco.mj_forward(self._model, self._data)


def require_inertia(robot: RobotModel, mass_matrix: Floats) -> None:
    """Raise a `SimulationError` if a joint has no inertia."""
    idle = _without_inertia(mass_matrix)
    if idle.any():
        names = ', '.join(repr(robot.joint_names[i]) for i in np.flatnonzero(idle))
        raise SimulationError(
            f'no mass resists the motion of joint {names}: add an <inertial> with mass and '
            'inertia to a link that the joint moves, or make the joint fixed'
        )


def _without_inertia(inertia: Floats) -> Booleans:
    """Return which joints move no mass, or cannot move mass independently of other joints."""
    idle = np.asarray(inertia.diagonal() < LEAST_INERTIA)
    if idle.any():
        return idle
    independence, mixtures = np.linalg.eigh(with_unit_diagonal(inertia))
    singular = mixtures[:, independence < LEAST_INDEPENDENCE]
    return np.asarray((abs(singular) > 0.1).any(axis=1))
