"""Whether a run went as it should: figures held against limits, in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...robot.model import Floats
from ..trajectory import slides
from .history import History
from .stage import Stage

MOVING_LIMIT, REST_LIMIT = 0.010, 0.001  # [rad or m]
RATE_LIMIT = 0.02  # share of the rate asked for
HARMLESS = 0.05  # [s]: for so long the loop may do without a new command
SETTLED = 1.5  # [s]: after a change, the node's loop has come to rest
STOPPED = 1.0  # [s]: the node's state timeout and stop ramp, and as much again to be fair
LEAST_FACTOR = 5.0  # by which telling the node of a load must help
CONTACT_LIMIT = 0.05  # share of the largest joint effort of a push


@dataclass(frozen=True)
class Verdict:
    """How a run went: what to say, and what went wrong, if anything did."""

    words: str
    failures: tuple[str, ...] = ()
    excuse: str = ''
    """What else may have been to blame; empty if nothing was seen."""

    def __str__(self) -> str:
        if self.failures:
            lines = [f'FAILED: {failure}' for failure in self.failures]
            return '\n'.join([*lines, self.excuse] if self.excuse else lines)
        return f'PASSED: {self.words}'


class Distance(NamedTuple):
    """How far off the joint was that was furthest off."""

    value: float
    """[rad or m]; NaN where nothing was measured."""
    words: str


def worst(stage: Stage, errors: Floats) -> Distance:
    """Find the largest of n errors, shape (n,) [rad or m]."""
    i = int(np.argmax(errors))  # NaN counts as the largest
    unit = 'mm' if slides(stage.robot)[i] else 'mrad'
    # Nobody asks for less than a thousandth of it.
    return Distance(float(errors[i]), f'{max(1000.0 * float(errors[i]), 0.001):.3g} {unit}')


def judge(words: str, *checks: tuple[bool, str]) -> Verdict:
    """Pass if all checks hold; each has words for when it does not."""
    return Verdict(words, tuple(otherwise for is_well, otherwise in checks if not is_well))


def tracking_limits(slack: Floats) -> tuple[Floats, Floats]:
    """
    Return how far joints may be off in motion and at rest.

    Parameters
    ----------
    slack : ndarray, shape (n,)
        How far dry friction may hold the joints off their places [rad or m].

    Returns
    -------
    moving, rest : ndarray, shape (n,)
        Limits [rad or m].

    """
    # A joint that dry friction lets go of swings as far beyond as it was held back.
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
    asked: float,
    slack: Floats | float = 0.0,
) -> list[str]:
    """List what missed its limit in tracking, in words; friction may take some slack besides."""
    failures = []
    moving_limits, rest_limits = tracking_limits(slack + np.zeros(len(joint_names)))
    for when, errors, limits in (
        ('moving', moving, moving_limits),
        ('at rest', rest, rest_limits),
    ):
        failures += [
            f'joint {name!r} was {1000 * error:.2f} mrad or mm off {when}, limit {1000 * most:.3g}'
            for name, error, most in zip(joint_names, errors, limits, strict=True)
            if not error <= most  # NaN is a failure: nothing was measured
        ]
    if not abs(rate / asked - 1.0) <= RATE_LIMIT:
        cause = (
            'another node publishes commands too, or the robot made up for a pause of this machine'
            if rate > asked
            else f'this machine is busy, or too slow for --rate {asked:g}'
        )
        failures.append(
            f'{rate:.1f} commands/s received, expected {asked:.1f} +- {RATE_LIMIT:.0%}: {cause}'
        )
    return failures


def excuse(history: History) -> str:
    """Say if the machine was too busy for a loop like this."""
    waited = float(np.max(np.diff(history.commands.times), initial=0.0))
    if waited <= HARMLESS:
        return ''
    return (
        f'The machine was busy: once no command came for {1000.0 * waited:.0f} ms, which no loop '
        'can make up for. Close what else runs, or ask for less: --rate 200.'
    )


def moving_limit(stage: Stage) -> float:
    """Return how far a joint may be off in motion [rad or m]."""
    return MOVING_LIMIT + float(np.max(stage.slack))


def rest_limit(stage: Stage) -> float:
    """Return how far a joint may be off at rest [rad or m]."""
    return REST_LIMIT + float(np.max(stage.slack))


def judge_hold(stage: Stage, history: History) -> Verdict:
    """Judge an arm of which nobody asks anything: it must not move."""
    moved = worst(stage, history.largest_error(0.0, np.inf))
    return judge(
        f'no joint moved by more than {moved.words}',
        (moved.value <= rest_limit(stage), f'a joint moved by {moved.words}'),
    )


def judge_payload(stage: Stage, history: History, picked_up: float, told: float) -> Verdict:
    """Judge a load: unknown it shows as an error, which goes when the node is told."""
    before = worst(stage, history.largest_error(0.0, picked_up))
    unknown = worst(stage, history.largest_error(picked_up, told))
    known = worst(stage, history.largest_error(told + SETTLED, np.inf))
    factor = unknown.value / known.value
    return judge(
        f'the load put a joint {unknown.words} off; told of it, the node kept all within '
        f'{known.words}: {factor:.0f} times better',
        (
            before.value <= moving_limit(stage),
            f'{before.words} off before there was a load',
        ),
        (
            known.value <= moving_limit(stage),
            f'{known.words} off although the node knew the load',
        ),
        (
            factor >= LEAST_FACTOR,
            f'telling the load made {unknown.words} to {known.words}: {factor:.1f} times '
            f'better, expected {LEAST_FACTOR:g}',
        ),
    )


def judge_push(
    stage: Stage, history: History, link: str, force: Floats, began: float, ended: float
) -> Verdict:
    """Judge a push: it shows at every joint as what must make up for it, until it ends."""
    window = began + SETTLED, ended
    rows, states = history.external.between(*window), history.states.between(*window)
    if not len(rows) or not len(states):
        return Verdict('', ('the node told nothing of external efforts',))
    found = np.mean(rows, axis=0)
    expected = stage.external_efforts(link, force, np.mean(states[:, 0], axis=0))
    size = float(np.max(np.abs(expected)))
    off = float(np.nanmax(np.abs(found - expected))) / size
    quiet = history.external.between(0.0, began)
    noise = float(np.nanmax(np.abs(quiet), initial=0.0)) / size
    given = worst(stage, history.largest_error(began, ended))
    after = worst(stage, history.largest_error(ended + SETTLED, np.inf))
    return judge(
        f'{np.linalg.norm(force):.3g} N at {link!r} moved a joint by {given.words}, and was found '
        f'within {max(100.0 * off, 0.01):.2g} % of -J^T F (up to {size:.3g} N m or N)',
        (off <= CONTACT_LIMIT, f'the push was found {off:.1%} off, limit {CONTACT_LIMIT:.0%}'),
        (noise <= CONTACT_LIMIT, f'{noise:.1%} of the push was seen before there was any'),
        (after.value <= rest_limit(stage), f'{after.words} off after the push'),
    )


def judge_tilt(
    stage: Stage, history: History, settled: float, without: tuple[Floats, Floats]
) -> Verdict:
    """Judge a base that tilts: it must not move the arm."""
    moved = worst(stage, history.largest_error(0.0, np.inf))
    rest = worst(stage, history.largest_error(settled, np.inf))
    lesser = worst(stage, np.max(np.abs(without[1]), axis=0))
    return judge(
        f'within {moved.words} while the base tilted, {rest.words} at rest; without the IMU it '
        f'would have been {lesser.words}',
        (
            moved.value <= moving_limit(stage),
            f'{moved.words} off while the base tilted',
        ),
        (rest.value <= rest_limit(stage), f'{rest.words} off on the tilted base'),
        (lesser.value >= LEAST_FACTOR * moved.value, f'without the IMU: {lesser.words} only'),
    )


def judge_sensor_lost(stage: Stage, history: History, lost: float, back: float) -> Verdict:
    """Judge a time without joint states: no efforts, and afterwards the arm is where it was."""
    # Until just before: the clock of the stamps, which is back then, may be a little behind.
    commands = np.abs(history.commands.between(lost + STOPPED, back - 0.1))
    left = float(np.max(commands, initial=0.0))
    before = float(np.max(np.abs(history.commands.between(0.0, lost)), initial=0.0))
    times, rows = history.commands.times, history.commands.rows
    is_zero = (times > lost) & (np.max(np.abs(rows), axis=1, initial=0.0) == 0.0)
    zero_after = float(times[is_zero][0]) - lost if is_zero.any() else np.nan
    brakes = [bool(on) for on in history.brakes.rows]
    moved = worst(stage, history.largest_error(0.0, np.inf))
    end = worst(stage, history.largest_error(stage.duration - 1.0, np.inf))
    return judge(
        f'efforts were zero {zero_after:.2f} s after the last joint state, and brakes held; moved '
        f'by {moved.words} in all, {end.words} off in the end',
        (before > 0.0, 'there were no efforts to begin with'),
        (len(commands) > 0, 'the node fell silent when joint states stopped'),
        (left == 0.0, f'efforts of up to {left:.3g} N m or N {STOPPED:g} s after the last state'),
        (brakes == [True, False], f'brakes should go on and open again, they went {brakes}'),
        (moved.value <= moving_limit(stage), f'{moved.words} off on the way'),
        (end.value <= rest_limit(stage), f'{end.words} off in the end'),
    )
