"""Reads recordings, and the node parameters that describe measured efforts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

from ..analysis.diagnosis import GravityConvention
from ..analysis.recordings.measured_states import read_measured_states
from ..analysis.recordings.signals import Recording
from ..control.settings import MeasuredGravity
from ..errors import ConfigurationError
from ..robot.model import RobotModel
from .console import progress

if TYPE_CHECKING:
    from ..ros.diagnostics import NodeStatus


def read_recording(
    path: Path, robot: RobotModel, topic: str | None, scale: Mapping[str, float] | None = None
) -> tuple[Recording, tuple[str, ...]]:
    """Read a recording, and scale its efforts; return the recording and notes on the data."""
    with progress(f'reading {path.name}') as report:
        recording, notes = read_measured_states(
            path, robot.joint_names, topic, report, robot.mimic_names
        )
    return scaled(recording, scale or {}), notes


def scaled(recording: Recording, scale: Mapping[str, float]) -> Recording:
    """Multiply the efforts of each joint by its factor in `scale`; the default is 1."""
    factors = np.array([scale.get(name, 1.0) for name in recording.joint_names])
    return recording._replace(efforts=factors * recording.efforts)


def measured_efforts(
    path: Path | None, joint_names: tuple[str, ...]
) -> tuple[GravityConvention, dict[str, float]]:
    """Return the gravity convention and the effort scales in a parameter file, or the defaults."""
    given = {} if path is None else _node_parameters(path)
    try:
        in_commands = given.get('include_gravity', True)
        if not isinstance(in_commands, bool):
            raise ValueError(f'include_gravity is {in_commands!r}, expected true or false')
        name, choices = given.get('measured_gravity', 'as_commanded'), list(MeasuredGravity)
        if name not in [choice.value for choice in choices]:
            expected = ', '.join(choice.value for choice in choices)
            raise ValueError(f'measured_gravity is {name!r}, expected one of {expected}')
        values = np.asarray(given.get('measured_effort_scale', 1.0), dtype=np.float64).ravel()
        joints = [*filter(None, given.get('joints') or ())] or joint_names
        if len(values) not in (1, len(joints)):
            raise ValueError(
                f'measured_effort_scale has {len(values)} numbers, expected one, or one for each '
                f'of {len(joints)} joints'
            )
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f'{path}: {error}') from None
    scale = dict(zip(joints, np.broadcast_to(values, len(joints)).tolist(), strict=True))
    in_measured = MeasuredGravity(name).is_included(in_commands)
    return GravityConvention(in_commands, in_measured), scale


def reported_convention(status: NodeStatus) -> GravityConvention:
    """Return the gravity convention that the diagnostics of a running node report."""
    in_commands = bool(status.numbers('model', 'gravity [m/s^2]'))
    in_measured = status.text('efforts', 'measured efforts contain gravity')
    return GravityConvention(in_commands, in_measured == 'yes' if in_measured else in_commands)


def _node_parameters(path: Path) -> dict[str, Any]:
    """Return the parameters of all nodes in a file."""
    import yaml

    try:
        document = yaml.safe_load(path.read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigurationError(f'{path}: {" ".join(str(error).split())}') from None
    nodes = document.values() if isinstance(document, dict) else ()
    sections = [each.get('ros__parameters') for each in nodes if isinstance(each, dict)]
    found: list[dict[str, Any]] = [each for each in sections if isinstance(each, dict)]
    if not found:
        raise ConfigurationError(f'{path} has no ros__parameters, expected a parameter file')
    return {name: value for each in found for name, value in each.items()}
