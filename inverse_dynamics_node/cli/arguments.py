"""Command-line arguments that several commands have in common."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..dynamics.inverse_dynamics import STANDARD_GRAVITY
from .output_files import picture_path


def add_urdf(parser: argparse.ArgumentParser) -> None:
    """Add the argument for the robot description."""
    parser.add_argument(
        'urdf', type=Path, help="robot description; '-' reads it from standard input, as of xacro"
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
    """Add the option --link; a second role of the link is text for the help."""
    text = 'link that carries the payload (default: tool0, else the end of the longest chain)'
    parser.add_argument('--link', help=text + role)


def add_payload(parser: argparse.ArgumentParser) -> None:
    """Add the option --payload."""
    parser.add_argument(
        '--payload',
        type=_payload,
        metavar='MASS[,X,Y,Z]',
        help='payload [kg] and its centre of mass in the frame of the link [m]',
    )


def add_friction(parser: argparse.ArgumentParser) -> None:
    """Add the option --friction."""
    parser.add_argument('--friction', action='store_true', help='include the friction of the URDF')


def add_picture(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the options --picture and --no-picture; the default is text for the help."""
    parser.add_argument(
        '--picture',
        type=picture_path,
        metavar='FILE',
        help=f'file for the picture: .png, .svg or .pdf (default: {default})',
    )
    parser.add_argument('--no-picture', action='store_true', help='do not write a picture')


def picture_or(options: argparse.Namespace, default: str) -> Path | None:
    """Return the file for the picture; None for no picture."""
    return None if options.no_picture else options.picture or Path(default)


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add the option --force."""
    parser.add_argument(
        '--force',
        action='store_true',
        help='replace files that exist; unchanged outputs of earlier calls are replaced anyway, '
        'inputs never',
    )


def add_strict(parser: argparse.ArgumentParser, condition: str) -> None:
    """Add the option --strict; the condition is text for the help."""
    parser.add_argument('--strict', action='store_true', help=f'exit with 3 if {condition}')


def joint_position(text: str) -> tuple[str, float]:
    """
    Parse the position of a joint.

    Raises
    ------
    argparse.ArgumentTypeError
        If the text is not JOINT=POSITION.

    """
    name, _, position = text.rpartition('=')
    try:
        return name, float(position)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not JOINT=POSITION") from None


def _payload(text: str) -> list[float]:
    """Parse a mass [kg] and an optional centre of mass [m], separated by commas."""
    try:
        values = [float(word) for word in text.split(',')]
    except ValueError:
        values = []
    if len(values) not in (1, 4):
        raise argparse.ArgumentTypeError(f"'{text}' is not MASS or MASS,X,Y,Z")
    return values
