"""Whether a run went as it should: figures held against limits, in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model import Floats
from .history import History
from .stage import Stage

MOVING_LIMIT, REST_LIMIT = 0.010, 0.001  # [rad or m]
RATE_LIMIT = 0.02  # share of the rate asked for
SETTLED = 1.5  # [s]: after a change, the node's loop has come to rest
STOPPED = 1.0  # [s]: the node's state timeout and stop ramp, and as much again to be fair
LEAST_FACTOR = 5.0  # by which telling the node of a load must help
CONTACT_LIMIT = 0.05  # share of the largest joint effort of a push


@dataclass(frozen=True)
class Verdict:
    """How a run went: what to say, and what went wrong, if anything did."""

    words: str
    failures: tuple[str, ...] = ()

    def __str__(self) -> str:
        if self.failures:
            return '\n'.join(f'FAILED: {failure}' for failure in self.failures)
        return f'PASSED: {self.words}'


def small(value: float) -> str:
    """Write what a joint that turns or slides was off at most; nobody asks for more than 1e-6."""
    return f'{1000.0 * value:.3g} mrad or mm' if value >= 1e-6 else '0.001 mrad or mm'


def judge(words: str, *checks: tuple[bool, str]) -> Verdict:
    """Pass if all checks hold; each has words for when it does not."""
    return Verdict(words, tuple(otherwise for is_well, otherwise in checks if not is_well))


def find_failures(
    joint_names: tuple[str, ...], moving: Floats, rest: Floats, rate: float, asked: float
) -> list[str]:
    """List what missed its limit in tracking, in words."""
    failures = []
    for when, errors, limit in (('moving', moving, MOVING_LIMIT), ('at rest', rest, REST_LIMIT)):
        failures += [
            f'joint {name!r} was {1000 * error:.2f} mrad or mm off {when}, limit {1000 * limit:g}'
            for name, error in zip(joint_names, errors, strict=True)
            if not error <= limit  # NaN is a failure: nothing was measured
        ]
    if not abs(rate / asked - 1.0) <= RATE_LIMIT:
        failures.append(f'{rate:.1f} commands/s came, {asked:.1f} were asked for')
    return failures


def judge_hold(stage: Stage, history: History) -> Verdict:
    """Judge an arm of which nobody asks anything: it must not move."""
    moved = float(history.largest_error(0.0, stage.duration).max())
    return judge(
        f'no joint moved by more than {small(moved)}, limit {small(REST_LIMIT)}',
        (moved <= REST_LIMIT, f'a joint moved by {small(moved)}, limit {small(REST_LIMIT)}'),
    )


def judge_payload(stage: Stage, history: History, picked_up: float, told: float) -> Verdict:
    """Judge a load: unknown it shows as an error, which goes when the node is told."""
    before = float(history.largest_error(0.0, picked_up).max())
    unknown = float(history.largest_error(picked_up, told).max())
    known = float(history.largest_error(told + SETTLED, stage.duration).max())
    factor = unknown / known
    return judge(
        f'the load put a joint {small(unknown)} off, told of it the node kept all within '
        f'{small(known)}: {factor:.0f} times better',
        (before <= MOVING_LIMIT, f'{small(before)} off before there was a load'),
        (known <= MOVING_LIMIT, f'{small(known)} off although the node knew the load'),
        (
            factor >= LEAST_FACTOR,
            f'telling the load made {small(unknown)} to {small(known)}: {factor:.1f} times '
            f'better, expected {LEAST_FACTOR:g}',
        ),
    )


def judge_push(
    stage: Stage, history: History, link: str, force: Floats, began: float, ended: float
) -> Verdict:
    """Judge a push: it shows at every joint as what must make up for it, until it ends."""
    window = began + SETTLED, ended
    rows, states = history.external.between(*window), history.states.between(*window)
    after = float(history.largest_error(ended + SETTLED, stage.duration).max())
    if not len(rows) or not len(states):
        return Verdict('', ('the node told nothing of external efforts',))
    found = np.mean(rows, axis=0)
    expected = stage.external_efforts(link, force, np.mean(states[:, 0], axis=0))
    size = float(np.max(np.abs(expected)))
    off = float(np.nanmax(np.abs(found - expected))) / size
    quiet = history.external.between(0.0, began)
    noise = float(np.nanmax(np.abs(quiet), initial=0.0)) / size
    given = float(history.largest_error(began, ended).max())
    return judge(
        f'{np.linalg.norm(force):.3g} N at {link!r} moved a joint by {small(given)}, '
        f'and was found within {100.0 * off:.2g} % of -J^T F (up to {size:.3g} N m or N)',
        (off <= CONTACT_LIMIT, f'the push was found {off:.1%} off, limit {CONTACT_LIMIT:.0%}'),
        (
            noise <= CONTACT_LIMIT,
            f'contact of {noise:.1%} of the push was seen before there was any',
        ),
        (after <= REST_LIMIT, f'{small(after)} off after the push'),
    )


def judge_tilt(
    stage: Stage, history: History, settled: float, without: tuple[Floats, Floats]
) -> Verdict:
    """Judge a base that tilts: it must not move the arm."""
    moved = float(history.largest_error(0.0, stage.duration).max())
    rest = float(history.largest_error(settled, stage.duration).max())
    would_have = float(np.max(np.abs(without[1])))
    return judge(
        f'within {small(moved)} while the base tilted, {small(rest)} at rest; without the IMU it '
        f'would have been {small(would_have)}',
        (moved <= MOVING_LIMIT, f'{small(moved)} off while the base tilted'),
        (rest <= REST_LIMIT, f'{small(rest)} off on the tilted base'),
        (would_have >= LEAST_FACTOR * moved, f'without the IMU it is {small(would_have)} only'),
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
    moved = float(history.largest_error(0.0, stage.duration).max())
    end = float(history.largest_error(stage.duration - 1.0, stage.duration).max())
    return judge(
        f'efforts were zero {zero_after:.2f} s after the last joint state, brakes held; moved by '
        f'{small(moved)} in all, {small(end)} off in the end',
        (before > 0.0, 'there were no efforts to begin with'),
        (len(commands) > 0, 'the node fell silent when joint states stopped'),
        (left == 0.0, f'efforts of up to {left:.3g} N m or N {STOPPED:g} s after the last state'),
        (brakes == [True, False], f'brakes on, expected on and open again, went {brakes}'),
        (moved <= MOVING_LIMIT, f'{small(moved)} off on the way'),
        (end <= REST_LIMIT, f'{small(end)} off in the end'),
    )
