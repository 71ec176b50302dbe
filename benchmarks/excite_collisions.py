"""
Looks for collisions in the motions of `inverse_dynamics excite`, with Pinocchio and coal.

The program runs the command on ten arms of example-robot-data, and writes
`doc/evidence/excite.md`. It checks the collision meshes in the poses of the motion. It also checks
the straight way from the zero pose, or the nearest limits, to the motion. Links that no joint
connects must not touch, and must stay above the floor. The check ignores pairs of links that touch
in almost all random poses, or in the zero pose and during the whole motion. On the way to the
motion, it also ignores pairs that touch in the zero pose.

    PYTHONPATH=test python -m benchmarks.excite_collisions [NAME or URDF ...]

The exit code is 1 in three cases: links collide; a search takes more than 30 s of processor time;
the expected errors are more than 20 % larger than without clearances, although the motion without
clearances hits nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
import math
import os
from pathlib import Path
import re
import resource
import subprocess
import sys
from tempfile import TemporaryDirectory
import textwrap
from typing import Any

import numpy as np

try:
    import coal
    import pinocchio
except ImportError:  # test/test_markdown.py and the linters import without them
    coal = pinocchio = None

from inverse_dynamics_node import InverseDynamics, load_urdf
from inverse_dynamics_node.analysis.excitation.limits import motion_limits
from inverse_dynamics_node.analysis.excitation.search import (
    DURATION,
    find_excitation,
    SAMPLES_PER_SECOND,
)
from inverse_dynamics_node.analysis.trajectory_files import read_trajectory
from inverse_dynamics_node.robot.model import Floats
from robot_files import real_robots, ROOT

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
LONGEST = 30.0  # longest processor time of a search [s]
LARGEST = 1.2  # largest ratio of the expected errors to those of the motion without clearances
RATE = 50.0  # checked poses per second [Hz]
ALMOST_ALL = 0.95  # fraction of the random poses
RANDOM_POSES = 200
FLOOR = 'floor'

Pair = tuple[int, int]


class CollisionModel:
    """The collision shapes of a robot, and the pairs of shapes that no joint connects."""

    def __init__(self, path: Path) -> None:
        # Paths of meshes are package://PACKAGE/..., relative to a folder above the description.
        packages = [str(folder) for folder in path.parents]
        self.model = pinocchio.buildModelFromUrdf(str(path))
        self.geometry = pinocchio.buildGeomFromUrdf(
            self.model, str(path), pinocchio.GeometryType.COLLISION, package_dirs=packages
        )
        self.data = self.model.createData()
        self.placements = self.geometry.createData()
        self.floor = 0.0
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
        """Return Pinocchio's configuration for positions by joint name; other joints are at 0."""
        q = pinocchio.neutral(self.model)
        for name, joint in zip(self.model.names[1:], self.model.joints[1:], strict=True):
            angle = positions.get(name, 0.0)
            if joint.nq == 2:
                q[joint.idx_q : joint.idx_q + 2] = np.cos(angle), np.sin(angle)
            else:
                q[joint.idx_q] = angle
        return np.asarray(q)

    def place(self, q: Floats) -> None:
        """Move the shapes to a configuration."""
        pinocchio.forwardKinematics(self.model, self.data, q)
        pinocchio.updateGeometryPlacements(self.model, self.data, self.geometry, self.placements)

    def touching(self, q: Floats) -> set[Pair]:
        """Return the pairs of joints whose bodies touch; -1 is the floor."""
        self.place(q)
        return {
            pair
            for pair, shapes in self.pairs.items()
            if any(self._is_touching(i, j) for i, j in shapes)
        }

    def distances(self, q: Floats) -> dict[Pair, float]:
        """Return the distances of pairs that do not touch [m]."""
        self.place(q)
        return {
            pair: min(self._distance(i, j) for i, j in shapes)
            for pair, shapes in self.pairs.items()
        }

    def _is_touching(self, i: int, j: int) -> bool:
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        return bool(coal.collide(*self._shape(i), *self._shape(j), request, result))

    def _distance(self, i: int, j: int) -> float:
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        return float(coal.distance(*self._shape(i), *self._shape(j), request, result))

    def _shape(self, index: int) -> tuple[Any, Any]:
        if index < 0:
            below = np.array([0.0, 0.0, self.floor - 1.0])
            return coal.Box(20.0, 20.0, 2.0), coal.Transform3s(np.eye(3), below)
        place = self.placements.oMg[index]
        shape = self.geometry.geometryObjects[index].geometry
        return shape, coal.Transform3s(place.rotation, place.translation)

    def name(self, pair: Pair) -> str:
        """Name a pair by its joints."""
        names = [self.model.names[k] if k >= 0 else FLOOR for k in pair]
        return ' and '.join('base' if name == 'universe' else name for name in names)


