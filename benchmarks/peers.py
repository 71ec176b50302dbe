"""
Single calls from Python, with the same robots and states for every installed library.

Each function makes a contender from one library. If the library is not installed, the function
raises an ImportError. If the library does not support the robot, the function raises the library's
own error. States are converted to the library's order and form before the timing starts.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import tempfile
from typing import Any

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.dynamics.inverse_dynamics import STANDARD_GRAVITY
from inverse_dynamics_node.robot.model import Floats
import numpy as np

from .robots import Robot
from .timing import Contender, contender, States

REFERENCE = 'pin.rnea'


def rows(*arrays: Floats) -> list[tuple[Any, ...]]:
    """Split batches of vectors into states."""
    return [tuple(np.ascontiguousarray(x) for x in state) for state in zip(*arrays, strict=True)]


def ours(robot: Robot, states: Floats, name: str = 'ours, out=') -> Contender:
    """Time this package with an existing array for the results."""
    efforts = InverseDynamics(robot.model).efforts
    out = np.empty(robot.n)

    def sweep(states: States) -> None:
        for q, qd, qdd in states:
            efforts(q, qd, qdd, out=out)

    return contender(name, rows(*states), sweep, lambda *state: efforts(*state).copy())


def ours_new_array(robot: Robot, states: Floats) -> Contender:
    """Time this package with a new array for every result."""
    efforts = InverseDynamics(robot.model).efforts

    def sweep(states: States) -> None:
        for q, qd, qdd in states:
            efforts(q, qd, qdd)

    return contender('ours, new array', rows(*states), sweep, efforts)


class Pinocchio:
    """A robot in Pinocchio: joints ordered by name, continuous joints stored as cos and sin."""

    def __init__(self, robot: Robot) -> None:
        import pinocchio

        self.model = pinocchio.buildModelFromXML(robot.urdf)
        self.model.gravity.linear = np.array(STANDARD_GRAVITY)
        self.data = self.model.createData()
        names = robot.model.joint_names
        self._joints = list(self.model.joints)[1:]
        order = [names.index(name) for name in list(self.model.names)[1:]]
        self.order = np.array(order)
        self.inverse = np.argsort(order)

    def positions(self, q: Floats) -> Floats:
        """Convert positions of shape (count, n) to Pinocchio's order and form."""
        x = q[:, self.order]
        positions = np.empty((len(q), self.model.nq))
        for k, joint in enumerate(self._joints):
            if joint.nq == 2:
                positions[:, joint.idx_q] = np.cos(x[:, k])
                positions[:, joint.idx_q + 1] = np.sin(x[:, k])
            else:
                positions[:, joint.idx_q] = x[:, k]
        return positions

    def states(self, states: Floats) -> tuple[Floats, Floats, Floats]:
        """Convert positions, velocities and accelerations to Pinocchio's order and form."""
        q, qd, qdd = states
        return self.positions(q), qd[:, self.order].copy(), qdd[:, self.order].copy()


def pinocchio(robot: Robot, states: Floats) -> Contender:
    """Time Pinocchio, the reference."""
    from pinocchio import rnea

    peer = Pinocchio(robot)
    model, data = peer.model, peer.data

    def sweep(states: States) -> None:
        for q, v, a in states:
            rnea(model, data, q, v, a)

    return contender(
        REFERENCE,
        rows(*peer.states(states)),
        sweep,
        lambda *state: rnea(model, data, *state)[peer.inverse],
    )


def _mujoco_model(robot: Robot) -> tuple[Any, Any, Floats]:
    import mujoco

    settings = '<mujoco><compiler fusestatic="false" balanceinertia="false"/></mujoco></robot>'
    text = settings.join(robot.urdf.rsplit('</robot>', 1))
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.gravity = STANDARD_GRAVITY
    disabled = mujoco.mjtDisableBit
    model.opt.disableflags |= int(disabled.mjDSBL_CONTACT) | int(disabled.mjDSBL_CONSTRAINT)
    names = robot.model.joint_names
    order = [names.index(model.joint(k).name) for k in range(model.njnt)]
    return model, mujoco.MjData(model), np.array(order)


