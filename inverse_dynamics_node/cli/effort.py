"""The command `effort`: the efforts that a trajectory requires, for choosing motors."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
import math
from pathlib import Path
from typing import Any

import numpy as np

from ..analysis.requirements import effort_requirements, EffortRequirements
from ..analysis.trajectory_files import (
    FORMATS,
    LoadedTrajectory,
    read_trajectory,
    write_table,
)
from ..analysis.trajectory_yaml import write_trajectory
from ..analysis.workspace import joint_ranges
from ..dynamics.inverse_dynamics import STANDARD_GRAVITY
from ..dynamics.trajectory import (
    complete,
    refine,
    smooth,
    Trajectory,
)
from ..errors import ConfigurationError, unknown_name
from ..report.quantities import decimals, effort_unit, fraction, number
from ..report.tables import Table
from ..robot.hand import last_link
from ..robot.model import Floats, RobotModel
from ..robot.model_warning import ModelWarning
from ..robot.plausibility import position_warnings
from .arguments import output_path, payload, picture_path
from .console import progress, show, show_warnings
from .pictures.style import try_to_draw
from .robots import HELP, load_dynamics

EPILOG = f"""\
{FORMATS}

examples:
  inverse_dynamics effort my_arm.urdf pick.yaml
  inverse_dynamics effort my_arm.urdf pick.yaml --payload 1.5,0,0,0.05 --link tool0 --friction
  inverse_dynamics effort my_arm.urdf pick.yaml --trajectory-out pick_with_efforts.yaml
  inverse_dynamics effort my_arm.urdf rosbag2_2026_01_31/ --topic /joint_states --smooth 10

What is missing is derived: velocities from a cubic spline through the positions, accelerations
from one through the velocities. Between points that are far apart run polynomials of fifth degree,
as in ros2_control's joint trajectory controller. Accelerations derived from measured states carry
their noise: --smooth 10 takes it away.

