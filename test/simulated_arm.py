"""A control loop and an arm in MuJoCo, step by step."""

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.simulation.mujoco.hardware import MujocoRobot
import numpy as np
from states import store_state

PERIOD = 0.005  # [s]; of joint states and commands


class SimulatedArm:
    """An arm that starts at rest, at full gain, with the same friction in URDF and node."""

    def __init__(self, path, q, settings, *, held=(), friction=True, seed=0):
        self.robot = load_urdf(path)
        self.hardware = MujocoRobot(path, self.robot, q, friction, held)
        self.loop = ControlLoop(self.robot, self.hardware.command_names, settings, PERIOD)
        self.dynamics = self.loop.dynamics
        self.noise, self._random = 0.0, np.random.default_rng(seed)  # [rad/s]
        self.tip = self.robot.link_names[-1]
        self.time = 0.0
        self.hardware.brakes_on = False

    @property
    def q(self):
        return self.hardware.positions()

    @property
    def qd(self):
        return self.hardware.velocities()

    def push(self, force):
        """Apply a force at the tip, in the base frame [N]."""
        R = self.dynamics.pose(self.q, self.tip)[:3, :3]
        self.hardware.world.set_external_wrench(self.tip, R.T @ force)

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
