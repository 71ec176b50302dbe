"""Formats the results of `inverse_dynamics compare` as a verdict and tables."""

from __future__ import annotations

import math

from ..analysis.diagnosis import ComparisonResult, JointResidual
from .diagnosis_text import amount, headline, sentence
from .tables import motion_notes, or_dash, table, with_error

AT_NOISE = 1.5  # a residual below this multiple of the noise may be noise only


def verdict(result: ComparisonResult) -> str:
    """Summarize the comparison in a few sentences."""
    if math.isnan(result.explained):
        opening = '. '.join(sentence(each) for each in result.faults)
        reason = 'The efforts cannot be compared, because they hardly vary.'
        return f'{opening}. {reason}' if opening else reason
    modelled = (
        f'the model explains {percent(result.explained)} of the measured effort (RMS residual '
        f'{_total(result, "rms_residual")} of {_total(result, "rms_measured")}).'
    )
    corrected = (
        f'the model explains {percent(result.explained_corrected)} (RMS residual '
        f'{_total(result, "rms_corrected")}).'
    )
    if result.faults:
        first, *others = result.faults
        opening = '; '.join([sentence(first), *map(headline, others)])
        return (
            f'{opening}. Without corrections, {modelled} With corrections and fitted friction, '
            f'{corrected}'
        )
    text = f'{modelled[0].upper()}{modelled[1:]} With fitted friction, {corrected}'
    if all(joint.friction.unknown_because for joint in result.joints):
        text = f'{modelled[0].upper()}{modelled[1:]} Friction cannot be fitted.'
    if result.is_too_short:
        seconds = result.motion.times[-1] - result.motion.times[0]
        text += f' The recording is too short ({seconds:.2g} s) to diagnose a difference.'
    return text


def _total(result: ComparisonResult, name: str) -> str:
    """Write the RMS of the field `name` over the moving joints of each type."""
    texts = []
    for is_prismatic in (False, True):
        values = [
            getattr(result.joints[c], name)
            for c in result.moving
            if result.joints[c].is_prismatic == is_prismatic
        ]
        if values:
            mean = math.sqrt(sum(x * x for x in values) / len(values))
            texts.append(amount(mean, is_prismatic))
    return ' and '.join(texts)


def comparison_table(result: ComparisonResult, notes: tuple[str, ...]) -> str:
    """Return measured efforts, modelled efforts and residuals, one row per joint."""
    motion, rows = result.motion, [_row(joint) for joint in result.joints]
    duration = motion.times[-1] - motion.times[0]
    columns = ('joint', '', 'measured', 'modelled', 'residual', 'friction', 'corrected', 'noise',
               'explained')  # fmt: skip
    corrections = ' and the corrections above' if result.faults else ''
    remarks = (
        'All efforts are RMS values. Residual: measured minus modelled effort. Friction: residual '
        'of the model with fitted friction and offset. Corrected: residual of the model with '
        f'fitted friction, offset{corrections}. Noise: noise that remains after smoothing; a '
        'residual below the noise needs no explanation. Explained: 1 - (corrected / measured)^2. '
        'Samples at rest are not used (except for joints with unknown friction), because dry '
        'friction at rest can have any value up to its maximum.',
        f'{len(motion.times)} samples over {duration:.3g} s; {motion.method}.',
        *(f'{note[0].upper()}{note[1:]}.' for note in (*motion_notes(motion), *notes)),
    )
    return table('Measured and modelled efforts', columns, rows, remarks,
                 [1])  # fmt: skip


def _row(joint: JointResidual) -> tuple[str, ...]:
    explained = percent(joint.explained_corrected)
    return (
        joint.name,
        'N' if joint.is_prismatic else 'N m',
        f'{joint.rms_measured:.4g}',
        f'{joint.rms_modelled:.4g}',
        f'{joint.rms_residual:.3g}',
        f'{joint.rms_friction:.3g}',
        f'{joint.rms_corrected:.3g}',
        or_dash(joint.noise, '.2g'),
        f'{explained} (noise)' if joint.rms_corrected < AT_NOISE * joint.noise else explained,
    )


def friction_table(result: ComparisonResult) -> str:
    """Return the fitted friction and the standard errors, one row per joint."""
    rows, unknown = [], []
    for joint in result.joints:
        *values, reason = joint.friction
        cells = ['-' if reason else with_error(*each) for each in values]
        rows.append((joint.name, *cells))
        if reason:
            unknown.append(f'{joint.name}: friction unknown, because {reason}.')
    notes = (
        'Friction effort: damping * velocity + (Coulomb + per load * |modelled effort|) * '
        'sign(velocity) + offset. Damping is in N m s/rad, Coulomb and offset are in N m '
        '(prismatic joints: N s/m and N).',
        *unknown,
    )
    return table(
        'Friction fitted to the residual (± standard errors)',
        ('joint', 'damping', 'Coulomb', 'per load', 'offset'),
        rows,
        notes,
    )


def percent(fraction: float) -> str:
    """Write a fraction as a percentage, or a dash for NaN."""
    if math.isnan(fraction):
        return '-'
    # Values near 100 % get more digits.
    if fraction < -9.99:
        return '<-999%'
    if fraction > 0.9999:
        return '>99.99%'
    if abs(fraction) < 5e-4:
        return '0.0%'
    return f'{fraction:.2%}' if fraction > 0.99 else f'{fraction:.1%}'
