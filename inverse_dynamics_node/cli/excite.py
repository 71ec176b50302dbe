"""The command `excite`: plans a motion for identifying masses and friction."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from ..analysis.excitation.collisions import Collisions
from ..analysis.excitation.limits import (
    default_and_random_poses,
    motion_limits,
    MotionLimits,
)
from ..analysis.excitation.search import DURATION, Excitation, find_excitation
from ..analysis.trajectory_files import write_table, write_trajectory
from ..dynamics.trajectory import Trajectory, trajectory_efforts
from ..errors import ConfigurationError
from ..report.excitation_tables import excitation_tables
from ..robot.model import RobotModel
from . import arguments
from .console import check_outputs, new_file, progress, say, show

EPILOG = """\
examples:
  inverse_dynamics excite my_arm.urdf
  inverse_dynamics excite my_arm.urdf --floor -0.1 --box 0.6 0 0.2 0.3 0.5 0.4
  inverse_dynamics excite my_arm.urdf --joints elbow wrist
  inverse_dynamics effort my_arm.urdf my_arm_excite.csv

The links stay at least 2 cm away from each other, from the floor and from each --box, according to
the collision shapes of the URDF. This needs the Python package coal (pip install coal). Without
it, collisions are not checked. Links that are often close to each other may come closer. A payload
has no shape: enclose it in a collision shape of the URDF. To restrict the motion, narrow the
limits in a copy of the URDF. The straight path in joint space to the start pose is checked too. It
begins at the default pose: each joint at 0, or in the middle of its range if 0 is out of range.

The motion is written as a JointTrajectory without efforts, as a joint_trajectory_controller
expects. Two more files contain a slow motion to the start pose (_start.yaml), and the motion five
times slower (_rehearsal.yaml). Send the start and the rehearsal first. Record /joint_states during
the motion.

exit code: 0 done; 1 no safe motion was found, or a file cannot be read or written; 2 invalid
arguments."""

_CSV_RATE, _YAML_RATE = 100.0, 20.0
"""Rates of the points in the CSV file and in the JointTrajectory [Hz]."""
_SLOW = 0.2
"""Fraction of the speed limits in the motion to the start, and of the speed in the rehearsal."""
_positive = arguments.number('a number above 0', lambda value: 0.0 < value <= 1e6)
_height = arguments.number("a height or 'none'", math.isfinite)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = arguments.new_parser(
        'excite',
        'Within the limits of the robot, find the motion that is best for identifying masses and '
        'friction. The command writes the motion as CSV and as a JointTrajectory, and reports the '
        'space that the motion needs and the standard errors that the identified parameters would '
        'have.',
        EPILOG,
    )
    arguments.add_urdf(parser)
    _add_limits(parser)
    parser.add_argument(
        '--duration',
        type=_positive,
        default=DURATION,
        metavar='SECONDS',
        help='duration at full speed [s] (default: %(default)g)',
    )
    arguments.add_payload(parser)
    arguments.add_link(parser)
    arguments.add_gravity(parser)
    _add_files(parser)
    return parser


def _add_limits(parser: argparse.ArgumentParser) -> None:
    """Add the options that limit the motion, and the options for its surroundings."""
    parser.add_argument(
        '--joints',
        nargs='+',
        default=[],
        metavar='JOINT',
        help='joints to move (default: all except wheels, fingers and a virtual base)',
    )
    parser.add_argument(
        '--floor',
        type=_floor,
        default=0.0,
        metavar='Z',
        help="height of the floor in the frame of the base [m], or 'none' (default: 0)",
    )
    parser.add_argument(
        '--box',
        action='append',
        nargs=6,
        default=[],
        type=float,
        metavar=('X', 'Y', 'Z', 'LX', 'LY', 'LZ'),
        help='obstacle: the centre of a box, and its lengths along the axes of the base [m]; may '
        'be repeated',
    )


def _add_files(parser: argparse.ArgumentParser) -> None:
    """Add the options for the files to write."""
    arguments.add_output(
        parser,
        '--trajectory-out',
        'the motion as a JointTrajectory (default: <name of the URDF>_excite.yaml); the names of '
        'the other files begin with the same stem',
        'YAML',
    )
    arguments.add_force(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    stem = f'{arguments.stem_of(options.urdf)}_excite'
    yaml = options.trajectory_out or Path(f'{stem}.yaml')
    start, rehearsal, csv = (
        yaml.with_name(yaml.stem + end) for end in ('_start.yaml', '_rehearsal.yaml', '.csv')
    )
    check_outputs(
        [options.urdf],
        {
            '--trajectory-out': yaml,
            'start motion': start,
            'rehearsal': rehearsal,
            'table': csv,
        },
        options.force,
    )
    source = arguments.read_source_text(options.urdf)
    dynamics = arguments.load_dynamics(source, options.gravity)
    robot = dynamics.robot
    arguments.attach_payload(dynamics, options)
    limits = motion_limits(robot, options.joints)
    collisions = _collisions(robot, source, limits, options)
    with progress('searching for the best motion') as report:
        excitation = find_excitation(dynamics, limits, collisions, options.duration, report)
    trajectory = excitation.series.trajectory(_CSV_RATE)
    efforts = trajectory_efforts(dynamics, trajectory, limits.rest)
    show(*excitation_tables(robot, excitation, trajectory, efforts, collisions))
    say('Before the motion runs at full speed, rehearse it, with a hand on the emergency stop.')
    print()

    with new_file(csv) as temporary:
        write_table(temporary, trajectory, efforts)
    to_start = _to_start(excitation)
    for path, motion in (
        (yaml, excitation.series.trajectory(_YAML_RATE)),
        (start, to_start),
        (rehearsal, excitation.series.trajectory(_YAML_RATE, _SLOW)),
    ):
        with new_file(path) as temporary:
            write_trajectory(temporary, motion)
    written = [
        f'{csv}: the motion, with modelled efforts',
        f'{yaml}: the motion as a JointTrajectory',
        f'{start}: the motion to the start pose, which takes {to_start.times[0]:g} s',
        f'{rehearsal}: the motion as a JointTrajectory, five times slower',
    ]
    print('\n'.join(f'written: {line}' for line in written))
    return 0


def _collisions(
    robot: RobotModel, source: Path | str, limits: MotionLimits, options: argparse.Namespace
) -> Collisions | None:
    """Return what finds collisions with the obstacles of the options; None without coal."""
    boxes = []
    for values in options.box:
        centre, lengths = np.array(values).reshape(2, 3)
        if not np.isfinite(values).all() or not (lengths > 0.0).all():
            raise ConfigurationError(
                f'--box is {values}, expected a centre and three lengths above 0'
            )
        boxes.append(np.array([centre - 0.5 * lengths, centre + 0.5 * lengths]))
    poses = default_and_random_poses(limits)
    with progress('reading collision shapes'):
        try:
            return Collisions(robot, source, poses, options.floor, boxes)
        except ImportError:
            if boxes:
                raise ConfigurationError(
                    '--box needs the package coal: pip install coal'
                ) from None
            return None


def _to_start(excitation: Excitation) -> Trajectory:
    """
    Return a trajectory with one point, which is the start pose at rest.

    The time of this point is late enough for every joint to cross its whole range slowly.
    """
    limits = excitation.limits
    longest = np.max(2.0 * limits.half / (_SLOW * limits.speeds))
    q, _, _ = excitation.series.sample(np.zeros(1))
    times = np.array([max(5.0, np.ceil(longest))])
    return Trajectory(excitation.series.joint_names, times, q, 0.0 * q, 0.0 * q)


def _floor(text: str) -> float:
    return -math.inf if text == 'none' else _height(text)
