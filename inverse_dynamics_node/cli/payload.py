"""The command `payload`: measures the mass and the centre of mass of a payload."""

from __future__ import annotations

import argparse
from functools import partial
import json
from pathlib import Path
import sys
from typing import TYPE_CHECKING

from ..analysis.diagnosis import GravityConvention
from ..analysis.payload import measure_payload, PayloadEstimate
from ..dynamics.inverse_dynamics import STANDARD_GRAVITY
from ..errors import ConfigurationError, escaped, RecordingError
from ..report.payload_report import (
    as_json,
    inertia_table,
    inertial_element,
    payload_table,
    topic_command,
    verdict,
)
from ..robot.kinematics import last_link
from . import arguments
from .arguments import choose_node, node_name
from .console import (
    check_outputs,
    collected_signals,
    output_path,
    OutputError,
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
formats of recordings.

With --record, the command records the joint states of a running node, and then measures the
payload. To record the empty arm, leave out --empty: the result is then the payload that the empty
arm seems to carry. Ctrl-C ends the recording early: what was recorded is saved, but no payload
is measured.

exit code: 0 measured; 1 a recording cannot be used, or the node did not accept the payload;
2 invalid arguments; 3 the recordings do not determine the mass, or determine only a part of the
centre of mass; 130 ended by Ctrl-C."""

_NOT_SHOWN = 3


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = arguments.new_parser(
        'payload',
        'Measure the mass and centre of mass of a payload from two recordings of the same motion, '
        'with and without the payload. The command prints the payload as a message for the node '
        'and as an <inertial> element.',
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
    parser.add_argument('--json', action='store_true', help='print the result as JSON')
    parser.add_argument(
        '--apply',
        nargs='?',
        const=True,
        type=node_name,
        metavar='NODE',
        help='publish the payload to a running node, and wait until the node uses it '
        '(needs ROS 2; default: the only node)',
    )
    arguments.add_picture(parser)
    arguments.add_force(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    _check_files(options)
    dynamics = arguments.load_dynamics(options.urdf, options.gravity)
    robot, link = dynamics.robot, options.link or last_link(dynamics.robot)
    robot.link_index(link)
    source, gravity = options.node_parameters, options.gravity
    convention, scale = measured_efforts(source, robot.joint_names)
    empty = None
    if options.empty is not None:
        empty, _ = read_recording(options.empty, robot, options.topic)
    if options.record is not None:
        node, status = _record(options, robot.joint_names)
        if source is None:
            source, convention = node, reported_convention(status)
            scale = status.measured_scale()
        if gravity is STANDARD_GRAVITY:
            gravity = tuple(status.gravity()) or gravity
    if empty is None and not convention.in_measured:
        raise ConfigurationError(
            f'{source}: the recorded efforts do not contain gravity; use --empty to add a '
            'recording without the payload'
        )
    topic = options.topic if options.record is None else None
    loaded, _ = read_recording(options.loaded, robot, topic, scale)
    empty = empty and scaled(empty, scale)
    result = measure_payload(robot, loaded, empty, link, gravity)
    apparent = None
    if empty is not None and convention.in_measured:
        apparent = measure_payload(robot, empty, None, link, gravity)
    is_shown = result.is_certain and not result.unknown
    if options.json:
        print(json.dumps(as_json(result, apparent)))
    else:
        say(verdict(result))
        print()
        show(inertia_table(result), payload_table(result, robot, apparent))
        if is_shown:
            print(escaped(topic_command(result)))
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
    inputs = [options.urdf, options.empty, options.node_parameters]
    outputs = {'--picture': options.picture}
    if options.record is None:
        inputs.append(options.loaded)
    else:
        if options.loaded.suffix != '.csv':
            raise OutputError(f"LOADED is '{options.loaded}', but --record writes a .csv file")
        try:
            output_path(str(options.loaded))
        except argparse.ArgumentTypeError as error:
            raise OutputError(str(error)) from None
        outputs['--record'] = options.loaded
        outputs['partial recording'] = _partial(options.loaded)
    check_outputs([*filter(None, inputs)], outputs, options.force)


def _record(options: argparse.Namespace, joints: tuple[str, ...]) -> tuple[str, NodeStatus]:
    """Record the joint states of a running node; return the name and status of the node."""
    from ..ros.observer import Observer, observing_node  # needs ROS
    from ..ros.recorder import JointStateRecorder

    wanted = None if options.apply is True else options.apply
    path, seconds = options.loaded, options.record
    with observing_node(options.ros_arguments) as node:
        observer = Observer(node, choose_node(node, wanted, is_patient=False))
        recorder = JointStateRecorder(observer)
        with progress(f'waiting for the joint states of {observer.name}'):
            recorder.wait(joints)
        before = observer.status
        text, partial = f'recording {recorder.topic} for {seconds:g} s', _partial(path)
        print(text, file=sys.stderr, flush=True)
        with collected_signals() as signals, progress(text) as report:
            reason = recorder.record(partial, seconds, lambda: bool(signals), report)
    # A recording that ended early must not replace a complete recording.
    written = partial if reason and path.exists() else partial.replace(path)
    count, duration = recorder.count, recorder.duration
    print(f'{written}: {count} joint states in {duration:.1f} s', file=sys.stderr)
    if signals:
        raise SystemExit(128 + signals[0])
    if reason:
        raise RecordingError(f'{written} ends before {seconds:g} s, because {reason}')
    after = observer.status
    assert before is not None
    assert after is not None
    if _content(before) != _content(after):
        raise RecordingError(
            f'{written}: {observer.name} changed its settings for measured efforts during the '
            'recording'
        )
    return observer.name, after


def _partial(path: Path) -> Path:
    """Return the path that a recording has until it is complete."""
    return path.with_name(f'{path.stem}_partial.csv')


def _content(status: NodeStatus) -> tuple[GravityConvention, dict[str, float]]:
    """Return the gravity convention and the scales of the measured efforts."""
    return reported_convention(status), status.measured_scale()


def _apply(result: PayloadEstimate, options: argparse.Namespace) -> str:
    """Apply the payload to a node, and return the name of the node."""
    from ..ros.observer import Observer, observing_node  # needs ROS
    from ..ros.payload import apply_payload

    name = None if options.apply is True else options.apply
    with observing_node(options.ros_arguments) as node:
        found = choose_node(node, name, is_patient=False)
        apply_payload(node, Observer(node, found), result.link, result.body)
    return found
