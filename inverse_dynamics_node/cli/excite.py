"""The command `excite`: a motion to record before masses and friction are identified."""

from __future__ import annotations

import argparse
from functools import partial
import math
from pathlib import Path
from typing import Any

import numpy as np

from ..analysis.excitation import (
    DURATION,
    Excitation,
    Extent,
    find_excitation,
    FRACTION,
    HARMONICS,
    motion_limits,
    NOISE,
    States,
    swept_box,
    whole_states,
)
from ..analysis.trajectory_files import write_table, write_trajectory
from ..dynamics.trajectory import Trajectory, trajectory_efforts
from ..report.excitation_tables import excitation_tables
from ..robot.model import Floats
from . import arguments
from .console import progress, say, show
from .output_files import check_outputs, new_file, output_path
from .pictures.excite import draw
from .pictures.style import try_to_draw

EPILOG = """\
examples:
  inverse_dynamics excite my_arm.urdf --floor 0.05
  inverse_dynamics excite my_arm.urdf --floor 0.05 --speed 0.2
  inverse_dynamics excite my_arm.urdf --joints elbow wrist --range elbow=-1.0:1.5
  inverse_dynamics effort my_arm.urdf my_arm_excite.csv

Collisions are not checked. Look at the picture and the printed space, restrict the motion with
--floor and --range, and rehearse it with --speed 0.2: the same path, five times slower. The motion
is a JointTrajectory without efforts, as a joint_trajectory_controller expects it. A second file
moves the arm slowly to the start pose. Record /joint_states meanwhile.

exit code: 0 done; 1 no motion is possible, or a file cannot be read or written; 2 invalid
arguments."""

_YAML_RATE = 20.0
"""Points per second of the JointTrajectory; controllers interpolate with 5th degree [Hz]."""
_SLOW = 0.2
"""Fraction of the speed limits at which the arm moves to the start pose."""
_positive = arguments.number('a number above 0', lambda value: 0.0 < value <= 1e6)


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        'excite',
        help='a motion to record for the identification of masses and friction',
        description='Find the motion within the limits from which masses and friction can be '
        'identified best. Writes it as CSV and as JointTrajectory, with a picture, and reports '
        'the space that it takes and the standard errors to expect.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    arguments.add_urdf(parser)
    _add_limits(parser)
    _add_motion(parser)
    arguments.add_payload(parser)
    arguments.add_link(parser)
    arguments.add_gravity(parser)
    _add_files(parser)
    parser.set_defaults(run=run)


def _add_limits(parser: argparse.ArgumentParser) -> None:
    """Add the options for the space and the limits of the motion."""
    parser.add_argument(
        '--joints', nargs='+', default=[], metavar='JOINT', help='joints to move (default: all)'
    )
    parser.add_argument(
        '--range',
        action='append',
        default=[],
        type=_range,
        metavar='JOINT=LOW:HIGH',
        help='range of a joint, to be used in full [rad, m]; may be repeated',
    )
    arguments.add_at(parser, 'does not move')
    parser.add_argument(
        '--floor',
        type=float,
        default=-math.inf,
        metavar='Z',
        help='least height of the origins of all links and of their centres of mass in the frame '
        'of the base [m] (default: none)',
    )
    parser.add_argument(
        '--fraction',
        type=float,
        default=FRACTION,
        help='fraction of the limits of position, speed and effort to use (default: %(default)g)',
    )


def _add_motion(parser: argparse.ArgumentParser) -> None:
    """Add the options for the motion itself."""
    parser.add_argument(
        '--duration',
        type=_positive,
        default=DURATION,
        help='duration at full speed [s] (default: %(default)g)',
    )
    parser.add_argument(
        '--harmonics',
        type=int,
        default=HARMONICS,
        help='number of harmonics, at least 2 (default: %(default)d)',
    )
    parser.add_argument(
        '--speed',
        type=_speed,
        default=1.0,
        help='speed at which to write the motion, up to 1; 0.2 to rehearse it (default: 1)',
    )
    parser.add_argument(
        '--noise',
        type=_positive,
        metavar='EFFORT',
        help='assumed standard deviation of measured efforts [N m, N] (default: '
        f'{100.0 * NOISE:g} %% of the effort limit)',
    )
    parser.add_argument(
        '--rate',
        type=_positive,
        default=100.0,
        help='points per second of the CSV file (default: %(default)g)',
    )