def _in_mujoco(
    robot: Robot, states: Floats, name: str, calls: Callable[[Any, Any, Any], None]
) -> Contender:
    model, data, order = _mujoco_model(robot)
    inverse = np.argsort(order)
    result = data.qfrc_inverse
    qpos, qvel, qacc = data.qpos, data.qvel, data.qacc

    def sweep(states: States) -> None:
        for q, v, a in states:
            qpos[:] = q
            qvel[:] = v
            qacc[:] = a
            calls(model, data, result)

    def one(*state: Floats) -> Floats:
        sweep([state])
        return result[inverse].copy()

    return contender(name, rows(*states[:, :, order]), sweep, one)


def mujoco_rne(robot: Robot, states: Floats) -> Contender:
    """Time MuJoCo's Newton-Euler recursion, including the functions that must run first."""
    from mujoco import mj_comPos, mj_comVel, mj_kinematics, mj_rne

    def calls(model: Any, data: Any, result: Any) -> None:
        mj_kinematics(model, data)
        mj_comPos(model, data)
        mj_comVel(model, data)
        mj_rne(model, data, 1, result)

    return _in_mujoco(robot, states, 'MuJoCo mj_rne', calls)


def mujoco_inverse(robot: Robot, states: Floats) -> Contender:
    """Time MuJoCo's documented inverse dynamics, without contacts and constraints."""
    from mujoco import mj_inverse

    def calls(model: Any, data: Any, result: Any) -> None:
        mj_inverse(model, data)

    return _in_mujoco(robot, states, 'MuJoCo mj_inverse', calls)


def drake(robot: Robot, states: Floats) -> Contender:
    """Time Drake's multibody plant, including its force elements for gravity."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import MultibodyForces

    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(robot.urdf, 'urdf')
    base = robot.model.body_names[0]
    if base != 'world':  # Drake reserves this name
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(base))
    plant.mutable_gravity_field().set_gravity_vector(np.array(STANDARD_GRAVITY))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    forces = MultibodyForces(plant)
    names = robot.model.joint_names
    inverse = np.array([plant.GetJointByName(name).velocity_start() for name in names])
    order = np.argsort(inverse)

    def one(q: Floats, v: Floats, a: Floats) -> Floats:
        sweep([(q, v, a)])
        return plant.CalcInverseDynamics(context, a, forces)[inverse]

    def sweep(states: States) -> None:
        for q, v, a in states:
            plant.SetPositions(context, q)
            plant.SetVelocities(context, v)
            plant.CalcForceElementsContribution(context, forces)
            plant.CalcInverseDynamics(context, a, forces)

    return contender('Drake', rows(*states[:, :, order]), sweep, one)


def toolbox(robot: Robot, states: Floats) -> Contender:
    """Time the Robotics Toolbox with a URDF; the toolbox's faster C code needs DH tables."""
    from roboticstoolbox import Robot as ToolboxRobot

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'robot.urdf'
        path.write_text(robot.urdf)
        peer = ToolboxRobot.URDF(str(path))
    ours = robot.model
    order = np.empty(robot.n, int)
    for link in peer.links:
        if link.isjoint:
            body = ours.link_body[ours.link_names.index(link.name)]
            order[link.jindex] = ours.joint_index[body]
    inverse = np.argsort(order)
    gravity = np.array(STANDARD_GRAVITY)

    def sweep(states: States) -> None:
        for q, qd, qdd in states:
            peer.rne(q, qd, qdd, gravity=gravity)

    return contender(
        'roboticstoolbox',
        rows(*states[:, :, order]),
        sweep,
        lambda *state: peer.rne(*state, gravity=gravity)[inverse],
    )
