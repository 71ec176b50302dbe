"""
Counts the faults with which `inverse_dynamics watch --for` would end with exit code 0.

The program writes `doc/evidence/gate.md`. A simulated robot with one fault rests, sways, or moves
every joint as `watch` asks. The samples are those that `watch` collects: 50 per second, filtered,
with noise.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
import json
from pathlib import Path

from inverse_dynamics_node import InverseDynamics, RobotModel
from inverse_dynamics_node.analysis.diagnosis.gate import Gate
from inverse_dynamics_node.analysis.diagnosis.live import (
    Agreement,
    check_agreement,
    LiveSamples,
    Outcome,
)
from inverse_dynamics_node.control.contact import CUTOFF
from inverse_dynamics_node.robot.model import Floats
import numpy as np
from robot_files import ROOT
from scipy.signal import butter, sosfilt

from .confusion import robot, TIPS

ROBOTS = 'seven_dof', 'ur10_robot', 'panda'
POSES = 3
RATE = 50.0  # [Hz]
NOISE = 0.003  # of the efforts, relative to the largest effort of each joint
MOTIONS = 'at rest', 'swaying', 'as asked'
DURATION = {'at rest': 10.0, 'swaying': 10.0, 'as asked': 20.0}  # [s]
FRICTION = 0.03  # Coulomb friction, as a fraction of the effort limit
GAIN = 0.03  # standard deviation of the errors of the gains of effort sensors

Change = Callable[['Run'], None]


@dataclass
class Run:
    """A robot that moves with one fault."""

    described: RobotModel
    pose: Floats
    motion: str
    rng: np.random.Generator
    friction: float = 0.0
    real: InverseDynamics = field(init=False)
    factors: Floats = field(init=False)
    """Factors of the measured efforts, shape (n,)."""
    speeds: Floats = field(init=False)
    """Factors of the measured velocities, shape (n,)."""
    axes: Floats = field(init=False)
    """Signs of the axes, shape (n,)."""
    zeros: Floats = field(init=False)
    """Errors of the encoders, shape (n,) [rad or m]."""

    def __post_init__(self) -> None:
        n = len(self.described.joint_names)
        self.real = InverseDynamics(self.described)
        self.factors, self.speeds, self.axes = np.ones((3, n))
        self.zeros = np.zeros(n)

    def states(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return times, positions, velocities and accelerations of the real motion."""
        times = np.arange(0.0, DURATION[self.motion], 1.0 / RATE)
        n = len(self.pose)
        if self.motion == 'at rest':
            rate, amplitude = np.ones(n), np.zeros(n)
        elif self.motion == 'swaying':
            rate, amplitude = np.full(n, 1.5), np.full(n, 0.2)
        else:
            rate, amplitude = 1.0 + 0.15 * np.arange(n), np.full(n, 0.5)
        amplitude = np.where(self.described.is_prismatic_joint, 0.1 * amplitude, amplitude)
        angle = np.outer(times, rate) + 1.7 * np.arange(n)
        return (
            times,
            self.pose + amplitude * (np.sin(angle) - np.sin(angle[0])),
            amplitude * rate * np.cos(angle),
            -amplitude * rate**2 * np.sin(angle),
        )

    def samples(self) -> LiveSamples:
        """Return the samples that `watch` collects."""
        times, q, qd, qdd = self.states()
        limits = self.described.effort_limits
        self.real.set_friction(0.0, self.friction * np.where(np.isfinite(limits), limits, 0.0))
        measured = self.axes * self.factors * self.real.efforts(q, qd, qdd)
        q = self.axes * q + self.zeros
        qd, qdd = self.axes * qd, self.axes * qdd
        measured += NOISE * np.abs(measured).max(axis=0) * self.rng.standard_normal(q.shape)
        modelled = InverseDynamics(self.described).efforts(q, qd, qdd)
        low_pass = butter(1, CUTOFF, fs=RATE, output='sos')
        start = np.array([q[:1], self.speeds * qd[:1], measured[:1], modelled[:1]])
        signals = np.array([q, self.speeds * qd, measured, modelled])
        filtered = start + sosfilt(low_pass, signals - start, axis=1)
        return LiveSamples(self.described.joint_names, times, *filtered)

    def result(self) -> Agreement:
        """Return the result of `watch` at the end of the run."""
        samples, gate = self.samples(), Gate()
        gravity = InverseDynamics(self.described).gravity
        agreement = None
        for end in np.arange(10.0, DURATION[self.motion] + 0.1, 5.0):
            seen = (samples.times > end - 10.0) & (samples.times <= end)
            window = LiveSamples(samples.joint_names, *(x[seen] for x in samples[1:]))
            found = check_agreement(
                window, self.described, gravity, commanded=self.described.joint_names
            )
            agreement = gate.add(found)
            if agreement.outcome is Outcome.DIFFER:
                break  # a difference stays a difference
        assert agreement is not None
        return agreement


