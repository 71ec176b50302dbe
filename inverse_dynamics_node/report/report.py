"""
What the robot is, as tables: masses, tree, limits, order of the commands, efforts at rest.

The tables hold words and numbers already written out, so that every reader gets the same: plain
text for logs and services, colours for a terminal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import math
import textwrap
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..dynamics.inverse_dynamics import InverseDynamics
from ..errors import ConfigurationError
from ..robot.model import Floats, Integers, RobotModel
from ..robot.plausibility import describe_implausible_position, implausible_positions
from .advice import advise, Concern

WIDTH = 100
"""Columns of text that a report stays within."""
_SHORTEST_NAME = 12
_FAR_BEYOND = 50.0
"""Effort limits of so many times the moment of the robot's weight are placeholders."""
_FEWEST_EQUAL, _SHARE_EQUAL = 3, 0.8
_ROUND_LIMITS = (100.0, 1000.0, 10000.0, 100000.0)
"""Effort limits [N m] that exporters write; equal for shoulder and wrist, they are not real."""
_GAP = '  '


class Table(NamedTuple):
    """Some rows under a title, with remarks below; a table without rows is its remarks."""

    title: str
    columns: tuple[str, ...] = ()
    """The first of them is for names, and may be cut short."""
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()
    words: frozenset[int] = frozenset()
    """Which columns but the first hold words, and are flushed left."""


def model_report(
    dynamics: InverseDynamics,
    joints: Sequence[str] = (),
    q: ArrayLike | None = None,
    effort_limits: ArrayLike | None = None,
) -> str:
    """
    Describe the robot in plain text, at most 100 columns wide.

    Parameters
    ----------
    dynamics, joints, q, effort_limits
        As for `model_tables`.

    Returns
    -------
    text : str
        Several lines, the last without an end.

    Raises
    ------
    ConfigurationError, JointStateError
        As for `model_tables`.

    """
    tables = model_tables(dynamics, joints, q, effort_limits)
    concerns = concerns_of(dynamics.robot)
    return '\n\n'.join([*map(as_text, tables), concerns_as_text(concerns)])


