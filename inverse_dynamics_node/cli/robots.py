"""The robot description that a command is given: a file, or standard input."""

from __future__ import annotations

from pathlib import Path
import sys

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import UrdfError
from ..robot.model import Floats
from ..robot.urdf import load_urdf
from .console import waiting

HELP = "the robot description; '-' reads it from standard input, as from xacro"


def load_dynamics(path: Path, gravity: Floats | tuple[float, ...]) -> InverseDynamics:
    """
    Load a robot and make it ready.

    Raises
    ------
    UrdfError
        If there is no such file, or it cannot be used.
    ConfigurationError
        If gravity is not three finite numbers.

    """
    source: Path | str = path
    if str(path) == '-':
        source = sys.stdin.read()
        if not source.lstrip('\ufeff \t\r\n').startswith('<'):  # else it would be a path
            raise UrdfError(['no XML'], 'standard input')
    with waiting('loading; the first time compiles for some seconds'):
        return InverseDynamics(load_urdf(source), gravity)


def stem_of(path: Path) -> str:
    """Return what files about a robot are named after."""
    return 'robot' if str(path) == '-' else path.stem
