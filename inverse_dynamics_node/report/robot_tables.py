"""Describes a robot: masses, tree, limits, command order, gravity efforts and warnings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import ConfigurationError
from ..robot.model import Floats, Integers, RobotModel
from .tables import (
    decimals,
    effort_unit,
    fraction,
    number,
    table,
    warnings_about,
    warnings_as_text,
    wrapped,
)


def model_tables(
    dynamics: InverseDynamics,
    joints: Sequence[str] = (),
    q: ArrayLike | None = None,
    effort_limits: ArrayLike | None = None,
) -> list[str]:
    """
    Return tables of the masses, joints and limits of a robot.

    `joints` are the commanded joints in the order of the commands, by default all joints. If
    positions `q` of all joints [rad or m] are given, a table shows the gravity efforts in this
    pose. `effort_limits` are the limits of the commanded joints [N m or N], by default the limits
    of the URDF. Raise ConfigurationError if a joint does not exist or the number of limits is
    wrong. Raise JointStateError if q has a wrong shape or is not finite.
    """
    robot = dynamics.robot
    commanded = tuple(joints) or robot.joint_names
    limits = _limits(robot, commanded, effort_limits)
    tables = [_summary(dynamics), _tree(robot, limits), *_merged(robot)]
    if joints:
        tables.append(_order(robot, commanded))
    if q is not None:
        tables.append(_at_rest(dynamics, np.asarray(q, dtype=np.float64), limits))
    return tables


def model_report(
    dynamics: InverseDynamics,
    joints: Sequence[str] = (),
    q: ArrayLike | None = None,
    effort_limits: ArrayLike | None = None,
) -> str:
    """Return `model_tables` and the warnings as text."""
    tables = model_tables(dynamics, joints, q, effort_limits)
    warnings = warnings_about(dynamics.robot)
    return '\n\n'.join([*tables, warnings_as_text(warnings)])


def _summary(dynamics: InverseDynamics) -> str:
    robot = dynamics.robot
    kinds = Counter(_kind(robot, body) for body in range(1, len(robot.parent)))
    moving, count = float(np.sum(robot.mass[1:])), len(robot.joint_names)
    listed = ', '.join(f'{number} {kind}' for kind, number in kinds.items())
    mimics = len(robot.parent) - 1 - count
    follow = 'mimics' if mimics == 1 else 'mimic'
    followers = f'; {mimics} of these joints {follow} another joint' if mimics else ''
    has_friction = int(np.count_nonzero(robot.damping + robot.friction))
    massless = [
        name
        for name, mass, body in zip(
            robot.link_names, robot.link_mass, robot.link_body, strict=True
        )
        if mass == 0.0 and body > 0
    ]
    notes = [
        f'total mass {np.sum(robot.mass):.4g} kg, moving mass {moving:.4g} kg; '
        f'{len(robot.link_names)} links in {len(robot.parent)} rigid bodies; joints: '
        f'{listed or "none"}{followers}',
        f'gravity: {" ".join(f"{g:g}" for g in dynamics.gravity)} m/s^2 in the frame of '
        f"'{robot.body_names[0]}'; the URDF has friction for {has_friction} of {count} joints",
    ]
    if massless:
        notes.append(
            'moving links without mass (correct for links that are only frames): '
            + ', '.join(massless)
        )
    return table(f"robot '{robot.name}'", notes=notes)


def _tree(robot: RobotModel, limits: Floats) -> str:
    columns = ('joint', 'kind', 'axis', 'from', 'to', 'speed', 'effort', 'mass [kg]')
    prefixes = _branches(robot.parent)
    rows: list[tuple[str, ...]] = [
        (robot.body_names[0], 'base', '', '', '', '', '', f'{robot.mass[0]:.4g}')
    ]
    followers: dict[str, list[str]] = {}
    notes = [
        'Axis: in the frame of the joint. Limits: position "from" and "to" [rad, m], speed '
        '[rad/s, m/s] and effort [N m, N]; "-" means no limit. Mass: the link that this joint '
        'moves, and links fixed to it.'
    ]
    for body in range(1, len(robot.parent)):
        name, joint = robot.body_names[body], int(robot.joint_index[body])
        of_joint: tuple[str, ...] = ('', '', '', '')
        if name == robot.joint_names[joint]:
            ends = robot.lower[joint], robot.upper[joint]
            of_joint = (*map(number, ends), number(robot.velocity_limits[joint]),
                        number(limits[joint]))  # fmt: skip
        else:
            rule = f'{name} ({robot.multiplier[body]:g} q {robot.offset[body]:+g})'
            followers.setdefault(robot.joint_names[joint], []).append(rule.replace(' +0)', ')'))
        kind, axis = _kind(robot, body), _axis(robot.axis[body])
        rows.append((prefixes[body] + name, kind, axis, *of_joint, f'{robot.mass[body]:.4g}'))
    notes += [
        f'The effort of {master} includes the efforts of the joints that mimic its position q: '
        + ', '.join(rules)
        for master, rules in followers.items()
    ]
    title = 'Joints, from the base outwards'
    return table(title, columns, rows, notes, [1, 2])


def _merged(robot: RobotModel) -> list[str]:
    """List the links that fixed joints hold together, with their masses."""
    rows = []
    for body, name in enumerate(robot.body_names):
        members = [int(k) for k in np.flatnonzero(robot.link_body == body)]
        if len(members) < 2:
            continue
        listed = ', '.join(
            f'{robot.link_names[k]} {robot.link_mass[k]:.4g}' if robot.link_mass[k] else
            robot.link_names[k] for k in members
        )  # fmt: skip
        lines = wrapped(listed, 62)
        rows += [(name if i == 0 else '', line) for i, line in enumerate(lines)]
    if not rows:
        return []
    columns = ('moves with', 'links, with their masses [kg] unless zero')
    title = 'Links that fixed joints hold together'
    return [table(title, columns, rows, words=[1])]


def _order(robot: RobotModel, commanded: Sequence[str]) -> str:
    index = {name: i for i, name in enumerate(robot.joint_names)}
    rows = tuple((str(k), name, str(index[name])) for k, name in enumerate(commanded))
    rest = [name for name in robot.joint_names if name not in commanded]
    notes = (f'not commanded, but taken into account: {", ".join(rest)}',) if rest else ()
    columns = ('command', 'joint', 'index in the URDF')
    return table('Order of the commands', columns, rows, notes, [1])


def _at_rest(dynamics: InverseDynamics, q: Floats, limits: Floats) -> str:
    robot = dynamics.robot
    efforts = dynamics.gravity_efforts(q)
    places, rows = decimals(efforts), []
    efforts = np.round(efforts, places) + 0.0  # avoids -0.0
    for i, name in enumerate(robot.joint_names):
        marks = []
        if not robot.lower[i] <= q[i] <= robot.upper[i]:
            marks.append('outside its range')
        if abs(efforts[i]) > limits[i]:
            marks.append('beyond its limit')
        unit = effort_unit(robot, i)
        rows.append((name, f'{q[i]:.4f}', f'{efforts[i]:.{places}f} {unit}', number(limits[i]),
                     fraction(efforts[i], limits[i]), ', '.join(marks)))  # fmt: skip
    columns = ('joint', 'position', 'gravity effort', 'limit', 'ratio', '')
    title = 'Efforts that hold the robot in this pose'
    return table(title, columns, rows, (), [5])


def _limits(
    robot: RobotModel, commanded: Sequence[str], effort_limits: ArrayLike | None
) -> Floats:
    """Return the effort limits of all joints, with `effort_limits` for the commanded joints."""
    indices = robot.joint_indices(commanded)
    limits: Floats = robot.effort_limits.copy()
    if effort_limits is not None:
        given = np.asarray(effort_limits, dtype=np.float64)
        if given.shape != (len(commanded),):
            raise ConfigurationError(
                f'effort_limits have shape {given.shape}, expected ({len(commanded)},)'
            )
        limits[indices] = given
    return limits


def _kind(robot: RobotModel, body: int) -> str:
    """Return the kind of the joint that moves a body."""
    if robot.is_prismatic[body]:
        return 'prismatic'
    return 'continuous' if robot.is_continuous[robot.joint_index[body]] else 'revolute'


def _axis(axis: Floats) -> str:
    for direction, letter in zip(np.eye(3), 'xyz', strict=True):
        for sign, mark in ((1.0, ''), (-1.0, '-')):
            if np.allclose(axis, sign * direction, atol=1e-3):
                return mark + letter
    return ' '.join(f'{x:.2f}'.removesuffix('.00') for x in axis + 0.0)


def _branches(parent: Integers) -> list[str]:
    """Return the characters that draw a tree in front of the names. Chains are not indented."""
    children: list[list[int]] = [[] for _ in parent]
    for body in range(1, len(parent)):
        children[int(parent[body])].append(body)
    first = [''] * len(parent)  # tree lines in front of the name of each body
    below = [''] * len(parent)  # tree lines in front of the names of all descendants
    for body, group in enumerate(children):
        for child in group:
            is_last = child == group[-1]
            alone = len(group) == 1
            first[child] = below[body] + ('' if alone else '└ ' if is_last else '├ ')
            below[child] = below[body] + ('' if alone else '  ' if is_last else '│ ')
    return first