# ---- Faults --------------------------------------------------------------------------------


def faults(described: RobotModel, tip: str) -> Iterator[tuple[str, Change]]:
    """Yield the faults of a robot, each with its group."""

    def scaled(name: str, j: int, factor: float) -> Change:
        return lambda run: getattr(run, name).__setitem__(j, factor)

    def everywhere(factor: float) -> Change:
        return lambda run: setattr(run, 'speeds', np.full(len(run.pose), factor))

    def loaded(mass: float) -> Change:
        return lambda run: run.real.set_payload(tip, mass, (0.0, 0.0, 0.05))

    def tilted(degrees: float) -> Change:
        angle = np.radians(degrees)
        gravity = 9.80665 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
        return lambda run: run.real.set_gravity(gravity)

    def heavier(factor: float) -> Change:
        bodies = replace(
            described, mass=factor * described.mass, inertia=factor * described.inertia
        )
        return lambda run: setattr(run, 'real', InverseDynamics(bodies))

    for j in range(len(described.joint_names)):
        yield 'sign of one joint', scaled('factors', j, -1.0)
        yield 'velocity sign of one joint', scaled('speeds', j, -1.0)
        yield 'reversed axis of one joint', scaled('axes', j, -1.0)
        yield 'effort of one joint halved', scaled('factors', j, 0.5)
        yield 'effort of one joint doubled', scaled('factors', j, 2.0)
        for zero in (0.3, 0.6, 1.57):
            yield f'encoder zero off by {zero:g} rad', scaled('zeros', j, zero)
    yield 'velocity sign of all joints', everywhere(-1.0)
    yield 'velocities in deg/s', everywhere(float(np.degrees(1.0)))
    for degrees in (5, 10, 20):
        yield f'base tilted by {degrees} degrees', tilted(degrees)
    for mass in (1, 2, 3):
        yield f'unknown payload of {mass} kg', loaded(mass)
    for factor in (0.75, 1.3):
        yield f'all masses times {factor:g}', heavier(factor)


def healthy(run: Run) -> None:
    """Give the effort sensors small errors of their gains."""
    run.factors = 1.0 + GAIN * run.rng.standard_normal(len(run.pose))


# ---- The table -----------------------------------------------------------------------------


def poses(described: RobotModel, rng: np.random.Generator) -> list[Floats]:
    """Draw poses in the middle of the ranges of the joints."""
    lower = np.where(np.isfinite(described.lower), described.lower, -np.pi)
    upper = np.where(np.isfinite(described.upper), described.upper, np.pi)
    middle, reach = 0.5 * (lower + upper), np.minimum(0.3 * (upper - lower), 1.0)
    return [middle + reach * rng.uniform(-1.0, 1.0, len(lower)) for _ in range(POSES)]


def count(
    name: str, friction: float, chosen: Sequence[int]
) -> dict[str, dict[str, tuple[int, int]]]:
    """Return for each fault and motion how many runs end with exit code 0, and how many ran."""
    described, rng = robot(name), np.random.default_rng(1979)
    passed: Counter[tuple[str, str]] = Counter()
    total: Counter[tuple[str, str]] = Counter()
    cases = [('none', healthy), *faults(described, TIPS[name])]
    every = poses(described, rng)
    for pose in [every[k] for k in chosen]:
        for motion in MOTIONS:
            for fault, change in cases:
                run = Run(described, pose, motion, rng, friction)
                change(run)
                outcome = run.result().outcome
                total[fault, motion] += 1
                passed[fault, motion] += outcome is Outcome.AGREE
    names = dict.fromkeys(fault for fault, _ in cases)
    return {
        fault: {motion: (passed[fault, motion], total[fault, motion]) for motion in MOTIONS}
        for fault in names
    }


