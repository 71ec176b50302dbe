"""The command `compare`: a recorded run against the model."""

from __future__ import annotations

import argparse
from functools import partial
import math
from pathlib import Path
from typing import Any

import numpy as np

from ..analysis.identification import (
    Diagnosis,
    Findings,
    friction_parameters,
    identify,
    JointFinding,
    Recording,
)
from ..analysis.measured_states import read_measured_states
from ..dynamics.inverse_dynamics import FRICTION_WIDTH, InverseDynamics, STANDARD_GRAVITY
from ..errors import ConfigurationError, RecordingError
from ..report.tables import Table
from ..robot.hand import last_link
from ..robot.model_warning import ModelWarning
from ..robot.plausibility import position_warnings
from .arguments import output_path, payload, picture_path
from .console import (
    progress,
    say,
    show,
    show_warnings,
)
from .pictures.style import try_to_draw
from .robots import HELP, load_dynamics

EPILOG = """\
examples:
  inverse_dynamics compare my_arm.urdf rosbag2_2026_11_21
  inverse_dynamics compare my_arm.urdf run.mcap --topic /joint_states --from 2 --to 30
  inverse_dynamics compare my_arm.urdf run.db3 --parameters friction.yaml
  inverse_dynamics compare my_arm.urdf run.csv --link tool0 --payload 1.5,0,0,0.05

The recording is a rosbag2 folder, or one .mcap or .db3 file, with sensor_msgs/msg/JointState that
has efforts; or a .csv file with a header of `time` [s] and, for each joint, `<joint>.position` (or
just `<joint>`), `<joint>.velocity` (not needed) and `<joint>.effort`. Twenty seconds with every
joint moving both ways, at different speeds, tell most.

What it can name: a sign that is swapped; efforts that are currents, or in another unit; gravity
that the driver compensates; another mounting of the base; a payload; joints in another order;
inertia of rotors; an offset; a driver that does not measure. Friction is fitted apart from these,
and written for the node by --parameters.

exit code: 0 compared; 1 it cannot be; 2 wrong arguments; 3 with --strict, when something was
found."""

