"""The result of an identification as URDF and as parameters of the node."""

from __future__ import annotations

from collections.abc import Sequence
import os

from ...robot.urdf.writer import Friction, rewrite
from ..diagnosis.friction import ros_number
from .result import IdentificationResult, JointResult


def calibrated_urdf(result: IdentificationResult, path_or_xml: str | os.PathLike[str]) -> bytes:
    """
    Return the robot description with identified inertials and friction.

    Parameters
    ----------
    result : IdentificationResult
        The result.
    path_or_xml : str or path-like
        The robot description that was calibrated.

    Returns
    -------
    text : bytes
        Only the numbers of changed inertials and of friction differ. Without an accepted model,
        only friction is written.

    """
    robot = result.robot
    friction = {
        joint.name: Friction(joint.terms.damping, joint.terms.coulomb)
        for joint in result.joints
        if not joint.unknown_because
    }
    # The fitted friction includes that of mimicking joints.
    for body in range(1, len(robot.parent)):
        name = robot.body_names[body]
        master = robot.joint_names[int(robot.joint_index[body])]
        if name != master and master in friction:
            friction[name] = Friction(0.0, 0.0)
    return rewrite(path_or_xml, result.inertials, friction)


def node_parameters(result: IdentificationResult) -> str:
    """Return friction, armature and offsets as parameters of the node, in YAML."""
    joints = result.joints
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
