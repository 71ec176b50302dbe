"""The command `effort`: the efforts that a trajectory requires."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
import math
from pathlib import Path

import numpy as np

from ..analysis.sizing import effort_requirements, EffortRequirements, joint_ranges
from ..analysis.trajectory_files import (
    FORMATS,
    LoadedTrajectory,
    read_trajectory,
    write_table,
)
from ..dynamics.trajectory import complete, refine, Trajectory
from ..errors import listed
from ..report.tables import (
    counted,
    decimals,
    effort_unit,
    fraction,
    number,
    table,
    warnings_as_text,
)
from ..robot.limit_checks import position_warnings
from ..robot.model import ModelWarning, RobotModel
from . import arguments
from .console import check_outputs, new_file, progress, say, show
from .pictures.robot import draw_requirements
from .pictures.style import try_to_draw

EPILOG = f"""\
{FORMATS}

examples:
  inverse_dynamics effort my_arm.urdf pick.yaml
  inverse_dynamics effort my_arm.urdf pick.yaml --payload 1.5,0,0,0.05 --link tool0 --friction
  inverse_dynamics effort my_arm.urdf rosbag2_2026_01_31/ --csv efforts.csv

Missing velocities are derived from a cubic spline through the positions. Missing accelerations are
derived from the same spline or, if the file has velocities, from a cubic spline through these. If
points are too far apart in time for --rate, quintic polynomials connect them, as in the
joint_trajectory_controller of ros2_control. A joint that the trajectory does not move stays at 0,
or at the limit nearest to 0.