BEFORE = {
    'sign of one joint': (33, 32, 63),
    'velocity sign of one joint': (63, 63, 63),
    'velocity sign of all joints': (9, 9, 9),
    'velocities in deg/s': (9, 0, 9),
    'reversed axis of one joint': (36, 35, 63),
    'effort of one joint halved': (38, 34, 63),
    'effort of one joint doubled': (35, 33, 63),
    'encoder zero off by 0.3 rad': (42, 41, 63),
    'encoder zero off by 0.6 rad': (38, 36, 63),
    'encoder zero off by 1.57 rad': (33, 33, 63),
    'base tilted by 5 degrees': (8, 3, 9),
    'base tilted by 10 degrees': (4, 0, 9),
    'base tilted by 20 degrees': (0, 0, 9),
}
"""Exit codes 0 at rest and swaying, and runs, with a gate that needed a quarter of the joints."""


def page(robots: Sequence[str], tables: dict[str, dict[str, dict[str, list[int]]]]) -> str:
    """Return the Markdown page; the tables are keyed by friction and fault."""
    lines = [
        '# Which faults pass `watch --for`',
        '',
        'Generated by',
        '',
        '```sh',
        'PYTHONPATH=test python -m benchmarks.gate',
        '```',
        '',
        f'Arms ({", ".join(robots)}) in up to three poses each, with one fault.',
        'Each cell is the number of runs that end with exit code 0, of all runs. No joint is',
        'accepted with `--unchecked`.',
        '',
        '- At rest: 10 s.',
        '- Swaying: all joints move by 0.2 rad at the same frequency, 10 s.',
        '- As asked: every joint moves by 0.5 rad at its own frequency, 20 s.',
        '- Before: commit 790d201, which ended with 0 if a quarter of the joints carried weight.',
        '  Another program measured these figures, with seven_dof, ur10_robot and panda.',
        '',
        'In the row *none*, the effort sensors have gain errors of 3 %.',
    ]
    for friction, table in tables.items():
        lines += [
            '',
            f'## Dry friction {float(friction):.0%} of the effort limits',
            '',
            '| fault | at rest, before | swaying, before | at rest | swaying | as asked |',
            '|---|---|---|---|---|---|',
        ]
        for fault, row in table.items():
            before = BEFORE.get(fault)
            old = [f'{before[k]} of {before[2]}' for k in (0, 1)] if before else ['', '']
            new = [f'{row[motion][0]} of {row[motion][1]}' for motion in MOTIONS]
            lines.append(f'| {fault} | {" | ".join([*old, *new])} |')
    return '\n'.join([*lines, ''])


def main() -> None:
    """Simulate all runs of the given robots, then print and write the page."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.gate', description=__doc__)
    parser.add_argument('--robots', nargs='*', default=list(ROBOTS), choices=sorted(TIPS))
    parser.add_argument('--friction', nargs='*', type=float, default=[0.0, FRICTION])
    parser.add_argument('--poses', nargs='*', type=int, default=list(range(POSES)))
    parser.add_argument('--parts', type=Path, help='file that collects results of several calls')
    parser.add_argument('--doc', type=Path, default=ROOT / 'doc', help='folder of the page')
    options = parser.parse_args()
    robots: list[str] = []
    tables: dict[str, dict[str, dict[str, list[int]]]] = {}
    if options.parts and options.parts.exists():
        robots, tables = json.loads(options.parts.read_text())
    robots += [name for name in options.robots if name not in robots]
    for friction in options.friction:
        table = tables.setdefault(str(friction), {})
        for name in options.robots:
            for fault, row in count(name, friction, options.poses).items():
                sums = table.setdefault(fault, {motion: [0, 0] for motion in MOTIONS})
                for motion, (passed, total) in row.items():
                    sums[motion][0] += passed
                    sums[motion][1] += total
    if options.parts:
        options.parts.write_text(json.dumps([robots, tables]))
    text = page(robots, tables)
    print(text)
    (options.doc / 'evidence' / 'gate.md').write_text(text)


if __name__ == '__main__':
    main()
