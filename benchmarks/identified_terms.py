"""
Count how often `identify` finds terms that exist, and writes terms that do not exist.

    python -m benchmarks.identified_terms [--seeds 5]

The simulated robots differ from their descriptions. Half of their joints have an armature. The
friction of a joint differs by 10 % between days, and varies by up to 15 % during a recording.
Efforts have noise of 2 %. A counterweight is a spring at the second joint, with the given part of
the RMS gravity effort of that joint per radian.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import sys
from typing import Any

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.identification import identify_parameters, terms
from inverse_dynamics_node.robot.model import RobotModel
import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / 'test'))
from identification_runs import exciting_motion, real_robot, record  # noqa: E402

ROBOTS = ROOT / 'config' / 'stanford.urdf', ROOT / 'test' / 'robots' / 'seven_dof.urdf'
RATE = 100.0  # [Hz]
LIMITS = (2.0, 1.0), (3.0, 3.0), (1.0, 0.0)
"""Limits to add and to keep springs and couplings, in standard errors; the first are used."""


def main() -> None:
    """Print one line for each limit, duration and counterweight."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--seeds', type=int, default=5)
    options = parser.parse_args()
    print('| limits | duration | counterweight | springs found | springs and couplings invented |'
          ' armatures found | armatures invented | residual |')  # fmt: skip
    print('|---|---|---|---|---|---|---|---|')
    robots = [load_urdf(path) for path in ROBOTS]
    for limits in LIMITS:
        terms.ERRORS_TO_ADD, terms.ERRORS_TO_KEEP = limits
        for duration in (10.0, 60.0):
            for stiffness in (0.0, 0.5, 1.5):
                cases = [
                    counted(robot, seed, duration, stiffness)
                    for robot in robots
                    for seed in range(options.seeds)
                ]
                counts = np.sum([case[:8] for case in cases], axis=0).astype(int)
                cells = [f'{a} of {b}' for a, b in counts.reshape(4, 2).tolist()]
                left = np.exp(np.mean(np.log([case[8] for case in cases])))
                print(f'| {limits[0]:g}, {limits[1]:g} | {duration:.0f} s | {stiffness:g} | '
                      f'{" | ".join(cells)} | {left:.2%} |', flush=True)  # fmt: skip


def counted(robot: RobotModel, seed: int, duration: float, stiffness: float) -> list[float]:
    """Return found and existing terms, and the residual relative to the measured efforts."""
    rng, n = np.random.default_rng(seed), len(robot.joint_names)
    real = real_robot(robot, rng, load_friction=0.03 * (seed % 2))
    has_armature = rng.permutation(n) < n // 2
    q = rng.uniform(-1.0, 1.0, (200, n))
    gravity = float(np.sqrt(np.mean(InverseDynamics(robot).gravity_efforts(q)[:, 1] ** 2)))
    is_second = np.arange(n) == 1
    real = replace(
        real,
        armature=np.where(has_armature, real.armature, 0.0),
        stiffness=np.where(is_second, stiffness * gravity, 0.0),
        rest=np.where(is_second, rng.uniform(-0.5, 0.5), 0.0),
    )
    motion = exciting_motion(robot, rng, duration, RATE, 1.0)
    training = record(of_a_day(real, rng), motion, rng)
    drift = np.cumsum(rng.normal(size=training.efforts.shape), axis=0)
    drift *= 0.15 / np.abs(drift).max(axis=0)
    steps = real.coulomb * np.tanh(motion[2] / real.width)
    training = training._replace(efforts=training.efforts + drift * steps)
    unseen = record(of_a_day(real, rng), exciting_motion(robot, rng, 10.0, RATE, 1.0), rng, 0.005)
    joints = identify_parameters(robot, [training], [unseen]).joints
    has_spring = is_second & (stiffness > 0.0)
    springs = np.array([joint.terms.stiffness != 0.0 for joint in joints])
    couplings = sum(joint.terms.coupling != 0.0 for joint in joints)
    armatures = np.array([joint.terms.armature > 0.0 for joint in joints])
    left = np.linalg.norm([joint.unseen.identified for joint in joints])
    measured = np.linalg.norm([joint.measured for joint in joints])
    counts = (
        springs & has_spring, has_spring, springs & ~has_spring, ~has_spring,
        armatures & has_armature, has_armature, armatures & ~has_armature, ~has_armature,
    )  # fmt: skip
    found = [float(values.sum()) for values in counts]
    found[2] += couplings
    return [*found, float(left / measured)]


def of_a_day(real: Any, rng: np.random.Generator) -> Any:
    """Return the robot with the friction of one day."""
    damping, coulomb = np.exp(rng.normal(0.0, 0.1, (2, len(real.damping))))
    return replace(real, damping=damping * real.damping, coulomb=coulomb * real.coulomb)


if __name__ == '__main__':
    main()
