"""The result of a live comparison in one sentence."""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np

from ..analysis.diagnosis.agreement import Agreement, Obstacle, Outcome, Size
from ..analysis.diagnosis.fault import FaultKind
from ..analysis.diagnosis.live_samples import DURATION

_MOST_NAMES = 4


def sentence(agreement: Agreement) -> str:
    """
    Say in one sentence whether model and robot agree, and why not.

    Parameters
    ----------
    agreement : Agreement
        The result of the comparison.

    Returns
    -------
    text : str
        Without a full stop.

    """
    text = _SENTENCES[agreement.cause](agreement)
    if agreement.saturated and agreement.outcome is Outcome.DIFFER:
        text += f'; effort cut to its limit: {_listed(agreement.saturated)}'
    return text


def _agree(agreement: Agreement) -> str:
    return f'model and robot agree: {_compared(agreement)}'


def _few_joints(agreement: Agreement) -> str:
    count, total = agreement.values
    return (
        f'model and robot agree in {count:.0f} of {total:.0f} joints only: '
        f'{_compared(agreement)}; move the arm to check the others'
    )


def _saturated(agreement: Agreement) -> str:
    return (
        f'{_joints(agreement.saturated)}: the effort is cut to its limit, so the arm cannot hold '
        'itself or follow; raise effort_limits, or move to another pose; do not go live'
    )


def _compared(agreement: Agreement) -> str:
    text = _sizes(agreement)
    if not agreement.is_moving:
        text += ', at rest'
    if agreement.unchecked:
        text += f'; not checked, because the efforts are small: {_listed(agreement.unchecked)}'
    if agreement.unmeasured:
        text += f'; not checked, because no effort is measured: {_listed(agreement.unmeasured)}'
    return text


def _sign(agreement: Agreement) -> str:
    text = (
        f'{_joints(agreement.joints)}: measured and modelled effort have opposite signs; '
        'do not go live'
    )
    if len(agreement.joints) > 1 and not agreement.is_moving:
        text += ' (if these are all joints, the base may also hang upside down)'
    return text


def _scale(agreement: Agreement) -> str:
    factors = np.array(agreement.values)
    if np.ptp(factors) < 0.1 * float(np.max(factors)):
        times = _factor(float(np.mean(factors)))
    else:
        times = ', '.join(map(_factor, agreement.values[:_MOST_NAMES]))
    return (
        f'{_joints(agreement.joints)}: the measured effort is {times} times the modelled one; '
        'another unit, or motor currents?'
    )


def _not_measured(agreement: Agreement) -> str:
    return (
        f'{_joints(agreement.joints)}: the measured effort is always 0, but the model expects an '
        'effort; the driver does not report it'
    )


def _gravity_compensated(agreement: Agreement) -> str:
    return (
        'the measured efforts lack gravity: either brakes hold the arm, or the driver compensates '
        'gravity (then set include_gravity: false before going live)' + _also(agreement)
    )


def _payload(agreement: Agreement) -> str:
    mass = agreement.values[0]
    if mass > 0.0:
        load = f"link '{agreement.link}' carries about {mass:.2g} kg that the model does not have"
        advice = 'publish it on ~/payload, or add it to the URDF'
    else:
        load = (
            f"the model has about {-mass:.2g} kg at link '{agreement.link}' that the robot lacks"
        )
        advice = 'remove it from ~/payload or from the URDF'
    return f'{load}: {_sizes(agreement)}; {advice}{_also(agreement)}'


def _mounting(agreement: Agreement) -> str:
    vector = ', '.join(f'{x:.1f}' for x in agreement.values)
    return (
        f'gravity does not act as in the model: [{vector}] m/s^2 in the frame of the root link '
        f'would explain the efforts; check the parameter gravity{_also(agreement)}'
    )


def _unexplained(agreement: Agreement) -> str:
    return (
        f'{_joints(agreement.joints)}: measured and modelled effort differ, {_sizes(agreement)}, '
        'without a known cause; record a bag and run inverse_dynamics compare'
    )


def _slow_states(agreement: Agreement) -> str:
    measured, least = agreement.values
    return (
        f'joint states arrive at {measured:.0f} Hz, expected at least {least:.0f} Hz; the efforts '
        'lag behind the motion'
    )


def _at_rest(agreement: Agreement) -> str:
    return (
        f'{_joints(agreement.joints)}: measured and modelled effort differ at rest, '
        f'{_sizes(agreement)}: dry friction, or a wrong model; move the arm to decide'
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


def _sizes(agreement: Agreement) -> str:
    return ', '.join(_size(size) for size in agreement.sizes)


def _size(size: Size) -> str:
    unit = 'N' if size.is_prismatic else 'N m'
    return f'{two_digits(size.residual)} {unit} RMS residual of {two_digits(size.measured)} {unit}'


def two_digits(value: float) -> str:
    """Write a number with two significant digits, and all digits before the decimal point."""
    if not math.isfinite(value) or value == 0.0:
        return '0' if value == 0.0 else '-'
    digits = max(0, 1 - math.floor(math.log10(abs(value))))
    return f'{value:.{min(digits, 3)}f}'


def _also(agreement: Agreement) -> str:
    if not agreement.also_swapped:
        return ''
    return f'; opposite signs at {_joints(agreement.also_swapped)}; do not go live'


_SENTENCES: dict[FaultKind | Obstacle | None, Callable[[Agreement], str]] = {
    None: _agree,
    FaultKind.SIGN: _sign,
    FaultKind.SCALE: _scale,
    FaultKind.NOT_MEASURED: _not_measured,
    FaultKind.GRAVITY_COMPENSATED: _gravity_compensated,
    FaultKind.PAYLOAD: _payload,
    FaultKind.MOUNTING: _mounting,
    FaultKind.UNEXPLAINED: _unexplained,
    Obstacle.SLOW_STATES: _slow_states,
    Obstacle.SATURATED: _saturated,
    Obstacle.FEW_JOINTS: _few_joints,
    Obstacle.AT_REST: _at_rest,
    Obstacle.NO_DIAGNOSTICS: lambda agreement: agreement.reason,
    Obstacle.NODE_STATE: lambda agreement: f'not compared: {agreement.reason}',
    Obstacle.NO_EFFORTS: lambda agreement: (
        'not compared: joint_states has no efforts; enable them in the driver'
    ),
    Obstacle.ZERO_EFFORTS: lambda agreement: (
        'not compared: all measured efforts are 0; brakes hold the arm, or the driver does not '
        'report efforts'
    ),
    Obstacle.TOO_FEW_SAMPLES: lambda agreement: (
        f'not compared yet: collecting samples, up to {DURATION:g} s'
    ),
    Obstacle.SMALL_EFFORTS: lambda agreement: (
        'not compared: the modelled efforts are too small in this position; move the arm to '
        'another one'
    ),
}
