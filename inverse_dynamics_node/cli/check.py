"""The command `check`: a report on a robot description."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

import numpy as np

from ..analysis.sizing import explore, payload_capacity, PayloadCapacity, Workspace
from ..errors import listed
from ..report.robot_tables import model_tables
from ..report.tables import (
    counted,
    decimals,
    effort_unit,
    fraction,
    number,
    percent,
    table,
    warnings_about,
    warnings_as_text,
    WIDTH,
)
from ..robot.kinematics import last_link
from ..robot.model import Floats, ModelWarning, RobotModel
from . import arguments
from .console import print_json, progress, say, show

EPILOG = """\
examples:
  inverse_dynamics check my_arm.urdf
  inverse_dynamics check my_arm.urdf --link tool0
  inverse_dynamics check wall_mounted.urdf --gravity 9.81 0 0
  xacro my_arm.urdf.xacro | inverse_dynamics check - --strict > report.txt

The search for the largest gravity effort of each joint starts from random poses in the ranges of
all joints (at most one turn per joint). The payload is a point mass at the origin of --link, and
the robot holds it at rest. Moving the payload takes larger efforts: see `inverse_dynamics effort`.

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
    arguments.add_json(parser)
    arguments.add_strict(parser, 'there are warnings')
    return parser


def run(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    dynamics = arguments.load_dynamics(options.urdf, options.gravity)
    robot = dynamics.robot
    warnings = warnings_about(robot)
    tables = model_tables(dynamics)
    result: dict[str, Any] = {'robot': robot.name}
    if robot.joint_names:
        with progress('computing poses'):
            workspace = explore(dynamics)
            payload = payload_capacity(dynamics, workspace, options.link or last_link(robot))
        warnings += _beyond_limits(workspace)
        tables.append(_workspace_table(workspace, payload))
        text = _verdict(workspace, payload)
        result |= _as_json(workspace, payload)
    else:
        text = 'No joint can move.'
    usable = f'with {counted(len(warnings), "warning")}' if warnings else 'no warnings'
    if options.json:
        found = [asdict(warning) for warning in warnings]
        print_json({**result, 'verdict': f'Usable, {usable}. {text}', 'warnings': found})
    else:
        say(f'Usable, {usable}. {text}')
        print()
        show(*tables, *([warnings_as_text(warnings)] if warnings else []))
    return arguments.strict_code(options, warnings)


def _as_json(workspace: Workspace, payload: PayloadCapacity) -> dict[str, Any]:
    rows = (workspace.worst, workspace.robot.effort_limits, workspace.poses)
    names = ('effort', 'limit', 'pose')
    return {
        'worst': {
            joint: dict(zip(names, values, strict=True))
            for joint, *values in zip(workspace.robot.joint_names, *rows, strict=True)
        },
        'payload': {name: getattr(payload, name) for name in ('link', 'mass', 'joint', 'pose')},
    }


def _verdict(workspace: Workspace, payload: PayloadCapacity) -> str:
    """Summarize the gravity efforts and the payload capacity."""
    robot, ratios = workspace.robot, workspace.ratios
    if not np.isfinite(robot.effort_limits).any():
        return 'No joint has an effort limit.'
    most = float(ratios.max())
    # all joints with nearly the largest ratio
    top = [name for name, x in zip(robot.joint_names, ratios, strict=True) if x > most - 0.005]
    text = f'Gravity takes at most {percent(most)} of an effort limit ({listed(top)}).'
    if most > 1.0:
        return f'{text} In some poses, the robot cannot hold itself.'
    if payload.joint is None:
        loads = 'only joints without effort limits' if payload.loads_joints else 'no joint'
        return f"{text} A payload at link '{payload.link}' loads {loads}."
    return f"{text} Largest payload at link '{payload.link}': {payload.mass:.3g} kg."


def _workspace_table(workspace: Workspace, payload: PayloadCapacity) -> str:
    """Return a table of gravity efforts, worst poses and the payload capacity."""
    robot = workspace.robot
    places = decimals(workspace.worst)
    rows = [
        (
            name,
            f'{round(worst, places) + 0.0:.{places}f} {effort_unit(robot, i)}',
            number(limit),
            fraction(worst, limit),
            'beyond its limit' if abs(worst) > limit else '',
            ' '.join(f'{round(x, 2) + 0.0:g}' for x in workspace.poses[i].tolist()),
        )
        for i, (name, worst, limit) in enumerate(
            zip(robot.joint_names, workspace.worst.tolist(), robot.effort_limits, strict=True)
        )
    ]
    columns = ('joint', 'worst', 'limit', 'ratio', '', 'worst pose [rad, m]')
    hardest = workspace.hardest
    notes = (
        f'Worst pose for {robot.joint_names[hardest]}: '
        f'{_pose_in_words(robot, workspace.poses[hardest])}.',
        _payload_in_words(robot, payload),
    )
    title, words = 'Efforts that hold the robot, in the worst pose of each joint', (4, 5)
    text = table(title, columns, rows, notes, words)
    if max(map(len, text.splitlines())) <= WIDTH:
        return text
    return table(title, columns[:-1], [row[:-1] for row in rows], notes, words)


def _payload_in_words(robot: RobotModel, payload: PayloadCapacity) -> str:
    """Describe the largest payload that the robot can hold, and the limiting joint."""
    where = f"at the origin of link '{payload.link}'"
    if payload.joint is None:
        no_limit = 'no loaded joint has an effort limit'
        reason = no_limit if payload.loads_joints else 'it loads no joint'
        return f'Largest payload {where}: unlimited, because {reason}.'
    at = f'{payload.joint} reaches its limit first (pose: {_pose_in_words(robot, payload.pose)})'
    if payload.mass == 0.0:
        return f'Largest payload {where}: none, because gravity alone exceeds a limit; {at}.'
    return f'In every pose, the robot can hold up to {payload.mass:.3g} kg {where}; {at}.'


def _pose_in_words(robot: RobotModel, pose: Floats) -> str:
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


def _beyond_limits(workspace: Workspace) -> tuple[ModelWarning, ...]:
    """Return warnings about joints that cannot hold the robot in some poses."""
    hint = (
        'check the masses and the limit; if they are right, the arm falls in such poses unless '
        'springs hold the arm'
    )
    return tuple(
        ModelWarning(
            f'gravity takes {percent(ratio)} of the effort limit in the worst pose',
            hint,
            f"joint '{name}'",
        )
        for name, ratio in zip(workspace.robot.joint_names, workspace.ratios, strict=True)
        if ratio > 1.0
    )