def model_tables(
    dynamics: InverseDynamics,
    joints: Sequence[str] = (),
    q: ArrayLike | None = None,
    effort_limits: ArrayLike | None = None,
) -> list[Table]:
    """
    Describe the robot.

    Parameters
    ----------
    dynamics : InverseDynamics
        The robot, with n joints, and what acts on it.
    joints : sequence of str
        The m joints to command, in the order of the commands; empty for all, in the robot's order.
    q : array_like, shape (n,), optional
        Where the robot is [rad or m]: the efforts that hold it there are told.
    effort_limits : array_like, shape (m,), optional
        Largest efforts of the commanded joints [N m or N]; without them, those of the URDF.

    Returns
    -------
    tables : list of Table

    Raises
    ------
    ConfigurationError
        If a joint cannot be commanded, or the limits are not one number for each.
    JointStateError
        If q does not fit the robot, or is not finite.

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


def concerns_of(robot: RobotModel) -> tuple[Concern, ...]:
    """Return what looks wrong, and what to do about it."""
    concerns = advise(robot.warnings)
    zero = 'limit effort is 0'  # told by the loader, with the line
    told = {
        name
        for name in robot.joint_names
        for text in robot.warnings
        if zero in text and f"'{name}'" in text
    }
    unlimited = tuple(
        f"joint '{name}': no effort limit"
        for name, limit in zip(robot.joint_names, robot.effort_limits, strict=True)
        if math.isinf(limit) and name not in told
    )
    if unlimited:
        advice = 'write <limit effort="..."/>, or give the node effort_limits'
        concerns += (Concern(advice, unlimited),)
    unlikely = _unlikely_limits(robot)
    if unlikely:
        advice = 'write the effort that the joint can give, from the data sheet of its drive'
        concerns += (Concern(advice, unlikely),)
    return concerns


def _unlikely_limits(robot: RobotModel) -> tuple[str, ...]:
    """
    Describe effort limits that look like placeholders.

    The measure is the moment of the weight of all moving parts at the farthest reach of the robot.
    Wrists turn far less than that, but they are not built for much more. Forces are not judged:
    the fingers of a gripper press with many times their weight.

    """
    turns = ~np.array(slides(robot), dtype=bool)
    limits = robot.effort_limits
    rated = limits[turns & np.isfinite(limits)]
    if not rated.size:
        return ()
    most = _moment_of_weight(robot)
    common, count = Counter(rated.tolist()).most_common(1)[0]
    if common in _ROUND_LIMITS and count >= max(_FEWEST_EQUAL, _SHARE_EQUAL * rated.size):
        return (
            f'{count} of {rated.size} effort limits of turning joints are {number(common)} N m: '
            'looks like a placeholder',
        )
    return tuple(
        f"joint '{name}': effort limit {number(limit)} N m, but the whole robot, stretched out, "
        f'takes at most {most:.3g} N m: looks like a placeholder'
        for name, limit, is_turning in zip(robot.joint_names, limits, turns, strict=True)
        if is_turning and most > 0.0 and _FAR_BEYOND * most < limit < math.inf
    )


def _moment_of_weight(robot: RobotModel) -> float:
    """Return an upper bound of the gravity efforts, on Earth [N m]."""
    reach = np.zeros(len(robot.parent))
    for body in range(1, len(robot.parent)):
        joint = int(robot.joint_index[body])
        ends = np.abs([robot.lower[joint], robot.upper[joint]])
        travel = np.max(ends[np.isfinite(ends)], initial=0.0) if robot.is_prismatic[body] else 0.0
        reach[body] = reach[robot.parent[body]] + np.linalg.norm(robot.p_PL[body]) + travel
    arms = reach + np.linalg.norm(robot.com, axis=1)
    return float(9.81 * np.sum((robot.mass * arms)[1:]))


def position_concerns(
    robot: RobotModel, positions: Floats, joint_names: Sequence[str]
) -> tuple[Concern, ...]:
    """
    Warn of positions far outside the limits, which are often in degrees.

    Parameters
    ----------
    robot : RobotModel
        With the limits.
    positions : ndarray, shape (k, m)
        Positions of m joints at k times [rad or m].
    joint_names : sequence of str
        The m joints.

    Returns
    -------
    concerns : tuple of Concern
        Empty if all positions are plausible.

    """
    found = implausible_positions(robot, positions, joint_names)
    groups = (
        ('convert the positions to radians', [each for each in found if each.looks_like_degrees]),
        (
            'check units (rad, m), zero positions and the order of the joints, and that the '
            'limits belong to this robot',
            [each for each in found if not each.looks_like_degrees],
        ),
    )
    return tuple(
        Concern(advice, tuple(describe_implausible_position(each) for each in findings))
        for advice, findings in groups
        if findings
    )


# ---- The tables ----------------------------------------------------------------------------


def _summary(dynamics: InverseDynamics) -> Table:
    robot = dynamics.robot
    kinds = Counter(kind_of(robot, body) for body in range(1, len(robot.parent)))
    moving, count = float(np.sum(robot.mass[1:])), len(robot.joint_names)
    listed = ', '.join(f'{number} {kind}' for kind, number in kinds.items())
    mimics = len(robot.parent) - 1 - count
    followers = f', {mimics} of them following another' if mimics else ''
    has_friction = int(np.count_nonzero(robot.damping + robot.friction))
    massless = [
        name
        for name, mass, body in zip(
            robot.link_names, robot.link_mass, robot.link_body, strict=True
        )
        if mass == 0.0 and body > 0
    ]
    notes = [
        f'{np.sum(robot.mass):.4g} kg, of which {moving:.4g} kg move; {len(robot.link_names)} '
        f'links in {len(robot.parent)} rigid bodies; joints: {listed or "none"}{followers}',
        f'gravity: {" ".join(f"{g:g}" for g in dynamics.gravity)} m/s^2 in the frame of '
        f"'{robot.body_names[0]}'; friction in the URDF: of {has_friction} of {count} joints",
    ]
    if massless:
        notes.append(
            f'moving links without mass, fine where they are frames only: {", ".join(massless)}'
        )
    return Table(f"robot '{robot.name}'", notes=tuple(notes))


def _tree(robot: RobotModel, limits: Floats) -> Table:
    columns = ('joint', 'kind', 'axis', 'from', 'to', 'speed', 'effort', 'mass [kg]')
    prefixes = _branches(robot.parent)
    rows: list[tuple[str, ...]] = [
        (robot.body_names[0], 'base', '', '', '', '', '', f'{robot.mass[0]:.4g}')
    ]
    followers: dict[str, list[str]] = {}
    notes = [
        'axis: in the frame of the joint. From, to [rad, m], speed [rad/s, m/s] and effort '
        '[N m, N]: limits, - where there is none. Mass: of the links that move with the joint '
        'and no later one.'
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
        kind, axis = kind_of(robot, body), _axis(robot.axis[body])
        rows.append((prefixes[body] + name, kind, axis, *of_joint, f'{robot.mass[body]:.4g}'))
    notes += [
        f'Following the position q of {master}, their efforts part of its effort: '
        + ', '.join(rules)
        for master, rules in followers.items()
    ]
    title = 'Joints, from the base outwards'
    return Table(title, columns, tuple(rows), tuple(notes), frozenset({1, 2}))


def _merged(robot: RobotModel) -> list[Table]:
    """Tell which links fixed joints hold together, and what each of them weighs."""
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
    columns = ('moves with', 'links, with mass [kg] where they have one')
    title = 'Links that fixed joints hold together'
    return [Table(title, columns, tuple(rows), words=frozenset({1}))]


def _order(robot: RobotModel, commanded: Sequence[str]) -> Table:
    index = {name: i for i, name in enumerate(robot.joint_names)}
    rows = tuple((str(k), name, str(index[name])) for k, name in enumerate(commanded))
    rest = [name for name in robot.joint_names if name not in commanded]
    notes = (f'not commanded, but counted: {", ".join(rest)}',) if rest else ()
    columns = ('command', 'joint', 'place in the URDF')
    return Table('Order of the commands', columns, rows, notes, frozenset({1}))


def _at_rest(dynamics: InverseDynamics, q: Floats, limits: Floats) -> Table:
    robot = dynamics.robot
    efforts = dynamics.gravity_efforts(q)
    places, rows = decimals(efforts), []
    efforts = np.round(efforts, places) + 0.0  # no minus before a zero
    for i, name in enumerate(robot.joint_names):
        marks = []
        if not robot.lower[i] <= q[i] <= robot.upper[i]:
            marks.append('outside its range')
        if abs(efforts[i]) > limits[i]:
            marks.append('beyond its limit')
        unit = effort_unit(robot, i)
        rows.append((name, f'{q[i]:.4f}', f'{efforts[i]:.{places}f} {unit}', number(limits[i]),
                     share(efforts[i], limits[i]), ', '.join(marks)))  # fmt: skip
    columns = ('joint', 'position', 'gravity effort', 'limit', 'share', '')
    title = 'Efforts that hold the robot where it is'
    return Table(title, columns, tuple(rows), words=frozenset({5}))


def _limits(
    robot: RobotModel, commanded: Sequence[str], effort_limits: ArrayLike | None
) -> Floats:
    """Return the limits of all joints; those given are of the commanded ones."""
    unknown = [name for name in commanded if name not in robot.joint_names]
    if unknown:
        names = ', '.join(robot.joint_names)
        raise ConfigurationError(f"joint '{unknown[0]}' does not exist; joints are {names}")
    limits: Floats = robot.effort_limits.copy()
    if effort_limits is not None:
        given = np.asarray(effort_limits, dtype=np.float64)
        if given.shape != (len(commanded),):
            raise ConfigurationError(
                f'effort_limits have shape {given.shape}, expected ({len(commanded)},)'
            )
        limits[[robot.joint_names.index(name) for name in commanded]] = given
    return limits


# ---- Words and numbers ---------------------------------------------------------------------


def kind_of(robot: RobotModel, body: int) -> str:
    """Name the kind of the joint that moves a body."""
    if robot.is_prismatic[body]:
        return 'prismatic'
    return 'continuous' if robot.is_continuous[robot.joint_index[body]] else 'revolute'


def slides(robot: RobotModel) -> list[bool]:
    """Tell which joints slide, shape (n,)."""
    moved = robot.body_names[1:]  # the first is a link, which a joint may share its name with
    return [bool(robot.is_prismatic[1 + moved.index(name)]) for name in robot.joint_names]


def effort_unit(robot: RobotModel, joint: int) -> str:
    """Return the unit of a joint's effort, padded to one length."""
    return 'N  ' if slides(robot)[joint] else 'N m'


