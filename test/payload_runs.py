"""Simulated runs of robots with and without a payload, whose friction, offsets and gains drift."""

from dataclasses import replace

from identification_runs import exciting_motion, ranges, real_robot
from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.analysis.recordings.signals import Recording
import numpy as np

PAUSE = 60.0  # [s] between the runs, in which the payload is mounted
WARMING = 0.1  # fraction of the friction that is lost while the gears warm up
WARM_UP = 120.0  # [s]
OFFSET_DRIFT = 0.005  # of the RMS effort, per minute
STICTION = 0.7, 0.1  # mean and deviation of the part of Coulomb friction that stays at rest
SAG = 0.001  # [rad or m] that a position controller gives way for the RMS effort of a joint


class Arm:
    """
    A robot that differs from its description.

    Joint torque sensors behind the gears feel a fifth of the friction that motor currents contain;
    with currents, friction also grows with the load on the gears.
    """

    def __init__(self, robot, rng, measures_currents=False, gain_error=0.01):
        self.robot, self.rng = robot, rng
        real = real_robot(robot, rng, load_friction=0.05 if measures_currents else 0.0)
        share = 1.0 if measures_currents else 0.2
        self.real = replace(real, coulomb=share * real.coulomb, damping=share * real.damping)
        self.gain = 1.0 + gain_error * rng.normal(size=len(robot.joint_names))
        self.drift = OFFSET_DRIFT / 60.0 * rng.normal(size=len(robot.joint_names))
        self.clock = 0.0

    def change(self, gains=0.01, friction=0.05):
        """Change gains and friction at random by these fractions, as between two days."""
        count = len(self.gain)
        self.gain = self.gain * (1.0 + gains * self.rng.normal(size=count))
        factor = 1.0 + friction * self.rng.normal(size=count)
        coulomb, damping = factor * self.real.coulomb, factor * self.real.damping
        self.real = replace(self.real, coulomb=coulomb, damping=damping)

    def efforts(self, q, qd, qdd, times, load=None):
        """Return measured efforts, without noise."""
        real, now = self.real, (self.clock + times)[:, None]
        dynamics = InverseDynamics(real.robot)
        dynamics.set_friction(0.0, 0.0)
        if load is not None:
            dynamics.set_payload(*load)
        rigid = dynamics.efforts(q, qd, qdd)
        warmth = 1.0 - WARMING * (1.0 - np.exp(-now / WARM_UP))
        friction = (real.coulomb + real.load_friction * np.abs(rigid)) * self._direction(qd)
        efforts = rigid + real.armature * qdd + warmth * (real.damping * qd + friction)
        size = np.sqrt(np.mean(rigid**2, axis=0))
        return self.gain * efforts + real.offset + self.drift * size * now

    def _direction(self, qd):
        """Return directions of friction; at rest, a part of the last one stays."""
        moves = np.abs(qd) > 1e-3
        last = np.maximum.accumulate(np.where(moves, np.arange(len(qd))[:, None], 0))
        part = STICTION[0] + STICTION[1] * self.rng.normal(size=qd.shape)
        left = np.take_along_axis(part * np.sign(qd), last, axis=0)
        return np.where(moves, np.tanh(qd / self.real.width), left)

    def record(self, motion, load=None, noise=0.02):
        """Record a motion; the arm gives way a little, and starts late."""
        times, q, qd, qdd = motion
        efforts = self.efforts(q, qd, qdd, times, load)
        size = np.sqrt(np.mean(efforts**2, axis=0))
        q = q - SAG * efforts / (size + 0.05 * size.max())
        efforts = self.efforts(q, qd, qdd, times, load)  # those of the states that are recorded
        efforts = efforts + noise * size * self.rng.normal(size=q.shape)
        self.clock += times[-1] + PAUSE
        late = 0.1 * self.rng.uniform()
        return Recording(self.robot.joint_names, times + late, q, qd, efforts)


def random_load(link, rng, mass):
    """Return a load for `InverseDynamics.set_payload`, a box of 6 to 16 cm."""
    sides = rng.uniform(0.06, 0.16, 3) ** 2
    com = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.03, 0.1)])
    return link, mass, com, np.diag(mass / 12.0 * (np.sum(sides) - sides))


def motion_of(robot, rng, duration=30.0, speed=1.0):
    """Return an excitation motion."""
    return exciting_motion(robot, rng, duration, 125.0, speed)


def poses_of(robot, rng, count=7, rest=2.0, rate=125.0):
    """Return rests in random poses, each approached in the same direction."""
    lower, upper = ranges(robot)
    q = rng.uniform(lower, upper, (count, len(lower)))
    times = np.arange(round(count * (rest + 1.0) * rate)) / rate
    phase = np.clip((times % (rest + 1.0)), 0.0, 1.0)
    blend = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    index = (times // (rest + 1.0)).astype(int)
    before = np.vstack([q[0] - 0.2, q])[index]
    after = q[index]
    position = before + blend[:, None] * (after - before)
    velocity = np.gradient(position, times, axis=0)
    return times, position, velocity, np.gradient(velocity, times, axis=0)
