"""
Loads a `RobotModel` from a URDF in four steps: parse, check, evaluate, merge.

The checks come before yourdfpy reads the values, because yourdfpy fills in missing inertias, and
checks neither types nor references. yourdfpy reads the tree of elements that has been checked. Its
links and joints have no type annotations. Links connected by fixed joints form one body. The frame
of a joint is the frame of its child link, and the pose of the joint is given in the frame of its
parent link.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
import os
from typing import Any, NamedTuple

import numpy as np

from ...errors import UrdfError
from ..model import Floats, ModelWarning, RobotModel
from ..rigid_body import combine, RigidBody
from .checks import check, children_read, Problems
from .xml import broken_values, Element, parse, read_source, Source


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
    x. An effort or velocity limit of 0 or -1 means unknown, and becomes infinite.

    """
    source = read_source(path_or_xml)
    root = parse(source)
    problems = check(root)
    _warn_of_broken_values(source, problems)
    if problems.errors:
        raise UrdfError(problems.errors, source.name)
    # Large numbers may overflow to infinite values, which `_overflows` reports.
    with np.errstate(all='ignore'):
        robot = _model(_read(root), problems.warnings)
    overflows = _overflows(robot)
    if overflows:
        raise UrdfError(overflows, source.name)
    return robot


def _warn_of_broken_values(source: Source, problems: Problems) -> None:
    text = 'has a line break or a tab inside an attribute; urdfdom, the parser of ROS, rejects it'
    hint = 'write spaces; urdfdom drops the <inertial> of a link without an error'
    for line, kind in broken_values(source):
        problems.warning(line, f'<{kind}>', text, hint)


def _read(root: Element) -> Any:
    """Return the robot as objects of yourdfpy; elements that have not been checked are removed."""
    import yourdfpy  # imported late, so that invalid files fail half a second earlier

    for parent in list(root.iter('robot', 'link', 'joint')):
        for child in list(parent):
            if child.tag not in children_read(parent):
                parent.remove(child)
    # The only function that reads a tree instead of a file, in which yourdfpy repairs errors.
    return yourdfpy.URDF._parse_robot(root)


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


# ---- The model ---------------------------------------------------------------------------


class _Placement(NamedTuple):
    """The body that contains a link, and the pose of the link in the body frame."""

    body: int
    rotation: Floats
    position: Floats


class _Body(NamedTuple):
    """A body: the joint that moves it, and its pose in the parent's frame at joint position 0."""

    joint: Any
    parent: int
    rotation: Floats
    position: Floats


class _Drive(NamedTuple):
    """A joint has the position ``multiplier * position of master + offset``."""

    master: str
    multiplier: float
    offset: float


def _model(description: Any, warnings: Iterable[ModelWarning]) -> RobotModel:
    """
    Merge links into bodies, and resolve mimic joints.

    ``description`` is a robot of yourdfpy, whose joints must form one tree. The model contains the
    given ``warnings``, and warnings about joints that move no mass.
    """
    links = description.links
    root, bodies, placements = _place(links, description.joints)
    placed = [placements[link.name] for link in links]
    inertials = [_inertial(link.inertial) for link in links]
    mass, com, inertia = _merge(placed, inertials, 1 + len(bodies))
    drives = _resolve_mimics(description.joints)
    masters = [body.joint for body in bodies if body.joint.mimic is None]
    index = {joint.name: i for i, joint in enumerate(masters)}
    moved = [drives[body.joint.name] for body in bodies]
    parents = [-1, *(body.parent for body in bodies)]
    limits = np.array([_limits(joint) for joint in masters], float).reshape(-1, 4).T.copy()
    damping, friction = _folded_friction(bodies, drives, index)
    return RobotModel(
        name=description.name,
        joint_names=tuple(index),
        lower=limits[0],
        upper=limits[1],
        velocity_limits=limits[2],
        effort_limits=limits[3],
        damping=damping,
        friction=friction,
        is_continuous=np.array([joint.type == 'continuous' for joint in masters], bool),
        body_names=(root, *(body.joint.name for body in bodies)),
        parent=np.array(parents, np.int64),
        is_prismatic=np.array([False, *(b.joint.type == 'prismatic' for b in bodies)], bool),
        joint_index=np.array([-1, *(index[drive.master] for drive in moved)], np.int64),
        multiplier=np.array([0.0, *(drive.multiplier for drive in moved)], float),
        offset=np.array([0.0, *(drive.offset for drive in moved)], float),
        R_PL=np.array([np.eye(3), *(body.rotation for body in bodies)]),
        p_PL=np.array([np.zeros(3), *(body.position for body in bodies)]),
        axis=np.array([np.zeros(3), *(_unit_axis(body.joint) for body in bodies)]),
        mass=mass,
        com=com,
        inertia=inertia,
        link_names=tuple(link.name for link in links),
        link_body=np.array([place.body for place in placed], np.int64),
        link_rotation=np.array([place.rotation for place in placed]),
        link_position=np.array([place.position for place in placed]),
        link_mass=np.array([inertial.mass for inertial in inertials], float),
        link_com=np.array([inertial.com for inertial in inertials], float),
        link_inertia=np.array([inertial.inertia for inertial in inertials], float),
        warnings=(*warnings, *_massless(bodies, parents, mass)),
    )


# ---- Values of yourdfpy, which are None if the element is missing --------------------------


def _pose(origin: Any) -> tuple[Floats, Floats]:
    """Return the rotation and the position of an origin."""
    return (np.eye(3), np.zeros(3)) if origin is None else (origin[:3, :3], origin[:3, 3])


