"""
Identify simulated robots from recordings with repeated samples, and with a wrong gain.

    python -m benchmarks.flawed_recordings
"""

from __future__ import annotations

from pathlib import Path
import sys
from typing import Any

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.analysis.identification import IdentificationResult, identify_parameters
from inverse_dynamics_node.analysis.recordings import signals
import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / 'test'))
from identification_runs import exciting_motion, real_robot, record  # noqa: E402

RATES = (30.0, 29.4), (500.0, 480.0), (1000.0, 500.0), (100.0, 500.0)
"""Samples per second of the recorder and of the source."""
FACTORS = 0.75, 0.9, 1.0, 1.1, 1.25
SPREADS = 0.0, 0.05, 0.15
"""Standard deviations of what changes the bodies of the real robot."""
SEEDS = range(4)


def main() -> None:
    """Print both tables."""
    robot = load_urdf(ROOT / 'config' / 'stanford.urdf')
    print('| recorder, source [1/s] | residual as recorded | repeats removed | without flaw |')
    print('|---|---|---|---|')
    remove = signals.without_repeats
    for rate, source_rate in RATES:
        real = real_robot(robot, np.random.default_rng(0))
        times, *states = exciting_motion(robot, np.random.default_rng(0), 30.0, source_rate)
        source = record(real, (times, *states), np.random.default_rng(1))
        stamps = np.arange(int(30.0 * rate)) / rate
        taken = np.minimum((stamps * source_rate + 1e-9).astype(int), len(times) - 1)
        flawed = source._replace(
            times=stamps,
            positions=source.positions[taken],
            velocities=source.velocities[taken],
            efforts=source.efforts[taken],
        )
        signals.without_repeats = lambda recording: (recording, ())
        as_recorded = left(identify_parameters(robot, [flawed]))
        signals.without_repeats = remove
        removed, clean = (left(identify_parameters(robot, [each])) for each in (flawed, source))
        print(
            f'| {rate:g}, {source_rate:g} | {as_recorded:.3f} N m | {removed:.3f} N m | '
            f'{clean:.3f} N m |',
            flush=True,
        )
    print('\n| bodies differ by | efforts times | named | named factor, over factor | error |')
    print('|---|---|---|---|---|')
    for spread in SPREADS:
        for factor in FACTORS:
            found: list[Any] = []
            for seed in SEEDS:
                rng = np.random.default_rng(seed)
                real = real_robot(robot, rng, spread + 1e-6)
                run = record(real, exciting_motion(robot, rng, 20.0, 100.0), rng)
                run = run._replace(efforts=factor * run.efforts)
                found.append(identify_parameters(robot, [run]).scale)
            named = [scale for scale in found if scale is not None]
            values = [f'{value / factor:.3f}' for value, _ in named]
            errors = [f'{error:.3f}' for _, error in named]
            print(
                f'| {spread:.0%} | {factor:g} | {len(named)} of {len(found)} | '
                f'{" ".join(values)} | {" ".join(errors)} |',
                flush=True,
            )


def left(result: IdentificationResult) -> float:
    """Return the residual on unseen data, combined for all joints [N m]."""
    return float(np.linalg.norm([joint.unseen.identified for joint in result.joints]))


if __name__ == '__main__':
    main()
