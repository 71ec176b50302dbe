"""Arms that are stopped in simulation, without ROS, and how fast their tips move."""

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.control.loop import ControlLoop
from inverse_dynamics_node.control.settings import Settings
import numpy as np
from robot_files import real_robots, ROOT
from states import store_state

_REAL = {path.stem: path for path in real_robots()}
# Each arm with the link at its tip, and a pose in which it is stretched out horizontally.
ARMS = {
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


def tip_speed(dynamics, tip, q, qd):
    """Return the speed of a link's origin [m/s]."""
    return float(np.linalg.norm(dynamics.jacobian(q, tip)[:3] @ qd))


class SoftStop:
    """
    An arm that is held, and stopped after `STOP`.

    Parameters
    ----------
    arm : str
        One of `ARMS`.
    rate : float
        Joint states per second; each is answered by a command.
    sign : float
        Factor of the measured velocities: -1 for a driver with the wrong sign.
    lost_at : float
        Time of the last joint state; commands continue.
    pause : float
        Length of pauses of the joint states [s]; commands continue.
    speeds : float
        Velocities at the start are uniform between minus and plus this [rad/s].
    **settings
        Of the controller.

    """

    def __init__(
        self, arm, rate, sign=1.0, lost_at=np.inf, speeds=0.0, pause=0.0, seed=0, **settings
    ):
        from inverse_dynamics_node.simulation.mujoco import MujocoRobot

        path, self.tip, start = ARMS[arm]
        self.robot = load_urdf(path)
        self.hardware = MujocoRobot(self.robot, start, friction=False)
        self.loop = ControlLoop(self.robot, settings=Settings(start_ramp=0.0, **settings))
        self.loop.start()
        self.dynamics = InverseDynamics(self.robot)
        self.rate, self.sign, self.lost_at, self.pause = rate, sign, lost_at, pause
        self.random = np.random.default_rng(seed)
        slow = self.robot.velocity_limits < 1.0  # fingers
        qd = np.where(slow, 0.0, self.random.uniform(-speeds, speeds, len(start)))
        self.hardware._data.qvel[self.hardware._order] = qd
        self.time, self.speeds, self.commands, self._measured = 0.0, [], [], []
        self.end, self.report = np.inf, ''

    def run(self, duration):
        """Advance by a duration [s]; keep the speeds of the tip and the commands."""
        robot, loop, hardware = self.robot, self.loop, self.hardware
        for _ in range(round(duration * self.rate)):
            q, qd = hardware.positions(), hardware.velocities()
            self.speeds.append(tip_speed(self.dynamics, self.tip, q, qd))
            self._measured.append(qd)
            late = self._measured[max(0, len(self._measured) - 1 - round(DELAY * self.rate))]
            noise = NOISE * self.random.standard_normal(len(q))
            if self.time <= self.lost_at and (self.time + 0.1) % PAUSES >= self.pause:
                store_state(
                    loop.collector, self.time, robot.joint_names, q, self.sign * late + noise
                )
            if self.time >= STOP and not loop.is_stopping:
                loop.stop()
            command = loop.step(self.time)
            self.commands.append(command.efforts.copy())
            if command.end_of_damping:
                self.end, self.report = self.time, command.end_of_damping
            hardware.command(self.commands[-1])
            hardware.advance(1.0 / self.rate)
            self.time += 1.0 / self.rate
        return self
