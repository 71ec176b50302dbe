"""The command `excite`: plans a motion for identifying masses and friction."""

from __future__ import annotations

import argparse
from contextlib import closing
import math
from pathlib import Path
import sys

import numpy as np

from ..analysis.excitation.collisions import Collisions
from ..analysis.excitation.limits import (
    default_and_random_poses,
    motion_limits,
    MotionLimits,
)
from ..analysis.excitation.search import DURATION, Excitation, find_excitation
from ..analysis.trajectory_files import write_trajectory
from ..dynamics.trajectory import Trajectory
from ..errors import ConfigurationError
from ..report.excitation_tables import errors_table, motion_notes
from ..robot.model import Floats, RobotModel
from . import arguments
from .arguments import choose_node, node_name
from .console import (
    check_outputs,
    collected_signals,
    new_file,
    OutputError,
    progress,
    say,
    show,
)

EPILOG = """\
examples:
  inverse_dynamics excite my_arm.urdf
  inverse_dynamics excite my_arm.urdf --floor -0.1 --box 0.6 0 0.2 0.3 0.5 0.4
  inverse_dynamics excite my_arm.urdf --joints elbow wrist
  inverse_dynamics excite my_arm.urdf --run
  inverse_dynamics effort my_arm.urdf my_arm_excite.yaml

The joints between the base and --link move. To move others, name all of them with --joints.

The links stay at least 5 mm away from each other, and 2 cm from the floor and from each --box,
according to the collision shapes of the URDF. This needs the Python package coal (pip install
coal). Without it, collisions are not checked. A payload has no shape: enclose it in a collision
shape of the URDF. To restrict the motion, narrow the limits in a copy of the URDF. The straight
path in joint space to the start pose is checked too. It begins at the default pose: each joint at
0, or in the middle of its range if 0 is out of range.

The motion is written as a JointTrajectory without efforts, as a joint_trajectory_controller
expects; `inverse_dynamics effort` prints its efforts. It begins with a slow motion to the start
pose. A second file contains the motion five times slower (_rehearsal.yaml). Send the rehearsal
first. Record /joint_states during both.

With --run, a running node that drives the motors follows the rehearsal and the motion, and returns
the arm to where it was. The joint states are recorded in a CSV file. Run `inverse_dynamics watch`
before. Ctrl-C ends the motion: the arm is held, and what was recorded is saved.

exit code: 0 done; 1 no safe motion was found, the node does not follow it, or a file cannot be
read or written; 2 invalid arguments; 130 ended by Ctrl-C."""

