"""Recordings computed from the model, with known deviations to be found."""

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.recordings.signals import Recording
import numpy as np
import pytest
from robot_files import ROOT, STANFORD

ROBOTS = {
    'stanford': STANFORD,
    'seven_dof': ROOT / 'test' / 'robots' / 'seven_dof.urdf',
    'branched': ROOT / 'test' / 'robots' / 'branched.urdf',
}
LONG = pytest.mark.long
STANFORD_TOO = pytest.param('stanford', marks=LONG)
BRANCHED_TOO = pytest.param('branched', marks=LONG)
EVERY_ROBOT = pytest.mark.parametrize('name', ['seven_dof', BRANCHED_TOO, STANFORD_TOO])
CHAIN_AND_TREE = pytest.mark.parametrize('name', ['seven_dof', 'branched', STANFORD_TOO])


def exciting(robot, times, rng):
    """Return q, qd, qdd with a sum of three sines per joint about the middle of its range."""
    n = len(robot.joint_names)
    bounded = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    lower = np.where(bounded, robot.lower, -np.pi)
    upper = np.where(bounded, robot.upper, np.pi)
    reach = np.minimum(0.3 * (upper - lower), 1.0)
    middle = 0.5 * (lower + upper) + 0.2 * reach
    q, qd, qdd = np.zeros((3, len(times), n))
    q += middle
    for _ in range(3):
        w = 2.0 * np.pi * rng.uniform(0.1, 0.7, n)
        phase = rng.uniform(0.0, 2.0 * np.pi, n)
        part = reach / 3.0
        angle = np.outer(times, w) + phase
        q += part * np.sin(angle)
        qd += part * w * np.cos(angle)
        qdd -= part * w * w * np.sin(angle)
    return q, qd, qdd


def run(
    name,
    seed=0,
    duration=20.0,
    rate=100.0,
    friction=None,
    effort_noise=0.01,
    encoder_noise=1e-4,
    has_velocities=True,
    act=None,
    armature=None,
):
    """
    Return the dynamics of a robot without friction, and a recording with friction.

    ``friction`` is damping and Coulomb friction; ``act`` sets other loads of the recorded robot.
    """
    robot = load_urdf(ROBOTS[name])
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, duration, 1.0 / rate)
    q, qd, qdd = exciting(robot, times, rng)
    real = InverseDynamics(robot)
    if friction is not None:
        real.set_friction(*friction)
    if armature is not None:
        real.set_armature(armature)
    if act is not None:
        act(real)
    efforts = real.efforts(q, qd, qdd)
    efforts += effort_noise * np.ptp(efforts, axis=0) * rng.standard_normal(efforts.shape)
    q = q + encoder_noise * rng.standard_normal(q.shape)
    qd = qd + 10.0 * encoder_noise * rng.standard_normal(q.shape) if has_velocities else None
    return InverseDynamics(robot), Recording(robot.joint_names, times, q, qd, efforts)


def samples_of(recording, keep):
    """Return a recording with some of the samples."""
    velocities = recording.velocities
    return recording._replace(
        times=recording.times[keep],
        positions=recording.positions[keep],
        velocities=None if velocities is None else velocities[keep],
        efforts=recording.efforts[keep],
    )