def random_configurations(model: Any) -> Iterator[Floats]:
    """Draw configurations within the position limits, and within one turn."""
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
    """Return the joint positions closest to 0 within the limits, by joint name."""
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


@dataclass(frozen=True)
class Result:
    """The result of the check for the motion of one robot."""

    name: str
    options: str
    """Options proposed by the message of the default call if that call found no motion."""
    hits: dict[str, int]
    """Number of poses in which a pair touches, by pair."""
    distance: float
    """Smallest distance between links during the motion [m]."""
    height: float
    """Smallest height of links above the floor [m]."""
    seconds: float
    errors: float
    """Expected errors relative to the motion without clearances (geometric mean)."""
    hits_before: int
    """Number of poses of the motion without clearances in which links touch."""
    left_out: list[str]
    message: str = ''
    """Message of the default call if that call found no motion."""

    @property
    def is_good(self) -> bool:
        """Return whether the motion fulfils all conditions of this check."""
        as_exact = self.hits_before > 0 or self.errors < LARGEST
        return not self.hits and self.seconds < LONGEST and as_exact


def excite(path: Path, folder: Path, *options: str) -> tuple[subprocess.CompletedProcess, float]:
    """Run the command; return the completed process and its processor time [s]."""
    command = [sys.executable, '-m', 'inverse_dynamics_node.cli.main', 'excite', str(path)]
    files = ['--csv', 'motion.csv', '--trajectory-out', 'motion.yaml', '--no-picture']
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [*command, *files, *options],
        cwd=folder,
        env={**os.environ, 'PYTHONPATH': str(ROOT)},
        capture_output=True,
        text=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def check(path: Path) -> Result:
    """Search for the motion of one robot, and check it."""
    robot, own = CollisionModel(path), load_urdf(path)
    options, message = '', ''
    with TemporaryDirectory() as name:
        folder = Path(name)
        done, seconds = excite(path, folder)
        if done.returncode == 1 and (found := re.search(r'--floor (-[\d.]+)', done.stderr)):
            options, robot.floor, message = found[0], float(found[1]), done.stderr.strip()
            done, seconds = excite(path, folder, *options.split())
        if done.returncode:
            sys.exit(f'{path.stem}: {done.stderr.strip()}')
        motion, _ = read_trajectory(folder / 'motion.csv', own.joint_names)
    rest = zero_pose(robot.model)

    def configurations(positions: Floats) -> list[Floats]:
        poses = (dict(zip(motion.joint_names, q, strict=True)) for q in positions)
        return [robot.configuration({**rest, **pose}) for pose in poses]

    counts: dict[Pair, int] = {}
    for q in random_configurations(robot.model):
        for pair in robot.touching(q):
            counts[pair] = counts.get(pair, 0) + 1
    left_out = {pair for pair, count in counts.items() if count >= ALMOST_ALL * RANDOM_POSES}
    at_first = robot.touching(robot.configuration(rest))
    moving = configurations(motion.positions[::2])
    during = [robot.touching(q) for q in moving]
    left_out |= at_first.intersection(*during)  # for example fingers that do not move
    zero = np.array([rest[joint] for joint in motion.joint_names])
    way = [zero + part * (motion.positions[0] - zero) for part in np.linspace(0.0, 1.0, 200)]
    on_way = [robot.touching(q) - at_first for q in configurations(np.array(way))]
    hits: dict[str, int] = {}
    for suffix, touching in (('', during), (' on the way', on_way)):
        for pair in set().union(*touching) - left_out:
            hits[robot.name(pair) + suffix] = sum(pair in pairs for pairs in touching)
    distances = [robot.distances(q) for q in moving]
    checked = set(robot.pairs) - left_out
    floor = {pair for pair in checked if pair[1] < 0}

    dynamics = InverseDynamics(own)
    before = find_excitation(dynamics, motion_limits(own))
    unknowns, log_det = (
        float(found)
        for found in re.findall(
            r'(\d+) unknowns; log det of their information\s+matrix: (\S+)', done.stdout
        )[0]
    )
    count = SAMPLES_PER_SECOND * before.series.duration
    lost = before.log_det + unknowns * math.log(count) - log_det
    poses = configurations(before.series.trajectory(RATE).positions)
    return Result(
        path.stem,
        options,
        hits,
        min(each[pair] for each in distances for pair in checked - floor),
        min(each[pair] for each in distances for pair in floor),
        seconds,
        math.exp(lost / (2.0 * unknowns)),
        sum(bool(robot.touching(q) - left_out) for q in poses),
        sorted(map(robot.name, left_out)),
        message,
    )


