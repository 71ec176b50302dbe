"""A control loop and an arm in MuJoCo, step by step."""

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.simulation.mujoco import MujocoRobot
import mujoco
import numpy as np
from states import store_state

PERIOD = 0.005  # [s]; of joint states and commands


def accelerations(robot):
    """Return the accelerations of a simulated robot, in the order of ``robot.joint_names``."""
    mujoco.mj_forward(robot._model, robot._data)
    robot._push()
    mujoco.mj_forward(robot._model, robot._data)
    return robot._data.qacc[robot._order]


class SimulatedArm:
    """An arm that starts at rest, at full gain, with the same friction in URDF and node."""

    def __init__(self, path, q, settings, *, joints=(), friction=True, seed=0):
        self.robot = load_urdf(path)
        self.hardware = MujocoRobot(self.robot, q, friction, joints)
        self.loop = ControlLoop(self.robot, self.hardware.command_names, settings, PERIOD)
        self.dynamics = self.loop.dynamics
        self.noise, self._random = 0.0, np.random.default_rng(seed)  # [rad/s]
        self.tip = self.robot.link_names[-1]
        self.time = 0.0

    @property
    def q(self):
        return self.hardware.positions()

    @property
    def qd(self):
        return self.hardware.velocities()

    def push(self, force):
        """Apply a force at the tip, in the base frame [N]."""
        R = self.dynamics.pose(self.q, self.tip)[:3, :3]
        self.hardware.set_external_wrench(self.tip, R.T @ force)

    def step(self):
        noise = self.noise * self._random.standard_normal(len(self.q))
        names = self.robot.joint_names
        store_state(self.loop.collector, self.time, names, self.q, self.qd + noise)
        self.hardware.command(self.loop.step(self.time).efforts)
        self.hardware.advance(PERIOD)
        self.time += PERIOD

    def run(self, duration):
        for _ in range(round(duration / PERIOD)):
            self.step()