def _inertial(inertial: Any) -> RigidBody:
    """Return mass, centre of mass and inertia of a link, in the link frame."""
    if inertial is None:
        return RigidBody(0.0, np.zeros(3), np.zeros((3, 3)))
    rotation, com = _pose(inertial.origin)
    return RigidBody(inertial.mass, com, rotation @ inertial.inertia @ rotation.T)


def _limits(joint: Any) -> tuple[float, float, float, float]:
    """Return lower, upper, velocity and effort limit; infinite if there is no limit."""
    limit = joint.limit
    velocity = limit.velocity if limit and limit.velocity > 0.0 else math.inf
    effort = limit.effort if limit and limit.effort > 0.0 else math.inf
    if joint.type == 'continuous':
        return -math.inf, math.inf, velocity, effort
    return limit.lower or 0.0, limit.upper or 0.0, velocity, effort


def _unit_axis(joint: Any) -> Floats:
    axis = joint.axis / np.abs(joint.axis).max()  # the norm of a large axis would overflow
    return np.asarray(axis / np.linalg.norm(axis))


# ---- Bodies --------------------------------------------------------------------------------


def _place(
    links: Sequence[Any], joints: Sequence[Any]
) -> tuple[str, list[_Body], dict[str, _Placement]]:
    """Return the root link, the bodies in depth-first order, and the placements of the links."""
    children: dict[str, list[Any]] = {link.name: [] for link in links}
    for joint in joints:
        children[joint.parent].append(joint)
    held = {joint.child for joint in joints}
    root = next(link.name for link in links if link.name not in held)

    bodies: list[_Body] = []
    placements = {root: _Placement(0, np.eye(3), np.zeros(3))}
    waiting = children[root][::-1]
    while waiting:  # not recursive: a chain may be longer than Python's recursion limit
        joint = waiting.pop()
        parent = placements[joint.parent]
        rotation, position = _pose(joint.origin)
        rotation = parent.rotation @ rotation
        position = parent.position + parent.rotation @ position
        if joint.type == 'fixed':
            placements[joint.child] = _Placement(parent.body, rotation, position)
        else:
            bodies.append(_Body(joint, parent.body, rotation, position))
            placements[joint.child] = _Placement(len(bodies), np.eye(3), np.zeros(3))
        waiting += children[joint.child][::-1]
    return root, bodies, placements


def _merge(
    placed: Sequence[_Placement], inertials: Sequence[RigidBody], count: int
) -> tuple[Floats, Floats, Floats]:
    """Return masses, centres of mass and inertias of the bodies, in the body frames."""
    parts: list[list[RigidBody]] = [[] for _ in range(count)]
    for place, inertial in zip(placed, inertials, strict=True):
        parts[place.body].append(inertial.rotate(place.rotation).shift(place.position))
    bodies = [combine(each) for each in parts]
    inertia = np.array([body.inertia for body in bodies])
    return (
        np.array([body.mass for body in bodies]),
        np.array([body.com for body in bodies]),
        0.5 * (inertia + inertia.transpose(0, 2, 1)),
    )


# ---- Mimic joints --------------------------------------------------------------------------


def _resolve_mimics(joints: Iterable[Any]) -> dict[str, _Drive]:
    """Return the drive of every joint; a joint that is not a mimic joint drives itself."""
    by_name = {joint.name: joint for joint in joints}
    drives: dict[str, _Drive] = {}
    for joint in by_name.values():
        chain = []
        while joint.name not in drives and joint.mimic is not None:
            chain.append(joint)
            joint = by_name[joint.mimic.joint]
        drive = drives.setdefault(joint.name, _Drive(joint.name, 1.0, 0.0))
        for follower in reversed(chain):
            multiplier, offset = follower.mimic.multiplier, follower.mimic.offset
            drive = _Drive(
                drive.master, multiplier * drive.multiplier, multiplier * drive.offset + offset
            )
            drives[follower.name] = drive
    return drives


def _folded_friction(
    bodies: Sequence[_Body], drives: Mapping[str, _Drive], index: Mapping[str, int]
) -> tuple[Floats, Floats]:
    """
    Return damping and friction of the joints, including those of their mimic joints.

    A mimic joint with multiplier m moves m times as fast as its master, and the effort of the
    mimic joint acts on the master, multiplied by m. The viscous friction of a mimic joint is
    therefore multiplied by m squared, and the Coulomb friction by |m|.

    """
    damping, friction = np.zeros(len(index)), np.zeros(len(index))
    for body in bodies:
        dynamics = body.joint.dynamics
        if dynamics is not None:  # its values are not converted to numbers
            master, multiplier, _ = drives[body.joint.name]
            damping[index[master]] += multiplier * multiplier * float(dynamics.damping or 0.0)
            friction[index[master]] += abs(multiplier) * float(dynamics.friction or 0.0)
    return damping, friction


def _massless(bodies: Sequence[_Body], parents: Sequence[int], mass: Floats) -> list[ModelWarning]:
    """Return warnings about joints that move no mass."""
    if not bodies:
        text = 'no joint can move, so there is no effort to compute'
        return [ModelWarning(text, 'check that this is the whole robot: every joint is fixed')]
    carried = mass.tolist()
    for body in range(len(bodies), 0, -1):
        carried[parents[body]] += carried[body]
    idle = [body.joint.name for i, body in enumerate(bodies, 1) if carried[i] == 0.0]
    if len(idle) == len(bodies):
        text = 'no joint moves any mass, so every gravity effort is zero'
        return [ModelWarning(text, 'write <inertial> for the links that the joints move')]
    text = 'moves no mass, so its gravity effort is always zero'
    hint = 'write <inertial> for the links that this joint moves, unless the links are only frames'
    return [ModelWarning(text, hint, f"joint '{name}'") for name in idle]
