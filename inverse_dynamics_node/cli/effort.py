"""The command `effort`: the efforts that a trajectory requires."""

from __future__ import annotations

import argparse
from functools import partial
import math
from pathlib import Path
from typing import Any

import numpy as np

from ..analysis.sizing import effort_requirements, EffortRequirements, joint_ranges
from ..analysis.trajectory_files import (
    FORMATS,
    LoadedTrajectory,
    read_trajectory,
    write_table,
)
from ..dynamics.trajectory import complete, refine
from ..errors import listed
from ..report.tables import (
    counted,
    decimals,
    effort_unit,
    fraction,
    number,
    percent,
    table,
    warnings_as_text,
)
from ..robot.limit_checks import position_warnings
from ..robot.model import Floats, ModelWarning, RobotModel
from . import arguments
from .console import check_outputs, new_file, print_json, progress, say, show
from .pictures.effort import draw_requirements
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
    arguments.add_json(parser)
    arguments.add_picture(parser, '<name of the trajectory>_efforts.png')
    arguments.add_force(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    stem = f'{options.trajectory.stem}_efforts'
    csv, picture = options.csv or Path(f'{stem}.csv'), arguments.picture_or(options, f'{stem}.png')
    inputs = [options.urdf, options.trajectory]
    check_outputs(inputs, {'--csv': csv, '--picture': picture}, options.force)
    dynamics = arguments.load_dynamics(options.urdf, options.gravity)
    robot = dynamics.robot
    load = arguments.attach_payload(dynamics, options)
    if options.friction:
        dynamics.set_friction()
    with progress('reading') as report:
        source = read_trajectory(options.trajectory, robot.joint_names, report)
    whole, derived = complete(source.trajectory)
    fine, _ = refine(whole, 1.0 / options.rate if options.rate else math.inf)
    requirements = effort_requirements(dynamics, fine, np.clip(0.0, *joint_ranges(robot)))
    warnings = (
        *position_warnings(robot, fine.positions, fine.joint_names),
        *_far_beyond(requirements),
    )
    notes = ('; '.join(filter(None, (load, _friction_note(options)))), *source.notes, *derived)
    if options.json:
        print_json(_as_json(requirements, [*map(str, warnings)], notes))
    else:
        summary = _summary(options, source, notes, requirements)
        show(summary, *_tables(robot, requirements))
        if warnings:
            show(warnings_as_text(warnings))

    written = [csv]
    with new_file(csv) as temporary:
        write_table(temporary, fine, requirements.efforts)
    title = f'{robot.name}: efforts along {options.trajectory.name}\n{load}'
    drawing = partial(draw_requirements, robot, requirements, title)
    if path := try_to_draw(drawing, options, f'{stem}.png'):
        written.append(path)
    if not options.json:
        print('\n'.join(f'written: {path}' for path in written))
        print()
        say(_verdict(requirements))
    return 0


def _friction_note(options: argparse.Namespace) -> str:
    return 'with the friction of the URDF' if options.friction else 'without friction'


def _ratios(requirements: EffortRequirements) -> dict[str, Floats]:
    """Return the ratios of the largest efforts and speeds to their limits, each of shape (m,)."""
    return {
        'effort': np.abs(requirements.peak) / requirements.effort_limits,
        'speed': requirements.speed / requirements.velocity_limits,
    }


def _verdict(requirements: EffortRequirements) -> str:
    """State whether the motion stays within the limits."""
    names, is_far = requirements.trajectory.joint_names, requirements.is_beyond['position']
    parts = [
        f'up to {percent(ratios.max())} of the {what} limit of {names[int(np.argmax(ratios))]}'
        for what, ratios in _ratios(requirements).items()
        if ratios.max() > 0.0
    ]
    if is_far.any():
        far = [name for name, beyond in zip(names, is_far, strict=True) if beyond]
        parts.append(f'{listed(far)} outside the position limits')
    if not parts:
        return 'No limit of effort or speed is known.'
    is_beyond = any(np.any(each) for each in requirements.is_beyond.values())
    does = 'exceeds limits' if is_beyond else 'stays within the known limits'
    return f'The motion {does}: {", ".join(parts)}.'


def _as_json(
    requirements: EffortRequirements, warnings: list[str], notes: tuple[str, ...]
) -> dict[str, Any]:
    names = requirements.trajectory.joint_names
    fields = ('peak', 'peak_time', 'rms', 'effort_limits', 'speed', 'velocity_limits', 'power',
              'braking')  # fmt: skip
    beyond = requirements.is_beyond
    return {
        'verdict': _verdict(requirements),
        'joints': {
            name: {field: getattr(requirements, field)[k] for field in fields}
            | {'beyond': [what for what, joints in beyond.items() if joints[k]]}
            for k, name in enumerate(names)
        },
        'warnings': warnings,
        'notes': notes,
    }


def _summary(
    options: argparse.Namespace,
    source: LoadedTrajectory,
    notes: tuple[str, ...],
    requirements: EffortRequirements,
) -> str:
    found, times = source.trajectory, requirements.trajectory.times
    joints = counted(len(found.joint_names), 'joint')
    count = f'{counted(len(found.times), "point")} in {times[-1] - times[0]:.3g} s, {joints}'
    if len(times) > len(found.times):
        count += f'; evaluated at {len(times)} states'
    return table(f'trajectory {options.trajectory}', notes=(count, *notes))


def _far_beyond(requirements: EffortRequirements) -> tuple[ModelWarning, ...]:
    """Return warnings about efforts and speeds that are far beyond the limits."""
    found = []
    for k, name in enumerate(requirements.trajectory.joint_names):
        beyond = [
            f'the {what} is {ratios[k]:.3g} times its limit'
            for what, ratios in _ratios(requirements).items()
            if ratios[k] > _FAR_BEYOND
        ]
        if beyond:
            hint = 'check the units: positions in rad or m, times in s'
            found.append(ModelWarning(' and '.join(beyond), hint, name))
    return tuple(found)


def _tables(robot: RobotModel, requirements: EffortRequirements) -> list[str]:
    """Return a table of peaks and limits, and a table of the terms of the efforts."""
    names = requirements.trajectory.joint_names
    places = decimals(requirements.peak)
    rows, parts = [], []
    for k, (name, i) in enumerate(zip(names, robot.joint_indices(names), strict=True)):
        unit = effort_unit(robot, i)
        speed_unit = 'm/s  ' if robot.is_prismatic_joint[i] else 'rad/s'
        power = float(requirements.power[k])
        beyond = [what for what, joints in requirements.is_beyond.items() if joints[k]]
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
                f'{power:.3g} W' if power >= 0.005 else '0 W',
                f'beyond: {", ".join(beyond)}' if beyond else '',
            )
        )
        rms = (f'{requirements.rms_terms[t, k]:.{places}f}' for t in range(len(_TERMS)))
        parts.append((name, *rms, f'{requirements.rms[k]:.{places}f} {unit}'))
    columns = ('joint', 'peak effort', 'at', 'limit', 'ratio', 'RMS', 'speed', 'limit', 'power')
    braking = float(np.max(requirements.braking))
    notes = (f'when braking, a joint absorbs up to {braking:.3g} W',) if braking > 0.0 else ()
    terms = ('joint', *_TERMS, 'total')
    note = 'the velocity term contains the Coriolis and centrifugal efforts'
    return [
        table('Peaks compared with the limits', (*columns, ''), rows, notes, [9]),
        table('Terms of the efforts (RMS)', terms, parts, [note]),
    ]
