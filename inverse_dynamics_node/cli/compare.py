"""The command `compare`: compares the measured efforts of a recording with the model."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from ..analysis.diagnosis import (
    ComparisonResult,
    diagnose_recording,
    FaultKind,
    friction_parameters,
)
from ..report.compare_report import comparison_table, friction_table, verdict
from ..report.diagnosis_text import diagnosis_warning
from ..report.tables import warnings_as_text
from ..robot.limit_checks import position_warnings
from . import arguments
from .console import check_outputs, say, show, write_file
from .pictures.compare import draw
from .pictures.style import try_to_draw
from .recordings import measured_efforts, read_recording

EPILOG = """\
examples:
  inverse_dynamics compare my_arm.urdf rosbag2_2026_11_21
  inverse_dynamics compare my_arm.urdf run.mcap --topic /joint_states
  inverse_dynamics compare my_arm.urdf run.db3 --parameters friction.yaml
  inverse_dynamics compare my_arm.urdf run.mcap --node-parameters driver.yaml
  inverse_dynamics compare my_arm.urdf run.csv --link tool0 --payload 1.5,0,0,0.05

The recording is a rosbag2 folder, a .mcap file or a .db3 file with sensor_msgs/msg/JointState
messages that contain efforts. It can also be a .csv file with these columns: `time` [s] and, for
each joint, `<joint>.position` (or just `<joint>`), `<joint>.velocity` (optional) and
`<joint>.effort`. Twenty seconds are enough if every joint moves in both directions, at different
speeds.

The command can diagnose these differences: efforts that have the wrong sign, are motor currents,
are in the wrong unit, have an offset, or arrive late; a reversed axis; positions in degrees;
gravity compensated by the driver; a different mounting of the base; a payload; joints in the wrong
order; rotor inertia; a driver that does not measure efforts; wrong masses of several links. A
load, a push or a tilt of the base may last for only part of the recording. The command also fits
friction, and --parameters writes it as parameters of the node.

exit code: 0 compared; 1 the recording cannot be compared; 2 invalid arguments; 3 there are
warnings, and --strict was given."""


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = arguments.new_parser(
        'compare',
        'Compare the measured efforts of a recording with the modelled ones, fit '
        'friction, and diagnose the differences. The command also writes a picture.',
        EPILOG,
    )
    arguments.add_urdf(parser)
    parser.add_argument('recording', type=Path, help='rosbag2 folder, .mcap, .db3 or .csv file')
    parser.add_argument(
        '--topic', help='topic of the joint states (default: the only one with efforts)'
    )
    role = (
        '; with --link, an unknown payload is sought only on this link, otherwise at the end of '
        'every chain'
    )
    arguments.add_link(parser, role)
    arguments.add_payload(parser)
    arguments.add_gravity(parser)
    arguments.add_friction(parser)
    arguments.add_node_parameters(parser)
    arguments.add_output(
        parser,
        '--parameters',
        'the fitted friction and any diagnosed rotor inertia, as parameters of the node',
    )
    arguments.add_picture(parser, '<name of the recording>_compare.png')
    arguments.add_force(parser)
    arguments.add_strict(parser, 'there are warnings')
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    picture = f'{options.recording.stem}_compare.png'
    check_outputs(
        [options.urdf, options.recording, *filter(None, [options.node_parameters])],
        {'--parameters': options.parameters, '--picture': arguments.picture_or(options, picture)},
        options.force,
    )
    dynamics = arguments.load_dynamics(options.urdf, options.gravity)
    robot = dynamics.robot
    if options.friction:
        dynamics.set_friction()
    load = arguments.attach_payload(dynamics, options)
    convention, scale = measured_efforts(options.node_parameters, robot.joint_names)
    recording, notes = read_recording(options.recording, robot, options.topic, scale)
    result = diagnose_recording(dynamics, recording, options.link, convention)
    say(verdict(result))
    print()
    warnings = [
        *position_warnings(robot, recording.positions, recording.joint_names),
        *map(diagnosis_warning, result.faults),
    ]
    if warnings:
        show(warnings_as_text(warnings))
    show(comparison_table(result, notes), friction_table(result))
    if options.parameters:
        write_parameters(result, robot.joint_names, options.parameters)
        print(f'friction: {options.parameters}')
    source = f'{robot.name}: {", ".join(filter(None, (options.recording.name, load)))}'
    drawing = partial(draw, result, source, verdict(result))
    if path := try_to_draw(drawing, options, picture):
        print(f'picture: {path}')
    return arguments.strict_code(options, warnings)


def write_parameters(result: ComparisonResult, joint_names: tuple[str, ...], path: Path) -> None:
    """Write the fitted friction and any diagnosed rotor inertia as parameters of the node."""
    joints = sorted(result.joints, key=lambda joint: joint_names.index(joint.name))
    fits = {joint.name: joint.friction for joint in joints}
    rotors = {
        name: value
        for fault in result.faults
        if fault.kind is FaultKind.ROTOR_INERTIA
        for name, value in zip(fault.joints, fault.values, strict=True)
    }
    armature = [rotors.get(name, 0.0) for name in fits] if rotors else []
    write_file(path, friction_parameters(fits, armature).encode())
