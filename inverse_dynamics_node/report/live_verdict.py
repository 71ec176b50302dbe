"""The verdict of a live comparison in one sentence."""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np

from ..analysis.live.verdict import Cause, Outcome, Size, Verdict
from ..analysis.live.window import DURATION

_MOST_NAMES = 4


def sentence(verdict: Verdict) -> str:
    """
    Describe a verdict in one sentence.

    Parameters
    ----------
    verdict : Verdict
        The verdict.

    Returns
    -------
    text : str
        Without a full stop.

    """
    text = _SENTENCES[verdict.cause](verdict)
    if verdict.saturated and verdict.outcome is Outcome.DIFFER:
        text += f'; effort cut to its limit: {_listed(verdict.saturated)}'
    return text


def _agreement(verdict: Verdict) -> str:
    return f'model and robot agree: {_compared(verdict)}'


def _few_joints(verdict: Verdict) -> str:
    count, total = verdict.values
    return (
        f'model and robot agree in {count:.0f} of {total:.0f} joints only: {_compared(verdict)}; '
        'move the arm to check the others'
    )


def _saturated(verdict: Verdict) -> str:
    return (
        f'{_joints(verdict.saturated)}: the effort is cut to its limit, so the arm cannot hold '
        'itself or follow; raise effort_limits, or move to another pose; do not go live'
    )


def _compared(verdict: Verdict) -> str:
    text = _sizes(verdict)
    if not verdict.is_moving:
        text += ', at rest'
    if verdict.unchecked:
        text += f'; not checked, because the efforts are small: {_listed(verdict.unchecked)}'
    if verdict.unmeasured:
        text += f'; not checked, because no effort is measured: {_listed(verdict.unmeasured)}'
    return text


def _sign(verdict: Verdict) -> str:
    text = (
        f'{_joints(verdict.joints)}: measured and modelled effort have opposite signs; '
        'do not go live'
    )
    if len(verdict.joints) > 1 and not verdict.is_moving:
        text += ' (if these are all joints, the base may also hang upside down)'
    return text


def _scale(verdict: Verdict) -> str:
    factors = np.array(verdict.values)
    if np.ptp(factors) < 0.1 * float(np.max(factors)):
        times = _factor(float(np.mean(factors)))
    else:
        times = ', '.join(map(_factor, verdict.values[:_MOST_NAMES]))
    return (
        f'{_joints(verdict.joints)}: the measured effort is {times} times the modelled one; '
        'another unit, or motor currents?'
    )


def _not_measured(verdict: Verdict) -> str:
    return (
        f'{_joints(verdict.joints)}: the measured effort is always 0, but the model expects an '
        'effort; the driver does not report it'
    )


def _gravity_compensated(verdict: Verdict) -> str:
    return (
        'the measured efforts lack gravity: either brakes hold the arm, or the driver compensates '
        'gravity (then set include_gravity: false before going live)' + _also(verdict)
    )


def _payload(verdict: Verdict) -> str:
    mass = verdict.values[0]
    if mass > 0.0:
        load = f"link '{verdict.link}' carries about {mass:.2g} kg that the model does not have"
        advice = 'publish it on ~/payload, or add it to the URDF'
    else:
        load = f"the model has about {-mass:.2g} kg at link '{verdict.link}' that the robot lacks"
        advice = 'remove it from ~/payload or from the URDF'
    return f'{load}: {_sizes(verdict)}; {advice}{_also(verdict)}'


def _mounting(verdict: Verdict) -> str:
    vector = ', '.join(f'{x:.1f}' for x in verdict.values)
    return (
        f'gravity does not act as in the model: [{vector}] m/s^2 in the frame of the root link '
        f'would explain the efforts; check the parameter gravity{_also(verdict)}'
    )


def _unexplained(verdict: Verdict) -> str:
    return (
        f'{_joints(verdict.joints)}: measured and modelled effort differ, {_sizes(verdict)}, '
        'without a known cause; record a bag and run inverse_dynamics compare'
    )


def _slow_states(verdict: Verdict) -> str:
    measured, least = verdict.values
    return (
        f'joint states arrive at {measured:.0f} Hz, expected at least {least:.0f} Hz; the efforts '
        'lag behind the motion'
    )


def _at_rest(verdict: Verdict) -> str:
    return (
        f'{_joints(verdict.joints)}: measured and modelled effort differ at rest, '
        f'{_sizes(verdict)}: dry friction, or a wrong model; move the arm to decide'
    )


def _factor(value: float) -> str:
    return f'{float(f"{value:.3g}"):g}'


def _joints(names: tuple[str, ...]) -> str:
    listed = _listed(names)
    if all('joint' in name for name in names):
        return listed
    return f'joint{"" if len(names) == 1 else "s"} {listed}'


def _listed(names: tuple[str, ...]) -> str:
    more = len(names) - _MOST_NAMES
    return ', '.join(names[:_MOST_NAMES]) + (f' and {more} more' if more > 0 else '')


def _sizes(verdict: Verdict) -> str:
    return ', '.join(_size(size) for size in verdict.sizes)


def _size(size: Size) -> str:
    unit = 'N' if size.is_prismatic else 'N m'
    return f'{two_digits(size.residual)} {unit} RMS residual of {two_digits(size.measured)} {unit}'


def two_digits(value: float) -> str:
    """Write a number with two significant digits, and all digits before the decimal point."""
    if not math.isfinite(value) or value == 0.0:
        return '0' if value == 0.0 else '-'
    digits = max(0, 1 - math.floor(math.log10(abs(value))))
    return f'{value:.{min(digits, 3)}f}'


def _also(verdict: Verdict) -> str:
    if not verdict.also_swapped:
        return ''
    return f'; opposite signs at {_joints(verdict.also_swapped)}; do not go live'


_SENTENCES: dict[Cause, Callable[[Verdict], str]] = {
    Cause.NONE: _agreement,
    Cause.SIGN: _sign,
    Cause.SCALE: _scale,
    Cause.NOT_MEASURED: _not_measured,
    Cause.GRAVITY_COMPENSATED: _gravity_compensated,
    Cause.PAYLOAD: _payload,
    Cause.MOUNTING: _mounting,
    Cause.UNEXPLAINED: _unexplained,
    Cause.SLOW_STATES: _slow_states,
    Cause.SATURATED: _saturated,
    Cause.FEW_JOINTS: _few_joints,
    Cause.AT_REST: _at_rest,
    Cause.NO_DIAGNOSTICS: lambda verdict: verdict.reason,
    Cause.NODE_STATE: lambda verdict: f'not compared: {verdict.reason}',
    Cause.NO_EFFORTS: lambda verdict: (
        'not compared: joint_states has no efforts; enable them in the driver'
    ),
    Cause.ZERO_EFFORTS: lambda verdict: (
        'not compared: all measured efforts are 0; brakes hold the arm, or the driver does not '
        'report efforts'
    ),
    Cause.TOO_FEW_SAMPLES: lambda verdict: (
        f'not compared yet: collecting samples, up to {DURATION:g} s'
    ),
    Cause.SMALL_EFFORTS: lambda verdict: (
        'not compared: the modelled efforts are too small in this position; move the arm to '
        'another one'
    ),
}