exit code: 0 done; 1 something cannot be read or used; 2 wrong arguments; 3 with --strict, when a
limit of effort, speed or position is exceeded."""

_EXCEEDED = 3
_FAR_BEYOND = 10.0
"""An effort or a speed of so many times its limit is more likely to be in a wrong unit."""
_TERMS = ('inertia', 'velocity', 'gravity', 'friction')


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        'effort',
        help='efforts, speeds and powers along a trajectory, against the limits',
        description='Compute the joint efforts along a trajectory: peaks and means against the '
        'limits, what they are made of, a table of them over time, and a picture.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('urdf', type=Path, help=HELP)
    parser.add_argument('trajectory', type=Path, help='a file or recording, see below')
    parser.add_argument('--topic', help='of a recording')
    parser.add_argument(
        '--payload',
        type=payload,
        metavar='MASS[,X,Y,Z]',
        help='a load [kg], its centre of mass in the frame of the link [m]',
    )
    parser.add_argument(
        '--link', help='where the payload is; default: tool0, else the end of the longest chain'
    )
    parser.add_argument('--friction', action='store_true', help='count the friction of the URDF')
    parser.add_argument(
        '--at',
        action='append',
        default=[],
        type=_place,
        metavar='JOINT=POSITION',
        help='where a joint rests that the trajectory does not move [rad, m]; default: 0, or the '
        'end of its range next to that; may be repeated',
    )
    parser.add_argument(
        '--smooth',
        type=_rate,
        metavar='HZ',
        help='for measured states: take what changes faster for noise, and derive velocities and '
        'accelerations from the rest of the positions',
    )
    parser.add_argument(
        '--rate',
        type=_rate,
        default=200.0,
        help='states a second to look at, at least; 0: the points only (default: %(default)g)',
    )
    parser.add_argument(
        '--gravity',
        type=float,
        nargs=3,
        default=STANDARD_GRAVITY,
        metavar=('X', 'Y', 'Z'),
        help='free-fall acceleration in the frame of the root link [m/s^2]',
    )
    parser.add_argument(
        '--csv',
        type=output_path,
        metavar='FILE',
        help='default: <name of the trajectory>_efforts.csv',
    )
    parser.add_argument(
        '--picture',
        type=picture_path,
        metavar='FILE',
        help='default: <name of the trajectory>_efforts.png, here',
    )
    parser.add_argument('--no-picture', action='store_true', help='write no picture')
    parser.add_argument(
        '--trajectory-out',
        type=output_path,
        metavar='YAML',
        help='write the trajectory with velocities, accelerations and effort filled in, as '
        '`ros2 topic pub` takes it',
    )
    parser.add_argument('--strict', action='store_true', help='exit with 3 if it exceeds a limit')
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    dynamics = load_dynamics(options.urdf, options.gravity)
    robot = dynamics.robot
    link = options.link or last_link(robot)
    if options.payload:
        mass, *com = options.payload
        dynamics.set_payload(link, mass, com or (0.0, 0.0, 0.0))
    if options.friction:
        dynamics.set_friction()
    others = _others(robot, options.at)
    with progress('reading') as tell:
        source = read_trajectory(options.trajectory, robot.joint_names, options.topic, tell)
    if options.smooth:
        whole = smooth(source.trajectory, options.smooth)
        derived: tuple[str, ...] = (
            f'evenly spaced and smoothed at {options.smooth:g} Hz; velocities and accelerations '
            'derived from that',
        )
    else:
        whole, derived = complete(source.trajectory)
    fine, points = refine(whole, 1.0 / options.rate if options.rate else math.inf)
    requirements = effort_requirements(dynamics, fine, others)
    show(_summary(options, link, source, derived, fine), *demand_tables(robot, fine, requirements))
    warnings = (
        *position_warnings(robot, fine.positions, fine.joint_names),
        *_peak_warnings(fine, requirements),
    )
    if warnings:
        show_warnings(warnings)
        print()

    stem = options.trajectory.stem
    written = [options.csv or Path(f'{stem}_efforts.csv')]
    write_table(written[0], fine, requirements.efforts)
    if options.trajectory_out:
        written.append(options.trajectory_out)
        write_trajectory(options.trajectory_out, whole, requirements.efforts[points])
    if not options.no_picture:
        from .pictures.effort import draw

        load = f"\npayload {options.payload[0]:g} kg on link '{link}'" if options.payload else ''
        title = f'{robot.name}: efforts along {options.trajectory.name}{load}'
        path = try_to_draw(
            partial(draw, robot, fine, requirements, title), options.picture, f'{stem}_efforts.png'
        )
        if path:
            written.append(path)
    print('\n'.join(f'written: {path}' for path in written))
    is_exceeded = requirements.is_too_strong | requirements.is_too_fast | requirements.is_too_far
    return _EXCEEDED if options.strict and is_exceeded.any() else 0


def _place(text: str) -> tuple[str, float]:
    name, _, position = text.rpartition('=')
    try:
        return name, float(position)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not JOINT=POSITION") from None


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = -1.0
    if not 0.0 <= rate <= 1e5:
        raise argparse.ArgumentTypeError(f"'{text}' is no rate from 0 to 100000 Hz")
    return rate


def _others(robot: RobotModel, places: Sequence[tuple[str, float]]) -> Floats:
    """Return where joints are that the trajectory does not move."""
    positions: Floats = np.clip(0.0, *joint_ranges(robot))
    for name, position in places:
        if name not in robot.joint_names:
            raise ConfigurationError(f'--at: {unknown_name("joint", name, robot.joint_names)}')
        positions[robot.joint_names.index(name)] = position
    return positions


def _summary(
    options: argparse.Namespace,
    link: str,
    source: LoadedTrajectory,
    derived: tuple[str, ...],
    fine: Trajectory,
) -> Table:
    found = source.trajectory
    duration = fine.times[-1] - fine.times[0]
    count = f'{_count(len(found.times), "point")} in {duration:.3g} s, of ' + _count(
        len(found.joint_names), 'joint'
    )
    if len(fine.times) > len(found.times):
        count += f'; looked at in {len(fine.times)} states'
    loads = []
    if options.payload:
        loads.append(f"payload {options.payload[0]:g} kg on link '{link}'")
    loads.append('friction of the URDF counted' if options.friction else 'friction not counted')
    notes = (count, '; '.join(loads), *source.notes, *derived)
    return Table(f'trajectory {options.trajectory}', notes=notes)


def _peak_warnings(fine: Trajectory, requirements: EffortRequirements) -> tuple[ModelWarning, ...]:
    """Warn of efforts and speeds so far beyond their limits that a unit must be wrong."""
    found = []
    hint = (
        'check the units: positions in rad (degrees are 57 times as large) or m, times in s; for '
        'measured states, try --smooth 10'
    )
    for k, name in enumerate(fine.joint_names):
        shares = (
            ('effort', abs(float(requirements.peak[k])) / float(requirements.effort_limits[k])),
            ('speed', float(requirements.speed[k]) / float(requirements.velocity_limits[k])),
        )
        beyond = [f'{what} {share:.3g} times' for what, share in shares if share > _FAR_BEYOND]
        if beyond:
            text = f'{" and ".join(beyond)} its limit'
            found.append(ModelWarning(text, hint, name))
    return tuple(found)


def _count(number: int, noun: str) -> str:
    return f'{number} {noun}' if number == 1 else f'{number} {noun}s'


def demand_tables(
    robot: RobotModel, fine: Trajectory, requirements: EffortRequirements
) -> list[Table]:
    """Write out peaks and means against the limits, and what the efforts are made of."""
    index = [robot.joint_names.index(name) for name in fine.joint_names]
    places = decimals(requirements.peak)
    rows, parts = [], []
    for k, (name, i) in enumerate(zip(fine.joint_names, index, strict=True)):
        unit = effort_unit(robot, i)
        speed_unit = 'm/s  ' if robot.is_prismatic_joint[i] else 'rad/s'
        rows.append(
            (
                name,
                f'{round(requirements.peak[k], places) + 0.0:.{places}f} {unit}',
                f'{requirements.peak_time[k]:.2f} s',
                number(requirements.effort_limits[k]),
                fraction(requirements.peak[k], requirements.effort_limits[k]),
                f'{requirements.rms[k]:.{places}f}',
                f'{requirements.speed[k]:.3g} {speed_unit}',
                number(requirements.velocity_limits[k]),
                f'{requirements.power[k]:.3g} W',
                _marks(requirements, k),
            )
        )
        parts.append(
            (
                name,
                *(f'{requirements.rms_terms[t, k]:.{places}f}' for t in range(len(_TERMS))),
                f'{requirements.rms[k]:.{places}f} {unit}',
            )
        )
    columns = ('joint', 'peak effort', 'at', 'limit', 'ratio', 'RMS', 'speed', 'limit', 'power')
    is_marked = any(row[-1] for row in rows)
    notes = (
        (f'takes back up to {np.max(requirements.braking):.3g} W at a joint, when braking',)
        if np.max(requirements.braking) > 0.0
        else ()
    )
    return [
        Table(
            'Peaks against the limits',
            (*columns, '') if is_marked else columns,
            tuple(row if is_marked else row[:-1] for row in rows),
            notes,
            frozenset({9}),
            frozenset(k for k, row in enumerate(rows) if row[-1]),
        ),
        Table(
            'What the efforts are made of (RMS)',
            ('joint', *_TERMS, 'all'),
            tuple(parts),
            ('inertia: of accelerations; velocity: Coriolis and centrifugal',),
        ),
    ]


def _marks(requirements: EffortRequirements, k: int) -> str:
    marks = (
        (requirements.is_too_strong[k], 'effort'),
        (requirements.is_too_fast[k], 'speed'),
        (requirements.is_too_far[k], 'position'),
    )
    beyond = [what for is_beyond, what in marks if is_beyond]
    return f'beyond: {", ".join(beyond)}' if beyond else ''
