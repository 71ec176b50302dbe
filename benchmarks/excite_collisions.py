"""
Looks for collisions in the motions of `inverse_dynamics excite`, with Pinocchio and coal.

Runs the command on robot descriptions, by default on ten arms of example-robot-data, and checks
the collision meshes themselves in all poses of the motion, and of the straight way to it from zero
or the nearest limits: links that no joint connects must not touch, and must be above the floor.
Pairs that touch in almost all random poses, or at zero and during all of the motion, are left out;
on the way also those that touch at zero.

    PYTHONPATH=test python -m benchmarks.excite_collisions [URDF ...]

The exit code is 1 if something collides, or a search takes more than 30 s of processor time.
"""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import resource
import subprocess
import sys
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

try:
    import coal
    import pinocchio
except ImportError:  # test/test_markdown.py and the linters import without them
    coal = pinocchio = None

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.trajectory_files import read_trajectory
from inverse_dynamics_node.robot.model import Floats
from robot_files import real_robots

ROOT = Path(__file__).parent.parent
ARMS = (
    'ur3_robot',
    'ur5_robot',
    'ur10_robot',
    'panda',
    'kinova',
    'z1',
    'xarm7',
    'so100',
    'so101',
    'talos_left_arm',
)
LONGEST = 30.0  # processor time of a search [s]
ALMOST_ALL = 0.95
RANDOM_POSES = 200
FLOOR = 'floor'

Pair = tuple[int, int]


class CollisionModel:
    """The collision shapes of a robot, and what of them no joint connects."""

    def __init__(self, path: Path) -> None:
        # A mesh is given as package://PACKAGE/..., relative to a folder above the description.
        packages = [str(folder) for folder in path.parents]
        self.model = pinocchio.buildModelFromUrdf(str(path))
        self.geometry = pinocchio.buildGeomFromUrdf(
            self.model, str(path), pinocchio.GeometryType.COLLISION, package_dirs=packages
        )
        self.data = self.model.createData()
        self.placements = self.geometry.createData()
        self.floor = coal.Box(20.0, 20.0, 2.0), coal.Transform3s(np.eye(3), np.array([0, 0, -1.0]))
        bodies = [each.parentJoint for each in self.geometry.geometryObjects]
        self.pairs: dict[Pair, list[tuple[int, int]]] = {}
        for i, a in enumerate(bodies):
            if a > 0:
                self.pairs.setdefault((a, -1), []).append((i, -1))
            for j, b in enumerate(bodies[:i]):
                low, high = sorted((a, b))
                if low != high and self.model.parents[high] != low:
                    self.pairs.setdefault((low, high), []).append((i, j))

    def configuration(self, positions: dict[str, float]) -> Floats:
        """Return Pinocchio's configuration for joint positions by name; 0 for others."""
        q = pinocchio.neutral(self.model)
        for name, joint in zip(self.model.names[1:], self.model.joints[1:], strict=True):
            angle = positions.get(name, 0.0)
            if joint.nq == 2:
                q[joint.idx_q : joint.idx_q + 2] = np.cos(angle), np.sin(angle)
            else:
                q[joint.idx_q] = angle
        return np.asarray(q)

    def touching(self, q: Floats) -> set[Pair]:
        """Return the pairs of joints whose bodies touch; -1 is the floor."""
        pinocchio.forwardKinematics(self.model, self.data, q)
        pinocchio.updateGeometryPlacements(self.model, self.data, self.geometry, self.placements)
        return {
            pair
            for pair, shapes in self.pairs.items()
            if any(self._is_touching(i, j) for i, j in shapes)
        }

    def _is_touching(self, i: int, j: int) -> bool:
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        return bool(coal.collide(*self._shape(i), *self._shape(j), request, result))

    def _shape(self, index: int) -> tuple[Any, Any]:
        if index < 0:
            return self.floor
        place = self.placements.oMg[index]
        shape = self.geometry.geometryObjects[index].geometry
        return shape, coal.Transform3s(place.rotation, place.translation)

    def name(self, pair: Pair) -> str:
        """Name a pair by its joints."""
        names = [self.model.names[k] if k >= 0 else FLOOR for k in pair]
        return ' and '.join('base' if name == 'universe' else name for name in names)


