"""The command `identify`: calibrates a robot description with recordings."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from ..analysis.diagnosis import diagnose_recording, FaultKind
from ..analysis.identification import IdentificationResult, identify_parameters
from ..analysis.identification.result import calibrated_urdf, identified_parameters
from ..analysis.recordings.signals import Recording
from ..dynamics.inverse_dynamics import InverseDynamics
from ..report.diagnosis_text import diagnosis_warning
from ..report.identification_report import (
    as_json,
    body_table,
    friction_table,
    residual_table,
    summary_lines,
)
from ..report.tables import table, warnings_as_text
from ..robot.kinematics import last_link
from ..robot.limit_checks import position_warnings
from ..robot.model import ModelWarning
from . import arguments
from .console import check_outputs, print_json, progress, say, show, write_file
from .pictures.identify import draw
from .pictures.style import try_to_draw
from .recordings import read_recording

MOST_UNEXPLAINED = 0.5
"""If the robot description leaves more of the efforts than this, causes are searched for."""
LEAST_FACTOR = 0.2
"""A smaller or negative factor of all efforts is not offered as a cause."""
CAUSES = (
    FaultKind.POSITIONS,
    FaultKind.SIGN,
    FaultKind.REVERSED_AXIS,
    FaultKind.UNIT,
    FaultKind.SCALE,
    FaultKind.ORDER,
    FaultKind.MOUNTING,
    FaultKind.GRAVITY_COMPENSATED,
)
EPILOG = """\
examples:
  inverse_dynamics identify my_arm.urdf rosbag2_2026_11_21 --output calibrated.urdf
  inverse_dynamics identify my_arm.urdf run_1 run_2 --validate run_3 --parameters node.yaml
  inverse_dynamics identify my_arm.urdf run.csv --payload 1.5,0,0,0.05 --link tool0

A recording is a rosbag2 folder, or a .mcap, .db3 or .csv file, with measured efforts; the help of
`inverse_dynamics compare` describes these formats. Record motions of all joints at the same time,
in varied poses, slowly and fast, in both directions, for 30 s or more; `inverse_dynamics excite`
plans such a motion. Without --validate, the recordings are divided into blocks. Each block in turn
is left out of the fit, and the result is evaluated on this block.

Where the recordings give little information, the result stays close to the URDF. The result is
always physically possible. The identified model is accepted only if it predicts unseen data better
than the URDF with fitted friction. Otherwise, only the friction is written.

exit code: 0 identified; 1 a recording cannot be used; 2 invalid arguments. With --json, the key
`accepted` says whether the identified model was accepted."""


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = arguments.new_parser(
        'identify',
        'Identify masses, centres of mass, inertias, friction and armature from '
        'recordings, and write a calibrated URDF and a picture.',
        EPILOG,
    )
    arguments.add_urdf(parser)
    parser.add_argument(
        'recordings',
        type=Path,
        nargs='+',
        metavar='RUN',
        help='rosbag2 folder, .mcap, .db3 or .csv file',
    )
    parser.add_argument(
        '--validate',
        type=Path,
        action='append',
        default=[],
        metavar='RUN',
        help='recording that is used only to evaluate the result, not to fit it; may be repeated',
    )
    arguments.add_output(parser, '--output', 'the calibrated URDF')
    arguments.add_output(
        parser, '--parameters', 'friction and armature, as parameters of the node'
    )
    arguments.add_json(parser)
    parser.add_argument(
        '--currents',
        action='store_true',
        help='efforts were recorded as motor currents: estimate one gain per joint',
    )
    parser.add_argument(
        '--topic', help='topic of the joint states (default: the only one with efforts)'
    )
    arguments.add_link(parser)
    arguments.add_payload(parser)
    arguments.add_gravity(parser)
    arguments.add_picture(parser, '<name of the URDF>_identify.png')
    arguments.add_force(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    picture = f'{arguments.stem_of(options.urdf)}_identify.png'
    check_outputs(
        [options.urdf, *options.recordings, *options.validate],
        {
            '--output': options.output,
            '--parameters': options.parameters,
            '--picture': arguments.picture_or(options, picture),
        },
        options.force,
    )
    source = arguments.read_source_text(options.urdf)
    dynamics = arguments.load_dynamics(source, options.gravity)
    robot = dynamics.robot
    arguments.attach_payload(dynamics, options)
    payload = options.payload and (options.link or last_link(robot), *options.payload)
    found = [
        read_recording(path, robot, options.topic)
        for path in (*options.recordings, *options.validate)
    ]
    recordings = [recording for recording, _ in found]
    notes = tuple(dict.fromkeys(note for _, notes in found for note in notes))
    count = len(options.recordings)
    runs, unseen = recordings[:count], recordings[count:]
    with progress('identifying') as report:
        result = identify_parameters(
            robot, runs, unseen, options.gravity, payload, options.currents, report
        )
    warnings = [
        *causes(dynamics, result, runs[0]),
        *dict.fromkeys(
            warning
            for recording in recordings
            for warning in position_warnings(robot, recording.positions, recording.joint_names)
        ),
        *(ModelWarning(text, hint) for text, hint in result.warnings),
    ]
    # The files come first, because a pipe such as `| head` may end the program during the report.
    files = _write(result, source, options)
    names = ', '.join(path.name for path in options.recordings)
    drawing = partial(draw, result, f'{robot.name}: {names}')
    if path := try_to_draw(drawing, options, picture):
        files.append(f'picture: {path}')
    if options.json:
        print_json(as_json(result, notes) | {'warnings': [*map(asdict, warnings)]})
    else:
        _show(result, notes, warnings)
        print('\n'.join(files), end='\n' if files else '')
    return 0


def causes(
    dynamics: InverseDynamics, result: IdentificationResult, recording: Recording
) -> list[ModelWarning]:
    """
    Return what `compare` finds if the robot description explains little of the efforts.

    Faults of masses and drives are left out, because these are identified.
    """
    measured = np.linalg.norm([joint.measured for joint in result.joints])
    left = np.linalg.norm([joint.unseen.urdf for joint in result.joints])
    if (result.accepted and left < MOST_UNEXPLAINED * measured) or result.are_currents:
        return []
    faults = diagnose_recording(dynamics, recording).faults
    return [
        diagnosis_warning(fault)
        for fault in faults
        if fault.kind in CAUSES
        and not (
            fault.kind in (FaultKind.UNIT, FaultKind.SCALE)
            and (fault.is_every_joint or fault.kind is FaultKind.UNIT)
            and min(fault.values, default=1.0) < LEAST_FACTOR
        )
    ]


def _show(
    result: IdentificationResult, notes: tuple[str, ...], warnings: list[ModelWarning]
) -> None:
    say(f'{result.verdict}.')
    print()
    if warnings:
        show(warnings_as_text(warnings))
    lines = (*summary_lines(result), *(f'{note}.' for note in notes))
    show(
        residual_table(result),
        friction_table(result),
        body_table(result),
        table('Data', notes=lines),
    )


def _write(
    result: IdentificationResult, source: Path | str, options: argparse.Namespace
) -> list[str]:
    """Write the files, and return a line of text for each file."""
    lines = []
    if options.output:
        write_file(options.output, calibrated_urdf(result, source))
        what = 'calibrated URDF' if result.accepted else 'URDF with fitted friction'
        lines.append(f'{what}: {options.output}')
    if options.parameters:
        write_file(options.parameters, identified_parameters(result).encode())
        lines.append(f'parameters of the node: {options.parameters}')
    return lines