_FOUND = 3


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        'compare',
        help='a recorded run against the model: what it explains, friction, what is wrong',
        description='Hold measured efforts of a recorded run against the modelled ones, fit '
        'friction, and name what explains the difference. Writes a picture too.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('urdf', type=Path, help=HELP)
    parser.add_argument('recording', type=Path, help='rosbag2 folder, .mcap, .db3 or .csv')
    parser.add_argument('--topic', help='default: the only joint states with efforts')
    parser.add_argument('--from', dest='start', type=float, metavar='S', help='leave out before')
    parser.add_argument('--to', dest='end', type=float, metavar='S', help='leave out after [s]')
    parser.add_argument('--link', help='where a payload may be; default: the ends of the tree')
    parser.add_argument(
        '--payload',
        type=payload,
        metavar='MASS[,X,Y,Z]',
        help='what the link carries as far as known [kg], and where in its frame [m]',
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
        '--friction', action='store_true', help='let the model have the friction of the URDF'
    )
    parser.add_argument(
        '--coulomb-width',
        type=float,
        default=FRICTION_WIDTH,
        metavar='SPEED',
        help='over which Coulomb friction is smoothed [rad/s, m/s] (default: %(default)s)',
    )
    parser.add_argument(
        '--parameters',
        type=output_path,
        metavar='FILE',
        help='write the fitted friction here, as parameters of the node',
    )
    parser.add_argument(
        '--picture',
        type=picture_path,
        metavar='FILE',
        help='default: <name of the recording>_compare.png, here',
    )
    parser.add_argument('--no-picture', action='store_true', help='write no picture')
    parser.add_argument(
        '--strict', action='store_true', help='exit with 3 if anything is found to be wrong'
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    dynamics = _dynamics(options, load_dynamics(options.urdf, options.gravity))
    robot = dynamics.robot
    with progress('reading') as tell:
        recording, notes = read_measured_states(
            options.recording, robot.joint_names, options.topic, tell
        )
    recording = _between(recording, options.start, options.end)
    findings = identify(dynamics, recording, link=options.link, width=options.coulomb_width)
    say(verdict(findings))
    print()
    warnings = [
        *position_warnings(robot, recording.positions, recording.joint_names),
        *map(diagnosis_warning, findings.diagnoses),
    ]
    if warnings:
        show_warnings(warnings)
        print()
    show(comparison_table(findings, notes), friction_table(findings))
    if options.parameters:
        write_parameters(findings, robot.joint_names, options.parameters)
        print(f'friction: {options.parameters}')
    if not options.no_picture:
        from .pictures.compare import draw

        link = options.link or last_link(robot)
        load = f", payload {options.payload[0]:g} kg on link '{link}'" if options.payload else ''
        source = f'{robot.name}: {options.recording.name}{load}'
        path = try_to_draw(
            partial(draw, findings, source, verdict(findings)),
            options.picture,
            f'{options.recording.stem}_compare.png',
        )
        if path:
            print(f'picture: {path}')
    return _FOUND if options.strict and warnings else 0


def _dynamics(options: argparse.Namespace, dynamics: InverseDynamics) -> InverseDynamics:
    if not (math.isfinite(options.coulomb_width) and options.coulomb_width > 0.0):
        raise ConfigurationError(
            f'--coulomb-width is {options.coulomb_width}, expected a speed above 0'
        )
    if options.friction:
        dynamics.set_friction(width=options.coulomb_width)
    if options.payload is not None:
        mass, *com = options.payload
        link = options.link or last_link(dynamics.robot)
        dynamics.set_payload(link, mass, com or (0.0, 0.0, 0.0))
    return dynamics


def _between(recording: Recording, start: float | None, end: float | None) -> Recording:
    """Cut a recording, by seconds from its first sample."""
    times = recording.times - recording.times[0]
    chosen = np.ones(len(times), dtype=bool)
    if start is not None:
        chosen &= times >= start
    if end is not None:
        chosen &= times <= end
    if not chosen.any():
        raise RecordingError(
            f'nothing was recorded from {start or 0:g} s to '
            f'{end if end is not None else times[-1]:g} s; the recording lasts {times[-1]:.3g} s'
        )
    velocities = recording.velocities
    return recording._replace(
        times=recording.times[chosen],
        positions=recording.positions[chosen],
        velocities=None if velocities is None else velocities[chosen],
        efforts=recording.efforts[chosen],
    )


def verdict(findings: Findings) -> str:
    """Say in a line what the comparison comes to."""
    explains = f'{percent(findings.explained)} of the measured effort'
    in_the_end = percent(findings.explained_corrected)
    if findings.diagnoses:
        what = '; '.join(diagnosis.headline for diagnosis in findings.diagnoses)
        # A sentence begins with a capital, the name of a joint does not.
        if what.startswith(('the ', 'every ', 'link ')):
            what = what[0].upper() + what[1:]
        return f'{what}. As it is, the model explains {explains}; with that, {in_the_end}.'
    if math.isnan(findings.explained):
        return 'The efforts hardly vary: there is too little to compare.'
    return f'The model explains {explains}; with fitted friction, {in_the_end}.'


def diagnosis_warning(diagnosis: Diagnosis) -> ModelWarning:
    """Return a diagnosis as a warning, with a suggestion for the next run."""
    numbers = [
        0.0 if abs(value) < 5e-4 or math.isnan(value) else value for value in diagnosis.values
    ]
    again = {
        'gravity_compensated': '--gravity 0 0 0',
        'mounting': f'--gravity {" ".join(f"{x:.3f}" for x in numbers)}',
        'payload': f'--link {diagnosis.link} --payload {",".join(f"{x:.3f}" for x in numbers)}',
    }.get(diagnosis.kind, '')
    if diagnosis.kind == 'payload' and numbers[0] < 0.0:
        again = ''
    hint = diagnosis.advice + (f' To see what is left then: {again}' if again else '')
    return ModelWarning(f'{diagnosis.headline}: {diagnosis.evidence}', hint)


def comparison_table(findings: Findings, notes: tuple[str, ...]) -> Table:
    """Write out measured against modelled efforts, a joint a row."""
    motion = findings.motion
    rows = [
        (
            joint.name,
            f'{joint.rms_measured:.4g}',
            f'{joint.rms_modelled:.4g}',
            f'{joint.rms_residual:.3g}',
            'N' if joint.is_prismatic else 'N m',
            percent(joint.explained),
            percent(joint.explained_with_mean),
            percent(joint.explained_corrected),
            _or_dash(joint.scale, '.3f'),
            _or_dash(joint.offset, '.3g'),
        )
        for joint in findings.joints
    ]
    columns = ('joint', 'measured', 'modelled', 'differ', '', 'explained', 'with mean',
               'in the end', 'scale', 'offset')  # fmt: skip
    lasts = motion.times[-1] - motion.times[0]
    remarks = (
        'RMS of measured and modelled efforts and of their difference; explained: share of the '
        'variance, and of the squares (with mean); in the end: with fitted friction and offset, '
        'while the joint moves (at rest, dry friction is anything up to its full value)'
        + (' and with what was found above' if findings.diagnoses else '')
        + '; measured is about scale * modelled + offset.',
        f'{len(motion.times)} samples over {lasts:.3g} s; {motion.method}.',
        *(f'{note}.' for note in (*motion.notes, *notes)),
    )
    return Table('Measured against modelled efforts', columns, tuple(rows), remarks,
                 frozenset({4}))  # fmt: skip


def friction_table(findings: Findings) -> Table:
    """Write out the fitted friction, with standard errors."""
    rows = []
    for joint in findings.joints:
        fit = joint.friction
        numbers = ('-', '-', '-')
        if not fit.unknown_because:
            numbers = (
                _with_error(fit.damping, fit.damping_error),
                _with_error(fit.coulomb, fit.coulomb_error),
                _with_error(fit.offset, fit.offset_error),
            )
        rows.append((joint.name, *numbers))
    notes = (
        f'damping * velocity + Coulomb * tanh(velocity / {findings.width:g}) + offset, in '
        'N m s/rad and N m, N s/m and N where the joint slides; with standard errors, of chance '
        'only.',
        *(
            f'{joint.name}: unknown, {joint.friction.unknown_because}.'
            for joint in findings.joints
            if joint.friction.unknown_because
        ),
    )
    columns = ('joint', 'damping', 'Coulomb', 'offset')
    return Table('Friction, fitted to what the model leaves', columns, tuple(rows), notes)


def write_parameters(findings: Findings, joint_names: tuple[str, ...], path: Path) -> None:
    """Write friction as parameters of the node, joints in the robot's order."""
    joints: list[JointFinding] = sorted(
        findings.joints, key=lambda joint: joint_names.index(joint.name)
    )
    names = [joint.name for joint in joints]
    text = friction_parameters(names, [joint.friction for joint in joints], findings.width)
    path.write_text(text, encoding='utf-8')


def percent(share: float) -> str:
    """Write a share, with a dash for none."""
    if math.isnan(share):
        return '-'
    # 99.96 is not 100, and a model far off is that, whatever the digits.
    if share < -9.99:
        return '<-999%'
    if share > 0.9999:
        return '>99.99%'
    return f'{share:.2%}' if share > 0.99 else f'{share:.1%}'


def _with_error(value: float, error: float) -> str:
    """Write a value to the digits that its standard error leaves."""
    if not error > 0.0 or not math.isfinite(error):
        return f'{value:.4g}'
    places = min(6, max(0, 1 - math.floor(math.log10(error))))
    return f'{value:.{places}f} ± {error:.{places}f}'


def _or_dash(value: float, how: str) -> str:
    return format(value, how) if math.isfinite(value) else '-'