_RATE = 20.0
"""Rate of the points in the JointTrajectory [Hz]."""
_SLOW = 0.2
"""Fraction of the speed limits in the motion to the start, and of the speed in the rehearsal."""
_positive = arguments.number('a number above 0', lambda value: 0.0 < value <= 1e6)
_height = arguments.number("a height or 'none'", math.isfinite)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = arguments.new_parser(
        'excite',
        'Within the limits of the robot, find the motion that is best for identifying masses and '
        'friction. The command writes the motion as a JointTrajectory, and reports the space that '
        'the motion needs and the standard errors that the identified parameters would have.',
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
    parser.add_argument(
        '--run',
        nargs='?',
        const=True,
        type=node_name,
        metavar='NODE',
        help='let a running node follow the motion, and record the joint states (needs ROS 2; '
        'default: the only node)',
    )
    _add_files(parser)
    return parser


def _add_limits(parser: argparse.ArgumentParser) -> None:
    """Add the options that limit the motion, and the options for its surroundings."""
    parser.add_argument(
        '--joints',
        nargs='+',
        default=[],
        metavar='JOINT',
        help='joints to move (default: those between the base and --link, without a virtual base)',
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
    rehearsal = yaml.with_name(f'{yaml.stem}_rehearsal.yaml')
    recording = yaml.with_suffix('.csv')
    outputs = {'--trajectory-out': yaml, 'rehearsal': rehearsal}
    check_outputs([options.urdf], outputs, options.force)
    if options.run is not None and recording.exists():
        raise OutputError(f'{recording} already exists, and a recording never replaces a file')
    source = arguments.read_source_text(options.urdf)
    dynamics = arguments.load_dynamics(source, options.gravity)
    robot = dynamics.robot
    arguments.attach_payload(dynamics, options)
    limits = motion_limits(robot, options.joints, options.link)
    collisions = _collisions(robot, source, limits, options)
    with progress('searching for the best motion') as report:
        excitation = find_excitation(dynamics, limits, collisions, options.duration, report)
    for note in motion_notes(excitation, collisions):
        say(f'- {note}')
    print()
    show(errors_table(excitation))
    say('Before the motion runs at full speed, rehearse it, with a hand on the emergency stop.')
    print()
    for path, speed in ((yaml, 1.0), (rehearsal, _SLOW)):
        with new_file(path) as temporary:
            write_trajectory(temporary, _with_approach(excitation, speed))
        print(f'written: {path}')
    if options.run is not None:
        _run(options, excitation, collisions, recording)
        print(f'inverse_dynamics identify {options.urdf} {recording} --output calibrated.urdf')
    return 0


def _run(
    options: argparse.Namespace,
    excitation: Excitation,
    collisions: Collisions | None,
    path: Path,
) -> None:
    """Let a running node follow the rehearsal and the motion, and record the joint states."""
    from ..ros.observer import Observer, observing_node  # needs ROS
    from ..ros.recorder import JointStateRecorder
    from ..ros.trajectories import follow

    robot = excitation.unknowns.dynamics.robot
    wanted = None if options.run is True else options.run
    rehearsal, motion = (_with_approach(excitation, speed) for speed in (_SLOW, 1.0))
    with observing_node(options.ros_arguments) as node:
        observer = Observer(node, choose_node(node, wanted, is_patient=False))
        recorder = JointStateRecorder(observer, robot.joint_names)
        with progress(f'waiting for the joint states of {observer.name}'):
            status = recorder.wait()
        if not status.is_computing or status.text('loop', 'dry run') != 'no':
            raise ConfigurationError(
                f'{observer.name} does not drive the motors: run `inverse_dynamics watch`, and '
                'set its parameter dry_run to false'
            )
        present = np.array([recorder.positions.get(name, 0.0) for name in robot.joint_names])
        _check_way(excitation, collisions, present)
        back = motion._replace(
            times=motion.times[:1],
            positions=present[np.newaxis, excitation.limits.index],
            velocities=0.0 * motion.positions[:1],
            accelerations=0.0 * motion.positions[:1],
        )
        seconds = rehearsal.times[-1] + motion.times[-1] + back.times[-1]
        print(f'{observer.name} follows the rehearsal and the motion for {seconds:.0f} s')
        sys.stdout.flush()
        trajectories = follow(node, observer, [rehearsal, motion, back])
        with collected_signals() as signals, closing(trajectories):
            recorder.record(path, lambda: bool(signals) or next(trajectories))
    print(f'{path}: {recorder.count} joint states')
    if signals:
        raise SystemExit(128 + signals[0])


def _check_way(excitation: Excitation, collisions: Collisions | None, present: Floats) -> None:
    """Raise ConfigurationError if the straight path to the start pose has a collision."""
    if collisions is None:
        return
    start = present.copy()
    start[excitation.limits.index] = excitation.series.sample(np.zeros(1))[0][0]
    way = present + np.linspace(0.0, 1.0, 500)[:, np.newaxis] * (start - present)
    if not collisions.is_way_free(way):
        raise ConfigurationError(
            f'on the straight path to the start pose, these collide: '
            f'{collisions.most_frequent(way)}; move the arm to another pose'
        )


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


def _with_approach(excitation: Excitation, speed: float) -> Trajectory:
    """
    Return the motion at a fraction of its speed, after a slow motion to the start pose.

    The time of the first point is late enough for every joint to cross its whole range slowly.
    """
    limits = excitation.limits
    longest = np.max(2.0 * limits.half / (_SLOW * limits.speeds))
    motion = excitation.series.trajectory(_RATE, speed)
    return motion._replace(times=motion.times + max(5.0, np.ceil(longest)))


def _floor(text: str) -> float:
    return -math.inf if text == 'none' else _height(text)
