"""
Loads a `RobotModel` from a URDF in six steps: read, parse, check, strip, evaluate, merge.

The checks come before yourdfpy reads the values, because yourdfpy repairs broken XML, fills in
missing inertias, and checks neither types nor references.
"""

from __future__ import annotations

import io
import math
import os
from typing import Any

from lxml import etree
import numpy as np

from ...errors import UrdfError
from ..kinematics import rpy_of_quaternion
from ..model import RobotModel
from ..rigid_body import RigidBody
from .bodies import build_model, Joint, Link, Mimic
from .checks import check
from .schema import CHILDREN, CHILDREN_OF_FIXED, READ_ONCE, RULES
from .xml import Element, parse, read_source, tag


def load_urdf(path_or_xml: str | os.PathLike[str]) -> RobotModel:
    """
    Load a robot from a URDF file or from URDF text.

    Meshes are not read. Links without ``<inertial>`` have no mass. Links connected by fixed joints
    are merged.

    Parameters
    ----------
    path_or_xml : str or path-like
        A path, or XML text. XML text starts with ``<``, after optional white space or a byte
        order mark.

    Returns
    -------
    robot : RobotModel
        The robot; ``robot.warnings`` lists problems that do not prevent its use.

    Raises
    ------
    UrdfError
        If the file cannot be read, or the description has errors. The joints must form one tree,
        and must be revolute, continuous, prismatic or fixed. Inertias must be complete.
        Revolute and prismatic joints need a ``<limit>``. A ``<limit>`` must contain effort and
        velocity. A robot without joints is an error. The message lists all errors with their
        lines.

    Notes
    -----
    As in urdfdom, the parser of ROS, lower and upper limits default to 0, and the axis defaults to
    x. An effort or velocity limit of 0 means unknown, and becomes infinite. The attribute
    ``quat_xyzw`` needs version 1.1 or later of the format.

    """
    source = read_source(path_or_xml)
    root = parse(source)
    problems = check(root)
    if problems.errors:
        raise UrdfError(problems.errors, source.name)
    links, joints = _values(_stripped(root))
    # Large numbers may overflow to infinite values, which `_overflows` reports.
    with np.errstate(all='ignore'):
        robot = build_model(root.get('name'), links, joints, problems.warnings)
    overflows = _overflows(robot)
    if overflows:
        raise UrdfError(overflows, source.name)
    return robot


def _stripped(root: Element) -> bytes:
    """Serialise only the elements and attributes that have been checked."""
    clean = etree.Element('robot')
    waiting = [(root, clean)]
    while waiting:
        element, copy = waiting.pop()
        rule = RULES[tag(element)]
        for name, text in element.attrib.items():
            if name == 'quat_xyzw':
                copy.set('rpy', rpy_of_quaternion(text))
            elif name in rule.names or name in rule.numbers:
                copy.set(name, text)
        is_fixed = tag(element) == 'joint' and element.get('type') == 'fixed'
        kinds = CHILDREN_OF_FIXED if is_fixed else CHILDREN.get(tag(element), ())
        for child in element:
            kind = tag(child)
            if kind in kinds and not (kind == READ_ONCE and copy.find(kind) is not None):
                waiting.append((child, etree.SubElement(copy, kind)))
    return bytes(etree.tostring(clean, encoding='utf-8'))


def _values(clean: bytes) -> tuple[list[Link], list[Joint]]:
    import yourdfpy  # imported late, so that invalid files fail half a second earlier

    robot = yourdfpy.URDF.load(
        io.BytesIO(clean),
        build_scene_graph=False,
        build_collision_scene_graph=False,
        load_meshes=False,
        load_collision_meshes=False,
    ).robot
    return [_link(link) for link in robot.links], [_joint(joint) for joint in robot.joints]


def _link(link: Any) -> Link:
    inertial = link.inertial
    if inertial is None:
        return Link(link.name, RigidBody(0.0, np.zeros(3), np.zeros((3, 3))))
    origin = np.eye(4) if inertial.origin is None else inertial.origin
    rotation = origin[:3, :3]
    inertia = rotation @ inertial.inertia @ rotation.T
    return Link(link.name, RigidBody(inertial.mass, origin[:3, 3], inertia))


def _joint(joint: Any) -> Joint:
    origin = np.eye(4) if joint.origin is None else joint.origin
    axis = joint.axis / np.abs(joint.axis).max()  # the norm of a large axis would overflow
    limit, dynamics, mimic = joint.limit, joint.dynamics, joint.mimic
    is_bounded = joint.type in ('revolute', 'prismatic')
    return Joint(
        name=joint.name,
        kind=joint.type,
        parent=joint.parent,
        child=joint.child,
        rotation=origin[:3, :3],
        position=origin[:3, 3],
        axis=axis / np.linalg.norm(axis),
        lower=(limit.lower or 0.0) if is_bounded else -math.inf,
        upper=(limit.upper or 0.0) if is_bounded else math.inf,
        velocity=(limit and limit.velocity) or math.inf,
        effort=(limit and limit.effort) or math.inf,
        # yourdfpy does not convert damping and friction to numbers.
        damping=float((dynamics and dynamics.damping) or 0.0),
        friction=float((dynamics and dynamics.friction) or 0.0),
        mimic=mimic and Mimic(mimic.joint, mimic.multiplier, mimic.offset),
    )


def _overflows(robot: RobotModel) -> list[str]:
    """Return an error for each value that has overflowed."""
    rows = {
        robot.body_names: ('p_PL', 'mass', 'com', 'inertia', 'multiplier', 'offset'),
        robot.joint_names: ('damping', 'friction'),
        robot.link_names: ('link_position',),
    }
    words = {'p_PL': 'origin', 'com': 'centre of mass', 'link_position': 'position'}
    return [
        f"{words.get(field, field)} of '{name}' is not finite: a number in the description is "
        'too large'
        for names, fields in rows.items()
        for field in fields
        for name, value in zip(names, getattr(robot, field), strict=True)
        if not np.isfinite(value).all()
    ]
