"""Defines arguments that commands share, loads robot descriptions, and finds running nodes."""

from __future__ import annotations

import argparse
from collections.abc import Callable
import math
import os
from pathlib import Path
import re
import sys
import textwrap
import time
from typing import Any

from ..dynamics.inverse_dynamics import InverseDynamics, STANDARD_GRAVITY
from ..errors import ConfigurationError, escaped, UrdfError
from ..robot.kinematics import last_link
from ..robot.model import Floats
from ..robot.urdf import load_urdf
from ..robot.urdf.xml import is_text
from .console import output_path, picture_path, progress

_WIDTH = 99
"""Largest width of the help of a command, in characters."""
_DISCOVERY = 1.5  # [s]; usual duration of discovery
_PATIENCE = 5.0  # [s]; after this time, the wait is announced
MOST_DISCOVERY = 10.0  # [s]; longest wait for a node, except in `watch` without --for


def new_parser(command: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """Return the parser of a command; the line breaks of the epilog are kept."""
    return argparse.ArgumentParser(
        prog=f'inverse_dynamics {command}',
        description=textwrap.fill(description, _WIDTH, break_on_hyphens=False),
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )


def add_urdf(parser: argparse.ArgumentParser) -> None:
    """Add the argument for the robot description."""
    parser.add_argument(
        'urdf',
        type=Path,
        help="robot description; '-' reads it from standard input, for example from xacro",
    )


def add_gravity(parser: argparse.ArgumentParser) -> None:
    """Add the option --gravity."""
    parser.add_argument(
        '--gravity',
        type=float,
        nargs=3,
        default=STANDARD_GRAVITY,
        metavar=('X', 'Y', 'Z'),
        help='free-fall acceleration in the frame of the base link [m/s^2] '
        '(default: 0 0 -9.80665)',
    )


def add_link(parser: argparse.ArgumentParser, role: str = '') -> None:
    """Add the option --link; the help ends with `role`."""
    text = (
        'link that carries the payload (default: tool0 if it exists, otherwise the tool or the '
        'last link of the longest chain, ignoring fingers and sensors)'
    )
    parser.add_argument('--link', help=text + role)


def add_payload(parser: argparse.ArgumentParser) -> None:
    """Add the option --payload."""
    parser.add_argument(
        '--payload',
        type=_payload,
        metavar='MASS[,X,Y,Z]',
        help='mass of a payload [kg], and its centre of mass in the frame of --link [m]',
    )


def add_node_parameters(parser: argparse.ArgumentParser) -> None:
    """Add the option --node-parameters."""
    parser.add_argument(
        '--node-parameters',
        type=Path,
        metavar='FILE',
        help='parameter file of the node; its values of include_gravity, measured_gravity and '
        'measured_effort_scale describe the recorded efforts',
    )


def add_friction(parser: argparse.ArgumentParser) -> None:
    """Add the option --friction."""
    parser.add_argument(
        '--friction',
        action='store_true',
        help='include the friction of the URDF in the computed efforts',
    )


def add_picture(parser: argparse.ArgumentParser, default: str = '') -> None:
    """
    Add the options --picture and --no-picture.

    The help shows the file name `default`, which is empty if the command draws only on request.
    """
    text = f' (default: {default})' if default else ' (default: no picture)'
    parser.add_argument(
        '--picture',
        type=picture_path,
        metavar='FILE',
        help=f'file for a picture: .png, .svg or .pdf{text}',
    )
    parser.add_argument('--no-picture', action='store_true', help='do not write a picture')


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add the option --json."""
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def picture_or(options: argparse.Namespace, default: str) -> Path | None:
    """Return the path of the picture, or None if --no-picture is given."""
    return None if options.no_picture else options.picture or Path(default)


def add_output(
    parser: argparse.ArgumentParser, option: str, help_text: str, metavar: str = 'FILE'
) -> None:
    """Add an option for a file to write."""
    parser.add_argument(option, type=output_path, metavar=metavar, help=f'file for {help_text}')


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add the option --force."""
    parser.add_argument(
        '--force',
        action='store_true',
        help='replace existing files, except inputs',
    )


def add_strict(parser: argparse.ArgumentParser, condition: str) -> None:
    """Add the option --strict; `condition` completes the help "exit with code 3 if ..."."""
    parser.add_argument('--strict', action='store_true', help=f'exit with code 3 if {condition}')


def strict_code(options: argparse.Namespace, is_met: object) -> int:
    """Return the exit code: 3 if --strict is given and its condition is met, otherwise 0."""
    return 3 if options.strict and is_met else 0


def number(expected: str, is_valid: Callable[[float], bool]) -> Callable[[str], float]:
    """Return a function that parses a number; its error message ends with `expected`."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not is_valid(value):
            raise argparse.ArgumentTypeError(f"'{text}' is not {expected}")
        return value

    return parse


positive = number('a positive number', lambda value: 0.0 < value < math.inf)


def _payload(text: str) -> tuple[float, list[float]]:
    """Parse a mass [kg] and an optional centre of mass [m], separated by commas."""
    try:
        mass, *com = map(float, text.split(','))
        if len(com) not in (0, 3):
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is neither MASS nor MASS,X,Y,Z") from None
    return mass, com or [0.0, 0.0, 0.0]


def read_source_text(path: Path | str) -> Path | str:
    """Return the XML text from standard input if the path is ``-``, otherwise the path itself."""
    if str(path) != '-':
        return path
    text = sys.stdin.read()
    if not is_text(text):  # other text would be taken for a path
        raise UrdfError(['is not XML'], 'standard input')
    return text


def load_dynamics(path: Path | str, gravity: Floats | tuple[float, ...]) -> InverseDynamics:
    """
    Load a robot description, and compile its inverse dynamics.

    `path` is the path of a file, ``-`` for standard input, or XML text. `gravity` is the free-fall
    acceleration in the frame of the base link [m/s^2]. Raise UrdfError if the description cannot
    be used. Raise ConfigurationError if gravity is not three finite numbers.
    """
    source = read_source_text(path)
    with progress('loading (compiling takes up to a minute the first time)'):
        return InverseDynamics(load_urdf(source), gravity)


def stem_of(path: Path) -> str:
    """Return the stem of the path, or 'robot' for standard input."""
    return 'robot' if str(path) == '-' else path.stem


def attach_payload(dynamics: InverseDynamics, options: argparse.Namespace) -> str:
    """Attach the payload from --payload and return a description; return '' without --payload."""
    if options.payload is None:
        return ''
    link = options.link or last_link(dynamics.robot)
    mass, com = options.payload
    dynamics.set_payload(link, mass, com)
    return f"payload {mass:g} kg on link '{link}'"


def node_name(text: str) -> str:
    """Check a node name that was given on the command line, and return it."""
    if not re.fullmatch(r'/?(\w+/)*[A-Za-z_]\w*', text, re.ASCII):
        raise argparse.ArgumentTypeError(
            f"'{text}' cannot be the name of a node: use letters, digits, _, and / between parts"
        )
    return text


def add_node(parser: argparse.ArgumentParser) -> None:
    """Add the name of a running node, which may be left out."""
    parser.add_argument(
        'node',
        nargs='?',
        type=node_name,
        metavar='NODE',
        help='name of the node, as in ros2 node list (default: the only inverse dynamics node)',
    )


def choose_node(node: Any, wanted: str | None, is_patient: bool) -> str:
    """
    Return the full name of the inverse dynamics node that the user wants.

    `wanted` is the full name, or the last part of the name, or None for the only node. Wait until
    a node matches, but no longer than `MOST_DISCOVERY` unless `is_patient` is true. Raise
    ConfigurationError if no node matches, or if several match and none has the full name `wanted`.
    """
    from ..ros.observer import find_nodes

    began = time.monotonic()
    has_announced = False
    while True:
        names = find_nodes(node)
        waited = time.monotonic() - began
        chosen = [name for name in names if _is_named(name, wanted)]
        if chosen and (waited > _DISCOVERY or wanted in chosen):
            break
        if not is_patient and waited > MOST_DISCOVERY:
            raise ConfigurationError(_not_found(wanted, names))
        if waited > _PATIENCE and not has_announced:
            print(escaped(f'{_not_found(wanted, names)}; still waiting'), file=sys.stderr)
            has_announced = True
        time.sleep(0.05)
    if wanted in chosen:
        return str(wanted)
    return only_one(chosen)


def only_one(names: list[str]) -> str:
    """Return the only name, or '' if there is none; raise ConfigurationError for several names."""
    if len(names) > 1:
        raise ConfigurationError(
            f'there are {len(names)} nodes: {", ".join(names)}; choose one by its name, such as '
            f'{names[0]}'
        )
    return names[0] if names else ''


def _is_named(name: str, wanted: str | None) -> bool:
    return wanted is None or name == wanted or name.endswith(f'/{wanted.lstrip("/")}')


def _not_found(wanted: str | None, names: list[str]) -> str:
    domain = os.environ.get('ROS_DOMAIN_ID', '0')
    reach = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    where = f'ROS_DOMAIN_ID is {domain}, ROS_AUTOMATIC_DISCOVERY_RANGE is {reach}'
    if wanted is None:
        return f'no inverse dynamics node found ({where})'
    others = f', only {", ".join(names)}' if names else ''
    return f"no inverse dynamics node '{wanted}' found{others} ({where})"