def random_configurations(model: Any) -> Iterator[Floats]:
    """Draw configurations within the limits, and within one turn."""
    rng = np.random.default_rng(0)
    for _ in range(RANDOM_POSES):
        q = pinocchio.neutral(model)
        for joint in model.joints[1:]:
            if joint.nq == 2:
                angle = rng.uniform(-np.pi, np.pi)
                q[joint.idx_q : joint.idx_q + 2] = np.cos(angle), np.sin(angle)
                continue
            k = joint.idx_q
            low, high = model.lowerPositionLimit[k], model.upperPositionLimit[k]
            q[k] = rng.uniform(max(low, -np.pi), min(high, np.pi))
        yield np.asarray(q)


def zero_pose(model: Any) -> dict[str, float]:
    """Return joint positions 0, or the nearest limits."""
    return {
        name: 0.0
        if joint.nq == 2
        else float(
            np.clip(
                0.0, model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
            )
        )
        for name, joint in zip(model.names[1:], model.joints[1:], strict=True)
    }


def check(path: Path) -> bool:
    """Search for the motion of one robot, print what it hits, and return whether it is good."""
    with TemporaryDirectory() as folder:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, '-m', 'inverse_dynamics_node.cli.main', 'excite', str(path)]
        options = ['--csv', 'motion.csv', '--trajectory-out', 'motion.yaml', '--no-picture']
        environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
        done = subprocess.run(
            [*command, *options], cwd=folder, env=environment, capture_output=True, text=True
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            print(f'{path.stem}: {done.stderr.strip()}', flush=True)
            return False
        robot = CollisionModel(path)
        names = load_urdf(path).joint_names
        motion, _ = read_trajectory(Path(folder) / 'motion.csv', names)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    counts: dict[Pair, int] = {}
    for q in random_configurations(robot.model):
        for pair in robot.touching(q):
            counts[pair] = counts.get(pair, 0) + 1
    left_out = {pair for pair, count in counts.items() if count >= ALMOST_ALL * RANDOM_POSES}
    at_first = zero_pose(robot.model)
    touching = robot.touching(robot.configuration(at_first))
    poses = [dict(zip(motion.joint_names, q, strict=True)) for q in motion.positions[::2]]
    during = [robot.touching(robot.configuration({**at_first, **pose})) for pose in poses]
    left_out |= touching.intersection(*during)  # such as fingers that do not move
    touching |= left_out
    hit: dict[str, int] = {}
    for pair in set().union(*during) - left_out:
        hit[robot.name(pair)] = sum(pair in pairs for pairs in during)
    for part in np.linspace(0.0, 1.0, 200):
        pose = dict(at_first)
        for name, end in zip(motion.joint_names, motion.positions[0], strict=True):
            pose[name] += part * (end - pose[name])
        for pair in robot.touching(robot.configuration(pose)) - touching:
            text = f'{robot.name(pair)} on the way'
            hit[text] = hit.get(text, 0) + 1
    skipped = ', '.join(sorted(map(robot.name, left_out))) or 'nothing'
    at_start = ', '.join(sorted(map(robot.name, touching - left_out))) or 'nothing'
    found = ', '.join(f'{name} in {count} poses' for name, count in hit.items()) or 'nothing'
    print(
        f'{path.stem}: hits {found}; {seconds:.1f} s. Always touching: {skipped}. '
        f'At zero: {at_start}.',
        flush=True,
    )
    print('   ', ' '.join(done.stdout.split('smallest distances')[1].split('Expected')[0].split()))
    return not hit and seconds < LONGEST


def main() -> int:
    """Check the robots of the command line."""
    if coal is None:
        sys.exit('Pinocchio and coal are not installed')
    paths = [Path(argument).resolve() for argument in sys.argv[1:]]
    if not paths:
        by_name = {path.stem: path for path in real_robots()}
        paths = [by_name[name] for name in ARMS]
    results = [check(path) for path in paths]
    print(f'{sum(results)} of {len(results)} motions hit nothing')
    return 0 if all(results) else 1


if __name__ == '__main__':
    sys.exit(main())
