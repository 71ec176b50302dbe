"""Judges the runs of the demo."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from ...robot.model import Floats
from .commander import History
from .demo_setup import DemoSetup
from .view import name_width

MOVING_LIMIT, REST_LIMIT = 0.010, 0.001  # [rad or m]
HARMLESS = 0.05  # [s]: longest gap between commands that does not affect the verdict
SETTLED = 1.5  # [s]: settling time after a change
STOPPED = 1.0  # [s]: efforts must be zero after this time without joint states
LEAST_FACTOR = 5.0  # smallest improvement by a known load, an IMU or a calibration
CONTACT_LIMIT = 0.05  # largest error of an estimated push, relative to the largest effort
RATE_LIMIT = 0.02  # largest relative error of the command rate
REST_FRACTION = 0.2  # final fraction of a `track` run in which the arm rests


@dataclass(frozen=True)
class ScenarioResult:
    """The outcome of a run."""

    words: str
    """Sentence to print if the run passed."""
    failures: tuple[str, ...] = ()
    """Reasons why the run failed; empty if the run passed."""
    excuse: str = ''
    """Cause of the failures, if it is known and lies outside the node."""

    def __str__(self) -> str:
        if self.failures:
            lines = [f'FAILED: {failure}' for failure in self.failures]
            return '\n'.join([*lines, self.excuse] if self.excuse else lines)
        return f'PASSED: {self.words}'


class Distance(NamedTuple):
    """The largest of the joints' position errors."""

    value: float
    """Error [rad or m]; NaN if nothing was measured."""
    words: str
    """Error as a string, in mrad or mm."""

    def within(self, limit: float, when: str) -> tuple[bool, str]:
        """Return a check for `result_of` that passes if the error does not exceed a limit."""
        return self.value <= limit, f'a joint was off by {self.words} {when}'


def worst(setup: DemoSetup, errors: Floats) -> Distance:
    """Return the largest of the joints' position errors; ``errors`` has shape (n,) [rad or m]."""
    i = int(np.argmax(errors))  # argmax prefers NaN
    unit = 'mm' if setup.robot.is_prismatic_joint[i] else 'mrad'
    # Errors below 0.001 mrad or mm are printed as 0.001.
    return Distance(float(errors[i]), f'{max(1000.0 * float(errors[i]), 0.001):.3g} {unit}')


def result_of(words: str, *checks: tuple[bool, str]) -> ScenarioResult:
    """Return a result; each check consists of a flag for success and a failure message."""
    return ScenarioResult(words, tuple(failure for passed, failure in checks if not passed))


def excuse(history: History) -> str:
    """Return a sentence about the longest gap between commands, or '' if the gap is harmless."""
    waited = float(np.max(np.diff(history.commands.times), initial=0.0))
    if waited <= HARMLESS:
        return ''
    return (
        f'The machine was busy: no command came for {1000.0 * waited:.0f} ms, too long for any '
        'control loop. Close other programs, or reduce the rate: --rate 200.'
    )


def moving_limit(setup: DemoSetup) -> float:
    """Return the largest permitted position error in motion [rad or m]."""
    return MOVING_LIMIT + float(np.max(setup.slack))


def rest_limit(setup: DemoSetup) -> float:
    """Return the largest permitted position error at rest [rad or m]."""
    return REST_LIMIT + float(np.max(setup.slack))


def check_hold(setup: DemoSetup, history: History) -> ScenarioResult:
    """Judge gravity compensation: the arm must not move."""
    moved = worst(setup, history.largest_error(0.0, np.inf))
    return result_of(
        f'no joint moved by more than {moved.words}',
        (moved.value <= rest_limit(setup), f'a joint moved by {moved.words}'),
    )


