"""The command `payload`: measures the mass and the centre of mass of a payload."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
import sys
import time
from typing import TYPE_CHECKING

from ..analysis.payload import measure_payload, PayloadEstimate
from ..dynamics.inverse_dynamics import STANDARD_GRAVITY
from ..errors import escaped
from ..report.payload_report import (
    as_json,
    inertial_element,
    payload_table,
    verdict,
)
from ..robot.kinematics import last_link
from ..robot.model import RobotModel
from . import arguments
from .arguments import choose_node, node_name
from .console import (
    check_outputs,
    collected_signals,
    output_path,
    OutputError,
    print_json,
    progress,
    say,
    show,
)
from .pictures.compare import draw_payload
from .pictures.style import write_picture
from .recordings import measured_efforts, read_recording, reported_convention, scaled

if TYPE_CHECKING:
    from ..ros.diagnostics import NodeStatus

EPILOG = """\
examples:
  inverse_dynamics payload my_arm.urdf loaded.mcap --empty empty.mcap --link tool0
  inverse_dynamics payload my_arm.urdf loaded.csv --empty empty.csv --apply
  inverse_dynamics payload my_arm.urdf loaded.csv --empty empty.csv --json | jq .mass
  inverse_dynamics payload my_arm.urdf empty.csv --record 30
  inverse_dynamics payload my_arm.urdf loaded.csv --record 30 --empty empty.csv --apply

Record the same motion twice, without and with the payload. Move all joints slowly, in both
directions, for 20 s or more. Or let the arm rest in 6 to 8 poses for 2 s each, and approach each
pose from the same side in both recordings. The help of `inverse_dynamics compare` lists the
formats of recordings. With a single recording, `inverse_dynamics compare` names a payload.

With --record, the command records the joint states of a running node, and then measures the
payload. To record the empty arm, leave out --empty. Ctrl-C ends the recording early: what was
recorded is saved, but no payload is measured.

