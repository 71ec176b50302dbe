"""Formats the results of `inverse_dynamics identify` as tables and JSON."""

from __future__ import annotations

import math
from typing import Any

from ..analysis.identification import BodyResult, IdentificationResult, JointResult
from ..errors import significant
from ..robot.model import Floats
from .tables import motion_notes, table, with_error


def residual_table(result: IdentificationResult) -> str:
    """Return the residuals of three models, one row per joint."""
    rows = [
        (
            joint.name,
            significant(joint.measured, 4),
            significant(joint.unseen.urdf),
            significant(joint.unseen.friction),
            significant(joint.unseen.identified),
            significant(joint.noise, 2),
            joint.unit,
        )
        for joint in result.joints
    ]
    columns = 'joint', 'measured', 'URDF', '+ friction', 'identified', 'noise', ''
    notes = (
        'RMS of the measured effort and of the residuals of three models, smoothed over '
        f'{1e3 * result.unseen.smoothing:.0f} ms. Unseen data: {result.unseen.description}. '
        'Noise: residual that no model can explain, estimated from the high frequencies of the '
        'efforts.',
    )
    return table('Measured minus modelled efforts of unseen data', columns, rows, notes, [6])


def friction_table(result: IdentificationResult) -> str:
    """Return friction, armature and offset of every joint, with their standard errors."""
    rows = [_friction_row(joint) for joint in result.joints]
    columns = ('joint', 'damping', 'Coulomb', 'width', 'per load', 'armature', 'offset')
    notes = (
        'Effort of the joint: damping * velocity + (Coulomb + per load * |effort of the links|) * '
        'tanh(velocity / width) + armature * acceleration + offset, in N m, rad and s (prismatic '
        'joints: N, m, s). Standard errors cover random errors and the spread between blocks of '
        'the recordings. Armature and friction per load are left out where they do not '
        'improve the prediction.',
        *_extra_notes(result),
        *(
            f'{joint.name}: friction unknown, because {joint.unknown_because}.'
            for joint in result.joints
            if joint.unknown_because
        ),
    )
    return table('Joints', columns, rows, notes)


def _extra_notes(result: IdentificationResult) -> list[str]:
    """Return sentences about springs, coupled joints and gains."""
    notes, gains = [], []
    for joint in result.joints:
        terms, unit = joint.terms, ('m' if joint.is_prismatic else 'rad')
        force = 'N' if joint.is_prismatic else 'N m'
        if terms.stiffness:
            value = with_error(terms.stiffness, terms.errors['stiffness'])
            notes.append(
                f'{joint.name}: an effort proportional to the position, as of a spring, a '
                f'counterweight or cables: {value} {force}/{unit} * (position - '
                f'{terms.rest:.3g} {unit}).'
            )
        if terms.coupling:
            notes.append(
                f'{joint.name}: the velocity of the drive is the velocity of this joint + '
                f'{terms.coupling:.3g} * the velocity of {joint.coupled_with[0]}; the drive acts '
                'on both joints.'
            )
        if joint.gain is not None:
            gains.append(f'{joint.name} {significant(joint.gain, 4)}')
    if gains:
        notes.append(f'The efforts are currents times these gains: {", ".join(gains)}.')
    return notes


def _friction_row(joint: JointResult) -> tuple[str, ...]:
    terms, cells = joint.terms, []
    for name in ('damping', 'coulomb', 'load_friction', 'armature', 'offset'):
        error = terms.errors.get(name)
        cells.append('-' if error is None else with_error(getattr(terms, name), error))
    width = '-' if joint.unknown_because else f'{terms.width:.2g}'
    return joint.name, *cells[:2], width, *cells[2:]


def body_table(result: IdentificationResult) -> str:
    """Return masses and centres of mass before and after the identification."""
    rows = []
    for body in result.bodies:
        rows.append(
            (
                body.link,
                significant(body.mass_before, 4),
                with_error(body.mass, body.mass_error),
                _millimetres(body.com_before),
                _millimetres(body.com),
                f'{1e3 * float(max(body.com_error)):.0f}',
            )
        )
    columns = 'link', 'mass [kg]', 'identified', 'centre of mass [mm]', 'identified', '±'
    notes = [
        'Efforts depend only on combinations of these values. A single mass with a large error '
        'may be wrong although the efforts are right. Centres of mass are in the frame of the '
        'joint that moves the link.',
        *(
            f'{body.link} stands for the links {", ".join(body.links)}, joined by fixed joints.'
            for body in result.bodies
            if len(body.links) > 1
        ),
    ]
    if not result.accepted:
        notes.append('These values were not accepted and are not written to the URDF.')
    return table('Bodies', columns, rows, notes)


def summary_lines(result: IdentificationResult) -> tuple[str, ...]:
    """Return sentences about the data and the fit."""
    delay = ''
    if math.isfinite(result.delay_error):
        late = 'late' if result.delay >= 0.0 else 'early'
        delay = (
            f'; the efforts are {abs(result.delay) * 1e3:.1f} ± '
            f'{result.delay_error * 1e3:.1f} ms {late}'
        )
        delay += ' (the fit removed this shift)' if result.delay_removed else ''
    return (
        f'{result.sample_count} samples over {significant(result.duration)} s; efforts and '
        f'regressors are smoothed over {result.smoothing * 1e3:.0f} ms; cross-validation gave the '
        f'robot description a weight of {result.urdf_weight:.3g}{delay}.',
        *(f'{note}.' for note in notes_of(result)),
    )


def notes_of(result: IdentificationResult) -> tuple[str, ...]:
    """Return notes about ignored, repaired and doubtful data, without full stops."""
    notes = [note for motion in result.signals for note in motion_notes(motion)]
    return tuple(dict.fromkeys(notes))


def _millimetres(position: Floats) -> str:
    return ' '.join(f'{1e3 * x:.0f}' for x in position)


# ---- JSON ----------------------------------------------------------------------------------


def as_json(result: IdentificationResult, notes: tuple[str, ...]) -> dict[str, Any]:
    """Return the result and notes about the recordings as values for JSON, in SI units."""
    return {
        'robot': result.robot.name,
        'accepted': result.accepted,
        'verdict': result.verdict,
        'unseen_data': result.unseen.description,
        'unseen_smoothing_window': result.unseen.smoothing,
        'joints': [_joint(joint) for joint in result.joints],
        'bodies': [_body(body, result.accepted) for body in result.bodies],
        'cut_off_frequency': result.signals[0].cut_off,
        'weight_of_urdf': result.urdf_weight,
        'effort_scale': result.scale and result.scale[0],
        'effort_delay': result.delay,
        'effort_delay_error': result.delay_error,
        'effort_delay_removed': result.delay_removed,
        'smoothing_window': result.smoothing,
        'samples': result.sample_count,
        'duration': result.duration,
        'notes': [*notes_of(result), *notes],
    }


def _body(body: BodyResult, accepted: bool) -> dict[str, Any]:
    kept = {} if accepted else {'mass': body.mass_before, 'com': body.com_before}
    return {**vars(body), **kept}


def _joint(joint: JointResult) -> dict[str, Any]:
    keys = {'width': 'coulomb_width', 'errors': 'standard_errors'}
    return {
        'name': joint.name,
        'unit': joint.unit,
        'measured': joint.measured,
        **vars(joint.unseen),
        'noise': joint.noise,
        **{keys.get(name, name): value for name, value in vars(joint.terms).items()},
        'friction_unknown_because': joint.unknown_because,
        'coupled_with': joint.coupled_with,
        'gain': joint.gain,
    }