def check_payload(
    setup: DemoSetup, history: History, picked_up: float, sent: float
) -> ScenarioResult:
    """Judge a run with a load: the error must vanish once the node knows the load."""
    before = worst(setup, history.largest_error(0.0, picked_up))
    unknown = worst(setup, history.largest_error(picked_up, sent))
    known = worst(setup, history.largest_error(sent + SETTLED, np.inf))
    factor = unknown.value / known.value
    return result_of(
        f'the unknown load deflected a joint by {unknown.words}; once the node knew the load, all '
        f'joints stayed within {known.words}: {factor:.0f} times better',
        before.within(moving_limit(setup), 'before the load was picked up'),
        known.within(moving_limit(setup), 'although the node knew the load'),
        (
            factor >= LEAST_FACTOR,
            f'the error fell from {unknown.words} to {known.words} once the node knew the load: '
            f'{factor:.1f} times better, expected at least {LEAST_FACTOR:g}',
        ),
    )


def check_push(
    setup: DemoSetup, history: History, link: str, force: Floats, began: float, ended: float
) -> ScenarioResult:
    """Judge a push: external efforts must be zero before the push, and -J^T F during it."""
    window = began + SETTLED, ended
    rows, states = history.external.between(*window), history.states.between(*window)
    if not len(rows) or not len(states):
        return ScenarioResult('', ('the node published no external efforts during the push',))
    found = np.mean(rows, axis=0)
    expected = setup.external_efforts(link, force, np.mean(states[:, 0], axis=0))
    size = float(np.max(np.abs(expected)))
    off = float(np.nanmax(np.abs(found - expected))) / size
    quiet = history.external.between(0.0, began)
    noise = float(np.nanmax(np.abs(quiet), initial=0.0)) / size
    given = worst(setup, history.largest_error(began, ended))
    after = worst(setup, history.largest_error(ended + SETTLED, np.inf))
    return result_of(
        f'{np.linalg.norm(force):.3g} N at {link!r} moved a joint by {given.words}, and the node '
        f'estimated the external efforts (up to {size:.3g} N m or N) to within '
        f'{max(100.0 * off, 0.01):.2g} %',
        (
            off <= CONTACT_LIMIT,
            f'the estimated external efforts are {off:.1%} off, limit {CONTACT_LIMIT:.0%}',
        ),
        (
            noise <= CONTACT_LIMIT,
            f'before the push, the external efforts reached {noise:.1%} of those due to the push',
        ),
        after.within(rest_limit(setup), 'after the push'),
    )


def check_tilt(
    setup: DemoSetup, history: History, settled: float, without: tuple[Floats, Floats]
) -> ScenarioResult:
    """Judge a run with a tilting base: the arm must not move."""
    moved = worst(setup, history.largest_error(0.0, np.inf))
    rest = worst(setup, history.largest_error(settled, np.inf))
    lesser = worst(setup, np.max(np.abs(without[1]), axis=0))
    return result_of(
        f'all joints stayed within {moved.words} while the base tilted, and within {rest.words} '
        f'at rest; without the IMU, the error would have been {lesser.words}',
        moved.within(moving_limit(setup), 'while the base tilted'),
        rest.within(rest_limit(setup), 'on the tilted base'),
        (
            lesser.value >= LEAST_FACTOR * moved.value,
            f'without the IMU, the error would have been only {lesser.words}, expected at least '
            f'{LEAST_FACTOR:g} times {moved.words}',
        ),
    )


def check_sensor_lost(
    setup: DemoSetup, history: History, lost: float, back: float
) -> ScenarioResult:
    """Judge the response to lost joint states: efforts must become zero, and brakes must hold."""
    # The window ends early, because stamps may lag behind the clock of the machine.
    commands = np.abs(history.commands.between(lost + STOPPED, back - 0.1))
    left = float(np.max(commands, initial=0.0))
    before = float(np.max(np.abs(history.commands.between(0.0, lost)), initial=0.0))
    times, rows = history.commands.times, history.commands.rows
    is_zero = (times > lost) & (np.max(np.abs(rows), axis=1, initial=0.0) == 0.0)
    zero_after = float(times[is_zero][0]) - lost if is_zero.any() else np.nan
    brakes = [bool(on) for on in history.brakes.rows]
    moved = worst(setup, history.largest_error(0.0, np.inf))
    end = worst(setup, history.largest_error(setup.duration - 1.0, np.inf))
    return result_of(
        f'efforts were zero {zero_after:.2f} s after the last joint state, and the brakes held; '
        f'no joint moved by more than {moved.words}, and none was off by more than {end.words} at '
        'the end',
        (before > 0.0, 'efforts were zero even before the joint states stopped'),
        (len(commands) > 0, 'the node published no commands while joint states were missing'),
        (
            left == 0.0,
            f'{STOPPED:g} s after the last joint state, efforts still reached {left:.3g} N m or N',
        ),
        (
            brakes == [True, False],
            f'brake states: {brakes}, expected [True, False] (engaged, then released)',
        ),
        moved.within(moving_limit(setup), 'during the run'),
        end.within(rest_limit(setup), 'at the end'),
    )