# ---- The table -----------------------------------------------------------------------------


def page(results: list[Result]) -> str:
    """Return the Markdown page with the table."""
    lines = [
        '# What the motions of `excite` hit',
        '',
        'Generated by',
        '',
        '```sh',
        'PYTHONPATH=test python -m benchmarks.excite_collisions',
        '```',
        '',
        'which runs `inverse_dynamics excite` with its default options on arms of',
        'example-robot-data. An independent check follows, with Pinocchio and coal on the',
        f'collision meshes, in {RATE:g} poses per second of the motion and in 200 poses of the',
        'straight way to its start.',
        '',
        f'**{sum(not each.hits for each in results)} of {len(results)} motions hit nothing.**',
        '',
        '| arm | hits | smallest distance | lowest link | processor time | errors | hits without '
        'clearances |',
        '|---|---|---|---|---|---|---|',
        *map(_row, results),
        '',
        '*Smallest distance*: of links that no joint connects. *Lowest link*: its height above',
        'the floor. *Errors*: the expected standard errors (geometric mean), relative to those of',
        'a motion that is searched without clearances and floor. *Hits without clearances*: the',
        'part of the poses of that motion in which links touch each other or the floor.',
    ]
    for each in results:
        if each.options:
            message = each.message.removeprefix('inverse_dynamics: ')
            lines += [
                '',
                f'The default call for {each.name} finds nothing and ends with exit code 1:',
                '',
                '```text',
                *textwrap.wrap(message, 98),
                '```',
                '',
                f'It is therefore run with `{each.options}`.',
            ]
    lines += ['', 'These pairs touch in almost all poses, and are not checked:', '']
    for each in results:
        lines += [f'- {each.name}: {pair}' for pair in each.left_out]
    return '\n'.join([*lines, ''])


def _row(result: Result) -> str:
    hits = ', '.join(f'{name} in {count} poses' for name, count in result.hits.items())
    options = f' `{result.options}`' if result.options else ''
    cells = [
        result.name + options,
        hits or 'nothing',
        f'{result.distance:.3f} m',
        f'{result.height:.3f} m',
        f'{result.seconds:.0f} s',
        f'{result.errors:.2f}',
        f'{result.hits_before / (RATE * DURATION):.0%}' if result.hits_before else 'none',
    ]
    return f'| {" | ".join(cells)} |'


def main() -> int:
    """Check the robots on the command line; return the exit code."""
    if coal is None:
        sys.exit('Pinocchio and coal are not installed')
    parser = argparse.ArgumentParser(prog='python -m benchmarks.excite_collisions')
    parser.add_argument('arms', nargs='*', default=ARMS, help='names or URDFs; writes no page')
    parser.add_argument('--doc', type=Path, default=ROOT / 'doc', help='folder of the page')
    options = parser.parse_args()
    by_name = {path.stem: path for path in real_robots()}
    results = []
    for arm in options.arms:
        results.append(check(by_name.get(arm) or Path(arm).resolve()))
        print(_row(results[-1]), flush=True)
    if options.arms == ARMS:
        (options.doc / 'evidence' / 'excite.md').write_text(page(results))
    print(f'{sum(each.is_good for each in results)} of {len(results)} motions are as promised')
    return 0 if all(each.is_good for each in results) else 1


if __name__ == '__main__':
    sys.exit(main())
