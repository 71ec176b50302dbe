"""
URDF to `RobotModel`: read, parse, check, strip, take the values, merge.

The checks come first and are ours, because the loader that reads the values forgives: it repairs
broken XML, fills in missing inertias, and looks at neither types nor references.
"""

from __future__ import annotations

import io
import math
import os
from typing import Any

from lxml import etree
import numpy as np

from ...errors import ConfigurationError, UrdfError
from ..model import RobotModel
from .bodies import (
    build_model,
    Joint,
    Link,
    Mimic,
)
from .checks import check
from .quaternions import rpy_of_quaternion
from .rules import CHILDREN, CHILDREN_OF_FIXED, RULES
from .xml import (
    Element,
    parse,
    read_source,
    tag,
)


def load_urdf(
    path_or_xml: str | os.PathLike[str], on_missing_inertial: str = 'warn'
) -> RobotModel:
    """
    Load a robot from a URDF file or from URDF text.

    Nothing but the file is opened: no meshes, no network. Links without ``<inertial>`` have no
    mass; fixed joints merge their links; mimicking joints follow their master.

    Parameters
    ----------
    path_or_xml : str or path-like
        A path, or XML text: a str that starts with ``<``, space and byte order mark aside.
    on_missing_inertial : {'warn', 'refuse'}
        What to do about links that have a shape, but no ``<inertial>``; the root apart.

    Returns
    -------
    robot : RobotModel
        What loaded but looks wrong is told in ``robot.warnings``.

    Raises
    ------
    UrdfError
        If there is no such file, or it does not describe one tree of revolute, continuous,
        prismatic and fixed joints with complete inertias and limits. A single link without
        joints is not a robot. All problems are listed,
        with their lines.
    ConfigurationError
        If ``on_missing_inertial`` is neither of the two.

    Notes
    -----
    Conventions are those of urdfdom, the parser of ROS: lower and upper limits default to 0, the
    axis to x. An effort or velocity limit of 0 is read as not known, hence infinite. Versions 1.0
    to 1.2 of the format are read; ``quat_xyzw`` of an origin from 1.1 on.

    """
    if on_missing_inertial not in ('warn', 'refuse'):
        raise ConfigurationError(
            f'on_missing_inertial is {on_missing_inertial!r}, expected warn or refuse'
        )
    source = read_source(path_or_xml)
    root, warnings = parse(source)
    findings = check(root, needs_inertials=on_missing_inertial == 'refuse')
    if findings.problems:
        raise UrdfError(findings.problems, source.name)
    links, joints = _values(_stripped(root))
    # Too large a number shows up as infinite, below, where it can be told which.
    with np.errstate(all='ignore'):
        robot = build_model(root.get('name'), links, joints, [*warnings, *findings.warnings])
    problems = _overflows(robot)
    if problems:
        raise UrdfError(problems, source.name)
    return robot


def _stripped(root: Element) -> bytes:
    """Serialise what dynamics need, which is what has been checked, and nothing else."""
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
            if tag(child) in kinds:
                waiting.append((child, etree.SubElement(copy, tag(child))))
    return bytes(etree.tostring(clean, encoding='utf-8'))


def _values(clean: bytes) -> tuple[list[Link], list[Joint]]:
    import yourdfpy  # here, because it takes half a second: a bad file fails without it

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
        return Link(link.name, 0.0, np.zeros(3), np.zeros((3, 3)))
    origin = np.eye(4) if inertial.origin is None else inertial.origin
    rotation = origin[:3, :3]
    inertia = rotation @ inertial.inertia @ rotation.T
    return Link(link.name, inertial.mass, origin[:3, 3], inertia)


def _joint(joint: Any) -> Joint:
    origin = np.eye(4) if joint.origin is None else joint.origin
    axis = joint.axis / np.abs(joint.axis).max()  # first, or a large axis overflows
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
        # The loader leaves these two as text.
        damping=float((dynamics and dynamics.damping) or 0.0),
        friction=float((dynamics and dynamics.friction) or 0.0),
        mimic=mimic and Mimic(mimic.joint, mimic.multiplier, mimic.offset),
    )


def _overflows(robot: RobotModel) -> list[str]:
    """Name what came out infinite though every number of the file is finite."""
    rows = {
        robot.body_names: ('p_PL', 'mass', 'com', 'inertia', 'multiplier', 'offset'),
        robot.joint_names: ('damping', 'friction'),
        robot.link_names: ('link_position',),
    }
    return [
        f"{field} of '{name}' is not finite: a number in the description is too large"
        for names, fields in rows.items()
        for field in fields
        for name, value in zip(names, getattr(robot, field), strict=True)
        if not np.isfinite(value).all()
    ]