exit code: 0 measured, or recorded without --empty; 1 a recording cannot be used, or the node did
not accept the payload; 2 invalid arguments; 3 the recordings do not determine the mass, or
determine only a part of the centre of mass; 130 ended by Ctrl-C."""

_NOT_SHOWN = 3


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = arguments.new_parser(
        'payload',
        'Measure the mass and centre of mass of a payload from two recordings of the same motion, '
        'with and without the payload.',
        EPILOG,
    )
    arguments.add_urdf(parser)
    parser.add_argument(
        'loaded', type=Path, metavar='LOADED', help='recording with the payload: rosbag2 folder, '
        '.mcap, .db3 or .csv file; with --record, a .csv file to write'
    )  # fmt: skip
    parser.add_argument(
        '--empty', type=Path, metavar='RUN', help='the same motion, recorded without the payload'
    )
    parser.add_argument(
        '--record',
        type=arguments.positive,
        metavar='SECONDS',
        help='first record the joint states of a running node for this time, and write the file '
        'LOADED; the diagnostics of the node say whether the efforts contain gravity '
        '(needs ROS 2)',
    )
    parser.add_argument(
        '--topic',
        help='topic of the joint states in a recording (default: the only one with efforts); '
        '--record uses the topic of the node',
    )
    arguments.add_link(parser)
    arguments.add_gravity(parser)
    arguments.add_node_parameters(parser)
    arguments.add_json(parser)
    parser.add_argument(
        '--apply',
        nargs='?',
        const=True,
        type=node_name,
        metavar='NODE',
        help='publish the payload to a running node, and wait until the node uses it '
        '(needs ROS 2; default: the only node)',
    )
    parser.add_argument(
        '--replace', action='store_true', help='with --apply, remove the payloads on other links'
    )
    arguments.add_picture(parser)
    arguments.add_force(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    _check_files(options)
    dynamics = arguments.load_dynamics(options.urdf, options.gravity)
    robot, link = dynamics.robot, options.link or last_link(dynamics.robot)
    gravity = options.gravity
    convention, scale = measured_efforts(options.node_parameters, robot.joint_names)
    if options.empty is not None:
        empty, _ = read_recording(options.empty, robot, options.topic)
    topic = options.topic
    if options.record is not None:
        topic = None
        status = _record(options, robot)
        if options.node_parameters is None:
            convention, scale = reported_convention(status), status.measured_scale()
        if gravity is STANDARD_GRAVITY:
            gravity = tuple(status.gravity()) or gravity
        if options.empty is None:
            return 0
    loaded, _ = read_recording(options.loaded, robot, topic, scale)
    result = measure_payload(
        robot, loaded, scaled(empty, scale), link, gravity, convention.in_measured
    )
    is_shown = result.is_certain and not result.unknown
    if options.json:
        print_json(as_json(result))
    else:
        say(verdict(result))
        print()
        show(payload_table(result, robot))
        if is_shown:
            print(escaped(inertial_element(result)))
    if options.picture:
        title = f'{robot.name}: {options.loaded.name}'
        write_picture(partial(draw_payload, result, title, verdict(result)), options.picture)
    if options.apply is not None and is_shown:
        name = _apply(result, options)
        if not options.json:
            print(f'{name} uses the payload')
    return 0 if is_shown else _NOT_SHOWN


def _check_files(options: argparse.Namespace) -> None:
    """Check the paths of the outputs."""
    if options.empty is None and options.record is None:
        raise OutputError(
            '--empty is missing: record the same motion without the payload. With a single '
            'recording, `inverse_dynamics compare` names a payload'
        )
    inputs = [options.urdf, options.empty, options.node_parameters, options.loaded]
    check_outputs([*filter(None, inputs)], {'--picture': options.picture}, options.force)
    if options.record is not None:
        if options.loaded.suffix != '.csv':
            raise OutputError(f"LOADED is '{options.loaded}', but --record writes a .csv file")
        if options.loaded.exists():
            raise OutputError(
                f'--record {options.loaded} already exists, and --record never replaces a file; '
                'choose another name'
            )
        try:
            output_path(str(options.loaded))
        except argparse.ArgumentTypeError as error:
            raise OutputError(str(error)) from None


def _record(options: argparse.Namespace, robot: RobotModel) -> NodeStatus:
    """Record the joint states of a running node; return the status of the node."""
    from ..ros.observer import Observer, observing_node  # needs ROS
    from ..ros.recorder import JointStateRecorder

    wanted = None if options.apply is True else options.apply
    path, seconds = options.loaded, options.record
    with observing_node(options.ros_arguments) as node:
        observer = Observer(node, choose_node(node, wanted, is_patient=False))
        recorder = JointStateRecorder(observer, robot.joint_names)
        with progress(f'waiting for the joint states of {observer.name}'):
            status = recorder.wait()
        text = f'recording {recorder.topic} for {seconds:g} s'
        print(text, file=sys.stderr, flush=True)
        began = time.monotonic()
        with collected_signals() as signals, progress(text) as report:

            def is_done() -> bool:
                elapsed = time.monotonic() - began
                report(min(1.0, elapsed / seconds))
                return bool(signals) or elapsed > seconds

            recorder.record(path, is_done)
    print(f'{path}: {recorder.count} joint states', file=sys.stderr)
    if signals:
        raise SystemExit(128 + signals[0])
    return status


def _apply(result: PayloadEstimate, options: argparse.Namespace) -> str:
    """Apply the payload to a node, and return the name of the node."""
    from ..ros.observer import Observer, observing_node  # needs ROS
    from ..ros.payload import apply_payload

    name = None if options.apply is True else options.apply
    with observing_node(options.ros_arguments) as node:
        found = choose_node(node, name, is_patient=False)
        apply_payload(node, Observer(node, found), result.link, result.body, options.replace)
    return found