def number(value: float) -> str:
    """Write a limit, with a dash for none."""
    if not math.isfinite(value):
        return '-'
    return f'{value:.0f}' if 1e4 <= abs(value) < 1e7 else f'{value:.4g}'


def share(effort: float, limit: float) -> str:
    """Write how much of its limit an effort takes, with a dash where there is none."""
    return f'{abs(effort) / limit:.0%}' if math.isfinite(limit) else '-'


def decimals(values: Floats, digits: int = 4) -> int:
    """Return how many decimals give the largest of the values so many digits, 1 to 6."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if not 0.0 < largest < math.inf:
        return 1
    return min(6, max(1, digits - 1 - math.floor(math.log10(largest))))


def _axis(axis: Floats) -> str:
    for direction, letter in zip(np.eye(3), 'xyz', strict=True):
        for sign, mark in ((1.0, ''), (-1.0, '-')):
            if np.allclose(axis, sign * direction, atol=1e-3):
                return mark + letter
    return ' '.join(f'{x:.2f}'.removesuffix('.00') for x in axis + 0.0)


def _branches(parent: Integers) -> list[str]:
    """Draw the tree, indented where it branches only: a chain of 30 joints goes straight down."""
    children: list[list[int]] = [[] for _ in parent]
    for body in range(1, len(parent)):
        children[int(parent[body])].append(body)
    first = [''] * len(parent)  # before the name
    below = [''] * len(parent)  # before what comes under it
    for body, group in enumerate(children):
        for child in group:
            is_last = child == group[-1]
            alone = len(group) == 1
            first[child] = below[body] + ('' if alone else '└ ' if is_last else '├ ')
            below[child] = below[body] + ('' if alone else '  ' if is_last else '│ ')
    return first


# ---- Plain text ----------------------------------------------------------------------------


def as_text(table: Table, width: int = WIDTH, whole_names: bool = False) -> str:
    """
    Lay a table out in plain text.

    Parameters
    ----------
    table : Table
        To lay out.
    width : int
        Longest line, in characters.
    whole_names : bool
        Let rows be longer instead of shortening names: for programs that read them.

    Returns
    -------
    text : str
        Several lines, the last without an end.

    """
    lines = [table.title]
    if table.rows:
        lines += _laid_out(table, math.inf if whole_names else width - 2)
    for note in table.notes:
        lines += wrapped(note, width - 2)
    return '\n'.join([lines[0], *(f'  {line}'.rstrip() for line in lines[1:])])


def concerns_as_text(concerns: Sequence[Concern], width: int = WIDTH) -> str:
    """Lay out what looks wrong, and what to do about it, in plain text."""
    if not concerns:
        return 'No warnings.'
    count = sum(len(concern.findings) for concern in concerns)
    lines = [f'{count} warning{"s" if count > 1 else ""}']
    for concern in concerns:
        for finding in concern.findings:
            lines += wrapped(finding, width, '  ', '    ')
        lines += wrapped(concern.advice, width, '    -> ', '       ')
    return '\n'.join(lines)


def wrapped(text: str, width: int, first: str = '', rest: str = '') -> list[str]:
    """Wrap a paragraph between words; names and numbers with hyphens stay whole."""
    return textwrap.wrap(
        text,
        width,
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _laid_out(table: Table, width: float) -> list[str]:
    cells = [table.columns, *table.rows]
    widths = [max(len(row[k]) for row in cells) for k in range(len(table.columns))]
    spare = width - sum(widths[1:]) - len(_GAP) * (len(widths) - 1)
    widths[0] = int(min(widths[0], max(_SHORTEST_NAME, spare)))
    names = [shortened(table.columns[0], widths[0])]
    names += all_shortened([row[0] for row in table.rows], widths[0])
    return [
        _GAP.join(
            [name.ljust(widths[0])]
            + [
                shortened(cell, size).ljust(size) if k in table.words else cell.rjust(size)
                for k, (cell, size) in enumerate(zip(row[1:], widths[1:], strict=True), 1)
            ]
        )
        for name, row in zip(names, cells, strict=True)
    ]


def _shared(names: Sequence[str]) -> int:
    """Count the letters with which all the names begin."""
    letters = list(zip(*names, strict=False))
    return next((i for i, each in enumerate(letters) if len(set(each)) > 1), len(letters))


def all_shortened(names: Sequence[str], size: int) -> list[str]:
    """Cut names so that they can be told apart still: what all share goes first."""
    short = [shortened(name, size) for name in names]
    if len(set(short)) == len(set(names)):
        return short
    head = _shared(names)
    tail = _shared([name[head:][::-1] for name in names])
    # What is left of a long name of many is its own part.
    parts = [name[head : len(name) - tail] for name in names]
    short = [f'…{shortened(part, size - 1)}' if head else shortened(part, size) for part in parts]
    for first in (size // 3, size // 4, 2 * size // 3, 1):
        if len(set(short)) == len(set(names)):
            break
        # Names of several branches differ at both ends: keep more of one of them.
        rest = size - 1 - first
        short = [n if len(n) <= size else f'{n[:first]}…{n[len(n) - rest :]}' for n in names]
    return short


def shortened(text: str, size: int) -> str:
    """Cut a text in its middle: joints are told apart by how they begin and how they end."""
    if len(text) <= size:
        return text
    stem = text.removesuffix('_joint')
    if stem != text and size >= _SHORTEST_NAME:  # what tells nothing goes first
        return f'{shortened(stem, size - 1)}…'
    head = (size - 1) // 2
    return f'{text[:head]}…{text[len(text) - (size - 1 - head) :]}'