def check_tracking(setup: DemoSetup, history: History) -> ScenarioResult:
    """Print the errors and the command rate, and compare them with their limits."""
    robot, duration, rate = setup.robot, setup.duration, history.command_rate()
    moving = history.largest_error(0.0, (1.0 - REST_FRACTION) * duration)
    rest = history.largest_error((1.0 - 0.5 * REST_FRACTION) * duration, math.inf)
    most_moving, most_rest = tracking_limits(setup.slack)
    columns = moving, most_moving, rest, most_rest
    wide = name_width(robot)
    print(f'{"largest error":{wide}}{"moving":>13}{"limit":>14}{"at rest":>15}{"limit":>15}')
    for name, slide, *row in zip(
        robot.joint_names, robot.is_prismatic_joint, *columns, strict=True
    ):
        unit = 'mm' if slide else 'mrad'
        cells = zip(row, ('8.3f', '9.3f', '10.4f', '10.4f'), strict=True)
        text = ''.join(f'{1000.0 * value:{form}} {unit:4}' for value, form in cells)
        print(f'{name:{wide}}{text}')
    print(f'rate: {rate:.1f} of {setup.rate:.1f} commands/s ({rate / setup.rate - 1.0:+.1%})')
    return judge_tracking(setup, moving, rest, rate)


def tracking_limits(slack: Floats) -> tuple[Floats, Floats]:
    """
    Return the largest permitted errors in motion and at rest, shapes (n,) [rad or m].

    ``slack`` is the largest position error that Coulomb friction can maintain, shape (n,)
    [rad or m].
    """
    # A joint that breaks away from Coulomb friction overshoots by as much as it lagged before.
    return MOVING_LIMIT + 2.0 * slack, REST_LIMIT + slack


def tracking_words(slack: Floats) -> str:
    """Describe the limits on tracking errors and on the command rate."""
    parts = []
    whens = 'mrad (mm) while moving', 'mrad (mm) at rest'
    for limits, when in zip(tracking_limits(slack), whens, strict=True):
        least, most = (f'{1000.0 * limit:.3g}' for limit in (limits.min(), limits.max()))
        parts.append(f'{least} {when}' if least == most else f'{least} to {most} {when}')
    words = f'every joint stayed within {" and ".join(parts)}'
    if np.any(slack):
        words = f'{words} (limits in the table; wider if a joint has dry friction)'
    return f'{words}; rate within {RATE_LIMIT:.0%}'


def judge_tracking(setup: DemoSetup, moving: Floats, rest: Floats, rate: float) -> ScenarioResult:
    """Judge the errors in motion and at rest, each of shape (n,), and the command rate [Hz]."""
    whens, errors = ('while moving', 'at rest'), (moving, rest)
    cause = (
        'another node publishes commands too, or the robot caught up after a pause'
        if rate > setup.rate
        else f'this machine is busy, or too slow for --rate {setup.rate:g}'
    )
    return result_of(
        tracking_words(setup.slack),
        *(
            (
                error <= most,  # False for NaN, without measurements
                f'joint {name!r} was {1000 * error:.2f} mrad or mm off {when}, '
                f'limit {1000 * most:.3g}',
            )
            for when, row, limits in zip(whens, errors, tracking_limits(setup.slack), strict=True)
            for name, error, most in zip(setup.robot.joint_names, row, limits, strict=True)
        ),
        (
            abs(rate / setup.rate - 1.0) <= RATE_LIMIT,
            f'{rate:.1f} commands/s received, '
            f'expected {setup.rate:.1f} +- {RATE_LIMIT:.0%}: {cause}',
        ),
    )
