"""Loads the robot on which a command works."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import sys

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import UrdfError
from ..robot.model import Floats
from ..robot.urdf import load_urdf
from .console import waiting


def read_source_text(path: Path | str) -> Path | str:
    """Return the text of standard input for ``-``, and anything else as it is."""
    if str(path) != '-':
        return path
    text = sys.stdin.read()
    if not text.lstrip('\ufeff \t\r\n').startswith('<'):  # otherwise it would be a path
        raise UrdfError(['is not XML'], 'standard input')
    return text


def load_dynamics(path: Path | str, gravity: Floats | tuple[float, ...]) -> InverseDynamics:
    """
    Load a robot description, and compile the functions that compute its efforts.

    Parameters
    ----------
    path : pathlib.Path or str
        A file; ``-`` is standard input; or XML text.
    gravity : array_like, shape (3,)
        Free-fall acceleration in the frame of the base link [m/s^2].

    Raises
    ------
    UrdfError
        If the file does not exist, or is not a usable robot description.
    ConfigurationError
        If gravity is not three finite numbers.

    """
    source = read_source_text(path)
    with waiting('loading (the first time, compiling takes some seconds)'):
        return InverseDynamics(load_urdf(source), gravity)


def stem_of(path: Path) -> str:
    """Return the start of the names of files about a robot."""
    return 'robot' if str(path) == '-' else path.stem


def attach_payload(dynamics: InverseDynamics, link: str, payload: Sequence[float] | None) -> str:
    """
    Attach the payload of the command line, if there is one, to a link.

    Returns
    -------
    description : str
        Text for titles; empty without a payload.

    """
    if payload is None:
        return ''
    mass, *com = payload
    dynamics.set_payload(link, mass, com or (0.0, 0.0, 0.0))
    return f"payload {mass:g} kg on link '{link}'"
