"""Describes the result of a live comparison of model and robot in a few sentences."""

from __future__ import annotations

from collections.abc import Callable
import math

from ..analysis.diagnosis import Fault, FaultKind
from ..analysis.diagnosis.live import Agreement, DURATION, Obstacle, Size
from .diagnosis_text import advice, centre_of_mass, headline, joined

_MOST_NAMES = 4


def sentence(agreement: Agreement) -> str:
    """Say whether and why model and robot differ, without the final full stop."""
    if agreement.obstacle is not None:
        return _OBSTACLES[agreement.obstacle](agreement)
    if agreement.faults:
        return _differ(agreement)
    return f'model and robot agree: {_compared(agreement)}'


def _differ(agreement: Agreement) -> str:
    """Describe all faults, and give advice on the first fault."""
    parts = [*map(_headline, agreement.faults), _sizes(agreement)]
    if any(fault.kind is FaultKind.SIGN for fault in agreement.faults):
        parts.append('do not go live')
    if agreement.saturated:
        parts.append(f'the effort of {_listed(agreement.saturated)} is cut to its limit')
    return f'{"; ".join(parts)}. {advice(agreement.faults[0]).removesuffix(".")}'


def _headline(fault: Fault) -> str:
    """Return the headline of a fault, with the centre of mass of a payload if it is known."""
    text = headline(fault)
    if fault.kind is not FaultKind.PAYLOAD or all(map(math.isnan, fault.values[1:])):
        return text
    return f'{text}, at {centre_of_mass(fault)} m in the frame of the link'


def _few_joints(agreement: Agreement) -> str:
    count, total = agreement.numbers
    return (
        f'model and robot agree, but only {count:.0f} of {total:.0f} joints could be checked: '
        f'{_compared(agreement)}; move the arm to check more joints'
    )


def _saturated(agreement: Agreement) -> str:
    return (
        f'{joined(agreement.saturated)}: the effort is cut to its limit, so the arm cannot hold '
        'itself or follow a motion; raise effort_limits, or move to another pose; do not go live'
    )


def _compared(agreement: Agreement) -> str:
    text = _sizes(agreement)
    if not agreement.is_moving:
        text += ', at rest'
    if agreement.unchecked:
        text += f'; not checked because of small efforts: {_listed(agreement.unchecked)}'
    if agreement.unmeasured:
        text += f'; not checked because no effort is measured: {_listed(agreement.unmeasured)}'
    return text


def _slow_states(agreement: Agreement) -> str:
    measured, least = agreement.numbers
    return (
        f'joint states arrive at {measured:.0f} Hz, expected at least {least:.0f} Hz; the efforts '
        'lag behind the motion'
    )


def _at_rest(agreement: Agreement) -> str:
    return (
        f'{joined(agreement.faults[0].joints)}: measured and modelled effort differ at rest '
        f'({_sizes(agreement)}); the cause is dry friction or a wrong model; move the arm to find '
        'out which'
    )


def _small_efforts(agreement: Agreement) -> str:
    if agreement.has_gravity:
        return (
            'not compared: the modelled efforts are too small in this pose; move the arm to '
            'another pose'
        )
    return (
        'not compared: without gravity, modelled and measured efforts are too small; move the arm'
    )


def _listed(names: tuple[str, ...]) -> str:
    more = len(names) - _MOST_NAMES
    return ', '.join(names[:_MOST_NAMES]) + (f' and {more} more' if more > 0 else '')


def _sizes(agreement: Agreement) -> str:
    return f'RMS residual {" and ".join(map(_size, agreement.sizes))}'


def _size(size: Size) -> str:
    unit = 'N' if size.is_prismatic else 'N m'
    residual, measured = _two_digits(size.residual), _two_digits(size.measured)
    return f'{residual} of {measured} {unit}'


def _two_digits(value: float) -> str:
    """Write a number with two significant digits, but at most three decimals."""
    if not math.isfinite(value) or value == 0.0:
        return '0' if value == 0.0 else '-'
    digits = max(0, 1 - math.floor(math.log10(abs(value))))
    return f'{value:.{min(digits, 3)}f}'


_OBSTACLES: dict[Obstacle, Callable[[Agreement], str]] = {
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
        'not compared: all measured efforts are 0; either brakes hold the arm, or the driver does '
        'not report efforts, or the driver reports efforts without gravity (then set '
        'measured_gravity to excluded)'
    ),
    Obstacle.TOO_FEW_SAMPLES: lambda agreement: (
        f'not compared yet: collecting samples for up to {DURATION:g} s'
    ),
    Obstacle.SMALL_EFFORTS: _small_efforts,
}
