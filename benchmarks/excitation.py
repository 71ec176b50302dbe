"""
Plan motions for the arms of example-robot-data, and check them with Pinocchio.

    python -m benchmarks.excitation [ROBOT ...]

Pinocchio loads the collision meshes, and finds collisions at 2001 poses of the written motion. It
leaves out links that a joint connects, links that do not move relative to each other, and the
pairs that `excite` does not check. The errors are compared with the best of 1000 random motions
within the same limits. They are the geometric means of the standard errors of the base parameters
and of the terms of the joints.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
import time

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.excitation import search
from inverse_dynamics_node.analysis.excitation.collisions import Collisions
from inverse_dynamics_node.analysis.excitation.limits import (
    default_and_random_poses,
    motion_limits,
    random_states,
    States,
    whole_positions,
)
import numpy as np
from robot_files import real_robots
from scipy.linalg import qr

ARMS = (
    'ur3_robot', 'ur5_robot', 'ur10_robot', 'panda', 'kinova', 'xarm7', 'z1', 'so100', 'so101',
    'talos_left_arm',
)  # fmt: skip
RANDOM = 1000
CHECKED = 2001
SAMPLES = 80


def collisions_of_pinocchio(
    path: Path, q: np.ndarray, joints: tuple, moving: tuple, unchecked: list
) -> int:
    """Return the number of poses in which links touch, except in the unchecked pairs."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(path))
    folders = [str(folder) for folder in path.parents]
    kind = pin.GeometryType.COLLISION
    shapes = pin.buildGeomFromUrdf(model, str(path), kind, package_dirs=folders)
    objects = shapes.geometryObjects
    links = [model.frames[each.parentFrame].name for each in objects]
    bodies = [each.parentJoint for each in objects]
    group = list(range(model.njoints))
    for joint in range(1, model.njoints):
        if model.names[joint] not in moving:
            group[joint] = group[model.parents[joint]]
    for i, j in itertools.combinations(range(len(objects)), 2):
        parents = model.parents[bodies[i]], model.parents[bodies[j]]
        are_joined = bodies[i] == parents[1] or bodies[j] == parents[0]
        are_fixed = group[bodies[i]] == group[bodies[j]]
        names = {f'{links[i]} and {links[j]}', f'{links[j]} and {links[i]}'}
        if not are_joined and not are_fixed and not names & set(unchecked):
            shapes.addCollisionPair(pin.CollisionPair(i, j))
    data, geometry = model.createData(), shapes.createData()
    poses = np.tile(pin.neutral(model), (len(q), 1))
    for k, name in enumerate(joints):
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 2:  # the cosine and the sine of an endless joint
            poses[:, joint.idx_q : joint.idx_q + 2] = np.stack(
                [np.cos(q[:, k]), np.sin(q[:, k])], 1
            )
        elif joint.nq == 1:
            poses[:, joint.idx_q] = q[:, k]
    return sum(pin.computeCollisions(model, data, shapes, geometry, pose, True) for pose in poses)


def row(path: Path) -> str:
    """Plan a motion, check it, and return a row of the table."""
    began = time.process_time()
    robot = load_urdf(path)
    dynamics = InverseDynamics(robot)
    limits = motion_limits(robot)
    collisions = Collisions(robot, path, default_and_random_poses(limits), 0.0)
    found = search.find_excitation(dynamics, limits, collisions)
    seconds = time.process_time() - began
    q, _, _ = found.series.sample(np.linspace(0.0, found.series.duration, CHECKED))
    whole = whole_positions(limits, q)
    names = robot.joint_names, limits.joint_names
    hits = collisions_of_pinocchio(path, whole, *names, collisions.unchecked)
    motions = search.MotionSpace(dynamics, limits, collisions, found.series.duration)
    states = found.unknowns.weighted(random_states(limits, 400, np.random.default_rng(1)))
    states = states.reshape(-1, states.shape[-1])
    # A QR decomposition with pivoting finds columns that are linearly independent.
    triangle, order = qr(states / np.linalg.norm(states, axis=0), mode='r', pivoting=True)
    sizes = np.abs(np.diagonal(triangle))
    leading = order[: np.count_nonzero(sizes > 1e-8 * sizes[0])]

    def information(states: States) -> float:
        """Return the mean logarithm of the information about a base parameter."""
        whole = found.unknowns.information(states, found.series.duration)
        return np.linalg.slogdet(whole[np.ix_(leading, leading)])[1] / len(leading)

    random = motions.random(RANDOM, np.random.default_rng(7))
    best = max(information(motions.states(x)) for x in random)
    times = found.series.duration / SAMPLES * np.arange(SAMPLES)
    ours = information(States(*found.series.sample(times)))
    ratio = np.exp(0.5 * (best - ours))
    pairs = ', '.join(collisions.unchecked) or '-'
    return (
        f'| {path.stem} | {len(limits.index)} | {hits} of {CHECKED} | {ratio:.2f} | {seconds:.1f} '
        f'| {pairs} |'
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('robots', nargs='*', default=ARMS)
    names = parser.parse_args().robots
    paths = {path.stem: path for path in real_robots()}
    print('| robot | joints | poses with a collision | errors | CPU [s] | not checked |')
    print('|---|---|---|---|---|---|')
    for name in names:
        print(row(paths[name]), flush=True)


if __name__ == '__main__':
    main()
