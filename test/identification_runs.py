"""Simulated recordings of robots that differ from their descriptions."""

from dataclasses import dataclass, replace

from inverse_dynamics_node import InverseDynamics
from inverse_dynamics_node.analysis.recordings.signals import Recording
from inverse_dynamics_node.robot.rigid_body import (
    parameters_of_pseudo_inertias,
    pseudo_inertias,
    rigid_body,
    RigidBody,
)
import numpy as np
from scipy.linalg import expm


@dataclass(frozen=True)
class Real:
    """A real robot, a chain: its bodies, the friction of its joints, springs and couplings."""

    robot: object
    armature: np.ndarray
    damping: np.ndarray
    coulomb: np.ndarray
    width: np.ndarray
    load_friction: np.ndarray
    offset: np.ndarray
    coupling: float | np.ndarray = 0.0
    stiffness: float | np.ndarray = 0.0
    rest: float | np.ndarray = 0.0

    def efforts(self, q, qd, qdd, gravity=(0.0, 0.0, -9.80665)):
        dynamics = InverseDynamics(self.robot, gravity)
        dynamics.set_friction(0.0, 0.0)
        load = dynamics.efforts(q, qd, qdd) + self.stiffness * (q - self.rest)
        coupling = np.broadcast_to(self.coupling, self.damping.shape)
        speed, rate = qd.copy(), qdd.copy()
        speed[..., 1:] += coupling[1:] * qd[..., :-1]
        rate[..., 1:] += coupling[1:] * qdd[..., :-1]
        dry = self.coulomb + self.load_friction * np.abs(load)
        drive = self.armature * rate + self.damping * speed + dry * np.tanh(speed / self.width)
        efforts = load + drive + self.offset
        efforts[..., :-1] += coupling[1:] * drive[..., 1:]
        return efforts


def other_bodies(robot, rng, spread=0.15):
    """Return the robot with other physical bodies: sheared, stretched and of another density."""
    mass, com, inertia = robot.mass.copy(), robot.com.copy(), robot.inertia.copy()
    for b in range(1, len(mass)):
        if mass[b] > 0.0:
            matrix = pseudo_inertias(RigidBody(mass[b], com[b], inertia[b]).parameters())
            change = rng.normal(0.0, spread, (4, 4)) * 0.5
            change[:3, 3] *= 0.1  # metres
            change[3, :3] = 0.0
            change = expm(change)
            changed = parameters_of_pseudo_inertias(change @ matrix @ change.T)
            mass[b], com[b], inertia[b] = rigid_body(changed)
    return replace(robot, mass=mass, com=com, inertia=inertia)


def real_robot(robot, rng, spread=0.15, load_friction=0.0, armature=0.05):
    """Return a robot that differs from its description, with friction."""
    dynamics = InverseDynamics(robot)
    n = len(robot.joint_names)
    q = rng.uniform(*ranges(robot), (200, n))
    efforts = np.sqrt(
        np.mean(dynamics.efforts(q, np.zeros(n), rng.normal(0, 2, (200, n))) ** 2, 0)
    )
    scale = efforts + 0.02 * efforts.max()
    return Real(
        other_bodies(robot, rng, spread),
        armature * scale * rng.uniform(0.5, 1.5, n),
        0.1 * scale * rng.uniform(0.5, 1.5, n),
        0.15 * scale * rng.uniform(0.5, 1.5, n),
        rng.uniform(0.02, 0.1, n),
        np.full(n, load_friction),
        0.01 * scale * rng.normal(size=n),
    )


def ranges(robot):
    """Return position limits, two radians or half a metre where there are none."""
    middle = np.where(
        np.isfinite(robot.lower) & np.isfinite(robot.upper), 0.5 * (robot.lower + robot.upper), 0.0
    )
    most = np.where(robot.is_prismatic_joint, 0.5, 2.0)
    half = np.where(
        np.isfinite(robot.lower) & np.isfinite(robot.upper),
        np.minimum(0.5 * (robot.upper - robot.lower), most),
        most,
    )
    return middle - 0.9 * half, middle + 0.9 * half


def exciting_motion(robot, rng, duration=40.0, rate=125.0, speed=1.5, harmonics=5):
    """Return times, positions, velocities and accelerations of a Fourier series."""
    n = len(robot.joint_names)
    times = np.arange(round(duration * rate)) / rate
    base = 2.0 * np.pi / 10.0
    lower, upper = ranges(robot)
    a, b = rng.normal(size=(2, harmonics, n)) / np.arange(1, harmonics + 1)[:, None]
    phase = base * np.arange(1, harmonics + 1)[:, None] * (1.0 + 0.013 * rng.uniform(size=(1, n)))
    angle = times[:, None, None] * phase
    q = (a * np.sin(angle) + b * np.cos(angle)).sum(1)
    scale = 0.5 * (upper - lower) / np.abs(q).max(0)
    qd = (phase * (a * np.cos(angle) - b * np.sin(angle))).sum(1) * scale
    fast = np.minimum(robot.velocity_limits, speed) / np.abs(qd).max(0)
    scale = scale * np.minimum(1.0, fast)
    q = 0.5 * (lower + upper) + q * scale
    qd = (phase * (a * np.cos(angle) - b * np.sin(angle))).sum(1) * scale
    qdd = -(phase**2 * (a * np.sin(angle) + b * np.cos(angle))).sum(1) * scale
    return times, q, qd, qdd


def record(
    real,
    motion,
    rng,
    noise=0.02,
    delay=0.0,
    position_noise=0.0,
    velocity_noise=0.0,
    has_velocities=True,
):
    """Record a motion; noise is relative to the RMS of each effort."""
    times, q, qd, qdd = motion
    efforts = real.efforts(q, qd, qdd)
    if delay:
        efforts = np.stack([np.interp(times - delay, times, x) for x in efforts.T], 1)
    efforts = efforts + noise * np.sqrt(np.mean(efforts**2, 0)) * rng.normal(size=efforts.shape)
    q = q + position_noise * rng.normal(size=q.shape)
    velocities = qd + velocity_noise * rng.normal(size=q.shape) if has_velocities else None
    return Recording(real.robot.joint_names, times, q, velocities, efforts)
