"""The result of tracking: errors of every joint in motion and at rest, and the command rate."""

from __future__ import annotations

import math

import numpy as np

from ...robot.model import Floats
from .demo_setup import DemoSetup
from .history import History
from .results import MOVING_LIMIT, REST_LIMIT, ScenarioResult
from .view import name_width

RATE_LIMIT = 0.02  # relative error of the command rate
REST_FRACTION = 0.2  # of the duration; its second half is judged


def check_tracking(setup: DemoSetup, history: History, expected_rate: float) -> ScenarioResult:
    """Print the errors and the command rate, and compare them with their limits."""
    robot, duration, rate = setup.robot, setup.duration, history.command_rate()
    moving = history.largest_error(0.0, (1.0 - REST_FRACTION) * duration)
    rest = history.largest_error((1.0 - 0.5 * REST_FRACTION) * duration, math.inf)
    wide = name_width(robot)
    limits = tracking_limits(setup.slack)
    # Without friction all joints have the same limits, which the verdict states.
    head = ('moving', 'limit', 'at rest', 'limit') if setup.friction else ('moving', 'at rest')
    widths = (13, 14, 15, 15) if setup.friction else (13, 15)
    columns = ''.join(f'{word:>{width}}' for word, width in zip(head, widths, strict=True))
    print(f'\n{"largest error":{wide}}{columns}')
    rows = zip(robot.joint_names, robot.is_prismatic_joint, moving, rest, *limits, strict=True)
    for name, slide, moving_error, rest_error, moving_limit, rest_limit in rows:
        unit = 'mm' if slide else 'mrad'
        cells = [f'{1000.0 * moving_error:8.3f} {unit:4}', f'{1000.0 * rest_error:10.4f} {unit:4}']
        if setup.friction:
            cells.insert(1, f'{1000.0 * moving_limit:9.3f} {unit:4}')
            cells.append(f'{1000.0 * rest_limit:10.4f} {unit:4}')
        print(f'{name:{wide}}{"".join(cells)}')
    print(
        f'rate: {rate:.1f} of {expected_rate:.1f} commands/s ({rate / expected_rate - 1.0:+.1%})'
    )
    return ScenarioResult(
        tracking_words(setup.slack),
        tuple(find_failures(robot.joint_names, moving, rest, rate, expected_rate, setup.slack)),
    )


def tracking_limits(slack: Floats) -> tuple[Floats, Floats]:
    """
    Return the largest permitted errors in motion and at rest.

    Parameters
    ----------
    slack : ndarray, shape (n,)
        Largest position error that dry friction can sustain [rad or m].

    Returns
    -------
    moving, rest : ndarray, shape (n,)
        Limits [rad or m].

    """
    # A joint that breaks away from dry friction overshoots by as much as it was held back.
    return MOVING_LIMIT + 2.0 * slack, REST_LIMIT + slack


def tracking_words(slack: Floats) -> str:
    """Describe the limits of tracking."""
    parts = []
    for limits, when in zip(tracking_limits(slack), ('mrad (mm) moving', 'at rest'), strict=True):
        least, most = (f'{1000.0 * limit:.3g}' for limit in (limits.min(), limits.max()))
        parts.append(f'{least} {when}' if least == most else f'{least} to {most} {when}')
    words = f'every joint within {" and ".join(parts)}'
    if np.any(slack):
        words = f'{words} (its limit in the table, wider where dry friction holds it)'
    return f'{words}, rate within {RATE_LIMIT:.0%}'


def find_failures(
    joint_names: tuple[str, ...],
    moving: Floats,
    rest: Floats,
    rate: float,
    expected_rate: float,
    slack: Floats | float = 0.0,
) -> list[str]:
    """Describe every joint error beyond its limit, widened by slack, and a wrong command rate."""
    failures = []
    moving_limits, rest_limits = tracking_limits(slack + np.zeros(len(joint_names)))
    for when, errors, limits in (
        ('moving', moving, moving_limits),
        ('at rest', rest, rest_limits),
    ):
        failures += [
            f'joint {name!r} was {1000 * error:.2f} mrad or mm off {when}, limit {1000 * most:.3g}'
            for name, error, most in zip(joint_names, errors, limits, strict=True)
            if not error <= most  # NaN, without a measurement, is a failure
        ]
    if not abs(rate / expected_rate - 1.0) <= RATE_LIMIT:
        cause = (
            'another node publishes commands too, or the robot caught up after a pause'
            if rate > expected_rate
            else f'this machine is busy, or too slow for --rate {expected_rate:g}'
        )
        failures.append(
            f'{rate:.1f} commands/s received, '
            f'expected {expected_rate:.1f} +- {RATE_LIMIT:.0%}: {cause}'
        )
    return failures
