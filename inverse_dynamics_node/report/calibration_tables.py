"""Tables of a calibration: residuals, friction, masses."""

from __future__ import annotations

import math

from ..analysis.calibration import Calibration, JointResult
from .compare_report import motion_notes
from .quantities import with_error
from .tables import Table


def residual_table(calibration: Calibration) -> Table:
    """Return what each model leaves of the measured efforts, one row per joint."""
    rows = [
        (
            joint.name,
            f'{joint.measured:.4g}',
            f'{joint.unseen.urdf:.3g}',
            f'{joint.unseen.friction:.3g}',
            f'{joint.unseen.identified:.3g}',
            f'{joint.noise:.2g}',
            'N' if joint.is_prismatic else 'N m',
            f'{joint.training.friction:.3g}',
            f'{joint.training.identified:.3g}',
        )
        for joint in calibration.joints
    ]
    columns = ('joint', 'measured', 'URDF', '+ friction', 'identified', 'noise', '',
               'fitted: + friction', 'identified')  # fmt: skip
    notes = (
        f'RMS of the measured effort and of its difference to three models. Left: unseen data, '
        f'{calibration.unseen.description}. Right: the data that were fitted. Noise: the part of '
        'the residual that no model can explain, from the high frequencies of the efforts.',
    )
    return Table('Measured minus modelled efforts', columns, tuple(rows), notes, frozenset({6}))


def friction_table(calibration: Calibration) -> Table:
    """Return friction, armature and offset of every joint with standard errors."""
    rows = [_friction_row(joint) for joint in calibration.joints]
    columns = ('joint', 'damping', 'Coulomb', 'width', 'per load', 'armature', 'offset')
    notes = (
        'damping * velocity + (Coulomb + per load * |effort of the links|) * tanh(velocity / '
        'width) + armature * acceleration + offset, in N m, rad and s (prismatic joints: N, m, '
        's). Standard errors cover random errors only. Joints without an armature or a load '
        'friction predict as well without it.',
        *_gain_notes(calibration),
        *(
            f'{joint.name}: friction unknown, {joint.unknown_because}.'
            for joint in calibration.joints
            if joint.unknown_because
        ),
    )
    return Table('Joints', columns, tuple(rows), notes)


def _gain_notes(calibration: Calibration) -> list[str]:
    gains = [
        f'{joint.name} {joint.gain:.4g}' for joint in calibration.joints if joint.gain is not None
    ]
    return [f'Efforts are currents times gains: {", ".join(gains)}.'] if gains else []


def _friction_row(joint: JointResult) -> tuple[str, ...]:
    terms = joint.terms

    def cell(name: str) -> str:
        return (
            with_error(getattr(terms, name), terms.errors[name]) if name in terms.errors else '-'
        )

    width = '-' if joint.unknown_because else f'{terms.width:.2g}'
    return (
        joint.name,
        cell('damping'),
        cell('coulomb'),
        width,
        cell('load_friction'),
        cell('armature'),
        cell('offset'),
    )


def body_table(calibration: Calibration) -> Table:
    """Return masses and centres of mass before and after."""
    rows = []
    for body in calibration.bodies:
        rows.append(
            (
                body.link,
                f'{body.mass_before:.4g}',
                with_error(body.mass, body.mass_error),
                _millimetres(body.com_before),
                _millimetres(body.com),
                f'{1e3 * float(max(body.com_error)):.0f}',
                f'{body.data_fraction:.0%}',
            )
        )
    columns = ('link', 'mass [kg]', 'identified', 'centre of mass [mm]', 'identified', '±',
               'recorded')  # fmt: skip
    merged = [body for body in calibration.bodies if len(body.links) > 1]
    notes = [
        'Recorded: fraction of the information about the mass that comes from the recordings; the '
        'rest comes from the robot description. Masses that no effort depends on keep their '
        'value. Centres of mass are in the frame of the joint that moves the link.',
        *(
            f'{body.link} stands for {", ".join(body.links)}, which fixed joints hold together.'
            for body in merged
        ),
    ]
    if calibration.kept:
        notes.append(f'Kept as they are: {", ".join(calibration.kept)}.')
    if not calibration.accepted:
        notes.append('These values were not accepted and are not written.')
    return Table('Bodies', columns, tuple(rows), tuple(notes))


def summary_lines(calibration: Calibration) -> tuple[str, ...]:
    """Return sentences about the data and the fit."""
    delay = ''
    if math.isfinite(calibration.delay_error):
        late = 'late' if calibration.delay >= 0.0 else 'early'
        delay = (
            f'; efforts are {abs(calibration.delay) * 1e3:.1f} ± '
            f'{calibration.delay_error * 1e3:.1f} ms {late}'
        )
        delay += ', which was removed' if calibration.delay_removed else ''
    return (
        f'{calibration.sample_count} samples over {calibration.duration:.3g} s; efforts and all '
        f'columns of the fit smoothed over {calibration.smoothing * 1e3:.0f} ms; weight of the '
        f'robot description {calibration.gamma:.3g}, by cross-validation{delay}.',
        *(f'{note}.' for note in notes_of(calibration)),
    )


def notes_of(calibration: Calibration) -> tuple[str, ...]:
    """Return sentences about ignored, repaired and doubtful data, without a full stop."""
    notes = [note for motion in calibration.signals for note in motion_notes(motion)]
    return tuple(dict.fromkeys(notes))


def _millimetres(position: object) -> str:
    return ' '.join(f'{1e3 * x:.0f}' for x in position)  # type: ignore[attr-defined]