def _add_files(parser: argparse.ArgumentParser) -> None:
    """Add the options for the files to write."""
    parser.add_argument(
        '--csv',
        type=output_path,
        metavar='FILE',
        help='file for the motion as CSV (default: <name of the URDF>_excite.csv)',
    )
    parser.add_argument(
        '--trajectory-out',
        type=output_path,
        metavar='YAML',
        help='file for the motion as JointTrajectory (default: <name of the URDF>_excite.yaml); '
        'the way to the start pose goes to a file whose name ends with _start.yaml',
    )
    arguments.add_picture(parser, '<name of the URDF>_excite.png')
    arguments.add_force(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    stem = f'{arguments.stem_of(options.urdf)}_excite'
    if options.speed < 1.0:
        stem = f'{stem}_speed_{options.speed:g}'
    csv = options.csv or Path(f'{stem}.csv')
    yaml = options.trajectory_out or Path(f'{stem}.yaml')
    start = yaml.with_name(f'{yaml.stem}_start{yaml.suffix}')
    check_outputs(
        [options.urdf],
        {
            '--csv': csv,
            '--trajectory-out': yaml,
            'start of --trajectory-out': start,
            '--picture': arguments.picture_or(options, f'{stem}.png'),
        },
        options.force,
    )
    dynamics = arguments.load_dynamics(options.urdf, options.gravity)
    robot = dynamics.robot
    arguments.attach_payload(dynamics, options)
    limits = motion_limits(
        robot,
        options.joints,
        options.fraction,
        dict(options.range),
        dict(options.at),
        options.floor,
    )
    with progress('searching for the best motion') as report:
        noise = None if options.noise is None else np.array(options.noise)
        excitation = find_excitation(
            dynamics, limits, options.duration, options.harmonics, noise, report
        )
    trajectory = excitation.series.trajectory(options.rate, options.speed)
    efforts = trajectory_efforts(dynamics, trajectory, limits.rest)
    box = swept_box(robot, _positions(excitation, trajectory))
    show(*excitation_tables(robot, excitation, trajectory, efforts, box))
    _warn(dynamics.gravity, box, options)

    with new_file(csv) as temporary:
        write_table(temporary, trajectory, efforts)
    for path, motion in (
        (yaml, excitation.series.trajectory(_YAML_RATE, options.speed)),
        (start, _to_start(excitation)),
    ):
        with new_file(path) as temporary:
            write_trajectory(temporary, motion)
    written = [
        f'{csv}: the motion, with modelled efforts',
        f'{yaml}: the motion as JointTrajectory',
        f'{start}: to its start pose within {_seconds_to_start(excitation):g} s, from anywhere',
    ]
    source = options.urdf.name
    drawing = partial(draw, dynamics, excitation, trajectory, efforts, box, source)
    if path := try_to_draw(drawing, options, f'{stem}.png'):
        written.append(f'{path}: picture')
    print('\n'.join(f'written: {line}' for line in written))
    return 0


def _positions(excitation: Excitation, trajectory: Trajectory) -> Floats:
    """Return the positions of all joints, shape (k, n)."""
    zeros = np.zeros_like(trajectory.positions)
    return whole_states(excitation.limits, States(trajectory.positions, zeros, zeros)).q


def _seconds_to_start(excitation: Excitation) -> float:
    """Return the time in which every joint crosses its range slowly [s]."""
    limits = excitation.limits
    longest = float(np.max(2.0 * limits.half / (_SLOW * limits.speeds)))
    return float(max(5.0, math.ceil(longest)))


def _to_start(excitation: Excitation) -> Trajectory:
    """Return a trajectory of a single point, the start pose at rest."""
    q, _, _ = excitation.series.sample(np.zeros(1))
    times = np.array([_seconds_to_start(excitation)])
    return Trajectory(excitation.series.joint_names, times, q, 0.0 * q, 0.0 * q)


def _warn(gravity: Floats, box: Extent, options: argparse.Namespace) -> None:
    text = 'Collisions are not checked: rehearse the motion slowly, with --speed 0.2.'
    lowest = float(box.lowest[2])
    is_upright = gravity[2] < 0.0 and abs(gravity[2]) > 0.9 * np.linalg.norm(gravity)
    if is_upright and lowest < 0.0 and not math.isfinite(options.floor):
        text = (
            f'The motion goes {-lowest:.2f} m below the base: on a table, add --floor 0.1. {text}'
        )
    say(text)
    print()


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, _, ends = text.rpartition('=')
    low, _, high = ends.partition(':')
    try:
        return name, (float(low), float(high))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not JOINT=LOW:HIGH") from None


def _speed(text: str) -> float:
    speed = _positive(text)
    if speed > 1.0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a factor above 0, up to 1")
    return speed
