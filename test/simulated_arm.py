"""A control loop and an arm in MuJoCo, step by step; and stops of such arms."""

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Settings
import numpy as np
from robot_files import real_robots, ROOT
from states import PERIOD, store_state


def accelerations(robot):
    """Return the accelerations of a simulated robot, in the order of ``robot.joint_names``."""
    import mujoco

    mujoco.mj_forward(robot._model, robot._data)
    robot._push()
    mujoco.mj_forward(robot._model, robot._data)
    return robot._data.qacc[robot._order]


class SimulatedArm:
    """An arm that starts at rest, at full gain, with the same friction in URDF and node."""

    def __init__(self, path, q, settings, *, joints=(), friction=True, seed=0, period=PERIOD):
        from inverse_dynamics_node.simulation.mujoco import MujocoRobot

        self.robot = load_urdf(path)
        self.hardware = MujocoRobot(self.robot, q, friction, joints)
        self.loop = ControlLoop(self.robot, self.hardware.command_names, settings, period)
        self.dynamics = self.loop.dynamics
        self.noise, self.random = 0.0, np.random.default_rng(seed)  # [rad/s]
        self.tip = self.robot.link_names[-1]
        self.time, self.period = 0.0, period

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

    def measure(self, qd):
        """Let the control loop receive the positions, and velocities with noise."""
        noise = self.noise * self.random.standard_normal(len(qd))
        store_state(self.loop.collector, self.time, self.robot.joint_names, self.q, qd + noise)

    def step(self):
        """Return the command of one step."""
        self.measure(self.qd)
        command = self.loop.step(self.time)
        self.hardware.command(command.efforts)
        self.hardware.advance(self.period)
        self.time += self.period
        return command

    def run(self, duration):
        for _ in range(round(duration / self.period)):
            self.step()


_REAL = {path.stem: path for path in real_robots()}
# Each arm with the link at its tip, and a pose in which it is stretched out horizontally.
HORIZONTAL_ARMS = {
    'gripper_arm': (
        ROOT / 'test/robots/gripper_arm.urdf',
        'left_finger',
        (-1.168, 1.388, -0.007, -0.403, 0.374, 0.833, 0.923, 0.02),
    ),
    'ur10': (
        _REAL.get('ur10_robot'),
        'ee_link',
        (-0.089, 3.142, 0.0, -1.571, 0.449, -1.119),
    ),
    'panda': (
        _REAL.get('panda'),
        'panda_hand_tcp',
        (0.253, 1.352, -0.024, -0.496, 0.725, 2.414, -0.899, 0.007),
    ),
}
STOP = 0.2  # [s]; when the arm is stopped
PAUSES = 0.25  # [s]; from one pause of the joint states to the next
DELAY, NOISE = 0.005, 0.01  # [s], [rad/s]; of the measured velocities


class SoftStop(SimulatedArm):
    """
    One of `HORIZONTAL_ARMS` that is held, and stopped after `STOP`, with ``rate`` joint states/s.

    ``sign`` is a factor of the measured velocities, ``lost_at`` the time of the last joint state,
    and ``pause`` the length of pauses of the joint states [s]. Velocities at the start are uniform
    between minus and plus ``speeds`` [rad/s]. Other arguments are settings.
    """

    def __init__(self, arm, rate, sign=1.0, lost_at=np.inf, speeds=0.0, pause=0.0, **settings):
        path, tip, start = HORIZONTAL_ARMS[arm]
        settings = Settings(start_ramp=0.0, **settings)
        super().__init__(path, start, settings, friction=False, period=1.0 / rate)
        self.tip, self.noise = tip, NOISE
        self.sign, self.lost_at, self.pause = sign, lost_at, pause
        slow = self.robot.velocity_limits < 1.0  # fingers
        qd = np.where(slow, 0.0, self.random.uniform(-speeds, speeds, len(start)))
        self.hardware._data.qvel[self.hardware._order] = qd
        self.speeds, self.commands, self._measured, self.report = [], [], [], ''

    def measure(self, qd):
        speed = np.linalg.norm(self.dynamics.jacobian(self.q, self.tip)[:3] @ qd)
        self.speeds.append(float(speed))  # of the tip [m/s]
        self._measured.append(qd)
        late = self._measured[max(0, len(self._measured) - 1 - round(DELAY / self.period))]
        if self.time <= self.lost_at and (self.time + 0.1) % PAUSES >= self.pause:
            super().measure(self.sign * late)

    def step(self):
        if self.time >= STOP and not self.loop.supervisor.is_stopping:
            self.loop.stop()
        command = super().step()
        self.commands.append(command.efforts.copy())
        self.report = command.end_of_damping or self.report
        return command

    def run(self, duration):
        """Advance by a duration [s]; return this arm, with the speeds of the tip and commands."""
        super().run(duration)
        return self
