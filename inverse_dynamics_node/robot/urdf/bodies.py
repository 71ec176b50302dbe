"""
Builds a `RobotModel` from links and joints; links connected by fixed joints form one body.

The frame of a joint is the frame of its child link. The pose of the joint is given in the frame of
its parent link.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..model import Floats, ModelWarning, RobotModel
from ..rigid_body import combine, RigidBody


class Link(NamedTuple):
    """A link of the URDF."""

    name: str
    inertial: RigidBody


class Mimic(NamedTuple):
    """A mimic rule: the joint has the position ``multiplier * position of master + offset``."""

    master: str
    multiplier: float
    offset: float


class Joint(NamedTuple):
    """A joint of the URDF; an infinite limit means no limit."""

    name: str
    kind: str
    parent: str
    child: str
    rotation: Floats
    position: Floats
    axis: Floats
    lower: float
    upper: float
    velocity: float
    effort: float
    damping: float
    friction: float
    mimic: Mimic | None


class _Placement(NamedTuple):
    """The body that contains a link, and the pose of the link in the body frame."""

    body: int
    rotation: Floats
    position: Floats


class _Body(NamedTuple):
    """A body: the joint that moves it, and its pose in the parent's frame at joint position 0."""

    joint: Joint
    parent: int
    rotation: Floats
    position: Floats


def build_model(
    name: str,
    links: Sequence[Link],
    joints: Sequence[Joint],
    warnings: Iterable[ModelWarning] = (),
) -> RobotModel:
    """
    Merge links into bodies, and resolve mimic joints.

    ``links`` and ``joints`` must form one tree. The model contains the given ``warnings``, and
    warnings about joints that move no mass.

    """
    root, bodies, placements = _place(links, joints)
    placed = [placements[link.name] for link in links]
    mass, com, inertia = _merge(placed, links, 1 + len(bodies))
    drives = resolve_mimics(joints)
    masters = [body.joint for body in bodies if body.joint.mimic is None]
    index = {joint.name: i for i, joint in enumerate(masters)}
    moved = [drives[body.joint.name] for body in bodies]
    parents = [-1, *(body.parent for body in bodies)]
    damping, friction = _folded_friction(bodies, drives, index)
    return RobotModel(
        name=name,
        joint_names=tuple(index),
        lower=np.array([joint.lower for joint in masters], float),
        upper=np.array([joint.upper for joint in masters], float),
        velocity_limits=np.array([joint.velocity for joint in masters], float),
        effort_limits=np.array([joint.effort for joint in masters], float),
        damping=np.array(damping, float),
        friction=np.array(friction, float),
        is_continuous=np.array([joint.kind == 'continuous' for joint in masters], bool),
        body_names=(root, *(body.joint.name for body in bodies)),
        parent=np.array(parents, np.int64),
        is_prismatic=np.array([False, *(b.joint.kind == 'prismatic' for b in bodies)], bool),
        joint_index=np.array([-1, *(index[drive.master] for drive in moved)], np.int64),
        multiplier=np.array([0.0, *(drive.multiplier for drive in moved)], float),
        offset=np.array([0.0, *(drive.offset for drive in moved)], float),
        R_PL=np.array([np.eye(3), *(body.rotation for body in bodies)]),
        p_PL=np.array([np.zeros(3), *(body.position for body in bodies)]),
        axis=np.array([np.zeros(3), *(body.joint.axis for body in bodies)]),
        mass=mass,
        com=com,
        inertia=inertia,
        link_names=tuple(link.name for link in links),
        link_body=np.array([place.body for place in placed], np.int64),
        link_rotation=np.array([place.rotation for place in placed]),
        link_position=np.array([place.position for place in placed]),
        link_mass=np.array([link.inertial.mass for link in links], float),
        link_com=np.array([link.inertial.com for link in links], float),
        link_inertia=np.array([link.inertial.inertia for link in links], float),
        warnings=(*warnings, *_massless(bodies, parents, mass)),
    )


def _place(
    links: Sequence[Link], joints: Sequence[Joint]
) -> tuple[str, list[_Body], dict[str, _Placement]]:
    """Return the root link, the bodies in depth-first order, and the placements of the links."""
    children: dict[str, list[Joint]] = {link.name: [] for link in links}
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
        rotation = parent.rotation @ joint.rotation
        position = parent.position + parent.rotation @ joint.position
        if joint.kind == 'fixed':
            placements[joint.child] = _Placement(parent.body, rotation, position)
        else:
            bodies.append(_Body(joint, parent.body, rotation, position))
            placements[joint.child] = _Placement(len(bodies), np.eye(3), np.zeros(3))
        waiting += children[joint.child][::-1]
    return root, bodies, placements


def _merge(
    placed: Sequence[_Placement], links: Sequence[Link], count: int
) -> tuple[Floats, Floats, Floats]:
    """Return masses, centres of mass and inertias of the bodies, in the body frames."""
    parts: list[list[RigidBody]] = [[] for _ in range(count)]
    for place, link in zip(placed, links, strict=True):
        moved = link.inertial.rotate(place.rotation).shift(place.position)
        parts[place.body].append(moved)
    bodies = [combine(each) for each in parts]
    inertia = np.array([body.inertia for body in bodies])
    return (
        np.array([body.mass for body in bodies]),
        np.array([body.com for body in bodies]),
        0.5 * (inertia + inertia.transpose(0, 2, 1)),
    )


def resolve_mimics(joints: Iterable[Joint]) -> dict[str, Mimic]:
    """
    Return a mimic rule for every joint; chains of mimic joints are resolved.

    A joint that is not a mimic joint follows itself.

    """
    by_name = {joint.name: joint for joint in joints}
    resolved: dict[str, Mimic] = {}
    for start in by_name.values():
        chain: list[tuple[str, Mimic]] = []
        joint = start
        while joint.name not in resolved and joint.mimic is not None:
            chain.append((joint.name, joint.mimic))
            joint = by_name[joint.mimic.master]
        base = resolved.setdefault(joint.name, Mimic(joint.name, 1.0, 0.0))
        for name, (_, multiplier, offset) in reversed(chain):
            offset += multiplier * base.offset
            base = Mimic(base.master, multiplier * base.multiplier, offset)
            resolved[name] = base
    return resolved


def _folded_friction(
    bodies: Sequence[_Body], drives: Mapping[str, Mimic], index: Mapping[str, int]
) -> tuple[list[float], list[float]]:
    """
    Return damping and friction of the joints, including those of their mimic joints.

    A mimic joint with multiplier m moves m times as fast as its master, and the effort of the
    mimic joint acts on the master, multiplied by m. The viscous friction of a mimic joint is
    therefore multiplied by m squared, and the Coulomb friction by |m|.

    """
    damping, friction = [0.0] * len(index), [0.0] * len(index)
    for body in bodies:
        master, multiplier, _ = drives[body.joint.name]
        damping[index[master]] += multiplier * multiplier * body.joint.damping
        friction[index[master]] += abs(multiplier) * body.joint.friction
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
