"""Formats tables of an excitation motion and of the errors to expect in an identification."""

from __future__ import annotations

import numpy as np

from ..analysis.excitation.collisions import CLEARANCE, Collisions
from ..analysis.excitation.information import expected_errors, ExpectedErrors
from ..analysis.excitation.limits import whole_positions
from ..analysis.excitation.search import Excitation, SAMPLES_PER_SECOND
from ..dynamics.trajectory import Trajectory
from ..errors import listed
from ..robot.model import Floats, RobotModel
from .tables import effort_unit, fraction, number, or_dash, table


def excitation_tables(
    robot: RobotModel,
    excitation: Excitation,
    trajectory: Trajectory,
    efforts: Floats,
    collisions: Collisions | None,
) -> list[str]:
    """
    Return tables of an excitation motion and of the errors to expect in an identification.

    `trajectory` is the motion in the output file, which may be slower than `excitation`.
    `efforts` contains the modelled efforts, shape (points, joints) [N m or N]. `collisions` is
    None if collisions were not checked.
    """
    errors = expected_errors(excitation.unknowns, excitation.information)
    return [
        _motion(robot, excitation, trajectory, efforts, collisions),
        _joints(robot, excitation, errors),
        _bodies(robot, errors),
    ]


def _motion(
    robot: RobotModel,
    excitation: Excitation,
    trajectory: Trajectory,
    efforts: Floats,
    collisions: Collisions | None,
) -> str:
    index = robot.joint_indices(trajectory.joint_names)
    assert trajectory.velocities is not None
    speeds = np.max(np.abs(trajectory.velocities), axis=0)
    rows = []
    for k, i in enumerate(index):
        unit = 'm  ' if robot.is_prismatic_joint[i] else 'rad'
        q = trajectory.positions[:, k]
        peak = float(np.max(np.abs(efforts[:, k])))
        rows.append(
            (
                trajectory.joint_names[k],
                f'{q[0]:.3f} {unit}',
                f'{np.min(q):.2f} to {np.max(q):.2f}',
                f'{number(robot.lower[i])} to {number(robot.upper[i])}',
                f'{speeds[k]:.3g} {unit.strip()}/s',
                number(robot.velocity_limits[i]),
                f'{peak:.3g} {effort_unit(robot, i)}',
                fraction(peak, robot.effort_limits[i]),
            )
        )
    notes = [
        f'{excitation.series.harmonics} harmonics of {1.0 / trajectory.times[-1]:.3g} Hz; the '
        'motion starts and ends at rest, in the pose of the column "start"',
        *excitation.limits.notes,
        *_clearances(collisions, whole_positions(excitation.limits, trajectory.positions)),
    ]
    title = f'Excitation motion of {robot.name}: {trajectory.times[-1]:g} s'
    columns = ('joint', 'start', 'moves', 'limits', 'speed', 'limit', 'effort', 'of limit')
    return table(title, columns, rows, notes)


def _clearances(collisions: Collisions | None, q: Floats) -> list[str]:
    """Return notes about collisions, and about the space that the links need."""
    if collisions is None:
        return ['collisions were NOT checked: the package coal is missing (pip install coal)']
    notes = ['collisions were NOT checked: no links have shapes that could collide']
    if collisions.has_pairs:
        notes = [
            f'the links keep {1e3 * CLEARANCE:g} mm from each other, from the floor and from '
            'boxes, also on the straight path to the start pose'
        ]
    notes += [
        f'{words}: {listed(names)}'
        for words, names in (
            ('not checked, because they have no readable shape', collisions.shapeless),
            ('not checked, because they touch in many poses', collisions.unchecked),
            ('only kept from touching, because they are near in many poses', collisions.near),
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


def _joints(robot: RobotModel, excitation: Excitation, errors: ExpectedErrors) -> str:
    noise, names = excitation.unknowns.noise, excitation.series.joint_names
    rows = []
    for k, i in enumerate(excitation.limits.index):
        armature, damping, coulomb, offset = (or_dash(x, '.2g') for x in errors.of_joints[k])
        noise_of_joint = f'{noise[k]:.3g} {effort_unit(robot, i)}'
        rows.append((names[k], noise_of_joint, damping, coulomb, offset, armature))
    duration = excitation.series.duration
    return table(
        'Expected standard errors of one run, by joint',
        ('joint', 'noise', 'damping', 'Coulomb', 'offset', 'armature'),
        rows,
        (
            f'assumes {SAMPLES_PER_SECOND * duration:g} independent samples in {duration:g} s, '
            'and no errors except those of the column "noise"; four runs halve all errors',
            f'{len(excitation.unknowns.columns)} unknowns',
        ),
    )


def _bodies(robot: RobotModel, errors: ExpectedErrors) -> str:
    rows = [
        (name, *(or_dash(x, '.2g') for x in values))
        for name, values in zip(robot.body_names[1:], errors.of_bodies, strict=True)
        if not np.isnan(values).all()
    ]
    return table(
        'Expected standard errors of one run, for the body that each joint moves',
        ('joint', 'mass [kg]', 'mass x distance [kg m]', 'inertia [kg m^2]'),
        rows,
        (
            'For vectors and tensors, the table shows the largest error among the components. If '
            'only a combination of parameters can be identified, its error is listed at one joint '
            'of the combination. The other joints show "-" or are left out.',
        ),
    )
