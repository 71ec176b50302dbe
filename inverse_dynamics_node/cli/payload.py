"""The command `payload`: measures mass and centre of mass of a payload from recordings."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import json
from pathlib import Path

from ..analysis.payload import measure_payload, PayloadEstimate
from ..errors import ConfigurationError
from ..report.payload_report import (
    as_json,
    inertia_table,
    inertial_element,
    payload_table,
    topic_command,
    verdict,
)
from ..robot.end_effector import last_link
from . import arguments
from .arguments import CommandParser, RESULT
from .console import say, show
from .nodes import choose_node, node_name
from .output_files import check_outputs, new_file
from .pictures.payload import draw
from .recordings import measured_efforts, read_recording

EPILOG = """\
examples:
  inverse_dynamics payload my_arm.urdf loaded.mcap --empty empty.mcap --link tool0
  inverse_dynamics payload my_arm.urdf loaded.csv --empty empty.csv --apply
  inverse_dynamics payload my_arm.urdf loaded.csv --empty empty.csv --json | jq .mass

Record the same motion twice, without and with the payload: 20 s or more in which all joints move
slowly, up and down, in both directions. Or let the arm rest in 6 to 8 poses for 2 s each, and
approach each pose from the same side. The help of `inverse_dynamics compare` lists
the formats of recordings.

exit code: 0 measured; 1 a recording cannot be used, or the node did not take the payload;
2 invalid arguments; 3 the recordings do not show the mass, or not all of the centre of mass."""

_NOT_SHOWN = 3
_DEFAULT_NODE = '/inverse_dynamics'


def make_parser() -> CommandParser:
    """Return the parser of the command."""
    parser = CommandParser(
        'payload',
        'Measure mass and centre of mass of a payload from two recordings of the same motion, '
        'with and without the payload. The command prints the payload as a message for the node '
        'and as an <inertial> element.',
        EPILOG,
    )
    arguments.add_urdf(parser)
    parser.add_argument(
        'loaded', type=Path, metavar='LOADED', help='recording with the payload: rosbag2 folder, '
        '.mcap, .db3 or .csv file'
    )  # fmt: skip
    parser.add_argument(
        '--empty', type=Path, metavar='RUN', help='the same motion, recorded without the payload'
    )
    parser.add_argument(
        '--topic', help='topic of the joint states (default: the only one with efforts)'
    )
    arguments.add_link(parser)
    arguments.add_gravity(parser)
    arguments.add_node_parameters(parser)
    parser.add_argument(
        '--json', group=RESULT, action='store_true', help='print the result as JSON'
    )
    parser.add_argument(
        '--apply',
        group=RESULT,
        nargs='?',
        const=True,
        type=node_name,
        metavar='NODE',
        help='publish the payload to a running node, and wait until the node has the payload '
        '(needs ROS 2; default: the only node)',
    )
    arguments.add_picture(parser)
    arguments.add_force(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    inputs = [options.urdf, options.loaded, options.empty, options.node_parameters]
    check_outputs([*filter(None, inputs)], {'--picture': options.picture}, options.force)
    dynamics = arguments.load_dynamics(options.urdf, options.gravity)
    robot, link = dynamics.robot, options.link or last_link(dynamics.robot)
    robot.link_index(link)
    convention, scale = measured_efforts(options.node_parameters, robot.joint_names)
    if options.empty is None and not convention.in_measured:
        raise ConfigurationError(
            f'{options.node_parameters}: the recorded efforts do not contain gravity, so a '
            'recording without the payload is needed: use --empty'
        )
    loaded, _ = read_recording(options.loaded, robot, options.topic, scale)
    empty = None
    if options.empty is not None:
        empty, _ = read_recording(options.empty, robot, options.topic, scale)
    result = measure_payload(robot, loaded, empty, link, options.gravity)
    apparent = None
    if empty is not None and convention.in_measured:
        apparent = measure_payload(robot, empty, None, link, options.gravity)
    is_shown = result.is_certain and not result.unknown
    if options.json:
        print(json.dumps(as_json(result, apparent)))
    else:
        say(verdict(result))
        print()
        show(inertia_table(result), payload_table(result, robot, apparent))
        if is_shown:
            print(topic_command(result, _DEFAULT_NODE))
            print(inertial_element(result))
    if options.picture:
        title = f'{robot.name}: {options.loaded.name}'
        with new_file(options.picture) as path:
            draw(result, title, verdict(result), path)
    if options.apply is not None and is_shown:
        wanted = None if options.apply is True else options.apply
        name = _apply(result, wanted, options.ros_arguments)
        if not options.json:
            print(f'{name} has the payload')
    return 0 if is_shown else _NOT_SHOWN


def _apply(result: PayloadEstimate, name: str | None, ros_arguments: Sequence[str]) -> str:
    """Publish the payload to a node, and wait until the node has it; return its full name."""
    from ..ros.observer import Observer, observing_node  # needs ROS
    from ..ros.payload import apply_payload

    with observing_node(ros_arguments) as node:
        found = choose_node(node, name, is_patient=False)
        apply_payload(node, Observer(node, found), result.link, result.body)
    return found
