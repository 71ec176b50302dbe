"""A side view of a robot in one pose: joints, what is between them, and where the masses are."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..dynamics import InverseDynamics
from ..kinematics import body_frames
from ..model import Floats, RobotModel
from ..report import shortened
from .pictures import BLUE, DARK, GREEN, GREY, ORANGE, RED

_MOST_NUMBERS = 12
"""Of joints; of more, the one of concern is numbered alone."""
_LARGEST_MASS = 260.0
"""Of a disc that shows a mass [square points]."""


def draw_arm(axes: Any, dynamics: InverseDynamics, q: Floats, joint: int, link: str) -> None:
    """
    Draw the robot as it is seen from the side that shows most of it.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        To draw in.
    dynamics : InverseDynamics
        The robot, and which way things fall: down, in the picture.
    q : ndarray, shape (n,)
        Joint positions [rad or m].
    joint : int
        The joint to point out.
    link : str
        The link to mark: where a payload is.

    """
    robot = dynamics.robot
    rotations, positions = body_frames(robot, q)
    links = positions[robot.link_body] + np.einsum(
        'kij,kj->ki', rotations[robot.link_body], robot.link_position
    )
    centres = positions + np.einsum('bij,bj->bi', rotations, robot.com)
    view = _side_view(dynamics.gravity, np.concatenate([positions, links, centres]))
    flat, flat_links, flat_centres = positions @ view, links @ view, centres @ view

    _draw_structure(axes, robot, flat, flat_links, flat_centres)
    _draw_masses(axes, robot, flat_centres)
    _draw_joints(axes, robot, flat, joint)
    mark = flat_links[robot.link_names.index(link)]
    axes.plot(*mark, 'v', color=GREEN, markersize=9, zorder=6, label=shortened(link, 22))
    _frame(axes, np.concatenate([flat, flat_links, flat_centres]))
    axes.set_xlabel('across [m]')
    axes.set_ylabel('up [m]')
    axes.set_title(f'side view, worst pose for joint {joint + 1}', fontsize=9.5)


def _frame(axes: Any, points: Floats) -> None:
    """Show all the points in a square, with the same scale along both sides."""
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    half = 0.6 * max(0.1, float(np.max(high - low)))
    middle = 0.5 * (low + high)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect('equal', adjustable='box', anchor='N')
    axes.locator_params(nbins=6)


def _side_view(gravity: Floats, points: Floats) -> Floats:
    """Return what takes points to (across, up), shape (3, 2): across is where most spread is."""
    size = float(np.linalg.norm(gravity))
    up = -gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
    spread = points - points[0]
    level = spread - np.outer(spread @ up, up)
    _, sizes, directions = np.linalg.svd(level)
    across = directions[0]
    if sizes[0] < 1e-9:  # all above each other: any level direction will do
        across = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
        across /= np.linalg.norm(across)
    if np.sum(level @ across) < 0.0:
        across = -across
    view: Floats = np.stack([across, up], axis=1)
    return view


def _draw_structure(
    axes: Any, robot: RobotModel, flat: Floats, flat_links: Floats, centres: Floats
) -> None:
    for body in range(1, len(robot.parent)):
        ends = flat[[robot.parent[body], body]]
        axes.plot(*ends.T, color=GREY, linewidth=3.5, solid_capstyle='round', zorder=2)
    for body in set(range(1, len(robot.parent))) - set(robot.parent.tolist()):
        if robot.mass[body] > 0.0:  # where it ends nobody knows; its mass is out there
            axes.plot(
                *np.array([flat[body], centres[body]]).T, color=GREY, linewidth=1.5, zorder=1
            )
    for place, body in zip(flat_links, robot.link_body, strict=True):
        axes.plot(*np.array([flat[body], place]).T, color=GREY, linewidth=1.5, zorder=1)
    axes.plot(*flat[0], 's', color=DARK, markersize=11, zorder=3, label='base')


def _draw_masses(axes: Any, robot: RobotModel, centres: Floats) -> None:
    mass = robot.mass
    if not np.any(mass > 0.0):
        return
    sizes = _LARGEST_MASS * mass / np.max(mass)
    label = f'masses, up to {np.max(mass):.3g} kg'
    axes.scatter(
        *centres.T, s=sizes, color=ORANGE, alpha=0.55, linewidths=0, zorder=4, label=label
    )
    middle = mass @ centres / np.sum(mass)
    label = f'their centre, {np.sum(mass):.3g} kg'
    axes.plot(*middle, 'x', color=DARK, markersize=9, markeredgewidth=2.2, zorder=7, label=label)


def _draw_joints(axes: Any, robot: RobotModel, flat: Floats, joint: int) -> None:
    """Draw the joints with their numbers, counted from 1; those at one place share a label."""
    many = len(robot.joint_names) > _MOST_NUMBERS
    apart = 0.07 * (float(np.max(np.ptp(flat, axis=0))) or 1.0)
    places: list[tuple[Floats, list[int]]] = []
    for body in range(1, len(robot.parent)):
        i, spot = int(robot.joint_index[body]), flat[body]
        is_concern = i == joint
        shape = 's' if robot.is_prismatic[body] else 'o'
        size = 9 if is_concern else 4 if many else 6.5
        colour = RED if is_concern else BLUE
        axes.plot(*spot, shape, color=colour, markersize=size, zorder=6 if is_concern else 5)
        if robot.body_names[body] != robot.joint_names[i] or (many and not is_concern):
            continue
        near = [numbers for place, numbers in places if np.linalg.norm(place - spot) < apart]
        if near:
            near[0].append(i + 1)
        else:
            places.append((spot, [i + 1]))
    for place, numbers in places:
        axes.annotate(', '.join(map(str, numbers)), place, xytext=(0, 12), ha='center', fontsize=9,
                      textcoords='offset points', color=DARK, zorder=8)  # fmt: skip
