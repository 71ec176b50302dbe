"""The result of a calibration as URDF, as parameters of the node, and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
import math
import os
from typing import Any

import numpy as np

from ...robot.urdf.writer import Friction, rewrite
from ..identification.friction import ros_number
from .result import Calibration, JointResult, Residuals


def calibrated_urdf(calibration: Calibration, path_or_xml: str | os.PathLike[str]) -> bytes:
    """
    Return the robot description with identified inertials and friction.

    Parameters
    ----------
    calibration : Calibration
        The result.
    path_or_xml : str or path-like
        The robot description that was calibrated.

    Returns
    -------
    text : bytes
        Only the numbers of changed inertials and of friction differ. Without an accepted model,
        only friction is written.

    """
    robot = calibration.robot
    friction = {
        joint.name: Friction(joint.terms.damping, joint.terms.coulomb)
        for joint in calibration.joints
        if not joint.unknown_because
    }
    # The fitted friction includes that of mimicking joints.
    for body in range(1, len(robot.parent)):
        name = robot.body_names[body]
        master = robot.joint_names[int(robot.joint_index[body])]
        if name != master and master in friction:
            friction[name] = Friction(0.0, 0.0)
    return rewrite(path_or_xml, calibration.inertials, friction)


def node_parameters(calibration: Calibration) -> str:
    """Return friction, armature and offsets as parameters of the node, in YAML."""
    joints = calibration.joints
    names = ', '.join("'" + joint.name.replace("'", "''") + "'" for joint in joints)
    unknown = [
        f'# {joint.name}: unknown, {joint.unknown_because}; -1.0 selects the friction of the URDF.'
        for joint in joints
        if joint.unknown_because
    ]
    lines = [
        '# Identified from recordings: damping [N m s/rad, N s/m], Coulomb friction [N m, N] and',
        '# the speed over which it is smoothed [rad/s, m/s], Coulomb friction per load, armature',
        '# [kg m^2, kg] and offsets of the efforts [N m, N].',
        *unknown,
        '/**:',
        '  ros__parameters:',
        f'    joints: [{names}]',
        '    include_friction: true',
        f'    damping: {_listed(joints, "damping", -1.0)}',
        f'    coulomb: {_listed(joints, "coulomb", -1.0)}',
        f'    coulomb_width: {_listed(joints, "width", 0.01)}',
        f'    load_friction: {_listed(joints, "load_friction", 0.0)}',
        f'    armature: {_listed(joints, "armature")}',
        f'    effort_offset: {_listed(joints, "offset")}',
    ]
    return '\n'.join(lines) + '\n'


def _listed(joints: Sequence[JointResult], name: str, unknown: float | None = None) -> str:
    values = [
        unknown if joint.unknown_because and unknown is not None else getattr(joint.terms, name)
        for joint in joints
    ]
    return f'[{", ".join(ros_number(value) for value in values)}]'


def as_json(calibration: Calibration) -> dict[str, Any]:
    """Return the report as values for JSON; lengths in m, masses in kg, efforts in N m or N."""
    report: dict[str, Any] = _plain(
        {
            'robot': calibration.robot.name,
            'accepted': calibration.accepted,
            'verdict': calibration.verdict,
            'unseen_data': calibration.unseen.description,
            'joints': [_joint(joint) for joint in calibration.joints],
            'bodies': [
                {
                    'link': body.link,
                    'links': body.links,
                    'mass_before': body.mass_before,
                    'mass': body.mass if calibration.accepted else body.mass_before,
                    'mass_error': body.mass_error,
                    'com_before': body.com_before,
                    'com': body.com if calibration.accepted else body.com_before,
                    'com_error': body.com_error,
                    'told': body.told,
                }
                for body in calibration.bodies
            ],
            'kept': calibration.kept,
            'weight_of_urdf': calibration.gamma,
            'tried_weights': [
                {'weight': weight, 'loss': loss} for weight, loss in calibration.trials
            ],
            'effort_delay': calibration.delay,
            'effort_delay_error': calibration.delay_error,
            'effort_delay_removed': calibration.delay_removed,
            'smoothing_window': calibration.smoothing,
            'samples': calibration.sample_count,
            'duration': calibration.duration,
            'warnings': [f'{text}: {hint}' for text, hint in calibration.warnings],
            'notes': calibration.notes,
            'what_to_record_next': calibration.advice,
        }
    )
    return report


def _joint(joint: JointResult) -> dict[str, Any]:
    terms = joint.terms
    return {
        'name': joint.name,
        'unit': 'N' if joint.is_prismatic else 'N m',
        'measured': joint.measured,
        **_residuals(joint.unseen),
        'noise': joint.noise,
        'training': _residuals(joint.training),
        'damping': terms.damping,
        'coulomb': terms.coulomb,
        'coulomb_width': terms.width,
        'load_friction': terms.load_friction,
        'armature': terms.armature,
        'offset': terms.offset,
        'standard_errors': terms.errors,
        'friction_unknown_because': joint.unknown_because,
        'coupled_with': joint.coupled_with,
    }


def _residuals(residuals: Residuals) -> dict[str, float]:
    return {
        'urdf': residuals.urdf,
        'friction': residuals.friction,
        'identified': residuals.identified,
    }


def _plain(value: Any) -> Any:
    """Convert to types that JSON has; numbers that are not finite become null."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(each) for each in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
