"""The command `check`: a report on a robot description."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from ..analysis.sizing import explore, payload_capacity, PayloadCapacity, SAMPLES, Workspace
from ..errors import listed
from ..report.robot_tables import model_tables
from ..report.tables import (
    counted,
    decimals,
    effort_unit,
    fraction,
    number,
    table,
    warnings_about,
    warnings_as_text,
    WIDTH,
)
from ..robot.kinematics import last_link
from ..robot.model import Floats, ModelWarning, RobotModel
from . import arguments
from .console import check_outputs, progress, say, show
from .pictures.robot import draw_workspace
from .pictures.style import write_picture

EPILOG = """\
examples:
  inverse_dynamics check my_arm.urdf
  inverse_dynamics check my_arm.urdf --link tool0 --picture arm.png
  inverse_dynamics check wall_mounted.urdf --gravity 9.81 0 0
  xacro my_arm.urdf.xacro | inverse_dynamics check - --strict > report.txt

The command samples poses over the ranges of all joints (at most one turn per joint). From the
samples with the largest gravity efforts, a local search finds poses with even larger efforts. The
payload is a point mass at the origin of --link, and the robot holds it at rest. Moving the payload
takes larger efforts: see `inverse_dynamics effort`.

exit code: 0 the description can be used; 1 it cannot be used; 2 invalid arguments; 3 there are
warnings, and --strict was given."""

_MOST_JOINTS = 8  # largest number of joints in the text of a pose


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = arguments.new_parser(
        'check',
        'Report on a robot description. The command prints a verdict, the tree of joints with '
        'masses and limits, the gravity efforts over the workspace, the payload that the effort '
        'limits allow, and warnings with hints.',
        EPILOG,
    )
    arguments.add_urdf(parser)
    arguments.add_link(parser)
    arguments.add_gravity(parser)
    arguments.add_picture(parser)
    parser.add_argument(
        '--samples',
        type=_sample_count,
        default=SAMPLES,
        metavar='N',
        help='number of sampled poses, rounded up to a power of two (default: %(default)s)',
    )
    arguments.add_force(parser)
    arguments.add_strict(parser, 'there are warnings')
    return parser


def _sample_count(text: str) -> int:
    if not text.isdecimal() or not 2 <= int(text) <= 2**20:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 2 to {2**20}")
    return int(text)


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    check_outputs([options.urdf], {'--picture': options.picture}, options.force)
    dynamics = arguments.load_dynamics(options.urdf, options.gravity)
    robot = dynamics.robot
    warnings = warnings_about(robot)
    if not robot.joint_names:
        _show(f'{_usable(warnings)} No joint can move.', model_tables(dynamics), warnings)
        return arguments.strict_code(options, warnings)
    link = options.link or last_link(robot)
    with progress('computing poses') as report:
        workspace = explore(dynamics, options.samples, progress=report)
        payload = payload_capacity(dynamics, workspace, link)
    warnings += beyond_limits(workspace)
    tables = [*model_tables(dynamics), workspace_table(workspace, payload)]
    _show(f'{_usable(warnings)} {verdict(workspace, payload)}', tables, warnings)
    if options.picture:
        drawing = partial(draw_workspace, workspace, payload, options.urdf.name)
        write_picture(drawing, options.picture)
        print(f'written: {options.picture}')
    return arguments.strict_code(options, warnings)


def _show(text: str, tables: Iterable[str], warnings: Sequence[ModelWarning]) -> None:
    say(text)
    print()
    show(*tables)
    if warnings:
        show(warnings_as_text(warnings))


def _usable(warnings: Sequence[ModelWarning]) -> str:
    count = f'with {counted(len(warnings), "warning")}' if warnings else 'no warnings'
    return f'Usable, {count}.'


def verdict(workspace: Workspace, payload: PayloadCapacity) -> str:
    """Summarize the gravity efforts and the payload capacity."""
    ratios = workspace.peaks / workspace.limits  # 0 without a limit
    if not np.isfinite(workspace.limits).any():
        return 'No joint has an effort limit.'
    # all joints with nearly the largest ratio
    names = workspace.robot.joint_names
    top = [name for name, x in zip(names, ratios, strict=True) if x > ratios.max() - 0.005]
    text = f'Gravity takes at most {ratios.max():.0%} of an effort limit ({listed(top)}).'
    if ratios.max() > 1.0:
        return f'{text} In some poses, the robot cannot hold itself.'
    if payload.joint is None:
        return (
            f"{text} A payload at link '{payload.link}' loads only joints without effort limits."
        )
    return f"{text} Largest payload at link '{payload.link}': {payload.mass:.3g} kg."


def workspace_table(workspace: Workspace, payload: PayloadCapacity) -> str:
    """Return a table of gravity efforts, worst poses and the payload capacity."""
    robot, limits = workspace.robot, workspace.limits
    places = decimals(workspace.efforts)
    rows: list[tuple[str, ...]] = []
    for i, name in enumerate(robot.joint_names):
        efforts = workspace.efforts[:, i]
        worst = float(efforts[workspace.worst[i]])
        median = np.median(np.abs(efforts[workspace.sampled]))
        rows.append(
            (
                name,
                f'{round(worst, places) + 0.0:.{places}f} {effort_unit(robot, i)}',
                f'{median:.{places}f}',
                number(limits[i]),
                fraction(worst, limits[i]),
                'beyond its limit' if abs(worst) > limits[i] else '',
                _short_pose(workspace.poses[workspace.worst[i]]),
            )
        )
    columns = ['joint', 'worst', 'median', 'limit', 'ratio', '', 'worst pose [rad, m]']
    hardest = workspace.hardest
    worst_pose = workspace.poses[workspace.worst[hardest]]
    notes: tuple[str, ...] = (
        f'Worst pose for {robot.joint_names[hardest]}: {pose_in_words(robot, worst_pose)}.',
        payload_in_words(robot, payload),
    )
    if workspace.is_search_shortened:
        notes += (
            'With this many joints, the search for the worst poses is shortened, so other poses '
            'may take more effort.',
        )
    widths = [max(map(len, column)) for column in zip(columns, *rows, strict=True)]
    if sum(width + 2 for width in widths if width) > WIDTH:
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    count = len(workspace.poses) - len(rows)
    title = f'Efforts that hold the robot, in {count} sampled poses and the worst poses near them'
    return table(title, columns, rows, notes, [5, 6])


def payload_in_words(robot: RobotModel, payload: PayloadCapacity) -> str:
    """Describe the largest payload that the robot can hold, and the limiting joint."""
    where = f"at the origin of link '{payload.link}'"
    if payload.joint is None:
        return f'Largest payload {where}: unlimited, because no loaded joint has an effort limit.'
    at = f'{payload.joint} reaches its limit first (pose: {pose_in_words(robot, payload.pose)})'
    if payload.mass == 0.0:
        return f'Largest payload {where}: none, because gravity alone exceeds a limit; {at}.'
    return f'In every pose, the robot can hold up to {payload.mass:.3g} kg {where}; {at}.'


def pose_in_words(robot: RobotModel, pose: Floats) -> str:
    """List the joint positions that are farthest from zero."""
    units = ['m' if slide else 'rad' for slide in robot.is_prismatic_joint]
    away = [i for i in np.argsort(-np.abs(pose)) if abs(pose[i]) >= 5e-4]
    shown = [
        f'{robot.joint_names[i]} {pose[i]:.3f} {units[i]}' for i in sorted(away[:_MOST_JOINTS])
    ]
    if not shown:
        return 'all joints 0'
    rest = len(away) - len(shown)
    return ', '.join(shown) + (f', {rest} more not listed' if rest else '') + ', the others 0'


def beyond_limits(workspace: Workspace) -> tuple[ModelWarning, ...]:
    """Return warnings about joints that cannot hold the robot in some poses."""
    hint = (
        'check the masses and the limit; if they are right, the arm falls in such poses unless '
        'springs hold the arm'
    )
    return tuple(
        ModelWarning(
            f'gravity takes {peak / limit:.0%} of the effort limit in the worst pose',
            hint,
            f"joint '{name}'",
        )
        for name, peak, limit in zip(
            workspace.robot.joint_names, workspace.peaks, workspace.limits, strict=True
        )
        if peak > limit
    )


def _short_pose(pose: Floats) -> str:
    return ' '.join(f'{round(float(x), 2) + 0.0:g}' for x in pose)
