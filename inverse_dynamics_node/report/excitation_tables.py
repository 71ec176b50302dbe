"""Formats an excitation motion and the errors to expect in an identification."""

from __future__ import annotations

import numpy as np

from ..analysis.excitation.collisions import APART, CLEARANCE, Collisions
from ..analysis.excitation.information import SAMPLES_PER_SECOND
from ..analysis.excitation.limits import whole_positions
from ..analysis.excitation.search import Excitation
from ..errors import listed
from ..robot.model import Floats
from .tables import effort_unit, or_dash, table

_POSES = 200
"""Number of poses that show the space that the links need."""


def motion_notes(excitation: Excitation, collisions: Collisions | None) -> list[str]:
    """Return notes about the joints, about collisions, and about the space that the links need."""
    limits = excitation.limits
    q, _, _ = excitation.series.sample(np.linspace(0.0, excitation.series.duration, _POSES))
    return [*limits.notes, *_clearances(collisions, whole_positions(limits, q))]


def _clearances(collisions: Collisions | None, q: Floats) -> list[str]:
    """Return notes about collisions, and about the space that the links need."""
    if collisions is None:
        return ['collisions were NOT checked: the package coal is missing (pip install coal)']
    notes = ['collisions were NOT checked: no links have shapes that could collide']
    if collisions.has_pairs:
        notes = [
            f'the links keep {1e3 * APART:g} mm from each other, and {1e3 * CLEARANCE:g} mm from '
            'the floor and from boxes, also on the straight path to the start pose'
        ]
    notes += [
        f'{words}: {listed(names)}'
        for words, names in (
            ('not checked, because they have no readable shape', collisions.shapeless),
            ('not checked, because they touch in many poses', collisions.unchecked),
        )
        if names
    ]
    box = collisions.extent(q)
    if box is not None:
        sides = [
            f'{axis} {low:.2f} to {high:.2f}' for axis, low, high in zip('xyz', *box, strict=True)
        ]
        notes.append(
            f'space that the links need: {", ".join(sides)} m in the frame of the base; a payload '
            'is not included'
        )
    return notes


def errors_table(excitation: Excitation) -> str:
    """Return a table of the errors to expect in an identification from one run."""
    unknowns, robot = excitation.unknowns, excitation.unknowns.dynamics.robot
    of_joints, of_bodies = unknowns.expected_errors(excitation.information)
    no_terms = np.full(of_joints.shape[1], np.nan)
    rows = []
    for name, body, i in zip(robot.body_names[1:], of_bodies, robot.joint_index[1:], strict=True):
        k = excitation.limits.index.index(i) if name in excitation.limits.joint_names else -1
        armature, damping, coulomb, offset = of_joints[k] if k >= 0 else no_terms
        values = [damping, coulomb, offset, armature, *body]
        if not np.isnan(values).all():
            noise = f'{unknowns.noise[k]:.3g} {effort_unit(robot, i)}' if k >= 0 else '-'
            rows.append((name, noise, *(or_dash(x, '.2g') for x in values)))
    duration = excitation.series.duration
    return table(
        'Expected standard errors of one run, for each joint and the body that it moves',
        (
            *('joint', 'noise', 'damping', 'Coulomb', 'offset', 'armature'),
            *('mass [kg]', 'mass x distance [kg m]', 'inertia [kg m^2]'),
        ),
        rows,
        (
            f'assumes {SAMPLES_PER_SECOND * duration:g} independent samples in {duration:g} s, '
            'and no errors except those of the column "noise"; four runs halve all errors',
            'of a vector or tensor, the largest error; "-": the motion does not halve the error '
            'that a description usually has',
        ),
    )