exit code: 0 done; 1 a file cannot be read or used; 2 invalid arguments."""

_FAR_BEYOND = 10.0
"""Beyond this multiple of the limit, an effort or a speed is probably in the wrong unit."""
_TERMS = ('inertia', 'velocity', 'gravity', 'friction')
_rate = arguments.number('a rate from 0 to 100000 Hz', lambda rate: 0.0 <= rate <= 1e5)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = arguments.new_parser(
        'effort',
        'Compute the joint efforts along a trajectory. The command prints the peaks and their '
        'limits, the RMS values, and the terms of the efforts. It also writes the efforts over '
        'time as CSV and as a picture.',
        EPILOG,
    )
    arguments.add_urdf(parser)
    parser.add_argument(
        'trajectory', type=Path, help='a file or recording, see "trajectory files" below'
    )
    arguments.add_payload(parser)
    arguments.add_link(parser)
    arguments.add_friction(parser)
    parser.add_argument(
        '--rate',
        type=_rate,
        default=200.0,
        metavar='HZ',
        help='evaluate at least this many states per second; 0 evaluates only the points of the '
        'trajectory (default: %(default)g)',
    )
    arguments.add_gravity(parser)
    arguments.add_output(
        parser,
        '--csv',
        'the efforts over time (default: <name of the trajectory>_efforts.csv)',
    )
    arguments.add_picture(parser, '<name of the trajectory>_efforts.png')
    arguments.add_force(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    stem = f'{options.trajectory.stem}_efforts'
    table = options.csv or Path(f'{stem}.csv')
    check_outputs(
        [options.urdf, options.trajectory],
        {
            '--csv': table,
            '--picture': arguments.picture_or(options, f'{stem}.png'),
        },
        options.force,
    )
    dynamics = arguments.load_dynamics(options.urdf, options.gravity)
    robot = dynamics.robot
    load = arguments.attach_payload(dynamics, options)
    if options.friction:
        dynamics.set_friction()
    with progress('reading') as report:
        source = read_trajectory(options.trajectory, robot.joint_names, report)
    whole, derived = complete(source.trajectory)
    fine, _ = refine(whole, 1.0 / options.rate if options.rate else math.inf)
    others = np.clip(0.0, *joint_ranges(robot))
    requirements = effort_requirements(dynamics, fine, others)
    show(
        _summary(options, load, source, derived, fine),
        *requirement_tables(robot, fine, requirements),
    )
    warnings = (
        *position_warnings(robot, fine.positions, fine.joint_names),
        *_peak_warnings(fine, requirements),
    )
    if warnings:
        show(warnings_as_text(warnings))

    written = [table]
    with new_file(table) as temporary:
        write_table(temporary, fine, requirements.efforts)
    title = f'{robot.name}: efforts along {options.trajectory.name}\n{load}'
    drawing = partial(draw_requirements, robot, fine, requirements, title)
    if path := try_to_draw(drawing, options, f'{stem}.png'):
        written.append(path)
    print('\n'.join(f'written: {path}' for path in written))
    print()
    say(verdict(requirements, fine.joint_names))
    return 0


def verdict(requirements: EffortRequirements, names: Sequence[str]) -> str:
    """State whether the motion stays within the limits."""
    quantities = (
        ('effort', np.abs(requirements.peak) / requirements.effort_limits),
        ('speed', requirements.speed / requirements.velocity_limits),
    )
    is_far = requirements.is_too_far
    is_beyond = requirements.is_too_strong | requirements.is_too_fast | is_far
    parts = [
        f'up to {ratios.max():.0%} of the {what} limit of {names[int(np.argmax(ratios))]}'
        for what, ratios in quantities
        if ratios.max() > 0.0
    ]
    if is_far.any():
        far = [name for name, beyond in zip(names, is_far, strict=True) if beyond]
        parts.append(f'{listed(far)} outside the position limits')
    if not parts:
        return 'No limit of effort or speed is known.'
    does = 'exceeds limits' if is_beyond.any() else 'stays within the known limits'
    return f'The motion {does}: {", ".join(parts)}.'


def _summary(
    options: argparse.Namespace,
    load: str,
    source: LoadedTrajectory,
    derived: tuple[str, ...],
    fine: Trajectory,
) -> str:
    found = source.trajectory
    duration = fine.times[-1] - fine.times[0]
    joints = counted(len(found.joint_names), 'joint')
    count = f'{counted(len(found.times), "point")} in {duration:.3g} s, {joints}'
    if len(fine.times) > len(found.times):
        count += f'; evaluated at {len(fine.times)} states'
    friction = 'with the friction of the URDF' if options.friction else 'without friction'
    notes = (count, '; '.join(filter(None, (load, friction))), *source.notes, *derived)
    return table(f'trajectory {options.trajectory}', notes=notes)


def _peak_warnings(fine: Trajectory, requirements: EffortRequirements) -> tuple[ModelWarning, ...]:
    """Return warnings about efforts and speeds that are far beyond the limits."""
    found = []
    hint = 'check the units: positions in rad or m, times in s'
    for k, name in enumerate(fine.joint_names):
        ratios = (
            ('effort', abs(float(requirements.peak[k])) / float(requirements.effort_limits[k])),
            ('speed', float(requirements.speed[k]) / float(requirements.velocity_limits[k])),
        )
        beyond = [
            f'the {what} is {ratio:.3g} times its limit'
            for what, ratio in ratios
            if ratio > _FAR_BEYOND
        ]
        if beyond:
            text = ' and '.join(beyond)
            found.append(ModelWarning(text, hint, name))
    return tuple(found)


def requirement_tables(
    robot: RobotModel, fine: Trajectory, requirements: EffortRequirements
) -> list[str]:
    """Return a table of peaks and limits, and a table of the terms of the efforts."""
    index = robot.joint_indices(fine.joint_names)
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
                f'{_power(requirements.power[k])} W',
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
    notes = (
        (f'when braking, a joint absorbs up to {np.max(requirements.braking):.3g} W',)
        if np.max(requirements.braking) > 0.0
        else ()
    )
    return [
        table(
            'Peaks compared with the limits',
            (*columns, ''),
            rows,
            notes,
            [9],
        ),
        table(
            'Terms of the efforts (RMS)',
            ('joint', *_TERMS, 'total'),
            parts,
            ('the velocity term contains the Coriolis and centrifugal efforts',),
        ),
    ]


def _power(value: float) -> str:
    return f'{value:.3g}' if value >= 0.005 else '0'


def _marks(requirements: EffortRequirements, k: int) -> str:
    marks = (
        (requirements.is_too_strong[k], 'effort'),
        (requirements.is_too_fast[k], 'speed'),
        (requirements.is_too_far[k], 'position'),
    )
    beyond = [name for is_beyond, name in marks if is_beyond]
    return f'beyond: {", ".join(beyond)}' if beyond else ''
